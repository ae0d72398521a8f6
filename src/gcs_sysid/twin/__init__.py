"""The identified model, flown with a log's inputs beside what the vehicle did."""
