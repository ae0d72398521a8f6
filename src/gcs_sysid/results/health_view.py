"""What a person is shown of a vehicle's health, from a health file's content.

The first line of every answer on a log is here too: is the vehicle all right, and what to do first?
It is made of what was judged, in one place, for terminal, page, report and JSON.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from gcs_sysid.judgement.status import OF_THE_DATA, READINGS
from gcs_sysid.model.airframe import USUAL
from gcs_sysid.model.estimate import Objection
from gcs_sysid.results.result import Result
from gcs_sysid.results.words import PLAIN, Notation, decimals_for, significant
from gcs_sysid.significance import Z95

_WORDS = {
    "yaw_imbalance": ("yaw imbalance", 100.0, "% of the load", ", ccw minus cw", 1.0),
    "hover_throttle": ("hover throttle", 100.0, "%", "", None),
    "thrust_to_weight": ("full thrust", 1.0, "times the weight", "", None),
    "drift_per_minute": ("thrust drift", 100.0, "% a minute", ", for the same command", 0.3),
}
"""Name, factor, unit, what one may know besides, and the span of all values that it may have, by
key of the file. A battery's voltage, whose square the thrust follows, falls by a sixth; None: it
may be any size above zero."""


WAYS = {"x": ("forward", "aft"), "y": ("right", "left")}
"""Along each axis of the body: the way of positive values and that of negative ones."""


def way(axis: str, value: float) -> str:
    """The way that something is off along an axis."""
    return WAYS[axis][value < 0.0]


def off_words(x: float, y: float, joint: str = " and ") -> str:
    """How far something is off, in whole millimeters: `12 mm forward and 3 mm left`."""
    return joint.join(f"{abs(1e3 * v):.0f} mm {way(axis, v)}" for axis, v in (("x", x), ("y", y)))


def half_of(quantity: Mapping[str, Any]) -> float:
    """Half of a quantity's 95 % interval; 0 where it is exact."""
    return Z95 * float(quantity["std"] or 0.0)


def cg_length(value: float, std: float, arm: float, arm_std: float) -> tuple[float, float, str]:
    """A place of the CG for people, and the half of its interval: in mm where the size is known.

    An arm that is only assumed says nothing of mm: then it is percent of the arm.

    Args:
        value: m.
        std: m, with the arm's part.
        arm: m.
        arm_std: m, of an arm that is assumed; 0.0 where it is known.

    Returns:
        Place, half and their unit.
    """
    factor, unit = (1e3, "mm") if not arm_std else (100.0 / arm, "% of the arm")
    own = math.sqrt(max(std**2 - (value * arm_std / arm) ** 2, 0.0)) if arm_std else std
    return factor * value, factor * Z95 * own, unit


def _cg_along(health: Mapping[str, Any], axis: str) -> tuple[float, float, str]:
    """As of `cg_length`, from a health file's content."""
    place = health["cg"][axis]
    return _length(health, place["value"] or 0.0, place["std"] or 0.0)


def _length(health: Mapping[str, Any], value: float, std: float) -> tuple[float, float, str]:
    arm = health.get("arm") or {"value": 1.0, "std": 0.0}  # files of earlier versions
    return cg_length(value, std, arm["value"], arm["std"])


def telling(quantity: Mapping[str, Any] | None, span: float | None = None) -> bool:
    """Whether a number says anything: its interval does not hold all that it may be.

    Args:
        quantity: of the file; None: not known.
        span: of all values that it may have, about zero, beyond which it is an artifact; None: any
            size above zero, which is known where its interval is within a power of ten.
    """
    if quantity is None or quantity["value"] is None:
        return False
    value, half = abs(float(quantity["value"])), half_of(quantity)
    if span is None:
        return value + half < 10.0 * (value - half)
    return half < 0.5 * span and value - half < span


def health_fact(
    health: Mapping[str, Any], key: str, notation: Notation = PLAIN, *, whole: bool = False
) -> tuple[str, str] | None:
    """The name of a number and its value with its interval; None where that says nothing.

    `whole`: all is said, where there is room.
    """
    quantity = health[key]
    name, factor, unit, besides, span = _WORDS[key]
    if quantity is None or not telling(quantity, span):
        return None
    text = notation.measure(factor * quantity["value"], factor * half_of(quantity), unit)
    return name, text + besides * whole


def health_facts(health: Mapping[str, Any], notation: Notation = PLAIN) -> list[tuple[str, str]]:
    """All of them that say something, as `health_fact` gives each."""
    return [fact for key in _WORDS if (fact := health_fact(health, key, notation))]


def absent_health(health: Mapping[str, Any] | None) -> str:
    """Why a session shows no health: there was no look yet, or it was refused."""
    if health is None:
        return "No hover yet: hover for 10 s."
    return f"No health: {'; '.join(health['reasons'])}"


def short_facts(health: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The numbers that one looks at first, rounded, without those that say nothing.

    Args:
        health: the file's content, in which something hovers.

    Returns:
        For each: name and value.
    """
    places = {axis: _cg_along(health, axis) for axis in WAYS}
    unit, _, whole = places["x"][2].partition(" ")
    off = ", ".join(
        f"{PLAIN.measure(abs(value), half, unit)} {way(axis, value)}"
        for axis, (value, half, _) in places.items()
    )
    source = "as identified" if "cg_by_hover" in health else "by hover"
    out = [("CG", f"{' '.join([off, *whole.split()])}, {source}")]
    shares = [rotor["thrust_share"] for rotor in health["rotors"]]
    if all(map(telling, shares)):
        out.append(("rotors carry", f"{', '.join(short(one, 100.0) for one in shares)} %"))
    for key, (name, factor, unit, besides, span) in _WORDS.items():
        # What is much like none is not worth a line.
        found = health[key]
        if telling(found, span) and (span is None or abs(float(found["value"])) > half_of(found)):
            out.append((name, f"{short(found, factor)} {unit}{besides}"))
    for key in ("k_T", "T_max", "mass"):
        quantity = health.get(key)
        if telling(quantity) and quantity is not None and quantity["std"]:
            out.append((key, quantity_text(quantity)))
    return out


_CELLS = (
    ("thrust_share", 100.0, " %", 1), ("motor_gain", 1.0, "", 3), ("headroom", 100.0, " %", 1),
    ("saturated", 100.0, " %", 1),
)  # fmt: skip


def rotor_cells(rotor: Mapping[str, Any], unit: str) -> list[str]:
    """Share of thrust, motor gain, throttle left, time at full command, vibration of a rotor.

    `unit` is m/s^2, as it is written there.
    """
    cells = []
    for key, factor, behind, digits in (*_CELLS, ("vibration", 1.0, f" {unit}", 3)):
        found = rotor[key]
        value = found["value"] if isinstance(found, Mapping) else found
        cells.append("-" if value is None else f"{factor * value:.{digits}f}{behind}")
    return cells


def quantity_text(quantity: Mapping[str, Any]) -> str:
    """A coefficient with its interval, in a power of ten where that is easier to read."""
    value, half, unit = quantity["value"], half_of(quantity), quantity["unit"]
    if not half:
        return f"{significant(value, 4)} {unit} (given)"
    shown, of_half, power, _ = PLAIN.value_and_half(value, half)
    return f"({shown} ± {of_half}){power} {unit}" if power else f"{shown} ± {of_half} {unit}"


def short(quantity: Mapping[str, Any], factor: float = 1.0) -> str:
    """A value to one digit of its interval and no more than three of its own."""
    return _short(factor * float(quantity["value"]), factor * half_of(quantity))


def _short(value: float, half: float) -> str:
    most = 2 - (math.floor(math.log10(abs(value))) if value else 0)
    decimals = min(most, -math.floor(math.log10(half)) if half > 0.0 else most)
    return PLAIN.fixed(value if decimals >= 0 else round(value, decimals), max(decimals, 0))


def cg_facts(
    health: Mapping[str, Any], notation: Notation = PLAIN
) -> list[tuple[str, str, str, str]]:
    """Where the center of gravity is, along and across.

    Returns:
        For each: name, distance with its interval, way, and the half interval of rotors that are
        identical, or which source it is of.
    """
    out = []
    for name, axis in (("along", "x"), ("across", "y")):
        quantity = health["cg"][axis]
        std = quantity["std"] or 0.0
        value, half, unit = _cg_along(health, axis)
        size = notation.measure(abs(value), half, unit)
        alike = half * max(1.0 - (quantity["std_given"] / std) ** 2, 0.0) ** 0.5 if std else 0.0
        identical = notation.fixed(alike, decimals_for(max(alike, 0.01)))
        source = f"identical rotors: ± {identical} {unit}"
        if "cg_by_hover" in health:
            source = "as identified"
        out.append((f"CG {name}", size, way(axis, value), source))
    return out


def unequal_rotors(health: Mapping[str, Any]) -> str:
    """What of the CG's interval is for rotors that may differ; empty where none is.

    Files of earlier versions, which do not say, assume the usual scatter.
    """
    usual = {"std_given": USUAL.rotor_thrust.of(1.0)}
    given = (rotor.get("efficiency", usual)["std_given"] for rotor in health["rotors"])
    scatter = 0.0 if "cg_by_hover" in health else max(given, default=0.0)
    return f"± includes unequal rotors ({100.0 * scatter:.2g} %)" if scatter else ""


_ROTORS = "the motor order"
HOVER = "hover for 30 s, in calm air"
_LOOK_INSIDE = "gcs-sysid inspect shows what the log holds, and what it lacks"


@dataclass(frozen=True)
class FirstAnswer:
    """What a user wants to know first.

    Attributes:
        word: the first words.
        what: to look at, or what is not shown, or what was looked through.
        action: the one thing to do next.
    """

    word: Literal["OK", "LOOK AT", "CANNOT TELL"]
    what: str
    action: str

    @property
    def line(self) -> str:
        """The first line."""
        return f"{self.word} {self.what}" if self.word == "LOOK AT" else f"{self.word}: {self.what}"

    def as_json(self) -> dict[str, str]:
        """As files have it."""
        return {"word": self.word, "line": self.line, "action": self.action}


def first_answer(health: Mapping[str, Any] | None, result: Result | None = None) -> FirstAnswer:
    """The first line on a flight.

    `health` is a health file's content; None where nothing was looked at.
    """
    # Rotors that are taken for others seem to read wrong, too.
    known = health is not None and health["order_contradicted"]
    unseen = health is not None and health["verdict"] == "refused"
    for objection in () if result is None else result.objections:
        at = OF_THE_DATA.get(objection.by)
        if unseen and result is not None and result.verdict == "refused" != objection.verdict:
            continue  # it is not why nothing is known
        if at and not (known and at == OF_THE_DATA[READINGS]):
            return FirstAnswer("LOOK AT", f"{at}: {objection.reason}", _remedy(objection))
    if health is None or unseen:
        return _unseen(health, result)
    findings = health["findings"]
    if findings:
        more = len({found["at"] for found in findings}) - 1
        also = f" (and {more} more)" if more else ""
        first = findings[0]
        return FirstAnswer("LOOK AT", f"{first['at']}: {first['what']}{also}", first["do"])
    seconds = f"{health['seconds_of_hover']:.0f} s of hover"
    if not all(telling(rotor["thrust_share"]) for rotor in health["rotors"]):
        return FirstAnswer("CANNOT TELL", f"{seconds} show no rotor's load", HOVER)
    if vague := _vague_cg(health):
        return FirstAnswer("CANNOT TELL", f"{seconds} leave the CG open by {vague}", HOVER)
    advice = (*health["advice"], "keep it with --json: --baseline shows what changes in a flight")
    value, half, unit = max((_cg_along(health, axis) for axis in WAYS), key=_farthest)
    within = PLAIN.fixed(_farthest((value, half, unit)), decimals_for(half, most=1))
    what = f"nothing wrong seen in {seconds}, CG within {within} {unit} of the center"
    return FirstAnswer("OK", what, advice[0])


def _farthest(place: tuple[float, float, str]) -> float:
    return abs(place[0]) + place[1]


def _vague_cg(health: Mapping[str, Any]) -> str:
    """The CG's interval, where it holds a rotor that gives nothing; else empty.

    Without its thrust the center of thrust is off by that rotor's place over their number.
    """
    rotors = health["airframe"]["rotors"]
    for axis in WAYS:
        _, half, unit = _cg_along(health, axis)
        farthest = max(abs(rotor[axis]) for rotor in rotors)
        if half > _length(health, farthest / len(rotors), 0.0)[0]:
            return f"± {PLAIN.fixed(half, decimals_for(half, most=1))} {unit}"
    return ""


def _unseen(health: Mapping[str, Any] | None, result: Result | None) -> FirstAnswer:
    """Of a flight without a hover that can be judged."""
    objections = [
        Objection(each["reason"], how=each.get("how", ""))
        for each in (health["objections"] if health else ())
    ]
    if not objections and result is not None:
        objections = list(result.objections)
    if not objections:
        return FirstAnswer("CANNOT TELL", "no hover to judge by", HOVER)
    first = objections[0]
    if health is not None and health["order_contradicted"]:
        return FirstAnswer("LOOK AT", f"{_ROTORS}: {first.reason}", _remedy(first))
    return FirstAnswer("CANNOT TELL", first.reason, _remedy(first))


def _remedy(objection: Objection) -> str:
    return objection.how or _LOOK_INSIDE
