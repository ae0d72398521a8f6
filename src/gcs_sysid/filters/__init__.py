"""Signal processing: complementary filter, tracking differentiators, windows."""
