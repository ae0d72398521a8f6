"""The inertial sensor's own stream: freed of outliers and moved to the CG before interpolation."""

import math
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.signals import outliers
from gcs_sysid.signals.stream_buffer import FAR, StreamBuffer, interpolate, neighbours, usual_gap

_SLOPE = 1
"""Samples on each side that angular acceleration takes."""
_GYRO = slice(0, 3)


@dataclass
class FaultCounts:
    """What was wrong with the samples of the inertial sensor.

    Attributes:
        spikes: samples with an outlier on a gyro axis, replaced by what their neighbours say.
        frozen: samples that repeat the one before in all six values, not used.
        missing: samples without a finite gyro, not used.
    """

    spikes: int = 0
    frozen: int = 0
    missing: int = 0


class InertialBuffer(StreamBuffer):
    """Recent samples of gyro and accelerometer, (n, 6), given out without outliers, at the CG.

    What it says of a time up to `settled` rests on the samples alone, not on when it is asked.

    Args:
        faults: counts what is found.
        arm: m, where the accelerometer sits, from the CG; None: there, as far as is known.
    """

    def __init__(self, faults: FaultCounts, arm: tuple[float, float, float] | None = None) -> None:
        super().__init__(6, keep=outliers.BEHIND + FAR + _SLOPE)
        self._arm = arm
        self.faults = faults
        self.step = 0.0
        """Usual time between samples, s, as the owner tells once it is known."""
        self._counted = -np.inf

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        other = super().__deepcopy__(memo)
        other.faults = deepcopy(self.faults, memo)  # its owner's copy counts in the same
        return other

    def push(self, t: float, values: tuple[float, ...]) -> None:
        """Add a sample, if its gyro is finite; its accelerometer need not be."""
        if not math.isfinite(values[0] + values[1] + values[2]):
            self.faults.missing += 1
            return
        super().push(t, values)

    def settled(self) -> float:
        """Time up to which later samples change nothing."""
        t, v = self._arrays()
        known, gap = t[~outliers.frozen(v)], usual_gap(self.step)
        ahead = outliers.AHEAD + neighbours(gap, self.step) + _SLOPE
        # A sensor that stands still must not hold everything up: past a gap nothing matters.
        latest = t[-1] - ahead * gap
        return float(max(known[-1 - ahead], latest) if len(known) > ahead else latest)

    def at(self, grid: Array, gap: float | None = None) -> Array:
        """(n, 6) values at the grid times, NaN in gaps, and where a spike cannot be replaced."""
        t, v = self._arrays()
        gap = usual_gap(self.step) if gap is None else gap
        frozen = outliers.frozen(v)
        stands = frozen.any()
        if stands:
            self._found(t[frozen], grid[-1], "frozen")
            t, v = t[~frozen], v[~frozen]
        gyro, spikes = outliers.despiked(t, v[:, _GYRO], gap, outliers.JOLT * self.step)
        if spikes.any():
            self._found(t[spikes.any(axis=1)], grid[-1], "spikes")
            v = np.hstack([gyro, v[:, 3:]])
        self._counted = float(grid[-1])
        if self._arm is not None and any(self._arm):
            v = np.hstack([v[:, _GYRO], at_cg(t, v[:, _GYRO], v[:, 3:], self._arm, gap)])
        return interpolate(t, v, grid, gap, neighbours(gap, self.step))

    def _found(self, times: Array, until: float, kind: str) -> None:
        new = int(np.count_nonzero((times > self._counted) & (times <= until)))
        setattr(self.faults, kind, getattr(self.faults, kind) + new)


def at_cg(
    t: Array, rates: Array, force: Array, arm: tuple[float, float, float], gap: float
) -> Array:
    """Specific force at the CG, from that at the sensor: less w' x r + w x (w x r).

    Args:
        t: (n,) s, rising.
        rates: (n, 3) rad/s.
        force: (n, 3) m/s^2.
        arm: r, the sensor from the CG in m.
        gap: s; samples further apart tell no angular acceleration.

    Returns:
        (n, 3) m/s^2, NaN beside gaps.
    """
    if len(t) < 2 * _SLOPE + 1:
        return np.full_like(force, np.nan)
    acceleration = np.gradient(rates, t, axis=0)
    apart = np.diff(t) > gap
    acceleration[1:][apart] = acceleration[:-1][apart] = np.nan
    turning = np.cross(rates, np.cross(rates, arm))
    out: Array = force - np.cross(acceleration, arm) - turning
    return out
