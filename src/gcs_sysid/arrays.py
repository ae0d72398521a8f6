"""Array types for signatures (docstrings give shapes and units), and where arrays are whole."""

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
"""Floats (float64 throughout)."""
Mask = NDArray[Any]
"""Booleans."""


def complete_rows(values: Array) -> Mask:
    """(n,) whether nothing is missing in each row of (n, width) values."""
    mask: Mask = np.asarray(np.isfinite(values).all(axis=1))
    return mask


def runs(mask: Mask) -> list[tuple[slice, bool]]:
    """The slices of a mask within which it does not change, with its value there."""
    edges = [0, *(np.flatnonzero(np.diff(mask.astype(np.int8))) + 1), len(mask)]
    return [(slice(a, b), bool(mask[a])) for a, b in pairwise(edges) if b > a]
