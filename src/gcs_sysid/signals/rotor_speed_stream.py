"""A rotor-speed stream: freed of wild values and of old ones before interpolation."""

from typing import NamedTuple

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.signals.recursions import lfilter
from gcs_sysid.signals.stream_buffer import (
    StreamBuffer,
    as_known,
    interpolate,
    neighbors,
    usual_gaps,
)

_NONE = np.zeros(0, np.int64)
_REACH = 2
"""Samples on each side that one is compared with."""
_WILD, _BESIDE = 0.2, 2.0
"""A wild value is off the middle of its neighbors by this share of it, and by so many times what
these differ by. No rotor speeds up and slows down by a fifth while its neighbors in time stand."""
_STANDS, _FEWEST = 0.15, 5
"""s, and repeats; speeds of all rotors that stay exactly the same for so long are old ones under
new stamps, as from an autopilot that receives nothing from its ESCs."""
_RARELY = 0.15
"""Share of messages that repeat the one before, from which that is how this stream is: readings
slower than messages, coarse ones, or a simulation without noise."""
_FRESH = 1.0 - 1.0 / 256.0
"""What a message leaves of the weight of those before it in that share."""


class _Stillness:
    """Follows how long speeds have stood still.

    Attributes:
        since: s, when the last values were new.
        suspected: whether the newest values are a repeat in a stream that hardly has any.
        stands: whether the newest values are old.
    """

    def __init__(self) -> None:
        self.since = -np.inf
        self.suspected = self.stands = False
        self._last: Array = np.empty(0)
        self._repeats = 0
        self._share = 1.0
        """Of repeats, up to `since`; all, until the stream has shown that they are rare in it."""

    def follow(self, t: Array, values: Array) -> "_Followed":
        """Of (n,) times and (n, rotors) values, up to the first old ones."""
        new = np.ones(len(t), dtype=bool)
        new[0] = not np.array_equal(values[0], self._last)
        new[1:] = (values[1:] != values[:-1]).any(axis=1)
        index = np.arange(len(t))
        if self._repeats == 0 and new.all():
            share = self._share * _FRESH ** (1.0 + index)
            none = np.zeros(len(t), dtype=bool)
            return _Followed(t, none, np.zeros(len(t), dtype=int), share, none)
        latest = np.maximum.accumulate(np.where(new, index, -1))
        faded = 1.0 if self.stands else _FRESH**self._repeats
        now = faded * self._share + 1.0 - faded
        added = np.where(new, 0.0, 1.0 - _FRESH)
        shares, _ = lfilter([1.0], [1.0, -_FRESH], added, np.array([_FRESH * now]))
        known = latest >= 0
        repeats = np.where(known, index - latest, self._repeats + 1 + index)
        since = np.where(known, t[latest], self.since)
        share = np.where(known, shares[latest], self._share)
        suspected = (repeats > 0) & (share < _RARELY)
        # Motors do stand on the ground.
        old = suspected & (repeats >= _FEWEST) & (t - since >= _STANDS) & values.any(axis=1)
        old |= self.stands & ~known
        return _Followed(since, suspected, repeats, share, old)

    def go_on(self, followed: "_Followed", values: Array) -> None:
        """Stand where messages, none but the last of them old, have led."""
        self.since, self._last = float(followed.since[-1]), values[-1].copy()
        self.suspected, self.stands = bool(followed.suspected[-1]), bool(followed.old[-1])
        self._repeats, self._share = int(followed.repeats[-1]), float(followed.share[-1])


class _Followed(NamedTuple):
    """How long speeds have stood still after each of some messages, see `_Stillness`."""

    since: Array
    suspected: Mask
    repeats: Array
    share: Array
    old: Mask


class RotorBuffer(StreamBuffer):
    """Recent rotor speeds, (n, rotors); wild and old messages are taken for lost ones.

    Attributes:
        wild: messages with a wild value so far.
        still: messages so far whose speeds stood still, in a stream in which they hardly ever do.
    """

    def __init__(self, width: int) -> None:
        super().__init__(width)
        self.wild = self.still = 0
        self._counted = -np.inf
        self._stillness = _Stillness()
        # As each tick knows them: times up to which speeds are surely new, s.
        self._moved = np.full(1, np.inf)

    def extend(self, t: Array, values: Array, marks: Array = _NONE) -> None:
        """Add samples that are no old ones, see `StreamBuffer`."""
        values = self._fitted(values)
        rows = self._sort_out(t)[0]
        if len(rows):
            followed = self._stillness.follow(t[rows], values[rows])
            if followed.old.any():
                self._extend_by_one(t, values)
                self.look(len(marks))
                return
            last = np.searchsorted(rows, marks) - 1
            self._moved = np.where(
                last >= 0,
                np.where(followed.suspected, followed.since, np.inf)[last],
                self._stillness.since if self._stillness.suspected else np.inf,
            )
            self._stillness.go_on(followed, values[rows])
        elif len(marks):
            self._look(len(marks))
        super().extend(t, values, marks)

    def _extend_by_one(self, t: Array, values: Array) -> None:
        for row in range(len(t)):
            some = slice(row, row + 1)
            if t[row] > self._newest:
                followed = self._stillness.follow(t[some], values[some])
                self._stillness.go_on(followed, values[some])
                if followed.old[0]:
                    self.still += 1 + self._drop_after(self._stillness.since)
                    continue
            super().extend(t[some], values[some])

    def look(self, ticks: int = 1) -> None:
        """As of `StreamBuffer`."""
        super().look(ticks)
        self._look(ticks)

    def _look(self, ticks: int) -> None:
        stillness = self._stillness
        self._moved = np.full(ticks, stillness.since if stillness.suspected else np.inf)

    def first_irregular(self, t: Array, values: Array) -> int:
        """As of any stream; messages that are old take those before them back."""
        rows = self._sort_out(t)[0]
        first = super().first_irregular(t, values)
        if len(rows):
            old = self._stillness.follow(t[rows], self._fitted(values)[rows]).old
            first = min(first, int(rows[np.argmax(old)]) if old.any() else first)
        return first

    @property
    def _ahead(self) -> Array:
        """(ticks,) samples after one that it may rest on: what the cubic takes, and judges that."""
        return neighbors(self.gaps, self.intervals) + _REACH

    def settled(self, newest: Array) -> Array:
        """(ticks,) s up to which later samples change nothing, (ticks,) `newest` s being now.

        A stream that is silent holds nothing up: what comes after a gap judges nothing before it.
        """
        t, _ = self._arrays()
        if not len(t):
            return np.full(len(newest), np.inf)
        ahead = self._ahead
        dead = newest - ahead * usual_gaps(self.intervals)
        count = np.minimum(self._known, np.searchsorted(t, self._moved, side="right"))
        known = t[np.maximum(count - 1 - ahead, 0)]
        settled = np.where(count > ahead, np.maximum(known, dead), dead)
        return np.where(self._known > 0, settled, np.inf)

    def _between(
        self, t: Array, v: Array, grid: Array, gap: float, among: int, known: Array
    ) -> Array:
        wild = wild_rows(t, v, gap)
        if not wild.any():
            # Nothing to judge: what later samples would say of these does not matter.
            return super()._between(t, v, grid, gap, among, known)
        right = np.searchsorted(t, grid)
        spoilt = np.concatenate([[0], np.cumsum(wild)])
        left_out = spoilt[known] - spoilt[np.minimum(right, known)]
        settled = (known == len(t)) | (known - right - left_out > among + _REACH)

        def values_at(count: int, grid: Array) -> Array:
            sound = ~wild_rows(t[:count], v[:count], gap)
            times = t[:count][~sound]
            self.wild += int(np.count_nonzero((times > self._counted) & (times <= grid[-1])))
            self._counted = float(grid[-1])
            return interpolate(t[:count][sound], v[:count][sound], grid, gap, among)

        return as_known(values_at, grid, known, settled, len(t))


def wild_rows(t: Array, v: Array, gap: float) -> Mask:
    """Which samples have a value that none of their neighbors bears out.

    Args:
        t: (n,) s, rising.
        v: (n, rotors) speeds.
        gap: s; samples further apart are not compared.

    Returns:
        (n,) never at the ends, nor beside a gap.
    """
    wild: Mask = np.zeros(len(t), dtype=bool)
    if len(t) < 2 * _REACH + 1:
        return wild
    middle = v[_REACH:-_REACH]
    near = np.sort(np.stack([v[:-4], v[1:-3], v[3:-1], v[4:]]), axis=0)
    center = 0.5 * (near[1] + near[2])
    off = np.abs(middle - center)
    jumps = (off > _WILD * np.abs(center)) & (off > _BESIDE * (near[3] - near[0]))
    if jumps.any():
        apart = np.diff(t) > gap
        beside = apart[:-3] | apart[1:-2] | apart[2:-1] | apart[3:]
        wild[_REACH:-_REACH] = jumps.any(axis=1) & ~beside
    return wild
