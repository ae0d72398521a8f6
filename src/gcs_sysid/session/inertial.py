"""The inertial sensor's own stream: spikes and frozen repeats taken out before interpolation."""

import math
from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.filters import outliers
from gcs_sysid.session.streams import StreamBuffer, interpolate, usual_gap

_CUBIC = 2
"""Samples on each side that interpolation takes."""
_AHEAD = outliers.AHEAD + _CUBIC
_GYRO = slice(0, 3)


@dataclass
class SensorFaults:
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
    """Recent samples of gyro and accelerometer, (n, 6), given out without outliers.

    What it says of a time up to `settled` rests on the samples alone, not on when it is asked.

    Args:
        faults: counts what is found.
    """

    def __init__(self, faults: SensorFaults) -> None:
        super().__init__(6, keep=outliers.BEHIND + _CUBIC)
        self.faults = faults
        self.step = 0.0
        """Usual time between samples, s, as the owner tells once it is known."""
        self._counted = -np.inf

    def push(self, t: float, values: tuple[float, ...]) -> None:
        """Add a sample, if its gyro is finite; its accelerometer need not be."""
        if not math.isfinite(values[0] + values[1] + values[2]):
            self.faults.missing += 1
            return
        super().push(t, values)

    def settled(self) -> float:
        """Time up to which later samples change nothing."""
        t, v = self._arrays()
        known = t[~outliers.frozen(v)]
        # A sensor that stands still must not hold everything up: past a gap nothing matters.
        latest = t[-1] - _AHEAD * usual_gap(self.step)
        return float(max(known[-1 - _AHEAD], latest) if len(known) > _AHEAD else latest)

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
        return interpolate(t, v, grid, gap)

    def _found(self, times: Array, until: float, kind: str) -> None:
        new = int(np.count_nonzero((times > self._counted) & (times <= until)))
        setattr(self.faults, kind, getattr(self.faults, kind) + new)
