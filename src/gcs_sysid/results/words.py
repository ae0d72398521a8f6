"""One vocabulary for terminal, screen, report and fleet page.

Parameters have the names of the JSON everywhere; what they are and what makes them observable is in
`model.parameters`. Statuses and verdicts are the words of the JSON, each with one sign.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from gcs_sysid.judgement.status import RULES
from gcs_sysid.model.estimate import Status, Verdict
from gcs_sysid.model.parameters import PARAMETERS, REGISTRY
from gcs_sysid.results.number_format import PLAIN, Notation

Change = Literal["changed", "no_change_seen", "cannot_tell"]
"""What two results say of a parameter, or of the vehicle."""


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


def label(name: str) -> str:
    """A parameter's name in at most thirteen letters: the result's own name where it fits."""
    return REGISTRY[name].label or name if name in REGISTRY else name


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
