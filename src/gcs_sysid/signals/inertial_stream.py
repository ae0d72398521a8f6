"""The inertial sensor's own stream: freed of outliers and moved to the CG before interpolation."""

from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.signals import outliers
from gcs_sysid.signals.interpolation import FAR, interpolate, neighbours, usual_gap
from gcs_sysid.signals.stream_buffer import StreamBuffer, as_known

_NONE = np.zeros(0, np.int64)
_SLOPE = 1
"""Samples on each side that angular acceleration takes."""
_GYRO = slice(0, 3)


@dataclass
class FaultCounts:
    """What was wrong with the samples of the inertial sensor.

    Attributes:
        spikes: samples with an outlier on a gyro axis, replaced by what their neighbors say.
        frozen: samples that repeat the one before in all six values, not used.
        missing: samples without a finite gyro, not used.
    """

    spikes: int = 0
    frozen: int = 0
    missing: int = 0


class InertialBuffer(StreamBuffer):
    """Recent samples of gyro and accelerometer, (n, 6), given out without outliers, at the CG.

    Its values up to `settled` depend on the samples alone, not on when they are requested.

    Args:
        faults: counts what is found.
        arm: m, where the accelerometer sits, from the CG; None: there, as far as is known.
    """

    def __init__(self, faults: FaultCounts, arm: tuple[float, float, float] | None = None) -> None:
        super().__init__(6, keep=outliers.BEHIND + FAR + _SLOPE)
        self._arm = arm
        self.faults = faults
        self.step = 0.0
        """Usual time between samples, s, set by the owner once known."""
        self._counted = -np.inf

    @property
    def gap(self) -> float:
        """S beyond which two samples have nothing between them, at the grid's step."""
        return usual_gap(self.step)

    @property
    def _among(self) -> int:
        return int(neighbours(np.array(self.gap), np.array(self.step)))

    @property
    def _ahead(self) -> int:
        """Samples after one that its value may use."""
        return outliers.AHEAD + self._among + _SLOPE

    def extend(self, t: Array, values: Array, marks: Array = _NONE) -> None:
        """Add samples whose gyro is finite, their accelerometer need not be; see `StreamBuffer`."""
        there = np.isfinite(values[:, :3].sum(axis=1))
        if not there.all():
            self.faults.missing += int(np.count_nonzero(~there))
            marks = np.concatenate([[0], np.cumsum(there)])[marks]
            t, values = t[there], values[there]
        super().extend(t, values, marks)

    def settled(self) -> Array:
        """(ticks,) s up to which later samples change nothing, as each tick knows it."""
        t, v = self._arrays()
        latest = t[self._known - 1] - self._ahead * self.gap
        sound = ~outliers.frozen(v)
        count = np.cumsum(sound)[self._known - 1]
        known = t[sound][np.maximum(count - 1 - self._ahead, 0)]
        # A sensor that stands still must not hold everything up: past a gap nothing matters.
        return np.where(count > self._ahead, np.maximum(known, latest), latest)

    def at(self, grid: Array, tick: Array) -> Array:
        """(n, 6) values, NaN in gaps, and where a spike cannot be replaced; see `StreamBuffer`."""
        t, v = self._arrays()
        known = self._known[tick]
        frozen = outliers.frozen(v)
        if frozen.any():
            self.faults.frozen += self._new(t[frozen], grid[-1])
            known = np.cumsum(~frozen)[known - 1]
            t, v = t[~frozen], v[~frozen]
        settled = (known == len(t)) | (known - np.searchsorted(t, grid) > self._ahead)

        def values_at(count: int, grid: Array) -> Array:
            return self._sound_values(t[:count], v[:count], grid)

        return as_known(values_at, grid, known, settled, len(t))

    def _sound_values(self, t: Array, v: Array, grid: Array) -> Array:
        gap = self.gap
        gyro, spikes = outliers.despiked(t, v[:, _GYRO], gap, outliers.JOLT * self.step)
        if spikes.any():
            self.faults.spikes += self._new(t[spikes.any(axis=1)], grid[-1])
            v = np.hstack([gyro, v[:, 3:]])
        self._counted = float(grid[-1])
        if self._arm is not None and any(self._arm):
            v = np.hstack([v[:, _GYRO], at_cg(t, v[:, _GYRO], v[:, 3:], self._arm, gap)])
        return interpolate(t, v, grid, gap, self._among)

    def _new(self, times: Array, until: float) -> int:
        """How many of the times, s, were not counted yet."""
        return int(np.count_nonzero((times > self._counted) & (times <= until)))


def at_cg(
    t: Array, rates: Array, force: Array, arm: tuple[float, float, float], gap: float
) -> Array:
    """Specific force at the CG, from that at the sensor: less w' x r + w x (w x r).

    Args:
        t: (n,) s, rising.
        rates: (n, 3) rad/s.
        force: (n, 3) m/s^2.
        arm: r, the sensor from the CG in m.
        gap: s; samples further apart give no angular acceleration.

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
