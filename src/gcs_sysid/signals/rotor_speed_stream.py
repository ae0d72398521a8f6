"""A rotor-speed stream: freed of wild values and of old ones before interpolation."""

from copy import copy
from typing import Any, Self

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.signals.recursions import lfilter
from gcs_sysid.signals.stream_buffer import StreamBuffer, neighbours, usual_gap

_REACH = 2
"""Samples on each side that one is compared with."""
_WILD, _BESIDE = 0.2, 2.0
"""A wild value is off the middle of its neighbours by this share of it, and by so many times what
these differ by. No rotor speeds up and slows down by a fifth while its neighbours in time stand."""
_STANDS, _FEWEST = 0.15, 5
"""s, and repeats; speeds of all rotors that stay exactly the same for so long are old ones under
new stamps, as an autopilot sends them that hears nothing of its ESCs."""
_RARELY = 0.15
"""Share of messages that repeat the one before, from which that is how this stream is: readings
slower than messages, coarse ones, or a simulation without noise."""
_FRESH = 1.0 - 1.0 / 256.0
"""What a message leaves of the weight of those before it in that share."""


class _Stillness:
    """Follows how long speeds have stood still.

    Attributes:
        since: s, when the last values were new.
    """

    def __init__(self) -> None:
        self.since = -np.inf
        self._last: tuple[float, ...] = ()
        self._repeats = 0
        self._stands = False
        self._share = 1.0
        """Of repeats, up to `since`; all, until the stream has shown that they are rare in it."""

    @property
    def suspected(self) -> bool:
        """Whether the newest values are a repeat in a stream that hardly has any."""
        return self._repeats > 0 and self._share < _RARELY

    def take(self, t: float, values: tuple[float, ...]) -> bool:
        """Take a message; whether its values are old."""
        if values != self._last:
            if not self._stands:
                faded = _FRESH**self._repeats
                self._share = faded * self._share + 1.0 - faded
            self._share *= _FRESH
            self.since, self._last, self._repeats, self._stands = t, values, 0, False
            return False
        self._repeats += 1
        long = self._repeats >= _FEWEST and t - self.since >= _STANDS
        self._stands = long and self.suspected and any(values)  # motors do stand on the ground
        return self._stands

    def after(self, t: Array, values: Array) -> "_Stillness | None":
        """The state after (n,) times and (n, rotors) values; None if some of them are old."""
        if self._stands:
            return None
        new = np.ones(len(t), dtype=bool)
        new[0] = tuple(values[0].tolist()) != self._last
        new[1:] = (values[1:] != values[:-1]).any(axis=1)
        index = np.arange(len(t))
        latest = np.maximum.accumulate(np.where(new, index, -1))
        faded = _FRESH**self._repeats
        now = faded * self._share + 1.0 - faded
        added = np.where(new, 0.0, 1.0 - _FRESH)
        shares, _ = lfilter([1.0], [1.0, -_FRESH], added, np.array([_FRESH * now]))
        known = latest >= 0
        repeats = np.where(known, index - latest, self._repeats + 1 + index)
        since = np.where(known, t[latest], self.since)
        share = np.where(known, shares[latest], self._share)
        old = (repeats >= _FEWEST) & (t - since >= _STANDS) & (share < _RARELY)
        if (old & values.any(axis=1)).any():
            return None
        state = _Stillness()
        state.since, state._repeats = float(since[-1]), int(repeats[-1])
        state._last, state._share = tuple(values[-1].tolist()), float(share[-1])
        return state


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

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        other = super().__deepcopy__(memo)
        other._stillness = copy(self._stillness)
        return other

    def push(self, t: float, values: tuple[float, ...]) -> None:
        """Add a sample, if it is not an old one."""
        if t > self._newest and self._stillness.take(t, values):
            self.still += 1 + self._drop_after(self._stillness.since)
        else:
            super().push(t, values)

    def extends(self, t: Array, values: Array) -> bool:
        """As any stream's; old samples are looked at one by one."""
        return super().extends(t, values) and self._stillness.after(t, values) is not None

    def extend(self, t: Array, values: Array) -> None:
        """Add samples that `extends` allows, as `push` one by one."""
        state = self._stillness.after(t, values)
        assert state is not None
        self._stillness = state
        super().extend(t, values)

    def settled(self, newest: float) -> float:
        """Time up to which later samples change nothing, `newest` s being now.

        A stream that is silent holds nothing up: what comes after a gap judges nothing before it.
        """
        t, _ = self._arrays()
        # What the cubic takes, and what judges that.
        ahead = neighbours(self.gap, self.interval) + _REACH
        dead = newest - ahead * usual_gap(self.interval)
        if self._stillness.suspected:
            t = t[: np.searchsorted(t, self._stillness.since, side="right")]
        return max(float(t[-1 - ahead]), dead) if len(t) > ahead else dead

    def _sound(self, t: Array, v: Array, grid: Array, gap: float) -> tuple[Array, Array]:
        wild = wild_rows(t, v, gap)
        if not wild.any():
            return t, v
        times = t[wild]
        self.wild += int(np.count_nonzero((times > self._counted) & (times <= grid[-1])))
        self._counted = float(grid[-1])
        return t[~wild], v[~wild]


def wild_rows(t: Array, v: Array, gap: float) -> Mask:
    """Which samples have a value that none of their neighbours bears out.

    Args:
        t: (n,) s, rising.
        v: (n, rotors) speeds.
        gap: s; samples further apart say nothing of each other.

    Returns:
        (n,) never at the ends, nor beside a gap.
    """
    wild: Mask = np.zeros(len(t), dtype=bool)
    if len(t) < 2 * _REACH + 1:
        return wild
    middle = v[_REACH:-_REACH]
    near = np.sort(np.stack([v[:-4], v[1:-3], v[3:-1], v[4:]]), axis=0)
    centre = 0.5 * (near[1] + near[2])
    off = np.abs(middle - centre)
    jumps = (off > _WILD * np.abs(centre)) & (off > _BESIDE * (near[3] - near[0]))
    if jumps.any():
        apart = np.diff(t) > gap
        beside = apart[:-3] | apart[1:-2] | apart[2:-1] | apart[3:]
        wild[_REACH:-_REACH] = jumps.any(axis=1) & ~beside
    return wild
