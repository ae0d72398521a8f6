"""Outliers: samples that agree with nothing around them, and samples that were never taken.

A Hampel test asks how far a sample lies from the median of its neighbors, in units of their
scatter. On a moving signal (a doublet at 20 Hz) that median is not where the sample should be, so
the sample is asked instead whether it agrees with any one of four readings of its neighbors: it
lies between the two sides, on the line through the two before it or the two after it, or on
the cubic through all four. Motion agrees with one of them, however hard; a spike with none, and
its neighbors still agree with the side that has no spike. Those between two spikes do not, but
with a line that passes over them. The unit is the median disagreement before, and what three of
the samples around exceed, so that vibration and noise raise the bar, and so does the start of
either, but two spikes do not.

A verdict depends on `AHEAD` samples after and `BEHIND` before, and on nothing else: samples may
come in any grouping.
"""

import numpy as np

from gcs_sysid.arrays import Array, Mask

_REACH = 2
"""Neighbors on each side that a sample is compared with."""
_AROUND = 3
"""Samples on each side for the usual disagreement around."""
_NOISE = 3
"""So many of them that disagree are no spikes, but noise that begins."""
_OVER = ((-2, 1), (-1, 2), (-2, 2))
"""Neighbors whose lines pass over one that may be a spike."""
_PAST = 64
"""Samples before those, for the usual disagreement."""
_LEAST_PAST = 24
"""Known disagreements among these, fewer than which allow no verdict."""
_USUAL = 15.0
"""A spike disagrees by so many medians; white noise, one sample in millions."""
JOLT = 25.0
"""rad/s^2; what a sample of a gyro may disagree by in any case, over the time between samples."""

_FILL = 3
"""Samples on each side among which a spike's sound neighbors are looked for."""
AHEAD = _FILL + _REACH + _AROUND
"""Samples after one that `despiked` needs for it: its neighbors' verdicts need theirs."""
BEHIND = AHEAD + _PAST
"""The same before it."""


def despiked(t: Array, x: Array, gap: float, least: float) -> tuple[Array, Mask]:
    """Replace spikes by what their neighbors say, each column for itself.

    Args:
        t: (n,) s, rising.
        x: (n, width) samples.
        gap: s; samples further apart are not compared.
        least: unit of x; a smaller disagreement is no spike.

    Returns:
        (n, width), NaN where a spike has no sound neighbor on a side, x itself where there is
        no spike; and (n, width) where spikes were.
    """
    if len(t) < 2 * _REACH + 1 or not _may_spike(x, least):
        return x, np.zeros(x.shape, dtype=bool)
    with np.errstate(divide="ignore", invalid="ignore"):
        off, own = _disagreement(t, x, gap)
        size = np.minimum(own, _outside(x))
        spikes: Mask = size > least
        rows, columns = np.nonzero(spikes)
        spikes[rows, columns] = size[rows, columns] > _USUAL * _usual(off, own, rows, columns)
    return (_filled(t, x, spikes, gap) if spikes.any() else x), spikes


def frozen(x: Array) -> Mask:
    """(n,) whether a row of (n, width) repeats the one before in every column.

    Values of noisy sensors never do: nothing was measured.
    """
    out: Mask = np.zeros(len(x), dtype=bool)
    # One column nearly always suffices, at a fraction of the cost.
    out[1:] = x[1:, 0] == x[:-1, 0]
    if out.any():
        now, before = x[1:], x[:-1]
        out[1:] &= ((now == before) | (np.isnan(now) & np.isnan(before))).all(axis=1)
    return out


def _may_spike(x: Array, least: float) -> bool:
    """Whether any sample is `least` off the middle of its neighbors: cheap, and never missed."""
    bend = x[1:-1] - 0.5 * (x[:-2] + x[2:])
    return bool(max(bend.max(), -bend.min()) > least)


def _outside(x: Array) -> Array:
    """(n, width) how far a sample is from lying between its two sides; NaN at the ends.

    Each side is read by either of its two samples: between a value and a spike is no place.
    """
    out = np.full(x.shape, np.nan)
    middle, sizes = x[2:-2], []
    for left, right in ((x[1:-3], x[3:-1]), (x[1:-3], x[4:]), (x[:-4], x[3:-1])):
        clipped = np.clip(middle, np.minimum(left, right), np.maximum(left, right))
        sizes.append(np.abs(middle - clipped))
    out[2:-2] = np.max(sizes, axis=0)
    return out


def _disagreement(t: Array, x: Array, gap: float) -> tuple[Array, Array]:
    """(n, width) distance to the nearest of the two lines and the cubic; NaN: fewer than two.

    And (n, width) to the nearest of these and of the lines that pass over a neighbor: remainder of
    a sample's disagreement when its neighbors may be spikes.
    """
    step = np.diff(t)
    step[step > gap] = np.nan
    slope = np.diff(x, axis=0) / step[:, None]
    bend = np.abs(np.diff(slope, axis=0))
    readings = np.full((3, *x.shape), np.nan)
    readings[0, 2:] = bend * step[1:, None]
    readings[1, :-2] = bend * step[:-1, None]
    k = np.arange(_REACH, len(t) - _REACH)
    around = k[:, None] + np.array([-2, -1, 1, 2])
    apart = t[k, None] - t[around]
    weights = np.ones_like(apart)
    for j in range(4):
        for i in range(4):
            if i != j:
                weights[:, j] *= apart[:, i] / (t[around[:, j]] - t[around[:, i]])
    cubic = np.einsum("kj,kjw->kw", weights, x[around])
    broken = np.isnan(step[around[:, 0]] + step[k - 1] + step[k] + step[k + 1])
    cubic[broken] = np.nan
    readings[2, k] = np.abs(x[k] - cubic)
    off: Array = np.fmin(np.fmin(readings[0], readings[1]), readings[2])
    # By one reading alone, a spike beside a sample would be taken for one in it.
    off[np.isnan(readings).sum(axis=0) > 1] = np.nan
    own = off.copy()
    for left, right in _OVER:
        share = (t[k] - t[k + left]) / (t[k + right] - t[k + left])
        line = x[k + left] + share[:, None] * (x[k + right] - x[k + left])
        own[k] = np.where(broken[:, None], own[k], np.fmin(own[k], np.abs(x[k] - line)))
    return off, own


def _usual(off: Array, own: Array, rows: Array, columns: Array) -> Array:
    """(m,) usual disagreement at those places, the larger of that around and that before."""
    near = rows[:, None] + np.arange(-_AROUND, _AROUND + 1)
    past = rows[:, None] - _AROUND - 1 - np.arange(_PAST)
    places = np.arange(len(rows))
    around, known = _sorted(own, near, columns)
    noise = around[places, np.maximum(known - _NOISE, 0)]
    before, known = _sorted(off, past, columns)
    median = before[places, np.maximum(known - 1, 0) // 2]
    # Without enough of the past nothing is known to be unusual.
    return np.where(known < _LEAST_PAST, np.inf, np.fmax(noise, median))


def _sorted(off: Array, rows: Array, columns: Array) -> tuple[Array, Array]:
    """(m, k) values of (m, k) rows, rising, unknown ones last; (m,) how many are known."""
    inside = (rows >= 0) & (rows < len(off))
    values = np.where(inside, off[np.clip(rows, 0, len(off) - 1), columns[:, None]], np.nan)
    values = np.sort(values, axis=1)
    return values, np.isfinite(values).sum(axis=1)


def _filled(t: Array, x: Array, spikes: Mask, gap: float) -> Array:
    """Spikes replaced by the cubic through four neighbors, or the line where it must be."""
    out: Array = x.copy()
    for row, column in zip(*np.nonzero(spikes), strict=True):
        near = np.arange(max(row - _FILL, 0), min(row + _FILL + 1, len(t)))
        sound = near[~spikes[near, column]]
        before, after = sound[sound < row][-2:], sound[sound > row][:2]
        out[row, column] = np.nan
        if not len(before) or not len(after) or t[after[0]] - t[before[-1]] > gap:
            continue
        chosen = np.concatenate([before, after])
        if len(chosen) < 4 or t[chosen[-1]] - t[chosen[0]] > 2.0 * gap:
            chosen = np.array([before[-1], after[0]])
        out[row, column] = _lagrange(t[chosen] - t[row], x[chosen, column])
    return out


def _lagrange(t: Array, x: Array) -> float:
    """The polynomial through the points, at t = 0."""
    total = 0.0
    for j in range(len(t)):
        others = np.delete(t, j)
        total += x[j] * float(np.prod(others / (others - t[j])))
    return total
