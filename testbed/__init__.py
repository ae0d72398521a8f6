"""What tests and benchmarks share: vehicles, flights, recordings, harnesses, and who judges."""
