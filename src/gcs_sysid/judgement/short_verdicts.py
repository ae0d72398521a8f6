"""Answers by objections alone: may this be identified from, and is there a hover?"""

from collections.abc import Iterable
from typing import Literal

from gcs_sysid.model.estimate import Objection

Readiness = Literal["yes", "partly", "no"]
Level = Literal["blocks", "limits", "note"]
HoverVerdict = Literal["available", "refused"]


def level_of(objection: Objection) -> Level:
    """What an objection means for what can be had from the data, by the verdict that it leaves."""
    if objection.verdict == "refused":
        return "blocks"
    return "limits" if objection.verdict == "partial" else "note"


def readiness(objections: Iterable[Objection]) -> Readiness:
    """Whether a vehicle can be identified from the data."""
    levels = {level_of(objection) for objection in objections}
    return "no" if "blocks" in levels else "partly" if "limits" in levels else "yes"


def hover_verdict(objections: Iterable[Objection], *, hovers: bool) -> HoverVerdict:
    """Whether a flight shows the balance of its vehicle.

    Args:
        objections: to it.
        hovers: whether anything hovered.
    """
    blocked = any(level_of(objection) == "blocks" for objection in objections)
    return "available" if hovers and not blocked else "refused"
