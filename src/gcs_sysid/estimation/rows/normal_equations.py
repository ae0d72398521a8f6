"""The recursive least squares memory: sums of products of rows, kept in batches.

Every estimate here is the minimizer of a cost that is quadratic in the data, so the sum of
z z' over all rows z = [inputs, outputs] is a sufficient statistic: the information form of
recursive least squares. Keeping that sum for each second or so of flight, instead of only the
total, costs little and shows how much the score varies from batch to batch, which a valid
covariance needs when residuals are colored; and it lets a fit be checked on batches it has not
seen.
"""

from collections.abc import Sequence
from copy import copy
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.arrays import Array

_AT_ONCE = 2**18
"""Bytes allocated from the system in a step; page by page that takes up to 10 ms a MB."""


class NormalEquations:
    """Second moments of rows, in batches of equally many rows; bounded memory.

    When `max_batches` are full, neighbors are merged and batches become twice as long.

    Args:
        shape: leading shape of one moment matrix, then its width twice: (..., m, m).
        rows_per_batch: rows summed in one batch.
        max_batches: an even number.
    """

    def __init__(self, shape: Sequence[int], rows_per_batch: int, max_batches: int = 512) -> None:
        self._rows_per_batch = rows_per_batch
        self._batches = np.zeros((max_batches, *shape))
        self._counts = np.zeros(max_batches, dtype=np.int64)
        self._full = 0
        self.total = np.zeros(shape)
        """(..., m, m) sum over all rows; not to be written to."""
        self.rows = 0
        """Rows added so far."""

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        # Most of the allocation is still zero and takes no memory until it is written.
        other, begun = copy(self), self._begun
        other._batches = np.zeros(self._batches.shape)
        other._batches[:begun] = self._batches[:begun]
        other._counts, other.total = self._counts.copy(), self.total.copy()
        return other

    def reserve(self) -> None:
        """Have all memory now, before a long flight, and not find it wanting in it."""
        each = max(_AT_ONCE // self.total.nbytes, 1)
        for start in range(self._begun, len(self._batches), each):
            self._batches[start : start + each] = 0.0  # untouched zeros take none

    @property
    def batches(self) -> Array:
        """(k, ..., m, m) sums of the batches begun so far, oldest first (a view)."""
        return self._batches[: self._begun]

    @property
    def counts(self) -> NDArray[np.int64]:
        """(k,) rows in each batch (a view)."""
        return self._counts[: self._begun]

    def add(self, rows: Array) -> None:
        """Add rows of shape (..., n, m), in time order.

        The sums do not depend on how rows are grouped in calls, but for rounding.
        """
        n, start = rows.shape[-2], 0
        self.rows += n
        while start < n:
            if self._full == len(self._batches):
                self._merge()
            room = self._rows_per_batch - int(self._counts[self._full])
            part = rows[..., start : start + room, :]
            products = np.swapaxes(part, -1, -2) @ part
            self.total += products
            self._batches[self._full] += products
            self._counts[self._full] += part.shape[-2]
            start += part.shape[-2]
            if self._counts[self._full] == self._rows_per_batch:
                self._full += 1

    def add_sum(self, products: Array, rows: int) -> None:
        """Add (..., m, m) products of so many rows, which stay together."""
        if self._full == len(self._batches):
            self._merge()
        self.rows += rows
        self.total += products
        self._batches[self._full] += products
        self._counts[self._full] += rows
        if self._counts[self._full] >= self._rows_per_batch:
            self._full += 1

    def drop_last(self, rows: int) -> None:
        """Forget the newest batches that hold at least so many rows."""
        dropped = 0
        while dropped < rows and self._begun:
            last = self._begun - 1
            dropped += int(self._counts[last])
            self._batches[last] = 0.0
            self._counts[last] = 0
            self._full = last
        self.total = self.batches.sum(axis=0)
        self.rows -= dropped

    def narrowed(self, leading: Sequence[int], columns: Sequence[int]) -> Self:
        """The same, of (n, m, m), with some of the leading index and of the columns alone."""
        other = copy(self)
        other.total = self.total[np.ix_(leading, columns, columns)]
        other._batches = np.zeros((len(self._batches), *other.total.shape))
        for old, new in zip(self.batches, other._batches, strict=False):
            new[...] = old[np.ix_(leading, columns, columns)]
        other._counts = self._counts.copy()
        return other

    @property
    def _begun(self) -> int:
        return self._full + int(self._full < len(self._counts) and self._counts[self._full] > 0)

    def _merge(self) -> None:
        half = len(self._batches) // 2
        for i in range(half):  # one by one: together they would take half as much memory again
            np.add(self._batches[2 * i], self._batches[2 * i + 1], out=self._batches[i])
        self._counts[:half] = self._counts[0::2] + self._counts[1::2]
        self._batches[half:] = 0.0
        self._counts[half:] = 0
        self._rows_per_batch *= 2
        self._full = half
