"""Faults of the inertial sensor that its data show: a gyro misread, samples beyond the range.

**The gyro against the attitude that the autopilot reports.** Over some tenths of a second the
attitude turns by the rotation vector phi, and the gyro integrates to theta. Where both measure the
same body,

    theta = G phi + b dt + tau (omega_1 - omega_0),

with G the identity, b the bias and tau by how much the attitude is late. A gyro in another unit or
of another scale, a turned board, a dead or exchanged axis shows in G. Terms of second order in the
turn are left out, with turns above half a radian.

Both sides are noisy: the autopilot corrects its attitude on the way, and a slow gyro misses turns.
Regressed one way a scale comes out too small, by the share R^2 that the fit explains at most.

**Saturation.** A sensor gives its last number again and again. No range need be known. The tails of
what a sensor measures thin out: its highest value comes no more often than the next lower one. A
sine dwells at its peaks; with its top rounded to steps q, it is in the last step 1 / (sqrt 2 - 1)
times as often as in the one before, the most of all motions without a flat top. So of the samples
at the two highest values that there ever were, a share of sqrt 2 / 2 at most is expected at the
highest, and a chance beyond that shows a limit.

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

from gcs_sysid.arrays import Array, Mask, complete_rows
from gcs_sysid.model import attitude
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
class GyroCheckRules:
    """Settings of the comparison.

    Attributes:
        interval: s, long against the attitude's lag, short against a turn.
        largest_turn: rad in an interval.
        fewest: intervals, some six for each of the seven unknowns of an axis.
        most: intervals that are kept, 40 minutes.
        least_share: explained, below which noise hides everything.
        noisy: share of noise in an attitude's turns, known to some 0.2, up to which they are
            turns.
        correlated: intervals over which corrections of an attitude go on.
    """

    interval: float = 0.3
    largest_turn: float = 0.5
    fewest: int = 40
    most: int = 8192
    least_share: float = 0.05
    noisy: float = 0.25
    correlated: int = 10


RULES = GyroCheckRules()


@dataclass(frozen=True)
class GyroAgainstAttitude:
    """What the gyro reads of what the attitude turns.

    Attributes:
        gain: (3, 3) G.
        std: (3, 3) its standard deviation, half of what noise of the attitude may hide included.
        bias: (3,) rad/s that the gyro reads too much.
        turned: (3,) rms, rad, of what the attitude turned in an interval; 0 where its noise may
            make most of that.
    """

    gain: Array
    std: Array
    bias: Array
    turned: Array


class GyroCheck:
    """Collects intervals of flight, block by block; how samples are grouped does not matter."""

    def __init__(self) -> None:
        self._number = -1
        self._run = 0
        self._last = False
        self._angle = np.zeros(3)
        self._ends: list[Array] = []
        self._before: tuple[float, Array] | None = None
        self._found: tuple[int, GyroAgainstAttitude | None] = 0, None

    def update(
        self,
        t: Array,
        gyro: Array,
        reported: Array,
        *,
        own: Mask | None = None,
        fresh: bool = False,
    ) -> None:
        """Take a block.

        Args:
            t: (n,) s.
            gyro: (n, 3) rad/s as measured; NaN where it does not fly or was not read.
            reported: (n, 4) attitude (w, x, y, z).
            own: (n,) where it was reported then: straight lines between reports of a slow one cut
                its turns short. None: wherever there is one.
            fresh: whether a gap lies before it.
        """
        there = complete_rows(gyro) & complete_rows(reported)
        if fresh:
            self._last = False
        joined = there & np.append(self._last, there[:-1])
        first = gyro[:1] if self._before is None else self._before[1][None]
        start = t[0] if self._before is None else self._before[0]
        rates = np.vstack([first, gyro])
        steps = 0.5 * (rates[1:] + rates[:-1]) * np.diff(t, prepend=start)[:, None]
        angle = self._angle + np.cumsum(np.where(joined[:, None], steps, 0.0), axis=0)
        run = self._run + np.cumsum(~joined)
        number = np.floor(t / RULES.interval).astype(np.int64)
        ends = np.flatnonzero(there if own is None else there & own)
        before, self._number = self._number, int(number[ends[-1]]) if len(ends) else self._number
        ends = ends[np.diff(number[ends], prepend=before) != 0]
        if len(ends) and len(self._ends) < RULES.most:
            columns = (t, run, angle, reported, gyro)
            self._ends += list(np.column_stack(columns)[ends])
        self._run, self._angle = int(run[-1]), angle[-1]
        self._last, self._before = bool(there[-1]), (float(t[-1]), gyro[-1].copy())

    def result(self) -> GyroAgainstAttitude | None:
        """What was found; None while there is too little to compare.

        It is renewed each time there is a fifth more, so that asking often costs little.
        """
        count = 2 * RULES.fewest
        if len(self._ends) < count:
            return None
        while (more := math.ceil(1.2 * count)) <= len(self._ends):
            count = more
        if count != self._found[0]:
            self._found = count, _compared(np.array(self._ends[:count]))
        return self._found[1]


def _compared(ends: Array) -> GyroAgainstAttitude | None:
    """From the (n, 12) ends of intervals: time, run, angle, attitude and rate."""
    t, run, angle, q, rate = np.split(ends, [1, 2, 5, 9], axis=1)
    same = (run[1:] == run[:-1])[:, 0] & (np.diff(t[:, 0]) < 2.0 * RULES.interval)
    dt = np.diff(t, axis=0)[same]
    phi = attitude.to_rotation_vector(attitude.multiply(attitude.conjugate(q[:-1]), q[1:]))[same]
    theta, change = np.diff(angle, axis=0)[same], np.diff(rate, axis=0)[same]
    small: Mask = np.linalg.norm(phi, axis=1) < RULES.largest_turn
    columns = np.column_stack([phi, dt, change])[small]
    phi, theta = phi[small], theta[small]
    if len(phi) < RULES.fewest:
        return None
    value, variances, shares = _robust(columns, theta)
    explained = np.maximum(shares, RULES.least_share)[:, None]
    gain = value[:, :3]
    half = 0.5 * gain * (1.0 / explained - 1.0)
    gain, std = gain + half, np.hypot(np.sqrt(variances[:, :3]), half)
    bias = value[:, 3]
    turned = np.where(_noise_share(phi) < RULES.noisy, np.sqrt((phi**2).mean(axis=0)), 0.0)
    return GyroAgainstAttitude(gain, std, bias, turned)


def _noise_share(phi: Array) -> Array:
    """(3,) share of the variance of (n, 3) turns that noise of the attitude makes.

    Differences of white noise that follow each other are correlated by -1/2.
    """
    following = (phi[1:] * phi[:-1]).mean(axis=0)
    return -2.0 * following / ((phi**2).mean(axis=0) + math.ulp(1.0))


def _robust(columns: Array, y: Array) -> tuple[Array, Array, Array]:
    """Least squares of (n, 3) y on (n, k) columns, Cauchy-weighted by all three at once.

    What corrects the attitude on the way, a fix or a compass, does so about every axis, and for
    seconds: scores that follow each other add up.

    Returns:
        (3, k) values, (3, k) their variances, (3,) explained shares.
    """
    ridge = 1e-9 * np.diag((columns**2).sum(axis=0) + math.ulp(1.0))
    # From a sound gyro on: a jump of the attitude alone has any least squares to itself.
    residual = y - columns[:, :3]
    residual = residual - np.median(residual, axis=0)
    for _ in range(10):
        scale = 2.0 * 1.4826 * np.median(np.abs(residual), axis=0) + 1e-9
        weights = 1.0 / (1.0 + ((residual / scale) ** 2).sum(axis=1))
        weighted = columns.T * weights
        inverse = np.linalg.inv(weighted @ columns + ridge)
        value = inverse @ (weighted @ y)
        residual = y - columns @ value
    starts = np.arange(0, len(y), RULES.correlated)
    scores = np.add.reduceat(columns[:, None] * (weights[:, None] * residual)[:, :, None], starts)
    variances = ((scores @ inverse) ** 2).sum(axis=0)
    shares = 1.0 - weights @ residual**2 / (weights @ y**2 + math.ulp(1.0))
    return value.T, variances, shares


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
        self.samples = 0
        """How many there were."""
        self._weighed, self._until = np.zeros(2), math.nan
        """Size of the specific force over time, and that time."""
        self._steps: list[deque[tuple[int, float]]] = [deque(maxlen=8192) for _ in range(6)]
        """Of each axis, over more than half of the range so far: number of the sample, step."""

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
            self._steps[axis].append((self.samples + row, float(steps[row, axis])))
        self.samples, self._last = self.samples + len(samples), samples[-1:].copy()

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
