"""A benchmark that others can enter: the same flights for every estimator, and one score."""
