"""Did it change? One answer for flights in a log, for two results, for a fleet and for health.

Each compares estimates of one quantity, whose difference has the variance of both; errors of what
was given are the same in both and cancel. Whatever is compared together, in one test or in many,
an unchanged vehicle is called changed once in a hundred times. Single values have 95 % intervals.
"""

import math
from collections.abc import Sequence
from typing import overload

import numpy as np
from scipy.special import chdtrc, ndtri, stdtr, stdtrit

from gcs_sysid.arrays import Array

FALSE_ALARM_RATE = 0.01
"""Probability that an unchanged vehicle is called changed, of all that is tested together."""


def chance(difference: float, std: float) -> float:
    """Probability of a difference at least as large, either way, where there is none."""
    return math.erfc(abs(difference) / std / math.sqrt(2.0))


def joint_chance(difference: Array, covariance: Array) -> float:
    """The same of (n,) differences together, by chi-square."""
    square = float(difference @ np.linalg.solve(covariance, difference))
    return float(chdtrc(len(difference), square))


def student_chance(t: float, freedom: float) -> float:
    """The same of a difference of t standard deviations, as estimated from few values."""
    return 2.0 * float(stdtr(freedom, -abs(t)))


def holm(chances: Sequence[float]) -> list[float]:
    """Probabilities corrected for how many are tested: Holm's step-down procedure (1979).

    It holds however the estimates hang together.
    """
    corrected, least = [0.0] * len(chances), 0.0
    for rank, i in enumerate(sorted(range(len(chances)), key=chances.__getitem__)):
        least = max(least, min((len(chances) - rank) * chances[i], 1.0))
        corrected[i] = least
    return corrected


def student_limit(freedom: float, rate: float = FALSE_ALARM_RATE) -> float:
    """Student's t that is exceeded, either way, at this rate."""
    return float(stdtrit(freedom, 1.0 - 0.5 * rate))


def normal_limit(rate: float = FALSE_ALARM_RATE) -> float:
    """Standard deviations that are exceeded, either way, at this rate."""
    return float(ndtri(1.0 - 0.5 * rate))


Z95 = normal_limit(0.05)
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
