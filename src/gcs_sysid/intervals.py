"""What a 95 % interval is."""

Z95 = 1.959963984540054
"""Half width of the 95 % interval of a normal distribution, in standard deviations."""
