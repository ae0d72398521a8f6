"""What the screen writes: numbers, units, curves, big letters. Pure functions, no Textual.

All parameters of one unit share one power of ten (Ixx and Ixy both in 10⁻³ kg m²), so that they
compare at a glance and their decimal points are in one column. The power follows the largest of
them and is held while it reads well, so that numbers do not jump as they converge.

Curves are lines of braille, two dots a column, four a line. Drawn here and not by a plotting
library: those make a point of every dot of a line, also of the part far outside the picture, which
is what the beginning of an estimate's history is.
"""

import math
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.model.estimate import Estimate, Status
from gcs_sysid.results.result import Result
from gcs_sysid.results.result_view import exponent_key, rows
from gcs_sysid.results.snapshot import LinkState
from gcs_sysid.results.words import Change, decimals_for, engineering_exponent

UNKNOWN = "?"
"""Written where there is no number."""

WHOLE_WIDTH, FRACTION_WIDTH = 4, 4
"""Room left of the decimal point, and for the point with what follows it."""
NUMBER_WIDTH = WHOLE_WIDTH + FRACTION_WIDTH
LABEL_WIDTH = 13


MUTED = "$foreground 65%"
"""Style of what is not the message: labels, times. (`$text-muted` has no effect inside a text.)"""

# Colors beside the signs of `results.words`.
STATUS_STYLE: dict[Status | None, str] = {
    "identified": "$text-success",
    "given": "$text-primary",
    "zero": "$text-success",
    "weak": "$text-warning",
    "unobservable": "$text-error",
}
LINK_STYLE: dict[LinkState, str] = {
    LinkState.WAITING: "$text-warning",
    LinkState.CONNECTED: "$text-success",
    LinkState.REPLAY: "$text-success",
    LinkState.LOST: "$text-error",
    LinkState.ENDED: "$text-primary",
}

CHANGE_STYLE: dict[Change, str] = {
    "changed": "bold",
    "no_change_seen": "$text-success",
    "cannot_tell": MUTED,
}

_EIGHTHS = " ▏▎▍▌▋▊▉█"


def choose_exponents(
    result: Result, truth: Mapping[str, float], previous: Mapping[str, int]
) -> dict[str, int]:
    """One power of ten for every unit in a result.

    Values that mean nothing (unobservable) do not take part unless there is nothing better.
    """
    sure: dict[str, list[float]] = {}
    unsure: dict[str, list[float]] = {}
    for parameter, estimate in rows(result):
        group = unsure if estimate.status == "unobservable" else sure
        shown = estimate.value if estimate.limit is None else estimate.limit
        if shown is not None and math.isfinite(shown):
            group.setdefault(exponent_key(parameter), []).append(abs(shown))
        if parameter.name in truth:
            sure.setdefault(exponent_key(parameter), []).append(abs(truth[parameter.name]))
    chosen = dict(previous)
    fixed = {exponent_key(p): p.exponent for p, _ in rows(result) if p.exponent is not None}
    for unit, values in {**unsure, **sure}.items():
        # Kilograms and plain numbers are read as they are at any size that flies.
        if unit in fixed:
            chosen[unit] = fixed[unit]
        elif unit in ("kg", "1") and 0.1 <= max(values) < 1000.0:
            chosen[unit] = 0
        else:
            chosen[unit] = engineering_exponent(max(values), previous.get(unit))
    return chosen


def aligned(value: float | None, decimals: int, whole: int = WHOLE_WIDTH) -> str:
    """A number whose decimal point stands at a fixed place, in a field of fixed width."""
    width = whole + FRACTION_WIDTH
    if value is None or not math.isfinite(value):
        return UNKNOWN.rjust(whole).ljust(width)
    head, point, tail = f"{value:.{decimals}f}".partition(".")
    if len(head) > whole:
        return f"{value:.0e}".rjust(width)
    return head.rjust(whole) + (point + tail).ljust(FRACTION_WIDTH)


def value_and_half(estimate: Estimate, exponent: int) -> tuple[str, str]:
    """Value and half interval as two aligned fields with the same decimals."""
    factor = 10.0**-exponent
    half = estimate.half
    half = None if half is None else half * factor
    decimals = decimals_for(half or 0.0, most=FRACTION_WIDTH - 1)
    value = aligned(None if estimate.value is None else estimate.value * factor, decimals)
    if estimate.status == "given" and half is None:
        return value, "exact".ljust(NUMBER_WIDTH - 1)
    return value, aligned(half, decimals, WHOLE_WIDTH - 1)


def value_with_half(estimate: Estimate, exponent: int) -> str:
    """Value and half interval in a field of fixed width: `2.05 ± 0.01`, `~0 (< 0.21)`, `-`."""
    width = 2 * NUMBER_WIDTH + 2
    if not estimate.shown:
        return "-".rjust(WHOLE_WIDTH).ljust(width)
    if estimate.limit is not None:
        limit = estimate.limit * 10.0**-exponent
        decimals = decimals_for(limit, most=FRACTION_WIDTH - 1)
        return f"{'~0':>{WHOLE_WIDTH}} (< {aligned(limit, decimals).strip()})".ljust(width)
    value, half = value_and_half(estimate, exponent)
    return f"{value}{'   ' if estimate.status == 'given' else ' ± '}{half}"


def bar(fraction: float, width: int) -> str:
    """A horizontal bar in eighths of a cell."""
    eighths = round(min(1.0, max(0.0, fraction)) * width * 8)
    full, rest = divmod(eighths, 8)
    return ("█" * full + (_EIGHTHS[rest] if rest else "")).ljust(width)


def one_line(parts: Iterable[str]) -> str:
    """Several sentences on one line."""
    return " · ".join(p for p in parts if p)


Floats = NDArray[np.float64]

DOTS_WIDE, DOTS_HIGH = 2, 4
"""Dots of one character."""
_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
"""Of each dot of a character: (row, column)."""

_GLYPHS = {
    " ": ("..", "..", "..", "..", ".."),
    "%": ("#.#", "..#", ".#.", "#..", "#.#"),
    "+": ("...", ".#.", "###", ".#.", "..."),
    "-": ("...", "...", "###", "...", "..."),
    ".": (".", ".", ".", ".", "#"),
    "/": ("..#", "..#", ".#.", "#..", "#.."),
    "0": ("###", "#.#", "#.#", "#.#", "###"),
    "1": (".#.", "##.", ".#.", ".#.", "###"),
    "2": ("###", "..#", "###", "#..", "###"),
    "3": ("###", "..#", ".##", "..#", "###"),
    "4": ("#.#", "#.#", "###", "..#", "..#"),
    "5": ("###", "#..", "###", "..#", "###"),
    "6": ("###", "#..", "###", "#.#", "###"),
    "7": ("###", "..#", ".#.", ".#.", ".#."),
    "8": ("###", "#.#", "###", "#.#", "###"),
    "9": ("###", "#.#", "###", "..#", "###"),
    ":": (".", "#", ".", "#", "."),
    "±": (".#.", "###", ".#.", "...", "###"),
    "°": ("##", "##", "..", "..", ".."),
    "_": ("...", "...", "...", "...", "###"),
    "A": (".#.", "#.#", "###", "#.#", "#.#"),
    "B": ("##.", "#.#", "##.", "#.#", "##."),
    "C": ("###", "#..", "#..", "#..", "###"),
    "D": ("##.", "#.#", "#.#", "#.#", "##."),
    "E": ("###", "#..", "##.", "#..", "###"),
    "F": ("###", "#..", "##.", "#..", "#.."),
    "G": ("###", "#..", "#.#", "#.#", "###"),
    "H": ("#.#", "#.#", "###", "#.#", "#.#"),
    "I": ("###", ".#.", ".#.", ".#.", "###"),
    "J": ("..#", "..#", "..#", "#.#", "###"),
    "K": ("#.#", "#.#", "##.", "#.#", "#.#"),
    "L": ("#..", "#..", "#..", "#..", "###"),
    "M": ("#...#", "##.##", "#.#.#", "#...#", "#...#"),
    "N": ("#..#", "##.#", "#.##", "#..#", "#..#"),
    "O": ("###", "#.#", "#.#", "#.#", "###"),
    "P": ("###", "#.#", "###", "#..", "#.."),
    "Q": ("###", "#.#", "#.#", "###", "..#"),
    "R": ("##.", "#.#", "##.", "#.#", "#.#"),
    "S": (".##", "#..", ".#.", "..#", "##."),
    "T": ("###", ".#.", ".#.", ".#.", ".#."),
    "U": ("#.#", "#.#", "#.#", "#.#", "###"),
    "V": ("#.#", "#.#", "#.#", "#.#", ".#."),
    "W": ("#...#", "#...#", "#.#.#", "##.##", "#...#"),
    "X": ("#.#", "#.#", ".#.", "#.#", "#.#"),
    "Y": ("#.#", "#.#", ".#.", ".#.", ".#."),
    "Z": ("###", "..#", ".#.", "#..", "###"),
}
"""Five rows of dots a letter."""
_ROWS = len(_GLYPHS["Z"])
_BLOCKS = {"..": " ", "##": "█", "#.": "▀", ".#": "▄"}


def extremes(x: NDArray[np.int64], values: Floats) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Least and greatest value in each dot column.

    Args:
        x: (n,) dot columns, not falling.
        values: (n,) finite.

    Returns:
        (k,) distinct columns, (k,) least and (k,) greatest values.
    """
    starts = np.flatnonzero(np.diff(x, prepend=-1))
    return x[starts], np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)


def filled(x: NDArray[np.int64], values: Floats, count: int, bridge: int) -> Floats:
    """Values at each of `count` columns: between known ones a straight line, over short gaps.

    Args:
        x: (k,) distinct columns, rising.
        values: (k,) there; NaN where there is none.
        count: of columns.
        bridge: columns; a wider gap stays empty, as does what lies beyond the ends.

    Returns:
        (count,) values, NaN where there are none.
    """
    known = np.isfinite(values)
    x, values = x[known], values[known]
    if not len(x):
        return np.full(count, np.nan)
    columns = np.arange(count)
    out = np.interp(columns, x, values, left=np.nan, right=np.nan)
    after = np.minimum(np.searchsorted(x, columns), len(x) - 1)
    before = np.maximum(np.searchsorted(x, columns, side="right") - 1, 0)
    out[x[after] - x[before] > bridge] = np.nan
    return out


def curve(
    x: NDArray[np.int64],
    low: Floats,
    high: Floats,
    bounds: tuple[float, float],
    size: tuple[int, int],
    bridge: int,
) -> list[str]:
    """A curve with its extremes in each dot column, neighbors joined.

    Args:
        x: (k,) distinct dot columns, rising.
        low: (k,) least value in each.
        high: (k,) greatest.
        bounds: value at the lower and the upper edge; what lies outside is not drawn.
        size: columns and lines of characters.
        bridge: dot columns over which two neighbors are still joined.
    """
    columns, lines = size
    wide, tall = columns * DOTS_WIDE, lines * DOTS_HIGH
    scale = (tall - 1) / (bounds[1] - bounds[0])
    top = np.rint((bounds[1] - filled(x, high, wide, bridge)) * scale)
    bottom = np.rint((bounds[1] - filled(x, low, wide, bridge)) * scale)
    # A column reaches up or down to where its neighbor on the left ends.
    above, below = bottom[:-1] + 1.0, top[:-1] - 1.0
    top[1:] = np.where(above < top[1:], above, top[1:])
    bottom[1:] = np.where(below > bottom[1:], below, bottom[1:])
    rows = np.arange(tall)[:, None]
    dots = (rows >= top) & (rows <= bottom)  # nothing where there is NaN
    cells = np.einsum(
        "irjc,rc->ij", dots.reshape(lines, DOTS_HIGH, columns, DOTS_WIDE).astype(np.int64), _BITS
    )
    return ["".join(chr(0x2800 + cell) if cell else " " for cell in row) for row in cells.tolist()]


def height_of(scale: int) -> int:
    """Lines of letters whose dots are so many columns wide."""
    return (_ROWS * scale + 1) // 2


HEIGHT = height_of(1)
"""Lines of the smallest letters."""


def big(text: str, scale: int = 1) -> list[str]:
    """A text as `height_of(scale)` lines of half blocks, one dot between letters.

    Args:
        text: in capitals; a sign that there is no letter for becomes a gap.
        scale: columns of a dot, which is half as many lines high.
    """
    glyphs = [_GLYPHS.get(letter, _GLYPHS[" "]) for letter in text]
    rows = [".".join(glyph[row] for glyph in glyphs) for row in range(_ROWS)]
    dots = ["".join(dot * scale for dot in row) for row in rows for _ in range(scale)]
    if len(dots) % 2:
        dots.append("." * len(dots[0]))
    return [
        "".join(_BLOCKS[upper + lower] for upper, lower in zip(*pair, strict=True))
        for pair in zip(dots[::2], dots[1::2], strict=True)
    ]
