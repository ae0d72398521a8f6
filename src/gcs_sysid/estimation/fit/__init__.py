"""From sums of rows to relative parameters: cost, search, covariance."""
