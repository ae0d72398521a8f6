"""Garbage that repeats itself: what begins in it needs no second look.

Erased or overwritten memory holds the same few bytes over and over. Where all of them may begin a
frame, each would be looked at as one; but what follows from the bytes behind it is what followed a
period before.
"""

import numpy as np

from gcs_sysid.arrays import Array

PERIOD = 840
"""Bytes after which all repeats itself that does so after one to eight, or another divisor."""


class Repeats:
    """Which of some places are as the one a period before.

    Args:
        raw: the bytes.
        places: (n,) rising, of all that begins in the same way.
        stop: where the bytes end, or what is behind them is of another kind.
        reach: bytes from a place on that decide what becomes of it.

    Attributes:
        others: (n,) the places to be looked at.
    """

    def __init__(self, raw: Array, places: Array, stop: int, reach: int) -> None:
        changes = np.flatnonzero(raw[PERIOD:] != raw[:-PERIOD]) + PERIOD
        changes = np.concatenate([[PERIOD - 1], changes, [len(raw)]])
        long = np.flatnonzero(np.diff(changes) > reach)
        first = changes[long] + 1
        last = np.minimum(changes[long + 1], stop) - reach
        bounds = np.stack([first - PERIOD, first, last], axis=1)[first < last]
        runs = np.searchsorted(places, bounds.astype(places.dtype)).tolist()
        self._runs = [(before, start, end) for before, start, end in runs if start < end]
        self.others = np.ones(len(places), bool)
        for _, start, end in self._runs:
            self.others[start:end] = False

    def __bool__(self) -> bool:
        return bool(self._runs)

    def fill(self, values: Array, step: int = 0) -> Array:
        """(n,) values of all places, by (k,) of the others.

        Args:
            values: of the others.
            step: by how much a value is larger than that of a period before.
        """
        filled = np.zeros(len(self.others), values.dtype)
        filled[self.others] = values
        for before, start, end in self._runs:
            times = -(-(end - start) // (start - before))
            repeated = np.tile(filled[before:start], (times, 1))
            if step:
                repeated += step * np.arange(1, times + 1, dtype=values.dtype)[:, None]
            filled[start:end] = repeated.ravel()[: end - start]
        return filled
