"""Samples beyond a sensor's range, found from the data: it gives its last number again and again.

No range need be known. The tails of what a sensor measures thin out: its highest value comes no
more often than the next lower one. A sine dwells at its peaks; with its top rounded to steps q, it
is in the last step 1 / (sqrt 2 - 1) times as often as in the one before, the most of all motions
without a flat top. So of the samples at the two highest values that there ever were, a share of
sqrt 2 / 2 at most is expected at the highest, and a chance beyond that shows a limit.

Other sensors go on from the other end: a step over nearly all of the range. Of a sine's steps over
more than half of its range, however rarely it is sampled, 53 % are nearly as large as that; one
that wraps around has hardly any between.

Whatever flies from v_0 to v_1 in the time t, its specific force has a mean of g + (v_1 - v_0) / t:
an accelerometer whose mean size is less reads too little.
"""

import math
from collections import deque
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import betainc

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.signals.stream_buffer import BREAK
from gcs_sysid.significance import FALSE_ALARM_RATE

_AT_PEAK = math.sqrt(0.5)
"""Share of a sine's samples in its two last steps that are in the last one."""
_NEARLY = 0.85
"""Share of the range that is nearly all of it."""
_OF_A_SINE = math.acos(_NEARLY) / math.acos(0.5)
"""Share of a sine's steps over more than half of its range that are over nearly all of it."""
_SMALLEST = np.tile(np.repeat([1.0, 12.0], 3), 2)
"""rad/s and m/s^2, below which no sensor has its limit: what rests or hangs reads the same."""
_FASTEST, _SCALE = 40.0, 0.05
"""m/s, by which a record may end faster than it began; scale error of a sound accelerometer."""


@dataclass(frozen=True)
class Saturated:
    """What a sensor could not measure.

    Attributes:
        sensor: "gyro" or "accelerometer".
        limit: that it stands at, rad/s or m/s^2.
        share: of its samples that do.
        wraps: whether it does not stand there, but goes on from the other end.
        low: whether it has no limit, but a mean size of `limit` that lacks `share` of gravity.
    """

    sensor: str
    limit: float
    share: float
    wraps: bool = False
    low: bool = False

    @property
    def absent(self) -> bool:
        """Whether there is none: it never reads anything."""
        return self.limit == 0.0


class Saturation:
    """Counts (n, 6) samples of gyro and accelerometer at their two outermost values."""

    def __init__(self) -> None:
        # Of the upper ends of six axes, then of the lower ones with their sign turned.
        self._values = np.full((2, 12), -np.inf)
        self._counts = np.zeros((2, 12))
        self._samples = np.zeros(6)
        self._last = np.full((1, 6), np.nan)
        self._passed = 0
        self._weighed, self._until = np.zeros(2), math.nan
        """Size of the specific force over time, and that time."""
        self._steps: list[deque[tuple[int, float]]] = [deque(maxlen=8192) for _ in range(6)]
        """Of each axis, over more than half of the range so far: number of the sample, step."""

    @property
    def samples(self) -> int:
        """How many there were."""
        return self._passed

    def update(self, t: Array, samples: Array) -> None:
        """Take samples as they come, NaN where missing, and (n,) s of theirs; blocks of any size
        count the same.
        """
        if not len(samples):
            return
        self._weigh(t, samples[:, 3:])
        self._samples += np.isfinite(samples).sum(axis=0)
        self._note_steps(samples)
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

    def _weigh(self, t: Array, force: Array) -> None:
        """Add up the size of (n, 3) specific force over time, but for gaps."""
        size, dt = np.linalg.norm(force, axis=1), np.diff(t, prepend=self._until)
        self._until = float(t[-1])
        counts = (size > 0.0) & (dt > 0.0) & (dt < BREAK)
        # One after the other: sums are the same however samples are grouped.
        steps = np.column_stack([size * dt, dt])[counts]
        self._weighed = np.cumsum(np.vstack([self._weighed, steps]), axis=0)[-1]

    @property
    def _lacks(self) -> float:
        """Share of gravity that the accelerometer certainly does not read."""
        impulse, seconds = self._weighed.tolist()
        lacks = GRAVITY * seconds - impulse
        certain = lacks > _SCALE * GRAVITY * seconds + _FASTEST
        return lacks / (GRAVITY * seconds) if certain else 0.0

    def _note_steps(self, samples: Array) -> None:
        """Keep the steps over more than half of the range so far."""
        steps = np.diff(np.vstack([self._last, samples]), axis=0)
        ends = np.maximum(self._values[0].reshape(2, 6), 0.0)
        there = np.nan_to_num(np.stack([samples, -samples], axis=1))
        spans = np.maximum.accumulate(np.concatenate([ends[None], there]))[1:].sum(axis=1)
        with np.errstate(invalid="ignore"):
            wide = np.abs(steps) > 0.5 * np.maximum(spans, 2.0 * _SMALLEST[:6])
        for row, axis in np.argwhere(wide).tolist():
            self._steps[axis].append((self._passed + row, float(steps[row, axis])))
        self._passed, self._last = self._passed + len(samples), samples[-1:].copy()

    def _wraps(self, axis: int) -> tuple[float, float] | None:
        """Limit and share of the samples beyond it, of an axis that certainly wraps around."""
        high, low = (float(end) for end in self._values[0].reshape(2, 6)[:, axis])
        span = high + low
        steps = [entry for entry in self._steps[axis] if abs(entry[1]) > 0.5 * span]
        wrapped = [entry for entry in steps if abs(entry[1]) > _NEARLY * span]
        up = sum(step > 0.0 for _, step in wrapped)
        # The ends of a number format are opposite; each excursion leads there and back.
        if abs(high - low) > (1.0 - _NEARLY) * span or not 0 < up < len(wrapped):
            return None
        between = len(steps) - len(wrapped) + 1.0
        if not betainc(len(wrapped), between, _OF_A_SINE) < FALSE_ALARM_RATE / 6:
            return None
        beyond = out = 0
        for (here, step), (there, _) in pairwise(wrapped):
            out = min(max(out - int(np.sign(step)), -1), 1)
            beyond += (there - here) * abs(out)
        return max(high, low), max(beyond, len(wrapped)) / max(float(self._samples[axis]), 1.0)

    @property
    def _weighs_nothing(self) -> bool:
        """Whether the gyro reads, and the accelerometer nothing: at rest it has 1 g."""
        nothing: Mask = self._values[0].reshape(2, 6)[:, 3:] <= 0.0
        return bool(self._samples[:3].any() and nothing.all())

    def found(self) -> tuple[Saturated, ...]:
        """The sensors that certainly stood at a limit."""
        at, before = self._counts
        # The binomial's upper tail: at least as many at the highest value, of those at both.
        chances = betainc(np.maximum(at, 1.0), before + 1.0, _AT_PEAK)
        limits = (chances < FALSE_ALARM_RATE / 12) & (self._values[0] > _SMALLEST)
        shares = np.where(limits, at / np.tile(np.maximum(self._samples, 1.0), 2), 0.0)
        out = []
        for sensor, axes in (("gyro", slice(0, 3)), ("accelerometer", slice(3, 6))):
            if sensor == "accelerometer" and self._weighs_nothing:
                out.append(Saturated(sensor, 0.0, 1.0))
                continue
            wraps = [w for axis in range(axes.start, axes.stop) if (w := self._wraps(axis))]
            if wraps:
                limit, share = (max(each) for each in zip(*wraps, strict=True))
                out.append(Saturated(sensor, limit, share, wraps=True))
                continue
            share = shares.reshape(2, 6)[:, axes].sum(axis=0)
            if share.any():
                ends = self._values[0].reshape(2, 6)[:, axes][limits.reshape(2, 6)[:, axes]]
                out.append(Saturated(sensor, float(ends.max()), float(share.max())))
            elif sensor == "accelerometer" and (lacks := self._lacks):
                out.append(Saturated(sensor, (1.0 - lacks) * GRAVITY, lacks, low=True))
        return tuple(out)
