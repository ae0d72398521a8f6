"""Truth benchmark: how often what the program claims is so, on vehicles that are not its model."""
