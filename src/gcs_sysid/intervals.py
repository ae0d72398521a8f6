"""What a 95 % interval is."""

from typing import overload

Z95 = 1.959963984540054
"""Half width of the 95 % interval of a normal distribution, in standard deviations."""


@overload
def interval95(value: float, std: float, *, not_negative: bool = False) -> tuple[float, float]: ...
@overload
def interval95(
    value: float | None, std: float | None, *, not_negative: bool = False
) -> tuple[float, float] | None: ...
def interval95(
    value: float | None, std: float | None, *, not_negative: bool = False
) -> tuple[float, float] | None:
    """The 95 % interval (normal), or None where there is no value.

    Args:
        value: estimated, or None.
        std: its standard deviation, or None.
        not_negative: whether the interval is cut off at zero. No true value lies below, so
            coverage stays at least 95 %.
    """
    if value is None or std is None:
        return None
    low = value - Z95 * std
    return (max(low, 0.0) if not_negative else low, value + Z95 * std)
