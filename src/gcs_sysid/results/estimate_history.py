"""How one estimate moved over the flight, as plots show it."""

from collections.abc import Iterable

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.intervals import Z95
from gcs_sysid.results.snapshot import History


def known_history(history: History, name: str) -> tuple[Array, Array, Array]:
    """(n,) times, values and halves of 95 % intervals where there is an estimate.

    Halves are NaN where there is no interval.
    """
    value = history.value.get(name, np.empty(0))
    std = history.std.get(name, np.full(value.shape, np.nan))
    known = np.isfinite(value)
    half = Z95 * std[known]
    half[~np.isfinite(half)] = np.nan
    return history.t[: len(value)][known], value[known], half


def settled_range(
    t: Array,
    values: tuple[Array, Array],
    band: tuple[Array, Array],
    also: Iterable[float] = (),
) -> tuple[float, float]:
    """The range worth looking at: all of the later half, what must be seen besides, and a margin.

    The start of a history is far off and its band is wider than the picture; letting it set the
    scale would flatten what matters.

    Args:
        t: (n,) s, rising.
        values: (n,) least and (n,) greatest value at each.
        band: (n,) ends of the 95 % intervals; NaN where there is none.
        also: values that must be seen.
    """
    late = t >= t[0] + 0.5 * (t[-1] - t[0])
    low, high = float(np.min(values[0][late])), float(np.max(values[1][late]))
    edges = np.concatenate([band[0][late], band[1][late]])
    edges = edges[np.isfinite(edges)]
    if edges.size:
        # A band far wider than the value (nothing known yet) must not hide the value's history.
        reach = 3.0 * max(abs(low), abs(high), high - low)
        low = min(low, max(float(edges.min()), low - reach))
        high = max(high, min(float(edges.max()), high + reach))
    low, high = min([low, *also]), max([high, *also])
    margin = 0.08 * (high - low) or 0.1 * abs(high) or 1.0
    return low - margin, high + margin
