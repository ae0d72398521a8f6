"""The estimators that see a whole flight at once."""
