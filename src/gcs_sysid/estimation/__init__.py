"""From regression rows to parameters: statistics, fit, uncertainty."""
