"""Between the samples of one stream: what counts as a gap, and the curve through the others."""

import numpy as np

from gcs_sysid.arrays import Array

SAME = 5e-7
"""Times closer than this (s) are the same: stamps are whole microseconds."""
STEP_SAMPLES = 64
"""Samples from which the usual interval is taken."""
_ALIKE = 0.7
"""Share of steps that make up a stream's rate."""
_SHORTEST = 0.04
"""s; a shorter time is no gap."""
_BRIDGED = ((4, 0.052), (2, 0.065))
"""Lost samples in a row that are bridged, as long as the gap (s) is not longer."""
FAR = 4
"""Samples on each side of a point among which interpolation looks for its two, where there may be
long gaps. Elsewhere these are the nearest."""
_WIDE = 3.5
"""Times the distance to its outer neighbors that a gap may have. A cubic across a longer one would
multiply their noise, by 3 for ten lost samples."""


def usual_gaps(interval: Array) -> Array:
    """(n,) s, times beyond which two samples of a stream have nothing between them.

    One lost sample is always bridged. So are more, four in a row at 100 Hz and two at 50 Hz, as
    long as the gap stays short against the windows of the estimator (0.2 s), which hardly let
    anything faster through: over a link that loses every fifth message half of all windows would
    else be lost, most of all those of the momentum balance, which lives on long unbroken stretches.

    Args:
        interval: (n,) s, usual ones.
    """
    gap = np.maximum(2.6 * interval, _SHORTEST)
    for lost, most in _BRIDGED:
        np.maximum(gap, np.minimum((lost + 1.2) * interval, most), out=gap)
    wide: Array = gap + SAME
    return wide


def usual_gap(interval: float) -> float:
    """The same of one stream, s."""
    return float(usual_gaps(np.array([interval]))[0])


def neighbors(gap: Array, interval: Array) -> Array:
    """(n,) samples on each side that `interpolate` looks at, of streams with such gaps.

    Args:
        gap: (n,) s, longest that is bridged.
        interval: (n,) s, the usual one.
    """
    return np.where(gap > _WIDE * interval, FAR, 2)


def usual_intervals(steps: Array, ends: Array) -> Array:
    """Time between samples that may be skipped, or come by turns at short and long intervals.

    Where most steps are alike (PX4, which skips a few), their mean; else (ArduPilot, which sends
    on its loop, 250 Hz by turns after 2.5 and 5 ms) the mean of all, where the median would be
    the longer one.

    Args:
        steps: (m,) s.
        ends: (n,) how many of them had come; of these the last `STEP_SAMPLES` count.

    Returns:
        (n,) s.
    """
    out = np.empty(len(ends))
    short = ends < STEP_SAMPLES
    for row in np.flatnonzero(short).tolist():
        out[row] = _usual(steps[None, : ends[row]])[0]
    if not short.all():
        starts = ends[~short] - STEP_SAMPLES
        out[~short] = _usual(steps[starts[:, None] + np.arange(STEP_SAMPLES)])
    return out


def _usual(windows: Array) -> Array:
    """(n,) of (n, m) steps."""
    count = windows.shape[1]
    middle = np.sort(windows, axis=1)[:, count // 2, None]
    near = (windows > 0.75 * middle) & (windows < 1.25 * middle)
    near |= (near.sum(axis=1) < _ALIKE * count)[:, None]
    mean: Array = np.where(near, windows, 0.0).sum(axis=1) / near.sum(axis=1)
    return mean


def interpolate(
    t: Array, v: Array, grid: Array, gap: float, among: int = 2, known: Array | None = None
) -> Array:
    """Cubic interpolation through four samples (Lagrange, any spacing).

    These are the two nearest, and on either side of them the next; if that is near against the gap
    between the two, one further out.

    Args:
        t: (m,) rising sample times.
        v: (m, width) samples.
        grid: (n,) times wanted.
        gap: samples further apart than this have nothing between them.
        among: how many samples on each side the outer ones may be looked for.
        known: (n,) how many of the samples each time may use; None: all.

    Returns:
        (n, width), NaN outside the samples and inside gaps. Next to a gap or an end the two
        neighbors alone are used.

    Example:
        >>> t = np.array([0.0, 1.0, 2.0, 3.0, 9.0])
        >>> interpolate(t, t[:, None] ** 3, np.array([1.5, 3.0, 5.0]), gap=2.0)[:, 0]
        array([ 3.375, 27.   ,    nan])
    """
    n, m = len(grid), len(t)
    if m < 2:
        return np.full((n, v.shape[1]), np.nan)
    end = m - 1 if known is None else known - 1
    right = np.searchsorted(t, grid, side="left")
    right = np.maximum(np.minimum(right, end), 1)
    left = right - 1
    before, after = t[left], t[right]
    past, ahead = grid - before, after - grid
    step = after - before
    inside = (past >= 0.0) & (ahead >= 0.0) & (step <= gap)
    out: Array = v[left] + (past / step)[:, None] * (v[right] - v[left])
    # A sample exactly on the grid is taken as it is, even beside a gap.
    on_left, on_right = np.abs(past) < SAME, np.abs(ahead) < SAME
    if known is not None and known.min(initial=2) < 2:
        inside &= known >= 2
        on_left &= known >= 2
        on_right &= known >= 2
    first, last = np.maximum(left - 1, 0), np.minimum(right + 1, end)
    width_before, width_after = before - t[first], t[last] - after
    for k in range(2, among):
        near = step > _WIDE * np.minimum(width_before, width_after)
        if not near.any():
            break
        near_before, near_after = step > _WIDE * width_before, step > _WIDE * width_after
        outer = np.maximum(left - k, 0)
        first = np.where(near_before & (before - t[outer] <= gap), outer, first)
        outer = np.minimum(right + k, end)
        last = np.where(near_after & (t[outer] - after <= gap), outer, last)
        width_before, width_after = before - t[first], t[last] - after
    cubic = inside & ~on_left & ~on_right
    cubic &= (width_before > 0.0) & (width_before <= gap) & (width_after > 0.0)
    cubic &= width_after <= gap
    if cubic.any():
        # All points, those without four neighbors too: few enough, and cheaper than picking.
        index = np.stack([first, left, right, last])
        d = grid - t[index]
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b, c = width_before, step, width_after
            weights = np.stack(
                [
                    -d[1] * d[2] * d[3] / (a * (a + b) * (a + b + c)),
                    d[0] * d[2] * d[3] / (a * b * (b + c)),
                    -d[0] * d[1] * d[3] / ((a + b) * b * c),
                    d[0] * d[1] * d[2] / ((a + b + c) * (b + c) * c),
                ]
            )
            curve: Array = np.einsum("in,inw->nw", weights, v[index])
        if cubic.all():
            return curve
        np.copyto(out, curve, where=cubic[:, None])
    np.copyto(out, v[right], where=on_right[:, None])
    np.copyto(out, v[left], where=on_left[:, None])
    out[~(inside | on_left | on_right)] = np.nan
    return out
