"""One vocabulary for terminal, screen, report and fleet page.

Parameters have the names of the JSON everywhere; what they are and what makes them observable is in
`model.parameters`. Statuses and verdicts are the words of the JSON, each with one sign.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from gcs_sysid.estimation.parameters.status import RULES
from gcs_sysid.model.estimate import Estimate, Status
from gcs_sysid.model.parameters import INERTIA, PARAMETERS, REGISTRY, Parameter
from gcs_sysid.results.comparison import Change
from gcs_sysid.results.number_format import (
    PLAIN,
    Notation,
    percent_column,
    rounded,
    scaled_unit,
    significant,
)
from gcs_sysid.results.result import Result, Verdict


@dataclass(frozen=True)
class Word:
    """A state as people meet it: its sign, since color is never the only one, and its meaning."""

    sign: str
    meaning: str
    advice: str = ""
    """What improves it, while there is more to fly."""

    @property
    def with_advice(self) -> str:
        """The meaning, and what improves it."""
        return f"{self.meaning}: {self.advice}" if self.advice else self.meaning


STATUS: dict[Status | None, Word] = {
    "identified": Word(
        "✓", f"sigma below {100.0 * RULES.identified_below:g} % of the reference value"
    ),
    "given": Word("•", "entered by you, sets the scale"),
    "zero": Word("≈", "consistent with zero, and smaller than the limit shown"),
    "weak": Word(
        "~", f"sigma below {100.0 * RULES.unobservable_above:g} %", "fly more of its motion"
    ),
    "unobservable": Word("✗", "not observable from this flight"),
}
WRONG_AIRFRAME = "wrong airframe"
"""Begins each reason that the vehicle's own parameters contradict the airframe."""
WAITING = Word("○", "waiting")
"""Of every parameter before there are data."""
VERDICT: dict[Verdict, Word] = {
    "identified": Word("✓", "Identified"),
    "partial": Word("~", "Partly identified"),
    "refused": Word("✗", "Not identified"),
}
CHANGE: dict[Change, Word] = {
    "changed": Word("≠", "changed"),
    "no_change_seen": Word("=", "no change seen"),
    "cannot_tell": Word("?", "undetermined"),
}


class Shown(NamedTuple):
    """An estimate as a terminal writes it; see `shown`."""

    value: str
    half: str
    """Half of the 95 % interval, or the limit of a value consistent with zero."""
    percent: str
    """The half interval over the value, without the sign."""

    @property
    def text(self) -> str:
        """Value and relative interval: `0.016553 ±0.49 %`, `~0 (< 0.00021)`, `-`."""
        if self.percent:
            return f"{self.value} ±{self.percent} %"
        return f"{self.value} {self.half}".rstrip(" -") or self.value


def shown(estimate: Estimate | None, digits: int = 6) -> Shown:
    """An estimate for terminals: rounded to its interval, nothing where it is unobservable.

    Args:
        estimate: None: not in the result.
        digits: of the value, at most.
    """
    if estimate is None or not estimate.shown or estimate.std is None:
        return Shown("-", "-", "")
    if estimate.limit is not None:
        return Shown("~0", f"(< {significant(estimate.limit, 2)})", "")
    if estimate.half is None:
        return Shown(rounded(estimate.value, None, digits), "", "")
    share = percent_column(estimate.relative_half).removesuffix(" %")
    return Shown(
        rounded(estimate.value, estimate.half, digits), significant(estimate.half, 2), share
    )


def label(name: str) -> str:
    """A parameter's name in at most thirteen letters: the result's own name where it fits."""
    return REGISTRY[name].label or name if name in REGISTRY else name


def rows(result: Result) -> list[tuple[Parameter, Estimate]]:
    """The parameters and timing values of a result, in the order of all tables."""
    there = result.parameters | result.timing
    return [(p, there[name]) for name, p in REGISTRY.items() if name in there]


def displayed(parameter: Parameter, estimate: Estimate) -> Estimate:
    """An estimate in the unit that people read it in, where the registry fixes one: ms."""
    if parameter.exponent is None:
        return estimate
    scale = 10.0**-parameter.exponent
    return replace(
        estimate,
        value=None if estimate.value is None else scale * estimate.value,
        std=None if estimate.std is None else scale * estimate.std,
        std_given=scale * estimate.std_given,
        bound=None if estimate.bound is None else scale * estimate.bound,
        unit=scaled_unit(parameter.unit, parameter.exponent),
    )


def exponent_key(parameter: Parameter) -> str:
    """What shares one power of ten: a unit; a rotor's inertia is too small for the body's."""
    body = INERTIA if parameter.unit == REGISTRY["Ixx"].unit else ()
    return parameter.name if body and parameter.name not in body else parameter.unit


def source_of(name: str, estimate: Mapping[str, Any], scale: Mapping[str, Any] | None) -> str:
    """What an estimate is based on, from its entry in a result's JSON."""
    if estimate["status"] == "given":
        return "given: sets the scale"
    if estimate.get("rests_on"):
        return f"mostly from {estimate['rests_on']}"
    if estimate["status"] == "unobservable":
        return f"needs {PARAMETERS[name].excited_by}"
    if scale and name == scale["anchor"] and scale.get("from"):
        return f"from {scale['from']}"
    return PARAMETERS[name].excited_by


_DISTURBANCES = {
    "contact": "contact with the ground",
    "thrust": "thrust far from the usual",
    "climb": "a climb or descent",
    "airspeed": "forward flight",
    "force": "a force, as of a gust",
    "moment": "a moment, as of a gust",
}
"""Words of a disturbance's `cause`."""


def disturbance_text(event: Mapping[str, Any]) -> str:
    """What moved the vehicle without changing it."""
    cause = _DISTURBANCES.get(str(event.get("cause")), "a disturbance")
    if event.get("undecided"):
        return (
            f"{cause} or a change, undecided at the end: the result covers only the flight up to it"
        )
    return f"{cause}; the vehicle is unchanged"


def event_text(event: Mapping[str, Any], notation: Notation = PLAIN) -> str:
    """What happened, in one line: of a change all parameters that surely changed with it."""
    if event.get("text"):
        return str(event["text"])
    if event["kind"] == "disturbance":
        return disturbance_text(event)
    text = str(event["kind"]).replace("_", " ")
    if "loss" in event:
        low, high = (100.0 * v for v in event["loss"]["ci95"])
        return f"{text}: rotor {event['rotor'] + 1} lost {low:.0f} to {high:.0f} % of its thrust"
    differences = []
    for name, change in event.get("parameters", {}).items():
        before, after, ci95 = (change.get(key) for key in ("before", "after", "ci95"))
        if before is None or after is None or ci95 is None or ci95[0] <= 0.0 <= ci95[1]:
            continue
        unit = notation.unit(PARAMETERS[name].unit) if name in PARAMETERS else ""
        first, second = (notation.number(value, 4) for value in (before, after))
        differences.append(f"{name} {first} {notation.arrow} {second} {unit}".rstrip())
    return f"{text}: {', '.join(differences)}" if differences else text
