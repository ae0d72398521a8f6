"""Whether an airframe makes sense: what a reader of the file cannot know is a slip of the pen."""

import math

from gcs_sysid.model.airframe import ANCHORS, Airframe
from gcs_sysid.setup_help.checks import Finding, Sign
from gcs_sysid.setup_help.layouts import (
    USUAL_ARM,
    layout_rotors,
    reversed_spins,
    same_order,
    same_places,
)

_USUAL_ARM = (0.03, 2.0)
_USUAL_MASS = (0.02, 100.0)
_USUAL_K_T = (1e-9, 1e-2)
_USUAL_T_MAX = (0.05, 1000.0)
_USUAL = {"mass": _USUAL_MASS, "k_T": _USUAL_K_T, "T_max": _USUAL_T_MAX}
_SLIPS = {
    "mass": "kilograms are asked for, not grams",
    "k_T": "N s^2 are asked for: thrust over the square of rad/s, not of rpm",
    "T_max": "newtons of one rotor are asked for, not grams",
}


def arm_doubt(metres: float) -> str | None:
    """Why a distance from the centre to a motor looks wrong; None: it does not."""
    low, high = _USUAL_ARM
    if low <= metres <= high:
        return None
    kind = "long" if metres > high else "short"
    return f"{metres:g} m is a {kind} arm; metres from the centre to the motor are asked for"


def scale_doubt(name: str, value: float) -> str | None:
    """Why a value for the scale looks wrong; None: it does not."""
    low, high = _USUAL[name]
    if low <= value <= high:
        return None
    kind = "large" if value > high else "small"
    unit = next(unit for anchor, unit in ANCHORS.items() if anchor == name)
    return f"{name} = {value:g} {unit} is very {kind}; {_SLIPS[name]}"


def check_airframe(airframe: Airframe) -> list[Finding]:
    """Judge an airframe that can be read.

    Returns:
        Findings on size, symmetry, motor order, spins and scale.
    """
    return [_size(airframe), _symmetry(airframe), _order(airframe), _scale(airframe)]


def _size(airframe: Airframe) -> Finding:
    doubt = arm_doubt(airframe.arm)
    if doubt:
        return Finding("size", Sign.WARNING, doubt, ["x and y of [[rotor]] are in metres"])
    text = f"{len(airframe.rotors)} rotors, {airframe.arm:.4g} m from the centre on average"
    return Finding("size", Sign.OK, text)


def _symmetry(airframe: Airframe) -> Finding:
    x, y, spin = airframe.geometry
    off = math.hypot(x.mean(), y.mean())
    if off > 0.05 * airframe.arm:
        return Finding(
            "symmetry",
            Sign.WARNING,
            f"the rotors' middle is ({x.mean():.3g}, {y.mean():.3g}) m from the origin",
            ["right if meant so; the centre of gravity counts from the origin, too"],
        )
    turning = f"{int((spin > 0).sum())} ccw and {int((spin < 0).sum())} cw"
    if spin.sum() != 0:
        return Finding(
            "symmetry", Sign.WARNING, f"{turning}: as a rule as many turn either way",
            ["look at each propeller from above"],
        )  # fmt: skip
    return Finding("symmetry", Sign.OK, f"middle of the rotors at the origin, {turning}")


def _order(airframe: Airframe) -> Finding:
    topic = "motor order"
    rotors = airframe.rotors
    named = same_order(rotors)
    if named:
        usual = layout_rotors(named[0], USUAL_ARM)
        spins, expected = [r.spin for r in rotors], [r.spin for r in usual]
        if spins == expected:
            return Finding(topic, Sign.OK, f"as {' and '.join(named)}")
        if spins == [r.spin for r in reversed_spins(usual)]:
            text = f"as {' and '.join(named)}, with every spin the other way"
            return Finding(
                topic, Sign.WARNING, text, ["right if the autopilot is set so (reversed yaw)"]
            )
        odd = [i for i, (a, b) in enumerate(zip(spins, expected, strict=True), 1) if a != b]
        wrong = ", ".join(map(str, odd))
        return Finding(
            topic, Sign.WARNING, f"as {' and '.join(named)}, but the spin of motor {wrong} differs",
            ["look at each propeller from above"],
        )  # fmt: skip
    places = same_places(rotors)
    if places:
        return Finding(
            topic,
            Sign.WARNING,
            f"the rotors stand as in {' and '.join(places)}, but are numbered otherwise",
            ["compare with the autopilot's motor test: a wrong order fits no flight"],
        )
    return Finding(
        topic, Sign.OK, "a layout of its own; compare it with the autopilot's motor test"
    )


def _scale(airframe: Airframe) -> Finding:
    anchor = airframe.anchor()
    if anchor is None:
        return Finding(
            "scale", Sign.WARNING, "nothing sets it",
            ["weigh the vehicle: mass = KG in the file, or --mass KG each time"],
        )  # fmt: skip
    name, value = anchor
    doubt = scale_doubt(name, value)
    if doubt:
        return Finding("scale", Sign.WARNING, doubt)
    if (name, airframe.rotor_input) in {("T_max", "speed"), ("k_T", "command")}:
        text = f"{name} cannot set it with rotor_input {airframe.rotor_input!r}"
        return Finding("scale", Sign.PROBLEM, text, ["give the mass instead"])
    return Finding("scale", Sign.OK, f"{name} = {value:g} {ANCHORS[name]}")
