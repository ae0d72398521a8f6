"""The first line of every answer on a log: is the vehicle all right, and what to do first?

Made of what was judged, in one place, for terminal, page, report and JSON.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from gcs_sysid.model.estimate import Objection
from gcs_sysid.results.health_view import telling
from gcs_sysid.results.result import Result

_ROTORS = "the motor order"
_OF_THE_DATA = {"gyro": "the gyro", "clock": "the clock", "units": "the unit of the rotor speeds"}
"""What to look at, by the producer of an objection to a result: the data, not the flying."""
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

    Args:
        health: a health file's content; None where nothing was looked at.
        result: of an identification of the same flight.
    """
    for objection in () if result is None else result.objections:
        if at := _OF_THE_DATA.get(objection.by):
            return FirstAnswer("LOOK AT", f"{at}: {_reason(objection)}", _remedy(objection))
    if health is None or health["verdict"] == "refused":
        return _unseen(health, result)
    findings = health["findings"]
    if findings:
        more = len({found["at"] for found in findings}) - 1
        also = f" (and {more} more)" if more else ""
        first = findings[0]
        return FirstAnswer("LOOK AT", f"{first['at']}: {first['what']}{also}", first["do"])
    seconds = f"{health['seconds_of_hover']:.0f} s of hover"
    if not all(telling(rotor["thrust_share"]) for rotor in health["rotors"]):
        return FirstAnswer("CANNOT TELL", f"{seconds} show no rotor's load", "hover for 30 s")
    advice = (*health["advice"], "keep it with --json: --baseline shows what changes in a flight")
    return FirstAnswer("OK", f"nothing wrong seen in {seconds}", advice[0])


def no_answer(objection: Objection) -> FirstAnswer:
    """That the vehicle cannot be judged, why, and what would help."""
    return FirstAnswer("CANNOT TELL", _reason(objection), _remedy(objection))


def _unseen(health: Mapping[str, Any] | None, result: Result | None) -> FirstAnswer:
    """Of a flight without a hover that can be judged."""
    objections = [Objection(reason) for reason in (health or {}).get("reasons", ())]
    if not objections and result is not None:
        objections = list(result.objections)
    if not objections:
        return FirstAnswer("CANNOT TELL", "no hover to judge by", "hover for 30 s")
    first = objections[0]
    if health is not None and health["order_contradicted"]:
        return FirstAnswer("LOOK AT", f"{_ROTORS}: {_reason(first)}", _remedy(first))
    return no_answer(first)


def _reason(objection: Objection) -> str:
    return _split(objection.reason)[0]


def _remedy(objection: Objection) -> str:
    return objection.how or _split(objection.reason)[1] or _LOOK_INSIDE


def _split(reason: str) -> tuple[str, str]:
    """A reason without what to do, and that: it stands after the last semicolon, or before give."""
    said, semicolon, rest = reason.rpartition("; ")
    if semicolon:
        return said, rest
    said, give, rest = reason.partition(": give ")
    return said, f"give {rest}" if give else ""
