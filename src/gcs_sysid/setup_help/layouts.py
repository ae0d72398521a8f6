"""Usual layouts of rotors in autopilots' motor orders, and their picture in characters."""

import math
from dataclasses import dataclass, replace

from gcs_sysid.model.airframe import Airframe, Rotor, load_airframe
from gcs_sysid.session.reported_layout import on_circle

_SHAPES = {
    "quad-x": "quad X",
    "quad-plus": "quad +",
    "hexa-x": "hexa X",
    "hexa-plus": "hexa +",
    "octo-x": "octo X",
    "octo-plus": "octo +",
}
_AUTOPILOTS = {"px4": "PX4", "ardupilot": "ArduPilot"}

LAYOUTS = {
    f"{autopilot}-{shape}": f"{shape_title}, {title}'s motor order"
    for shape, shape_title in _SHAPES.items()
    for autopilot, title in _AUTOPILOTS.items()
} | {"betaflight-quad-x": "quad X, Betaflight's motor order"}
"""Name -> what it is, in words."""

TWO_LENGTHS = ("px4-quad-x", "ardupilot-quad-x", "betaflight-quad-x")
"""Layouts that need not be square: forward and sideways may differ."""

USUAL_ARM = 0.25
"""m."""

_ANGLE_NEAR = math.radians(12.0)
"""Rotors of a real frame are where the layout has them within this."""


def layout_rotors(name: str, arm: float | tuple[float, float]) -> tuple[Rotor, ...]:
    """The rotors of a layout, in motor order.

    Args:
        name: one of `LAYOUTS`.
        arm: m from the center to each motor; for `TWO_LENGTHS` also m forward and m sideways.
    """
    shape = name.partition("-")[2]
    # PX4's airframes 5001, 7001 and 9001 and ArduPilot's FRAME_TYPE 0 are the same.
    rotors = on_circle(shape) if shape.endswith("plus") else load_airframe(name).rotors
    if isinstance(arm, tuple):
        x, y = arm
        return tuple(Rotor(math.copysign(x, r.x), math.copysign(y, r.y), r.spin) for r in rotors)
    return Airframe(name, rotors).with_arm(arm).rotors


def place_of(x: float, y: float) -> str:
    """Where a rotor is, in words: "front right", "right", "right front" (further right)."""
    if math.hypot(x, y) < 1e-6:
        return "center"
    along, across = "front" if x > 0 else "rear", "right" if y > 0 else "left"
    if abs(y) < math.tan(math.radians(10.0)) * abs(x):
        return along
    if abs(x) < math.tan(math.radians(10.0)) * abs(y):
        return across
    return f"{along} {across}" if abs(x) >= 0.999 * abs(y) else f"{across} {along}"


def _bearings(rotors: tuple[Rotor, ...]) -> list[float]:
    return [math.atan2(r.y, r.x) for r in rotors]


def _apart(a: float, b: float) -> float:
    return abs(math.remainder(a - b, math.tau))


def same_order(rotors: tuple[Rotor, ...]) -> list[str]:
    """Layouts whose motors point the same ways, in the same order; spins aside."""
    found = []
    for name in LAYOUTS:
        usual = layout_rotors(name, USUAL_ARM)
        if len(usual) == len(rotors) and all(
            _apart(a, b) < _near(name)
            for a, b in zip(_bearings(rotors), _bearings(usual), strict=True)
        ):
            found.append(name)
    return found


def same_places(rotors: tuple[Rotor, ...]) -> list[str]:
    """Layouts with motors in the same directions, in whatever order."""
    mine = sorted(_bearings(rotors))
    found = []
    for name in LAYOUTS:
        usual = sorted(_bearings(layout_rotors(name, USUAL_ARM)))
        # Directions near +-180 deg may sort to either end.
        turns = [usual[i:] + usual[:i] for i in range(-1, 2)]
        if len(usual) == len(mine) and any(
            all(_apart(a, b) < _near(name) for a, b in zip(mine, turn, strict=True))
            for turn in turns
        ):
            found.append(name)
    return found


def _near(name: str) -> float:
    """A quad X need not be square, and stays one while its rotors are in their quadrants."""
    return math.radians(30.0) if name in TWO_LENGTHS else _ANGLE_NEAR


def reversed_spins(rotors: tuple[Rotor, ...]) -> tuple[Rotor, ...]:
    """The same rotors, each turning the other way."""
    return tuple(replace(rotor, spin=-rotor.spin) for rotor in rotors)


@dataclass(frozen=True)
class Pen:
    """The characters to draw with."""

    ccw: str
    cw: str
    arm: str
    center: str
    front: str


UNICODE = Pen(ccw="↺", cw="↻", arm="·", center="┼", front="▲")
ASCII = Pen(ccw=" ccw", cw=" cw", arm=".", center="+", front="^")

UNICODE_SIGNS = "".join((UNICODE.ccw, UNICODE.cw, UNICODE.arm, UNICODE.center, UNICODE.front))
"""What a terminal must be able to show for `UNICODE`."""

_ASPECT = 2.0
"""A character is about so much taller than wide."""


def draw(rotors: tuple[Rotor, ...], pen: Pen) -> str:
    """The layout seen from above, front up: arms, motor numbers and spins.

    Args:
        rotors: in motor order.
        pen: `UNICODE` or `ASCII`.
    """
    reach_x = max(abs(r.x) for r in rotors)
    reach_y = max(abs(r.y) for r in rotors)
    most_lines, most_columns, margin = 6, 18, 7  # from the center outwards; labels beside
    lines_per_meter = min(
        most_lines / max(reach_x, 1e-6), most_columns / _ASPECT / max(reach_y, 1e-6)
    )
    height = max(1, round(reach_x * lines_per_meter))
    width = round(reach_y * lines_per_meter * _ASPECT) + margin
    canvas = [[" "] * (2 * width + 1) for _ in range(2 * height + 1)]
    ends = [
        (height - round(r.x * lines_per_meter), width + round(r.y * lines_per_meter * _ASPECT))
        for r in rotors
    ]
    for row, column in ends:
        _line(canvas, (height, width), (row, column), pen.arm)
    canvas[height][width] = pen.center
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
    """Center a label on a point; coaxial rotors stand one under the other."""
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
