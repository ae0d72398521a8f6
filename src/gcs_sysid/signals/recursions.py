"""Recursive filters of low order, as one banded triangular system.

SciPy's `lfilter` does the same; but what it takes to load `scipy.signal`, a third of a second and
more, every command of ours would pay at its start.
"""

import math
from collections.abc import Sequence

import numpy as np
from scipy.linalg.lapack import dtbtrs

from gcs_sysid.arrays import Array


def lfilter(
    b: Sequence[float] | Array, a: Sequence[float] | Array, x: Array, zi: Array | None = None
) -> tuple[Array, Array]:
    """a0 y[n] + a1 y[n-1] + ... = b0 x[n] + b1 x[n-1] + ..., along the first axis.

    Args:
        b: numerator, at most as long as `a`.
        a: denominator, a0 = 1; two coefficients or more.
        x: (n, ...) samples.
        zi: (len(a) - 1, ...) state before the first sample, as of `scipy.signal.lfilter`
            (transposed direct form II); None: at rest.

    Returns:
        (n, ...) y, and the state after the last sample.

    Example:
        A sum that forgets half in each step:

        >>> lfilter([1.0], [1.0, -0.5], np.array([1.0, 0.0, 0.0, 1.0]))[0]
        array([1.   , 0.5  , 0.25 , 1.125])
    """
    order, n = len(a) - 1, len(x)
    flat = np.asarray(x, dtype=float).reshape(n, math.prod(x.shape[1:]))
    driven = np.zeros((n, flat.shape[1]), order="F")
    for delay, gain in enumerate(b[:n]):
        if gain:
            driven[delay:] += gain * flat[: n - delay]
    state = np.zeros((order, flat.shape[1]))
    if zi is not None:
        before = np.asarray(zi, dtype=float).reshape(order, flat.shape[1])
        driven[:order] += before[:n]
        if n < order:
            state[: order - n] = before[n:]
    if n == 0:
        return np.array(x, dtype=float), state.reshape(order, *x.shape[1:])
    bands = np.empty((order + 1, n), order="F")
    bands.T[:] = a
    y, _ = dtbtrs(bands, driven, uplo="L", diag="U", overwrite_b=1)
    for i in range(order):
        # What the last samples leave for the (i + 1)th after them.
        for k in range(i + 1, min(order, n + i) + 1):
            state[i] -= a[k] * y[n + i - k]
            if k < len(b):
                state[i] += b[k] * flat[n + i - k]
    return y.reshape(x.shape), state.reshape(order, *x.shape[1:])


def recursion(kept: Array, added: Array, first: Array) -> Array:
    """y[n] = kept[n] y[n-1] + added[n] along the last axis, whose coefficient changes.

    Args:
        kept: (..., n) coefficients.
        added: (..., n) what is added.
        first: (..., 1) y before the first sample.

    Returns:
        (..., n) y.

    Example:
        >>> recursion(np.array([0.5, 0.0, 2.0]), np.ones(3), np.array([4.0]))
        array([3., 1., 3.])
    """
    shape = added.shape
    if not added.size:
        return np.empty(shape)
    # All of them as one system: none reaches into the next one.
    driven, n = np.array(added, order="C").reshape(-1, shape[-1]), added.size
    slopes = np.zeros((2, n), order="F")
    below = slopes[1].reshape(driven.shape)
    below[:, :-1] = -kept.reshape(driven.shape)[:, 1:]
    driven[:, 0] += (kept[..., 0] * first[..., 0]).ravel()
    y, _ = dtbtrs(slopes, driven.reshape(n, 1), uplo="L", diag="U", overwrite_b=1)
    return y.reshape(shape)
