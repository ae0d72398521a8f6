"""The inertial sensor's own stream: freed of outliers and moved to the CG before interpolation.

Outliers: samples that agree with nothing around them, and samples that were never taken.

A Hampel test asks how far a sample lies from the median of its neighbors, in units of their
scatter. On a moving signal (a doublet at 20 Hz) that median is not where the sample should be, so
the sample is asked instead whether it agrees with any one of four readings of its neighbors: it
lies between the two sides, on the line through the two before it or the two after it, or on
the cubic through all four. Motion agrees with one of them, however hard; a spike with none, and
its neighbors still agree with the side that has no spike. Those between two spikes do not, but
with a line that passes over them. The unit is the median disagreement before, and what three of
the samples around exceed, so that vibration and noise raise the bar, and so does the start of
either, but two spikes do not.

A verdict depends on `AHEAD` samples after and `BEHIND` before, and on nothing else: samples may
come in any grouping.
"""

from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.signals.imu_checks import Saturation
from gcs_sysid.signals.stream_buffer import (
    BREAK,
    FAR,
    StreamBuffer,
    as_known,
    interpolate,
    neighbors,
    usual_gap,
)


@dataclass(frozen=True)
class SpikeRules:
    """What makes a sample a spike.

    Attributes:
        reach: neighbors on each side that a sample is compared with.
        around: samples on each side for the usual disagreement around.
        noise: so many of them that disagree are no spikes, but noise that begins.
        past: samples before those, for the usual disagreement.
        least_past: known disagreements among these, fewer than which allow no verdict.
        usual: a spike disagrees by so many medians; white noise, one sample in millions.
        fill: samples on each side among which a spike's sound neighbors are looked for.
    """

    reach: int = 2
    around: int = 3
    noise: int = 3
    past: int = 64
    least_past: int = 24
    usual: float = 15.0
    fill: int = 3


RULES = SpikeRules()
_OVER = ((-2, 1), (-1, 2), (-2, 2))
"""Neighbors whose lines pass over one that may be a spike."""
JOLT = 25.0
"""rad/s^2; what a sample of a gyro may disagree by in any case, over the time between samples."""

AHEAD = RULES.fill + RULES.reach + RULES.around
"""Samples after one that `despiked` needs for it: its neighbors' verdicts need theirs."""
BEHIND = AHEAD + RULES.past
"""The same before it."""
_NONE = np.zeros(0, np.int64)
_SLOPE = 1
"""Samples on each side that angular acceleration takes."""
_GYRO = slice(0, 3)


def despiked(t: Array, x: Array, gap: float, least: float) -> tuple[Array, Mask]:
    """Replace spikes by what their neighbors say, each column for itself.

    Args:
        t: (n,) s, rising.
        x: (n, width) samples.
        gap: s; samples further apart are not compared.
        least: unit of x; a smaller disagreement is no spike.

    Returns:
        (n, width), NaN where a spike has no sound neighbor on a side, x itself where there is
        no spike; and (n, width) where spikes were.
    """
    if len(t) < 2 * RULES.reach + 1 or not _may_spike(x, least):
        return x, np.zeros(x.shape, dtype=bool)
    with np.errstate(divide="ignore", invalid="ignore"):
        off, own = _disagreement(t, x, gap)
        size = np.minimum(own, _outside(x))
        spikes: Mask = size > least
        rows, columns = np.nonzero(spikes)
        spikes[rows, columns] = size[rows, columns] > RULES.usual * _usual(off, own, rows, columns)
    return (_filled(t, x, spikes, gap) if spikes.any() else x), spikes


class Standstill:
    """Finds samples that repeat the one before in every column because nothing was measured.

    Noise changes some value with every sample. Without it, as in a simulator, values stand until
    they have moved by a step of their number format: a repeat after a change of one step at most in
    each column is a measurement, unless the change is longer ago than any interval. Steps are the
    least changes so far, so that only samples before count, in any grouping.

    Args:
        width: columns of the samples.
    """

    def __init__(self, width: int) -> None:
        self._last = np.full((1, width), np.nan)
        self._steps = np.full((1, width), np.inf)
        self._moved = -np.inf
        """s of the latest change, if that was of single steps."""

    def update(self, t: Array, x: Array) -> Mask:
        """(n,) which of the next (n, width) samples at (n,) s measure nothing; NaN: missing."""
        before, self._last = np.vstack([self._last, x[:-1]]), x[-1:].copy()
        change = np.where(np.isnan(x) & np.isnan(before), 0.0, np.abs(x - before))
        least = np.where(change > 0.0, change, np.inf)
        steps = np.minimum.accumulate(np.vstack([self._steps, least]))
        self._steps = steps[-1:]
        repeats = (change == 0.0).all(axis=1)
        small = (change < 2.0 * steps[1:]).all(axis=1)
        moved = np.append(self._moved, np.where(small, t, -np.inf))
        latest = np.maximum.accumulate(np.append(0, np.where(repeats, 0, np.arange(1, len(x) + 1))))
        self._moved = float(moved[latest[-1]])
        return repeats & (t - moved[latest[1:]] > BREAK)


def _may_spike(x: Array, least: float) -> bool:
    """Whether any sample is `least` off the middle of its neighbors: cheap, and never missed."""
    bend = x[1:-1] - 0.5 * (x[:-2] + x[2:])
    return bool(max(bend.max(), -bend.min()) > least)


def _outside(x: Array) -> Array:
    """(n, width) how far a sample is from lying between its two sides; NaN at the ends.

    Each side is read by either of its two samples: between a value and a spike is no place.
    """
    out = np.full(x.shape, np.nan)
    middle, sizes = x[2:-2], []
    for left, right in ((x[1:-3], x[3:-1]), (x[1:-3], x[4:]), (x[:-4], x[3:-1])):
        clipped = np.clip(middle, np.minimum(left, right), np.maximum(left, right))
        sizes.append(np.abs(middle - clipped))
    out[2:-2] = np.max(sizes, axis=0)
    return out


def _disagreement(t: Array, x: Array, gap: float) -> tuple[Array, Array]:
    """(n, width) distance to the nearest of the two lines and the cubic; NaN: fewer than two.

    And (n, width) to the nearest of these and of the lines that pass over a neighbor: remainder of
    a sample's disagreement when its neighbors may be spikes.
    """
    step = np.diff(t)
    step[step > gap] = np.nan
    slope = np.diff(x, axis=0) / step[:, None]
    bend = np.abs(np.diff(slope, axis=0))
    readings = np.full((3, *x.shape), np.nan)
    readings[0, 2:] = bend * step[1:, None]
    readings[1, :-2] = bend * step[:-1, None]
    k = np.arange(RULES.reach, len(t) - RULES.reach)
    around = k[:, None] + np.array([-2, -1, 1, 2])
    apart = t[k, None] - t[around]
    weights = np.ones_like(apart)
    for j in range(4):
        for i in range(4):
            if i != j:
                weights[:, j] *= apart[:, i] / (t[around[:, j]] - t[around[:, i]])
    cubic = np.einsum("kj,kjw->kw", weights, x[around])
    broken = np.isnan(step[around[:, 0]] + step[k - 1] + step[k] + step[k + 1])
    cubic[broken] = np.nan
    readings[2, k] = np.abs(x[k] - cubic)
    off: Array = np.fmin(np.fmin(readings[0], readings[1]), readings[2])
    # By one reading alone, a spike beside a sample would be taken for one in it.
    off[np.isnan(readings).sum(axis=0) > 1] = np.nan
    own = off.copy()
    for left, right in _OVER:
        share = (t[k] - t[k + left]) / (t[k + right] - t[k + left])
        line = x[k + left] + share[:, None] * (x[k + right] - x[k + left])
        own[k] = np.where(broken[:, None], own[k], np.fmin(own[k], np.abs(x[k] - line)))
    return off, own


def _usual(off: Array, own: Array, rows: Array, columns: Array) -> Array:
    """(m,) usual disagreement at those places, the larger of that around and that before."""
    near = rows[:, None] + np.arange(-RULES.around, RULES.around + 1)
    past = rows[:, None] - RULES.around - 1 - np.arange(RULES.past)
    places = np.arange(len(rows))
    around, known = _sorted(own, near, columns)
    noise = around[places, np.maximum(known - RULES.noise, 0)]
    before, known = _sorted(off, past, columns)
    median = before[places, np.maximum(known - 1, 0) // 2]
    # Without enough of the past nothing is known to be unusual.
    return np.where(known < RULES.least_past, np.inf, np.fmax(noise, median))


def _sorted(off: Array, rows: Array, columns: Array) -> tuple[Array, Array]:
    """(m, k) values of (m, k) rows, rising, unknown ones last; (m,) how many are known."""
    inside = (rows >= 0) & (rows < len(off))
    values = np.where(inside, off[np.clip(rows, 0, len(off) - 1), columns[:, None]], np.nan)
    values = np.sort(values, axis=1)
    return values, np.isfinite(values).sum(axis=1)


def _filled(t: Array, x: Array, spikes: Mask, gap: float) -> Array:
    """Spikes replaced by the cubic through four neighbors, or the line where it must be."""
    out: Array = x.copy()
    for row, column in zip(*np.nonzero(spikes), strict=True):
        near = np.arange(max(row - RULES.fill, 0), min(row + RULES.fill + 1, len(t)))
        sound = near[~spikes[near, column]]
        before, after = sound[sound < row][-2:], sound[sound > row][:2]
        out[row, column] = np.nan
        if not len(before) or not len(after) or t[after[0]] - t[before[-1]] > gap:
            continue
        chosen = np.concatenate([before, after])
        if len(chosen) < 4 or t[chosen[-1]] - t[chosen[0]] > 2.0 * gap:
            chosen = np.array([before[-1], after[0]])
        out[row, column] = _lagrange(t[chosen] - t[row], x[chosen, column])
    return out


def _lagrange(t: Array, x: Array) -> float:
    """The polynomial through the points, at t = 0."""
    total = 0.0
    for j in range(len(t)):
        others = np.delete(t, j)
        total += x[j] * float(np.prod(others / (others - t[j])))
    return total


@dataclass
class FaultCounts:
    """What was wrong with the samples of the inertial sensor.

    Attributes:
        spikes: samples with an outlier on a gyro axis, replaced by what their neighbors say.
        frozen: samples that repeat the one before in all six values and measure nothing, not used.
        missing: samples without a finite gyro, not used.
    """

    spikes: int = 0
    frozen: int = 0
    missing: int = 0


class InertialBuffer(StreamBuffer):
    """Recent samples of gyro and accelerometer, (n, 6), given out without outliers, at the CG.

    Its values up to `settled` depend on the samples alone, not on when they are requested. `arm` is
    m, where the accelerometer sits, from the CG; None: there, as far as is known.
    """

    def __init__(
        self,
        faults: FaultCounts,
        saturation: Saturation,
        arm: tuple[float, float, float] | None = None,
    ) -> None:
        super().__init__(7, keep=BEHIND + FAR + _SLOPE)  # the last one: whether it is frozen
        self._arm = arm
        self._standstill = Standstill(6)
        self.faults = faults
        self._saturation = saturation
        self.step = 0.0
        """Usual time between samples, s, set by the owner once known."""
        self._counted = -np.inf

    @property
    def gap(self) -> float:
        """S beyond which two samples have nothing between them, at the grid's step."""
        return usual_gap(self.step)

    @property
    def _among(self) -> int:
        return int(neighbors(np.array(self.gap), np.array(self.step)))

    @property
    def _ahead(self) -> int:
        """Samples after one that its value may use."""
        return AHEAD + self._among + _SLOPE

    def extend(self, t: Array, values: Array, marks: Array = _NONE) -> None:
        """Add samples whose gyro is finite, their accelerometer need not be; see `StreamBuffer`."""
        values = values[:, :6]
        self._saturation.update(t, values)
        there = np.isfinite(values[:, :3].sum(axis=1))
        if not there.all():
            self.faults.missing += int(np.count_nonzero(~there))
            marks = np.concatenate([[0], np.cumsum(there)])[marks]
            t, values = t[there], values[there]
        if len(t):
            values = np.column_stack([values, self._standstill.update(t, values)])
        super().extend(t, values, marks)

    def settled(self) -> Array:
        """(ticks,) s up to which later samples change nothing, as each tick knows it."""
        t, v = self._arrays()
        latest = t[self._known - 1] - self._ahead * self.gap
        sound = ~self._stuck(v)
        count = np.cumsum(sound)[self._known - 1]
        known = t[sound][np.maximum(count - 1 - self._ahead, 0)]
        # A sensor that stands still must not hold everything up: past a gap nothing matters.
        return np.where(count > self._ahead, np.maximum(known, latest), latest)

    @staticmethod
    def _stuck(v: Array) -> Mask:
        """(n,) which samples of the buffer measure nothing; its first stands for those before."""
        stuck: Mask = v[:, -1] > 0.0
        stuck[:1] = False
        return stuck

    def at(self, grid: Array, tick: Array) -> Array:
        """(n, 6) values, NaN in gaps, and where a spike cannot be replaced; see `StreamBuffer`."""
        t, v = self._arrays()
        known = self._known[tick]
        stuck, v = self._stuck(v), v[:, :-1]
        if stuck.any():
            self.faults.frozen += self._new(t[stuck], grid[-1])
            known = np.cumsum(~stuck)[known - 1]
            t, v = t[~stuck], v[~stuck]
        settled = (known == len(t)) | (known - np.searchsorted(t, grid) > self._ahead)

        def values_at(count: int, grid: Array) -> Array:
            return self._sound_values(t[:count], v[:count], grid)

        return as_known(values_at, grid, known, settled, len(t))

    def _sound_values(self, t: Array, v: Array, grid: Array) -> Array:
        gap = self.gap
        gyro, spikes = despiked(t, v[:, _GYRO], gap, JOLT * self.step)
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
    return force - np.cross(acceleration, arm) - turning
