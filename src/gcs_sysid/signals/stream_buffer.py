"""The recent samples of one stream: put in order, kept as arrays, interpolated."""

from collections import deque
from collections.abc import Sequence
from copy import copy
from typing import Any, Self

import numpy as np

from gcs_sysid.arrays import Array

STEP_SAMPLES = 64
"""Samples from which the usual interval is taken."""
_RENEW = 16
"""Samples after which the usual interval is taken anew, and by which a change of it is told."""
BREAK = 1.0
"""s; a longer silence is no interval."""
_KEEP = 8
"""Samples of a stream kept behind the grid for interpolation."""
_ALIKE, _STILL = 0.7, 0.3
"""Share of steps that make up a stream's rate, and that show that it is still the same."""
_SAME = 5e-7
"""Times closer than this (s) are the same: stamps are whole microseconds."""
_SHORTEST = 0.04
"""s; a shorter time is no gap."""
_BRIDGED = ((4, 0.052), (2, 0.065))
"""Lost samples in a row that are bridged, as long as the gap (s) is not longer."""
FAR = 4
"""Samples on each side of a point among which interpolation looks for its two, where there may be
long gaps. Elsewhere these are the nearest."""
_WIDE = 3.5
"""Times the distance to its outer neighbours that a gap may have. A cubic across a longer one would
multiply their noise, by 3 for ten lost samples."""
_REORDER = 0.02
"""s; a sample that comes after one so much newer still finds its place. The grid, which is 0.04 s
behind at least, has not been there."""
_MOST = 4096
"""Samples of each stream kept while no grid takes them (an IMU that is silent)."""
_AT_ONCE, _LEAST = 512, 256
"""Samples that wait at most to be put into the arrays, and least size of these."""


class StreamBuffer:
    """Recent samples of one stream, in strictly rising time.

    Args:
        width: numbers in a sample.
        hold: whether the last value holds (states) instead of being interpolated (signals).
        bridged: s; a shorter time between samples is no gap, however fast they usually come.
        keep: samples kept behind the grid.
    """

    def __init__(
        self, width: int, *, hold: bool = False, bridged: float = 0.0, keep: int = _KEEP
    ) -> None:
        self.width = width
        self._keep = keep
        self._bridged = bridged
        self.hold = hold
        self.repeated = 0
        """Samples dropped because their stamp was not new."""
        self.interval = 0.0
        """Usual time between samples in s, see `usual_interval`; 0 until it is known."""
        self._newest = -np.inf
        self._steps: deque[float] = deque(maxlen=STEP_SAMPLES)
        self._count = 0
        # What came since the arrays were last asked for; a list grows cheapest.
        self._new_t: list[float] = []
        self._new_values: list[tuple[float, ...]] = []
        self._t = np.empty(_LEAST)
        self._values = np.empty((_LEAST, width))
        self._start = self._end = 0

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        # Nothing but arrays and numbers, of which the arrays alone are written to.
        t, values = self._arrays()
        other = copy(self)
        other._steps = self._steps.copy()
        other._new_t, other._new_values = [], []
        other._t, other._values, other._start, other._end = t.copy(), values.copy(), 0, len(t)
        return other

    def __len__(self) -> int:
        return self._end - self._start + len(self._new_t)

    def push(self, t: float, values: tuple[float, ...]) -> None:
        """Add a sample; one whose stamp was there before, or is far behind, is dropped."""
        step = t - self._newest
        if step <= 0.0:
            if step <= -_REORDER or not self._insert(t, values):
                self.repeated += 1
            return
        self._newest = t
        self._new_t.append(t)
        self._new_values.append(values)
        if step < BREAK or self.hold:
            self._steps.append(step)
            self._count += 1
            if self._count % _RENEW == 0 or self._count < _RENEW:
                self.interval = usual_interval(self._steps)
        if len(self._new_t) > _AT_ONCE:
            self._arrays()

    def extends(self, t: Array, values: Array) -> bool:
        """Whether samples are like those before, go on where they ended, and rise in time."""
        if values.shape[1] != self.width:
            return False
        return bool(t[0] > self._newest and (np.diff(t) > 0.0).all())

    def extend(self, t: Array, values: Array) -> None:
        """Add (n,) times and (n, width) samples that `extends` allows, as `push` one by one."""
        _, n = self._arrays(), len(t)
        steps = np.diff(t, prepend=self._newest)
        if not self.hold:
            steps = steps[steps < BREAK]
        every = [*self._steps, *steps[-STEP_SAMPLES - _RENEW :].tolist()]
        self._count += len(steps)
        renewed = len(every) - (self._count % _RENEW if self._count >= _RENEW else 0)
        if renewed > len(self._steps):
            self.interval = usual_interval(every[max(renewed - STEP_SAMPLES, 0) : renewed])
        self._steps = deque(every, maxlen=STEP_SAMPLES)
        self._newest = float(t[-1])
        if self._end + n > len(self._t):
            self._make_room(n)
        self._t[self._end : self._end + n] = t
        self._values[self._end : self._end + n] = values
        self._end += n

    @property
    def knows_interval(self) -> bool:
        """Whether enough samples came to know the interval."""
        return len(self._steps) >= STEP_SAMPLES - 1

    @property
    def is_settled(self) -> bool:
        """Whether the last few samples came at the rate of all those that the interval is of."""
        last = list(self._steps)[-_RENEW:]
        return self.knows_interval and abs(sum(last) / len(last) / self.interval - 1.0) < 0.2

    def keeps_step(self, step: float) -> bool:
        """Whether the stream still comes at this step, s, though many of its samples are lost."""
        near = sum(0.75 * step < s < 1.25 * step for s in self._steps)
        return near >= _STILL * len(self._steps)

    @property
    def oldest(self) -> float:
        """Time of the oldest sample kept."""
        return float(self._arrays()[0][0])

    @property
    def gap(self) -> float:
        """Time in s beyond which two samples have nothing between them."""
        return max(usual_gap(self.interval), self._bridged)

    def known_until(self, horizon: float) -> float:
        """Time up to which samples to come change nothing, if none of before `horizon` does.

        After a lost sample the next may still bridge the gap: that is worth waiting for. A stream
        that has been silent for longer holds nothing up.
        """
        t, _ = self._arrays()
        if not len(t) or t[-1] + self.gap < horizon:
            return np.inf
        last = t[-neighbours(self.gap, self.interval) :]
        broken = np.flatnonzero(np.diff(last) > self.gap)
        return float(last[broken[-1] + 1 if len(broken) else 0])

    def at(self, grid: Array, gap: float | None = None) -> Array:
        """(n, width) values at the grid times, NaN where the stream has a gap.

        Args:
            grid: (n,) times wanted.
            gap: s, a longer time between samples is one; None: by the stream's own interval.
        """
        t, v = self._arrays()
        if not len(t):
            return np.full((len(grid), self.width), np.nan)
        if self.hold:
            if t[-1] <= grid[0]:
                return np.repeat(v[-1:], len(grid), axis=0)
            index = np.searchsorted(t, grid + _SAME, side="right") - 1
            return np.where(index[:, None] >= 0, v[np.maximum(index, 0)], np.nan)
        if gap is None:
            gap = self.gap
        among = neighbours(gap, self.interval)
        return interpolate(*self._sound(t, v, grid, gap), grid, gap, among)

    def _sound(self, t: Array, v: Array, grid: Array, gap: float) -> tuple[Array, Array]:
        """The samples to interpolate between: here all of them."""
        return t, v

    def stamps(self, grid: Array) -> Array:
        """(n,) s, times of the latest samples at the grid times, NaN where there is none."""
        t, _ = self._arrays()
        index = np.searchsorted(t, grid + _SAME, side="right") - 1
        return np.append(t, np.nan)[index]  # -1 is the NaN

    def forget_before(self, t: float) -> None:
        """Drop what no later grid point needs."""
        times, _ = self._arrays()
        older = int(np.searchsorted(times, t))
        self._start += max(min(older, len(times)) - self._keep, 0)

    def _drop_after(self, t: float) -> int:
        """Forget the samples after a time, as if they had not come; how many there were."""
        times, _ = self._arrays()
        dropped = len(times) - int(np.searchsorted(times, t, side="right"))
        self._end -= dropped
        if dropped:
            self._newest = t
        return dropped

    def _arrays(self) -> tuple[Array, Array]:
        """Times and values of all samples, as views."""
        n = len(self._new_t)
        if n:
            if self._end + n > len(self._t):
                self._make_room(n)
            self._t[self._end : self._end + n] = self._new_t
            self._values[self._end : self._end + n] = self._new_values
            self._end += n
            self._new_t.clear()
            self._new_values.clear()
            self._start = max(self._start, self._end - _MOST)
        kept = slice(self._start, self._end)
        return self._t[kept], self._values[kept]

    def _make_room(self, n: int) -> None:
        """Move what is kept to the front of arrays that hold n more, twice over."""
        kept, count = slice(self._start, self._end), self._end - self._start
        size = max(2 * (count + n), _LEAST)
        t, values = np.empty(size), np.empty((size, self.width))
        t[:count], values[:count] = self._t[kept], self._values[kept]
        self._t, self._values, self._start, self._end = t, values, 0, count

    def _insert(self, t: float, values: tuple[float, ...]) -> bool:
        """Put a sample between older ones, if there is none of its time."""
        times, _ = self._arrays()
        at = self._start + int(np.searchsorted(times, t))
        if at == self._start or self._t[at] == t:
            return False
        if self._end == len(self._t):
            shift = self._start
            self._make_room(1)
            at -= shift - self._start
        for array in (self._t, self._values):
            array[at + 1 : self._end + 1] = array[at : self._end].copy()
        self._t[at], self._values[at] = t, values
        self._end += 1
        return True


def usual_gap(interval: float) -> float:
    """Time in s beyond which two samples of a stream have nothing between them.

    One lost sample is always bridged. So are more, four in a row at 100 Hz and two at 50 Hz, as
    long as the gap stays short against the windows of the estimator (0.2 s), which hardly let
    anything faster through: over a link that loses every fifth message half of all windows would
    else be lost, most of all those of the momentum balance, which lives on long unbroken stretches.
    """
    bridged = (min((lost + 1.2) * interval, most) for lost, most in _BRIDGED)
    return max(2.6 * interval, *bridged, _SHORTEST) + _SAME


def neighbours(gap: float, interval: float) -> int:
    """Samples on each side that `interpolate` looks at, of a stream with such gaps.

    Args:
        gap: s, longest that is bridged.
        interval: s, the usual one.
    """
    return FAR if gap > _WIDE * interval else 2


def usual_interval(steps: Sequence[float]) -> float:
    """Time between samples that may be skipped, or come by turns at short and long intervals.

    Where most steps are alike (PX4, which skips a few), their mean; else (ArduPilot, which sends
    on its loop, 250 Hz by turns after 2.5 and 5 ms) the mean of all, where the median would be
    the longer one.

    Args:
        steps: s, at least one.
    """
    middle = sorted(steps)[len(steps) // 2]
    near = [step for step in steps if 0.75 * middle < step < 1.25 * middle]
    alike = near if len(near) >= _ALIKE * len(steps) else steps
    return sum(alike) / len(alike)


def interpolate(t: Array, v: Array, grid: Array, gap: float, among: int = 2) -> Array:
    """Cubic interpolation through four samples (Lagrange, any spacing).

    These are the two nearest, and on either side of them the next; if that is near against the gap
    between the two, one further out.

    Args:
        t: (m,) rising sample times.
        v: (m, width) samples.
        grid: (n,) times wanted.
        gap: samples further apart than this have nothing between them.
        among: how many samples on each side the outer ones may be looked for.

    Returns:
        (n, width), NaN outside the samples and inside gaps. Next to a gap or an end the two
        neighbours alone are used.

    Example:
        >>> t = np.array([0.0, 1.0, 2.0, 3.0, 9.0])
        >>> interpolate(t, t[:, None] ** 3, np.array([1.5, 3.0, 5.0]), gap=2.0)[:, 0]
        array([ 3.375, 27.   ,    nan])
    """
    n, m = len(grid), len(t)
    if m < 2:
        return np.full((n, v.shape[1]), np.nan)
    right = np.searchsorted(t, grid, side="left")
    np.clip(right, 1, m - 1, out=right)
    left = right - 1
    before, after = t[left], t[right]
    past, ahead = grid - before, after - grid
    step = after - before
    inside = (past >= 0.0) & (ahead >= 0.0) & (step <= gap)
    out: Array = v[left] + (past / step)[:, None] * (v[right] - v[left])
    # A sample exactly on the grid is taken as it is, even beside a gap.
    on_left, on_right = np.abs(past) < _SAME, np.abs(ahead) < _SAME
    first, last = np.maximum(left - 1, 0), np.minimum(right + 1, m - 1)
    width_before, width_after = before - t[first], t[last] - after
    for k in range(2, among):
        near = step > _WIDE * np.minimum(width_before, width_after)
        if not near.any():
            break
        near_before, near_after = step > _WIDE * width_before, step > _WIDE * width_after
        outer = np.maximum(left - k, 0)
        first = np.where(near_before & (before - t[outer] <= gap), outer, first)
        outer = np.minimum(right + k, m - 1)
        last = np.where(near_after & (t[outer] - after <= gap), outer, last)
        width_before, width_after = before - t[first], t[last] - after
    cubic = inside & ~on_left & ~on_right
    cubic &= (width_before > 0.0) & (width_before <= gap) & (width_after > 0.0)
    cubic &= width_after <= gap
    if cubic.any():
        # All points, those without four neighbours too: few enough, and cheaper than picking.
        index = np.stack([first, left, right, last])
        d = grid - t[index]
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b, c = width_before, step, width_after
            weights = np.stack(
                [
                    -d[1] * d[2] * d[3] / (a * (a + b) * (a + b + c)),
                    d[0] * d[2] * d[3] / (a * b * (b + c)),
                    -d[0] * d[1] * d[3] / ((a + b) * b * c),
                    d[0] * d[1] * d[2] / ((a + b + c) * (b + c) * c),
                ]
            )
            curve: Array = np.einsum("in,inw->nw", weights, v[index])
        if cubic.all():
            return curve
        np.copyto(out, curve, where=cubic[:, None])
    np.copyto(out, v[right], where=on_right[:, None])
    np.copyto(out, v[left], where=on_left[:, None])
    out[~(inside | on_left | on_right)] = np.nan
    return out
