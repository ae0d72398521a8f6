"""An airframe file from answers, and whether an airframe makes sense.

Usual layouts are in autopilots' motor orders; their picture is of characters.
"""

import json
import math
from dataclasses import dataclass, replace

import numpy as np

from gcs_sysid.files import parse_toml
from gcs_sysid.model.airframe import (
    ANCHORS,
    Airframe,
    AnchorName,
    Rotor,
    load_airframe,
    parse_airframe,
)
from gcs_sysid.session.reported_layout import bearings, on_circle, place_words, turned_between
from gcs_sysid.setup_help.checks import SetupFinding, Sign

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

    Of one of `LAYOUTS`; `arm` is m from the center to each motor, for `TWO_LENGTHS` also m forward
    and m sideways.
    """
    shape = name.partition("-")[2]
    # PX4's airframes 5001, 7001 and 9001 and ArduPilot's FRAME_TYPE 0 are the same.
    rotors = on_circle(shape) if shape.endswith("plus") else load_airframe(name).rotors
    if isinstance(arm, tuple):
        x, y = arm
        return tuple(Rotor(math.copysign(x, r.x), math.copysign(y, r.y), r.spin) for r in rotors)
    return Airframe(name, rotors).with_arm(arm).rotors


def same_order(rotors: tuple[Rotor, ...]) -> list[str]:
    """Layouts whose motors point the same ways, in the same order; spins aside."""
    found = []
    for name in LAYOUTS:
        usual = layout_rotors(name, USUAL_ARM)
        if len(usual) == len(rotors) and turned_between(
            bearings(rotors), bearings(usual)
        ).max() < _near(name):
            found.append(name)
    return found


def same_places(rotors: tuple[Rotor, ...]) -> list[str]:
    """Layouts with motors in the same directions, in whatever order."""
    mine = np.sort(bearings(rotors))
    found = []
    for name in LAYOUTS:
        usual = np.sort(bearings(layout_rotors(name, USUAL_ARM)))
        # Directions near +-180 deg may sort to either end.
        if len(usual) == len(mine) and any(
            turned_between(mine, np.roll(usual, turn)).max() < _near(name) for turn in (-1, 0, 1)
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
    """The layout seen from above, front up: arms, motor numbers and spins."""
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
        rows.append((str(number), place_words(rotor), x, y, spin))
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


_ANCHOR_WORDS: dict[AnchorName, str] = {
    "mass": "weighed, ready to fly, with battery",
    "k_T": "thrust of a rotor over the square of its speed",
    "T_max": "thrust of a rotor at full command",
}


def airframe_text(airframe: Airframe, origin: str = "") -> str:
    """The file: TOML with units as comments. `checked` says whether it can be used.

    Args:
        airframe: what a user enters: name, rotors, scale, rotor input, IMU and priors.
        origin: where the rotors come from, in words, for a comment.
    """
    lines = [f"# {origin}"] if origin else []
    lines.append(f"name = {json.dumps(airframe.name, ensure_ascii=False)}")
    if (scale := airframe.anchor()) is not None:
        anchor, value = scale
        lines.append(f"{anchor} = {value!r}  # {ANCHORS[anchor]}, {_ANCHOR_WORDS[anchor]}")
    lines.append(f'rotor_input = "{airframe.rotor_input}"')
    if airframe.motor_poles is not None:
        lines.append(f"motor_poles = {airframe.motor_poles}  # magnets of a motor, counted")
    if airframe.imu_position is not None:
        x, y, z = (_in_meters(value) for value in airframe.imu_position)
        lines += ["", "[imu]"]
        lines.append(f"position = [{x}, {y}, {z}]  # m, forward, right and down from the center")
    for number, rotor in enumerate(airframe.rotors, 1):
        spin = "ccw" if rotor.spin > 0 else "cw"
        lines += ["", f"[[rotor]]  # motor {number}, {place_words(rotor)}"]
        lines.append(f"x = {_in_meters(rotor.x)}  # m forward")
        lines.append(f"y = {_in_meters(rotor.y)}  # m to the right")
        lines.append(f'spin = "{spin}"')
        if rotor.axis != Rotor.axis:
            lines.append(f"axis = {list(rotor.axis)!r}  # of thrust, forward, right and down")
    if airframe.priors:
        lines += ["", "[prior]  # value and standard deviation, SI"]
        lines += [
            f"{name} = [{value!r}, {std!r}]" for name, (value, std) in airframe.priors.items()
        ]
    return "\n".join(lines) + "\n"


def _in_meters(value: float) -> str:
    """To a micrometer; adding zero makes 0 of -0."""
    return repr(round(value, 6) + 0.0)


def checked(text: str, where: str) -> Airframe:
    """The airframe that a text makes, as the reader of files sees it.

    Raises:
        InputError: it makes none.
    """
    return parse_airframe(parse_toml(text, where, "an airframe file"), where)


_USUAL = {"arm": (0.03, 2.0), "mass": (0.02, 100.0), "k_T": (1e-9, 1e-2), "T_max": (0.05, 1000.0)}
_SLIPS = {
    "mass": "enter kg, not grams",
    "k_T": "enter N s^2: thrust over (rad/s)^2, not over rpm^2",
    "T_max": "enter newtons per rotor, not grams",
}


def arm_doubt(meters: float) -> str | None:
    """Why a distance from the center to a motor looks wrong; None: it does not."""
    low, high = _USUAL["arm"]
    if low <= meters <= high:
        return None
    kind = "long" if meters > high else "short"
    return f"{meters:g} m is a {kind} arm; enter m from the center to the motor"


def scale_doubt(name: str, value: float) -> str | None:
    """Why a value for the scale looks wrong; None: it does not."""
    low, high = _USUAL[name]
    if low <= value <= high:
        return None
    kind = "large" if value > high else "small"
    unit = next(unit for anchor, unit in ANCHORS.items() if anchor == name)
    return f"{name} = {value:g} {unit} is very {kind}; {_SLIPS[name]}"


def check_airframe(airframe: Airframe) -> list[SetupFinding]:
    """Judge an airframe that can be read.

    Returns:
        Findings on size, symmetry, motor order, spins and scale.
    """
    return [_size(airframe), _symmetry(airframe), _order(airframe), _scale(airframe)]


def _size(airframe: Airframe) -> SetupFinding:
    doubt = arm_doubt(airframe.arm)
    if doubt:
        return SetupFinding("size", Sign.WARNING, doubt, ["x and y of [[rotor]] are in m"])
    text = f"{len(airframe.rotors)} rotors, {airframe.arm:.4g} m from the center on average"
    return SetupFinding("size", Sign.OK, text)


def _symmetry(airframe: Airframe) -> SetupFinding:
    x, y, spin = airframe.geometry
    off = math.hypot(x.mean(), y.mean())
    if off > 0.05 * airframe.arm:
        return SetupFinding(
            "symmetry",
            Sign.WARNING,
            f"the rotors' midpoint is ({x.mean():.3g}, {y.mean():.3g}) m from the origin",
            ["fine if intended; the CG is relative to the origin, too"],
        )
    turning = f"{int((spin > 0).sum())} ccw and {int((spin < 0).sum())} cw"
    if spin.sum() != 0:
        return SetupFinding(
            "symmetry", Sign.WARNING, f"{turning}: usually half turn each way",
            ["look at each propeller from above"],
        )  # fmt: skip
    return SetupFinding("symmetry", Sign.OK, f"midpoint of the rotors at the origin, {turning}")


def _order(airframe: Airframe) -> SetupFinding:
    topic = "motor order"
    rotors = airframe.rotors
    named = same_order(rotors)
    if named:
        usual = layout_rotors(named[0], USUAL_ARM)
        spins, expected = [r.spin for r in rotors], [r.spin for r in usual]
        if spins == expected:
            return SetupFinding(topic, Sign.OK, f"as {' and '.join(named)}")
        if spins == [r.spin for r in reversed_spins(usual)]:
            text = f"as {' and '.join(named)}, with every spin the other way"
            return SetupFinding(
                topic,
                Sign.WARNING,
                text,
                ["fine if the autopilot is configured for it (reversed yaw)"],
            )
        odd = [i for i, (a, b) in enumerate(zip(spins, expected, strict=True), 1) if a != b]
        wrong = ", ".join(map(str, odd))
        return SetupFinding(
            topic, Sign.WARNING, f"as {' and '.join(named)}, but the spin of motor {wrong} differs",
            ["look at each propeller from above"],
        )  # fmt: skip
    places = same_places(rotors)
    if places:
        return SetupFinding(
            topic,
            Sign.WARNING,
            f"the rotors are placed as in {' and '.join(places)}, but numbered differently",
            ["check with the autopilot's motor test: a wrong order fits no flight"],
        )
    return SetupFinding(topic, Sign.OK, "custom layout; check it with the autopilot's motor test")


def _scale(airframe: Airframe) -> SetupFinding:
    anchor = airframe.anchor()
    if anchor is None:
        return SetupFinding(
            "scale", Sign.WARNING, "not set",
            ["weigh the vehicle: mass = KG in the file, or --mass KG each time"],
        )  # fmt: skip
    name, value = anchor
    doubt = scale_doubt(name, value)
    if doubt:
        return SetupFinding("scale", Sign.WARNING, doubt)
    wanted = airframe.wanted_input
    if wanted is not None and not wanted.fits(name):
        text = f"{name} cannot set the scale with rotor_input {airframe.rotor_input!r}"
        return SetupFinding("scale", Sign.PROBLEM, text, ["give the mass instead"])
    return SetupFinding("scale", Sign.OK, f"{name} = {value:g} {ANCHORS[name]}")
