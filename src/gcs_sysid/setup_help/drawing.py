"""A picture of the rotors, seen from above, in characters."""

import math
from dataclasses import dataclass

from gcs_sysid.model.airframe import Rotor
from gcs_sysid.setup_help.layouts import place_of


@dataclass(frozen=True)
class Pen:
    """The characters to draw with."""

    ccw: str
    cw: str
    arm: str
    centre: str
    front: str


UNICODE = Pen(ccw="↺", cw="↻", arm="·", centre="┼", front="▲")
ASCII = Pen(ccw=" ccw", cw=" cw", arm=".", centre="+", front="^")

UNICODE_SIGNS = "".join((UNICODE.ccw, UNICODE.cw, UNICODE.arm, UNICODE.centre, UNICODE.front))
"""What a terminal must be able to show for `UNICODE`."""

_HALF_HEIGHT, _HALF_WIDTH = 6, 18
"""Lines and columns from the centre to the outermost rotor, at most."""
_ASPECT = 2.0
"""A character is about so much taller than wide."""
_MARGIN = 7
"""Columns for the labels beside the outermost rotors."""


def draw(rotors: tuple[Rotor, ...], pen: Pen) -> str:
    """The layout seen from above, front up: arms, motor numbers and spins.

    Args:
        rotors: in motor order.
        pen: `UNICODE` or `ASCII`.
    """
    reach_x = max(abs(r.x) for r in rotors)
    reach_y = max(abs(r.y) for r in rotors)
    lines_per_metre = min(
        _HALF_HEIGHT / max(reach_x, 1e-6), _HALF_WIDTH / _ASPECT / max(reach_y, 1e-6)
    )
    height = max(1, round(reach_x * lines_per_metre))
    width = round(reach_y * lines_per_metre * _ASPECT) + _MARGIN
    canvas = [[" "] * (2 * width + 1) for _ in range(2 * height + 1)]
    ends = [
        (height - round(r.x * lines_per_metre), width + round(r.y * lines_per_metre * _ASPECT))
        for r in rotors
    ]
    for row, column in ends:
        _line(canvas, (height, width), (row, column), pen.arm)
    canvas[height][width] = pen.centre
    taken: set[int] = set()
    for number, (rotor, (row, column)) in enumerate(zip(rotors, ends, strict=True), 1):
        label = f"{number}{pen.ccw if rotor.spin > 0 else pen.cw}"
        _write(canvas, row, column, label, taken)
    front = f"{pen.front} front".rjust(width + 1 + len(" front"))
    drawn = ["".join(line).rstrip() for line in canvas]
    indent = min(len(line) - len(line.lstrip()) for line in (front, *drawn) if line)
    return "\n".join(line[indent:] for line in (front, *drawn))


def _line(canvas: list[list[str]], start: tuple[int, int], end: tuple[int, int], mark: str) -> None:
    steps = max(abs(end[0] - start[0]), math.ceil(abs(end[1] - start[1]) / _ASPECT), 1)
    for i in range(steps + 1):
        row = start[0] + round((end[0] - start[0]) * i / steps)
        column = start[1] + round((end[1] - start[1]) * i / steps)
        canvas[row][column] = mark


def _write(canvas: list[list[str]], row: int, column: int, label: str, taken: set[int]) -> None:
    """Centre a label on a point; coaxial rotors stand one under the other."""
    wide = len(canvas[0])
    left = min(max(column - len(label) // 2, 0), wide - len(label))
    while any(row * wide + left + i in taken for i in range(-1, len(label) + 1)):
        row += 1
        if row == len(canvas):
            canvas.append([" "] * wide)
    for i, character in enumerate(label):
        canvas[row][left + i] = character
        taken.add(row * wide + left + i)


def rotor_table(rotors: tuple[Rotor, ...]) -> str:
    """The rotors in numbers: motor, place, x and y in m, spin."""
    rows = [("motor", "place", "x m", "y m", "spin")]
    for number, rotor in enumerate(rotors, 1):
        # Adding zero makes 0 of -0.
        x, y = (f"{round(value, 4) + 0.0:.4g}" for value in (rotor.x, rotor.y))
        spin = "ccw" if rotor.spin > 0 else "cw"
        rows.append((str(number), place_of(rotor.x, rotor.y), x, y, spin))
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    sides = "><>><"
    return "\n".join(
        "  ".join(
            f"{cell:{side}{wide}}" for cell, side, wide in zip(row, sides, widths, strict=True)
        ).rstrip()
        for row in rows
    )


def legend(pen: Pen) -> str:
    """What the signs mean."""
    if pen is ASCII:
        return "seen from above; ccw: counter-clockwise, cw: clockwise"
    return f"seen from above; {pen.ccw} ccw: counter-clockwise, {pen.cw} cw: clockwise"
