"""Garbage that repeats itself: what begins in it needs no second look.

Erased or overwritten memory holds the same few bytes over and over. Where all of them may begin a
frame, each would be looked at as one; but what follows from the bytes behind it is what followed a
period before.
"""

import numpy as np

from gcs_sysid.arrays import Array

PERIOD = 840
"""Bytes after which all repeats itself that does so after one to eight, or another divisor."""


class RepeatedBytes:
    """Which of some places are as the one a period before.

    Args:
        raw: the bytes.
        places: (n,) rising, of all that begins in the same way; or n: the first n bytes.
        stop: where the bytes end, or what is behind them is of another kind.
        reach: bytes from a place on that decide what becomes of it.

    Attributes:
        others: (n,) the places to be looked at.
    """

    def __init__(self, raw: Array, places: Array | int, stop: int, reach: int) -> None:
        count = places if isinstance(places, int) else len(places)
        self.others = np.ones(count, bool)
        self._runs: list[tuple[int, int, int]] = []
        changed = raw[PERIOD:] != raw[:-PERIOD]
        half = (reach + 1) // 2  # a run of so many holds one that begins at a multiple of half
        halves = changed[: len(changed) // half * half].reshape(-1, half)
        if halves.any(axis=1).all():
            return
        changes = np.flatnonzero(changed) + PERIOD
        changes = np.concatenate([[PERIOD - 1], changes, [len(raw)]])
        long = np.flatnonzero(np.diff(changes) > reach)
        first = changes[long] + 1
        last = np.minimum(changes[long + 1], stop) - reach
        bounds = np.stack([first - PERIOD, first, last], axis=1)[first < last]
        if isinstance(places, int):
            runs = np.minimum(bounds, places).tolist()
        else:
            runs = np.searchsorted(places, bounds.astype(places.dtype)).tolist()
        self._runs = [(before, start, end) for before, start, end in runs if start < end]
        for _, start, end in self._runs:
            self.others[start:end] = False

    def __bool__(self) -> bool:
        return bool(self._runs)

    def fill(self, values: Array) -> Array:
        """(n,) values of all places, by (k,) of the others."""
        filled = np.zeros(len(self.others), values.dtype)
        filled[self.others] = values
        self.repeat(filled)
        return filled

    def repeat(self, values: Array) -> None:
        """Set those of (n,) values that are not of the others, in place."""
        for before, start, end in self._runs:
            times = -(-(end - start) // (start - before))
            values[start:end] = np.tile(values[before:start], times)[: end - start]
