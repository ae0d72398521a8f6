"""Series of numbers, thinned to what a figure can show and packed for the page."""

import base64

import numpy as np

from gcs_sysid.arrays import Array


def thinned(t: Array, values: Array, most: int) -> tuple[Array, Array]:
    """At most about `most` instants that keep every peak of every column.

    Of each bucket of neighbors a column keeps its least and its greatest value, in the order in
    which they came; a bucket with something missing keeps that as a break.

    Args:
        t: (n,) s.
        values: (n, columns).
        most: instants; an even number.
    """
    n, pairs = len(t), most // 2
    if n <= most:
        return t, values
    size = -(-n // pairs)
    whole = np.full((-(-n // size) * size, values.shape[1]), np.nan)
    whole[:n] = values
    buckets = whole.reshape(-1, size, values.shape[1])
    there = np.isfinite(buckets)
    low = np.where(there, buckets, np.inf)
    high = np.where(there, buckets, -np.inf)
    rises = low.argmin(axis=1) <= high.argmax(axis=1)
    least, greatest = low.min(axis=1), high.max(axis=1)
    out = np.empty((len(buckets), 2, values.shape[1]))
    out[:, 0] = np.where(rises, least, greatest)
    out[:, 1] = np.where(rises, greatest, least)
    inner = there.all(axis=1)
    inner[-1] = there[-1].any(axis=0)  # filled up above
    out[:, 1][~inner] = np.nan
    out[:, 0][~np.isfinite(out[:, 0])] = np.nan
    first = np.arange(0, n, size)
    middle = np.minimum(first + size // 2, n - 1)
    return np.stack([t[first], t[middle]], axis=1).reshape(-1), out.reshape(-1, values.shape[1])


def packed(values: Array) -> str:
    """(n,) numbers as base64 of little-endian float32; NaN is a break."""
    return base64.b64encode(np.asarray(values, "<f4").tobytes()).decode("ascii")
