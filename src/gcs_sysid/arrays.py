"""Array types for signatures (docstrings give shapes and units), and where arrays are whole."""

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
"""Floats (float64 throughout)."""
Mask = NDArray[Any]
"""Booleans."""

_AT_ONCE = 32
"""Matrices multiplied at a time."""


def complete_rows(values: Array) -> Mask:
    """(n,) whether nothing is missing in each row of (n, width) values."""
    mask: Mask = np.asarray(np.isfinite(values).all(axis=1))
    return mask


def runs(mask: Mask) -> list[tuple[slice, bool]]:
    """The slices of a mask within which it does not change, with its value there."""
    edges = [0, *(np.flatnonzero(np.diff(mask.astype(np.int8))) + 1), len(mask)]
    return [(slice(a, b), bool(mask[a])) for a, b in pairwise(edges) if b > a]


def mapped(P: Array, moments: Array) -> Array:
    """(..., n, n) P M P' of (..., m, m) moments M, a few at a time: they may be many, and large.

    Args:
        P: (n, m).
        moments: as many as there are.
    """
    n = len(P)
    out = np.empty((*moments.shape[:-2], n, n))
    if moments.ndim == 2:
        return np.matmul(P @ moments, P.T, out=out)
    if moments.ndim > 3:
        for part, result in zip(moments, out, strict=True):
            result[...] = mapped(P, part)
        return out
    for start in range(0, len(moments), _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        np.matmul(P @ moments[some], P.T, out=out[some])
    return out
