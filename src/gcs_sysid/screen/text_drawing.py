"""What is drawn with characters: curves, and letters to be read from two meters. No Textual here.

Curves are lines of braille, two dots a column, four a line. Drawn here and not by a plotting
library: those make a point of every dot of a line, also of the part far outside the picture, which
is what the beginning of an estimate's history is.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

DOTS_WIDE, DOTS_HIGH = 2, 4
"""Dots of one character."""
_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
"""Of each dot of a character: (row, column)."""
HEIGHT = 3
"""Lines of the smallest letters."""

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
_ROWS = 5
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
