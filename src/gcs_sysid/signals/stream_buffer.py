"""The recent samples of one stream: put in order, kept as arrays, given out between samples.

Samples come in pieces of any length. The value at a time depends on the samples received when the
grid passed it, at a tick; where one piece holds several ticks, the buffer remembers how many of its
samples each of them may use (`extend`). Here is also what counts as a gap between the samples of a
stream, and the curve through the others.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from gcs_sysid.arrays import Array

SAME = 5e-7
"""Times closer than this (s) are the same: stamps are whole microseconds."""
STEP_SAMPLES = 64
"""Samples from which the usual interval is taken."""
_ALIKE = 0.7
"""Share of steps that make up a stream's rate."""
_SHORTEST = 0.04
"""s; a shorter time is no gap."""
_BRIDGED = ((4, 0.052), (2, 0.065))
"""Lost samples in a row that are bridged, as long as the gap (s) is not longer."""
FAR = 4
"""Samples on each side of a point among which interpolation looks for its two, where there may be
long gaps. Elsewhere these are the nearest."""
_WIDE = 3.5
"""Times the distance to its outer neighbors that a gap may have. A cubic across a longer one would
multiply their noise, by 3 for ten lost samples."""


def usual_gaps(interval: Array) -> Array:
    """(n,) s, times beyond which two samples of a stream have nothing between them.

    One lost sample is always bridged. So are more, four in a row at 100 Hz and two at 50 Hz, as
    long as the gap stays short against the windows of the estimator (0.2 s), which hardly let
    anything faster through: over a link that loses every fifth message half of all windows would
    else be lost, most of all those of the momentum balance, which lives on long unbroken stretches.

    Args:
        interval: (n,) s, usual ones.
    """
    gap = np.maximum(2.6 * interval, _SHORTEST)
    for lost, most in _BRIDGED:
        np.maximum(gap, np.minimum((lost + 1.2) * interval, most), out=gap)
    return gap + SAME


def usual_gap(interval: float) -> float:
    """The same of one stream, s."""
    return float(usual_gaps(np.array([interval]))[0])


def neighbors(gap: Array, interval: Array) -> Array:
    """(n,) samples on each side that `interpolate` looks at, of streams with such gaps.

    Args:
        gap: (n,) s, longest that is bridged.
        interval: (n,) s, the usual one.
    """
    return np.where(gap > _WIDE * interval, FAR, 2)


def usual_intervals(steps: Array, ends: Array) -> Array:
    """Time between samples that may be skipped, or come by turns at short and long intervals.

    Where most steps are alike (PX4, which skips a few), their mean; else (ArduPilot, which sends
    on its loop, 250 Hz by turns after 2.5 and 5 ms) the mean of all, where the median would be
    the longer one.

    Args:
        steps: (m,) s.
        ends: (n,) how many of them had come; of these the last `STEP_SAMPLES` count.

    Returns:
        (n,) s.
    """
    out = np.empty(len(ends))
    short = ends < STEP_SAMPLES
    for row in np.flatnonzero(short).tolist():
        out[row] = _usual(steps[None, : ends[row]])[0]
    if not short.all():
        starts = ends[~short] - STEP_SAMPLES
        out[~short] = _usual(steps[starts[:, None] + np.arange(STEP_SAMPLES)])
    return out


def _usual(windows: Array) -> Array:
    """(n,) of (n, m) steps."""
    count = windows.shape[1]
    middle = np.sort(windows, axis=1)[:, count // 2, None]
    near = (windows > 0.75 * middle) & (windows < 1.25 * middle)
    near |= (near.sum(axis=1) < _ALIKE * count)[:, None]
    return np.where(near, windows, 0.0).sum(axis=1) / near.sum(axis=1)


def interpolate(
    t: Array, v: Array, grid: Array, gap: float, among: int = 2, known: Array | None = None
) -> Array:
    """Cubic interpolation through four samples (Lagrange, any spacing).

    These are the two nearest, and on either side of them the next; if that is near against the gap
    between the two, one further out.

    Args:
        t: (m,) rising sample times.
        v: (m, width) samples.
        grid: (n,) times wanted.
        gap: samples further apart than this have nothing between them.
        among: how many samples on each side the outer ones may be looked for.
        known: (n,) how many of the samples each time may use; None: all.

    Returns:
        (n, width), NaN outside the samples and inside gaps. Next to a gap or an end the two
        neighbors alone are used.

    Example:
        >>> t = np.array([0.0, 1.0, 2.0, 3.0, 9.0])
        >>> interpolate(t, t[:, None] ** 3, np.array([1.5, 3.0, 5.0]), gap=2.0)[:, 0]
        array([ 3.375, 27.   ,    nan])
    """
    n, m = len(grid), len(t)
    if m < 2:
        return np.full((n, v.shape[1]), np.nan)
    end = m - 1 if known is None else known - 1
    right = np.searchsorted(t, grid, side="left")
    right = np.maximum(np.minimum(right, end), 1)
    left = right - 1
    before, after = t[left], t[right]
    past, ahead = grid - before, after - grid
    step = after - before
    inside = (past >= 0.0) & (ahead >= 0.0) & (step <= gap)
    out: Array = v[left] + (past / step)[:, None] * (v[right] - v[left])
    # A sample exactly on the grid is taken as it is, even beside a gap.
    on_left, on_right = np.abs(past) < SAME, np.abs(ahead) < SAME
    if known is not None and known.min(initial=2) < 2:
        inside &= known >= 2
        on_left &= known >= 2
        on_right &= known >= 2
    first, last = np.maximum(left - 1, 0), np.minimum(right + 1, end)
    width_before, width_after = before - t[first], t[last] - after
    for k in range(2, among):
        near = step > _WIDE * np.minimum(width_before, width_after)
        if not near.any():
            break
        near_before, near_after = step > _WIDE * width_before, step > _WIDE * width_after
        outer = np.maximum(left - k, 0)
        first = np.where(near_before & (before - t[outer] <= gap), outer, first)
        outer = np.minimum(right + k, end)
        last = np.where(near_after & (t[outer] - after <= gap), outer, last)
        width_before, width_after = before - t[first], t[last] - after
    cubic = inside & ~on_left & ~on_right
    cubic &= (width_before > 0.0) & (width_before <= gap) & (width_after > 0.0)
    cubic &= width_after <= gap
    if cubic.any():
        # All points, those without four neighbors too: few enough, and cheaper than picking.
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


_RENEW = 16
"""Samples after which the usual interval is updated, and by which a change of it is detected."""
BREAK = 1.0
"""s; a longer silence is no interval."""
_STILL = 0.3
"""Share of steps that show that a stream's rate is still the same."""
_REORDER = 0.02
"""s; a sample that comes after one so much newer still finds its place. The grid, which is 0.04 s
behind at least, has not been there."""
_MOST = 4096
"""Samples of each stream kept while no grid takes them (an IMU that is silent)."""
_LEAST = 256
"""Least size of the arrays."""
_NONE = np.zeros(0, np.int64)


class StreamBuffer:
    """Recent samples of one stream, in strictly rising time.

    Args:
        width: numbers in a sample.
        hold: whether the last value holds (states) instead of being interpolated (signals).
        bridged: s; a shorter time between samples is no gap, however fast they usually come.
        keep: samples kept behind the grid.
    """

    def __init__(
        self, width: int, *, hold: bool = False, bridged: float = 0.0, keep: int = 8
    ) -> None:
        self.width = width
        self._keep = keep
        self._bridged = bridged
        self.hold = hold
        self.repeated = 0
        """Samples dropped because their stamp was not new."""
        self.interval = 0.0
        """Usual time between samples in s, see `usual_intervals`; 0 until it is known."""
        self._newest = -np.inf
        self._steps = np.empty(0)
        self._count = 0
        self._t = np.empty(_LEAST)
        self._values = np.empty((_LEAST, width))
        self._start = self._end = 0
        self._known = np.zeros(1, np.int64)
        """(ticks,) samples known to each of the latest piece."""
        self.intervals = np.zeros(1)
        """(ticks,) s, the usual time between samples as each tick knows it."""

    def __len__(self) -> int:
        return self._end - self._start

    def extend(self, t: Array, values: Array, marks: Array = _NONE) -> None:
        """Add samples; those whose stamp was there before, or is far behind, are dropped.

        Args:
            t: (n,) s, in the order in which they came.
            values: (n, width); narrower ones lack their last values, wider ones widen the stream.
            marks: (ticks,) rising, how many of them each tick knows.
        """
        self._start = max(self._start, self._end - _MOST)
        before, interval = len(self), self.interval
        rows, late, counted, step = self._sort_out(t)
        values = self._fitted(values)
        kept = slice(None) if len(rows) == len(t) else rows
        self._append(t[kept], values[kept])
        due, intervals = self._renewals(step)
        self._count += len(step)
        self._steps = np.concatenate([self._steps, step])[-STEP_SAMPLES:]
        if len(due):
            self.interval = float(intervals[-1])
        if len(rows):
            self._newest = float(t[rows[-1]])
        for row in late.tolist():
            self.repeated += not self._insert(float(t[row]), values[row])
        self.repeated += len(t) - len(rows) - len(late)
        if len(marks):
            # Late samples come before the first of the ticks, see `first_irregular`.
            known = before + np.searchsorted(rows, marks)
            self._known = np.full(len(marks), len(self)) if len(late) else known
            renewed = np.searchsorted(counted[due], marks)
            self.intervals = np.concatenate([[interval], intervals])[renewed]

    def look(self, ticks: int = 1) -> None:
        """Have so many ticks know all samples that came so far."""
        self._known = np.full(ticks, len(self))
        self.intervals = np.full(ticks, self.interval)

    def first_irregular(self, t: Array, values: Array) -> int:
        """The first of samples to come, laid out as of `extend`, that changes older ones.

        It must come before the first tick of its piece; n where there is none.
        """
        newest = np.maximum.accumulate(np.concatenate([[self._newest], t]))
        late = t < newest[:-1]
        return int(np.argmax(late)) if late.any() else len(t)

    def intervals_ahead(self, t: Array, marks: Array) -> Array:
        """(ticks,) s, usual intervals that each tick would know, see `extend`."""
        _, _, counted, step = self._sort_out(t)
        due, intervals = self._renewals(step)
        renewed = np.searchsorted(counted[due], marks)
        return np.concatenate([[self.interval], intervals])[renewed]

    def _sort_out(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """Of (n,) times, s, the rows that are newer than all before, and those that are late.

        And the rows of those that came without a break, with the steps that lead to them, s.
        """
        step = np.empty(len(t))
        step[:1], step[1:] = t[:1] - self._newest, t[1:] - t[:-1]
        if len(t) and step.min() > 0.0:  # as it nearly always is
            rows = np.arange(len(t))
            if not self.hold and step.max() < BREAK:
                return rows, _NONE, rows, step
        else:
            newest = np.maximum.accumulate(np.concatenate([[self._newest], t]))
            step = t - newest[:-1]
            rows = np.flatnonzero(step > 0.0)
        late = np.flatnonzero((step < 0.0) & (step > -_REORDER))
        counted = rows[:0] if self.hold else rows[step[rows] < BREAK]
        return rows, late, counted, step[counted]

    def _renewals(self, step: Array) -> tuple[Array, Array]:
        """After which of (n,) steps, s, the usual interval is updated, and its new value."""
        if not len(step) or (self._count >= _RENEW and self._count % _RENEW + len(step) < _RENEW):
            return _NONE, np.empty(0)
        count = self._count + np.arange(1, len(step) + 1)
        due = np.flatnonzero((count % _RENEW == 0) | (count < _RENEW))
        if not len(due):
            return due, np.empty(0)
        every = np.concatenate([self._steps, step])
        return due, usual_intervals(every, due + len(self._steps) + 1)

    @property
    def knows_interval(self) -> bool:
        """Whether enough samples came to know the interval."""
        return len(self._steps) >= STEP_SAMPLES - 1

    @property
    def is_settled(self) -> bool:
        """Whether the last few samples came at the rate of all those that the interval is of."""
        last = self._steps[-_RENEW:]
        return self.knows_interval and abs(float(last.mean()) / self.interval - 1.0) < 0.2

    def keeps_step(self, step: float) -> bool:
        """Whether the stream still comes at this step, s, though many of its samples are lost."""
        near = (self._steps > 0.75 * step) & (self._steps < 1.25 * step)
        return int(near.sum()) >= _STILL * len(self._steps)

    @property
    def oldest(self) -> float:
        """Time of the oldest sample kept."""
        return float(self._t[self._start])

    @property
    def gaps(self) -> Array:
        """(ticks,) s beyond which two samples have nothing between them."""
        return np.maximum(usual_gaps(self.intervals), self._bridged)

    def known_until(self, horizon: Array) -> Array:
        """(ticks,) s up to which samples to come change nothing, if none of before `horizon` does.

        After a lost sample the next may still bridge the gap: that is worth waiting for. A stream
        that has been silent for longer holds nothing up.
        """
        t, _ = self._arrays()
        count, gaps = self._known, self.gaps
        if not len(t):
            return np.full(len(count), np.inf)
        among = neighbors(gaps, self.intervals)
        until = t[np.maximum(count - among, 0)]
        for back in range(FAR - 1, 0, -1):
            here = (back < among) & (count > back)
            after = t[np.maximum(count - back, 0)]
            broken = after - t[np.maximum(count - back - 1, 0)] > gaps
            until = np.where(here & broken, after, until)
        waits = (count > 0) & (t[np.maximum(count - 1, 0)] + gaps >= horizon)
        return np.where(waits, until, np.inf)

    def at(self, grid: Array, tick: Array) -> Array:
        """Values between samples.

        Args:
            grid: (n,) s, rising.
            tick: (n,) number of the tick at which each of these times is given out.

        Returns:
            (n, width), NaN where the stream has a gap, as that tick knows it.
        """
        t, v = self._arrays()
        known = self._known[tick]
        if not len(t):
            return np.full((len(grid), self.width), np.nan)
        if self.hold:
            index = np.minimum(np.searchsorted(t, grid + SAME, side="right"), known) - 1
            return np.where(index[:, None] >= 0, v[np.maximum(index, 0)], np.nan)
        gaps = self.gaps
        among = neighbors(gaps, self.intervals)
        gaps, among = gaps[tick], among[tick]
        out = np.empty((len(grid), self.width))
        for part in _alike(t, gaps, among):
            gap, near = float(gaps[part.start]), int(among[part.start])
            out[part] = self._between(t, v, grid[part], gap, near, known[part])
        return out

    def _between(
        self, t: Array, v: Array, grid: Array, gap: float, among: int, known: Array
    ) -> Array:
        """(n, width) values, see `interpolate`."""
        return interpolate(t, v, grid, gap, among, None if known[0] == len(t) else known)

    def stamps(self, grid: Array, tick: Array) -> Array:
        """(n,) s, times of the latest samples at the grid times, NaN where there is none."""
        t, _ = self._arrays()
        index = np.searchsorted(t, grid + SAME, side="right")
        # Before the first is the NaN.
        return np.append(t, np.nan)[np.minimum(index, self._known[tick]) - 1]

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
        kept = slice(self._start, self._end)
        return self._t[kept], self._values[kept]

    def _fitted(self, values: Array) -> Array:
        """(n, width) of values that may be narrower; wider ones widen what is kept."""
        more = values.shape[1] - self.width
        if more > 0:
            self._values = np.pad(self._values, ((0, 0), (0, more)), constant_values=np.nan)
            self.width += more
        elif more < 0:
            values = np.pad(values, ((0, 0), (0, -more)), constant_values=np.nan)
        return values

    def _append(self, t: Array, values: Array) -> None:
        n = len(t)
        if self._end + n > len(self._t):
            self._make_room(n)
        self._t[self._end : self._end + n] = t
        self._values[self._end : self._end + n] = values
        self._end += n

    def _make_room(self, n: int) -> None:
        """Move what is kept to the front of arrays that hold n more, twice over."""
        kept, count = slice(self._start, self._end), self._end - self._start
        size = max(2 * (count + n), _LEAST)
        t, values = np.empty(size), np.empty((size, self.width))
        t[:count], values[:count] = self._t[kept], self._values[kept]
        self._t, self._values, self._start, self._end = t, values, 0, count

    def _insert(self, t: float, values: Array) -> bool:
        """Put a sample between older ones, if there is none of its time."""
        times, _ = self._arrays()
        at = self._start + int(np.searchsorted(times, t))
        if at in (self._start, self._end) or self._t[at] == t:
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


def _alike(t: Array, gaps: Array, among: Array) -> list[slice]:
    """Parts of (n,) gaps, s, and neighbors that are read alike between samples at (m,) times."""
    if not len(gaps):
        return []
    low, high = gaps.min(), gaps.max()
    changes = np.diff(among) != 0
    if low < high and any(
        ((t[k:] - t[:-k] > low) & (t[k:] - t[:-k] <= high)).any() for k in range(1, FAR)
    ):
        changes |= np.diff(gaps) != 0.0
    edges = [0, *(np.flatnonzero(changes) + 1).tolist(), len(gaps)]
    return [slice(a, b) for a, b in pairwise(edges)]


def as_known(
    evaluate: Callable[[int, Array], Array], grid: Array, known: Array, settled: Array, count: int
) -> Array:
    """Values, of which some must not use samples that came later.

    Args:
        evaluate: (n, width) values from so many samples, at (n,) s; called in order.
        grid: (n,) s.
        known: (n,) how many samples were known of each.
        settled: (n,) whether samples to come changed nothing any more.
        count: how many samples there are.
    """
    from_ = np.where(settled, count, known)
    edges = [0, *(np.flatnonzero(np.diff(from_)) + 1).tolist(), len(grid)]
    parts = [evaluate(int(from_[a]), grid[a:b]) for a, b in pairwise(edges)]
    return parts[0] if len(parts) == 1 else np.concatenate(parts)
