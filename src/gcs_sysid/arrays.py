"""Array types for signatures (docstrings give shapes and units), and where arrays are whole."""

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
    mask: Mask = np.asarray(np.isfinite(values).all(axis=1))
    return mask


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
