"""Least squares with unknowns that are not negative.

`scipy.optimize.nnls` does the same; but loading `scipy.optimize` takes a tenth of a second, which
every flight on commands would pay.
"""

import numpy as np

from gcs_sysid.arrays import Array

_ROUNDING = 1e-14
"""Of the size of the terms."""


def fit_nonnegative(A: Array, b: Array) -> Array:
    """(p,) x of least |A x - b|^2, none of them negative.

    The active set method of Lawson and Hanson (1974, Solving Least Squares Problems, chapter 23).

    Args:
        A: (n, p) of full rank.
        b: (n,).

    Example:
        >>> fit_nonnegative(np.eye(2), np.array([3.0, -1.0]))
        array([3., 0.])
    """
    p = A.shape[1]
    x, free = np.zeros(p), np.zeros(p, dtype=bool)
    least = _ROUNDING * float(np.abs(A).sum(axis=0).max(initial=0.0)) * np.abs(b).max(initial=0.0)
    for _ in range(3 * p):
        downhill = np.where(free, -np.inf, A.T @ (b - A @ x))
        if not (downhill > least).any():
            break
        free[np.argmax(downhill)] = True
        while True:
            best = np.zeros(p)
            best[free] = np.linalg.lstsq(A[:, free], b, rcond=None)[0]
            out = free & (best <= 0.0)
            if not out.any():
                x = best
                break
            # As far as all of them allow; the first to reach zero stays there.
            share = x[out] / np.maximum(x[out] - best[out], 1e-300)
            x = x + share.min() * (best - x)
            free[np.flatnonzero(out)[share == share.min()]] = False
            x[~free] = 0.0
    return x
