"""Array types for signatures (docstrings give shapes and units), and what is done to them."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
"""Floats (float64 throughout)."""
Mask = NDArray[Any]
"""Booleans."""

_AT_ONCE = 32
"""Matrices worked on at a time."""


def complete_rows(values: Array) -> Mask:
    """(n,) whether nothing is missing in each row of (n, width) values."""
    return np.asarray(np.isfinite(values).all(axis=1))


def runs(mask: Mask) -> list[tuple[slice, bool]]:
    """The slices of a mask within which it does not change, with its value there."""
    edges = [0, *(np.flatnonzero(np.diff(mask.astype(np.int8))) + 1), len(mask)]
    return [(slice(a, b), bool(mask[a])) for a, b in pairwise(edges) if b > a]


def by_parts(work: Callable[[Array], Array], stack: Array) -> Array:
    """Apply `work` to a stack of (k, ...) matrices, a few at a time; (k, ...).

    This bounds the memory for intermediate results, as the matrices may be many and large.
    """
    starts = range(0, max(len(stack), 1), _AT_ONCE)
    return np.concatenate([work(stack[start : start + _AT_ONCE]) for start in starts])


def nonnegative(columns: Array, target: Array) -> Array:
    """(p,) least squares of which no value is negative: Lawson and Hanson, 1974.

    SciPy's `nnls` does the same; `scipy.optimize` takes a fifth of a second to load.

    Args:
        columns: (n, p).
        target: (n,).
    """
    values = np.zeros(columns.shape[1])
    free = np.zeros(len(values), dtype=bool)
    least = 1e-12 * np.abs(columns.T @ target).max(initial=0.0)
    for _ in range(3 * len(values)):
        downhill = np.where(free, 0.0, columns.T @ (target - columns @ values))
        if downhill.max(initial=0.0) <= least:
            break
        free[np.argmax(downhill)] = True
        while True:
            there = np.zeros_like(values)
            there[free] = np.linalg.lstsq(columns[:, free], target)[0]
            beyond = free & (there <= 0.0)
            if not beyond.any():
                break
            shares = values[beyond] / np.maximum(values[beyond] - there[beyond], 1e-300)
            values = values + shares.min() * (there - values)
            free[np.flatnonzero(beyond)[shares == shares.min()]] = False
            values[~free] = 0.0
        values = there
    return values


def long_run(series: Array, lags: int) -> Array:
    """(p, p) sum of products of (n, p) rows with themselves and with those up to so many before.

    Bartlett's weights (Newey and West 1987) keep it positive definite.
    """
    total: Array = series.T @ series
    for lag in range(1, lags + 1):
        cross = series[lag:].T @ series[:-lag]
        total += (1.0 - lag / (lags + 1.0)) * (cross + cross.T)
    return total
