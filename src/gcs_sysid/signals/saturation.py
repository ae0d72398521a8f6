"""Samples beyond a sensor's range, found from the data: it gives its last number again and again.

No range need be known. The tails of what a sensor measures thin out: its highest value comes no
more often than the next lower one. A sine dwells at its peaks; with its top rounded to steps q, it
is in the last step 1 / (sqrt 2 - 1) times as often as in the one before, the most of all motions
without a flat top. So of the samples at the two highest values that there ever were, a share of
sqrt 2 / 2 at most is expected at the highest, and a chance beyond that shows a limit.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import betainc

from gcs_sysid.arrays import Array
from gcs_sysid.change_test import FALSE_ALARM_RATE

_AT_PEAK = math.sqrt(0.5)
"""Share of a sine's samples in its two last steps that are in the last one."""
_SMALLEST = np.tile(np.repeat([1.0, 12.0], 3), 2)
"""rad/s and m/s^2, below which no sensor has its limit: what rests or hangs reads the same."""


@dataclass(frozen=True)
class Saturated:
    """What a sensor could not measure.

    Attributes:
        sensor: "gyro" or "accelerometer".
        limit: that it stands at, rad/s or m/s^2.
        share: of its samples that do.
    """

    sensor: str
    limit: float
    share: float


class Saturation:
    """Counts (n, 6) samples of gyro and accelerometer at their two outermost values."""

    def __init__(self) -> None:
        # Of the upper ends of six axes, then of the lower ones with their sign turned.
        self._values = np.full((2, 12), -np.inf)
        self._counts = np.zeros((2, 12))
        self._samples = np.zeros(6)

    def update(self, samples: Array) -> None:
        """Take samples as they come, NaN where missing; blocks of any size count the same."""
        if not len(samples):
            return
        self._samples += np.isfinite(samples).sum(axis=0)
        both = np.column_stack([samples, -samples])
        both = np.where(np.isnan(both), -np.inf, both)
        highest = both.max(axis=0)
        second = np.where(both == highest, -np.inf, both).max(axis=0)
        values = np.vstack([self._values, highest, second])
        counts = np.vstack([self._counts, (both == highest).sum(0), (both == second).sum(0)])
        for row in range(2):
            found = values.max(axis=0)
            there = values == found
            self._values[row], self._counts[row] = found, (there * counts).sum(axis=0)
            values = np.where(there, -np.inf, values)

    def found(self) -> tuple[Saturated, ...]:
        """The sensors that certainly stood at a limit."""
        at, before = self._counts
        # The binomial's upper tail: at least as many at the highest value, of those at both.
        chances = betainc(np.maximum(at, 1.0), before + 1.0, _AT_PEAK)
        limits = (chances < FALSE_ALARM_RATE / 12) & (self._values[0] > _SMALLEST)
        shares = np.where(limits, at / np.tile(np.maximum(self._samples, 1.0), 2), 0.0)
        out = []
        for sensor, axes in (("gyro", slice(0, 3)), ("accelerometer", slice(3, 6))):
            share = shares.reshape(2, 6)[:, axes].sum(axis=0)
            if share.any():
                limit = self._values[0].reshape(2, 6)[:, axes][limits.reshape(2, 6)[:, axes]]
                out.append(Saturated(sensor, float(limit.max()), float(share.max())))
        return tuple(out)
