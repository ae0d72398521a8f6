"""A rotor-speed stream: freed of wild values before interpolation."""

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.session.streams import StreamBuffer, usual_gap

_REACH = 2
"""Samples on each side that one is compared with."""
AHEAD = 2 * _REACH
"""Samples after a grid point that its value depends on: the cubic's, and what judges them."""
_WILD, _BESIDE = 0.2, 2.0
"""A wild value is off the middle of its neighbours by this share of it, and by so many times what
these differ by. No rotor speeds up and slows down by a fifth while its neighbours in time stand."""


class RotorBuffer(StreamBuffer):
    """Recent rotor speeds, (n, rotors); messages with a wild value are taken for lost ones.

    Attributes:
        wild: messages with a wild value so far.
    """

    def __init__(self, width: int) -> None:
        super().__init__(width)
        self.wild = 0
        self._counted = -np.inf

    def settled(self, newest: float) -> float:
        """Time up to which later samples change nothing, `newest` s being now.

        A stream that is silent holds nothing up: what comes after a gap judges nothing before it.
        """
        t, _ = self._arrays()
        dead = newest - AHEAD * usual_gap(self.interval)
        return max(float(t[-1 - AHEAD]), dead) if len(t) > AHEAD else dead

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
