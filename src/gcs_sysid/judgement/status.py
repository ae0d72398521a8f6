"""Answers in one word: of a value by its interval alone, of data by objections alone."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

from gcs_sysid.model.estimate import Estimate, Objection
from gcs_sysid.model.parameters import ARM, REGISTRY, Parameter
from gcs_sysid.significance import Z95


@dataclass(frozen=True)
class StatusRules:
    """Where one status ends and the next begins.

    Where gusts or unmodeled torques move the vehicle more than its rotors do, the controller's
    reaction to them is mistaken for the vehicle's response, and intervals are confidently wrong:
    hence the rules on R², the share of an axis' angular acceleration that is explained.
    """

    identified_below: float = 0.05
    """Standard deviation over the reference value."""
    unobservable_above: float = 0.5
    """The same, above which the data carry no useful information."""
    weak_below_r2: float = 0.8
    """R² below which nothing on that axis is identified."""
    unobservable_below_r2: float = 0.5
    """R² below which it is not even weak."""
    impossible_below: float = -3.0
    """Standard deviations below zero from which a value that cannot be negative contradicts the
    model: noise alone does so once in 740 estimates of zero."""
    weak_below_whitened: float = 0.35
    unobservable_below_whitened: float = 0.2
    """The same of whitened rows, of which slow disturbances are taken out and much is noise: 0.99
    in calm air, 0.36 to 0.96 on real flights, whose inertia is right to 5 %; a vehicle with two
    rotors swapped has 0.0 to 0.4."""

    def explained(self, *, whitened: bool) -> tuple[float, float]:
        """Shares of an axis' acceleration, below which nothing is identified, or even weak.

        Args:
            whitened: whether of whitened rows.
        """
        if whitened:
            return self.weak_below_whitened, self.unobservable_below_whitened
        return self.weak_below_r2, self.unobservable_below_r2


RULES = StatusRules()
NOTHING = Estimate(None, None, status="unobservable")
"""Of a parameter of which nothing is known."""


def by_interval(estimate: Estimate, reference: float, parameter: Parameter) -> Estimate:
    """An estimate with the status that its interval gives it.

    The interval is that of the flight's data: a value that only the givens blur was observed.

    Args:
        estimate: with a standard deviation, which is zero where the value was given.
        reference: what the standard deviation is divided by.
        parameter: what it is of. What may be zero, and is small with an interval that contains
            zero, is "zero". Of what cannot be negative, but is, nothing is left: the model is
            wrong.
    """
    value, std = estimate.value, estimate.std_data
    if value is None or std is None or not (math.isfinite(value) and math.isfinite(std)):
        return nothing(estimate)
    if std == 0.0:
        return replace(estimate, status="given")
    if parameter.sign == "not negative" and value < RULES.impossible_below * std:
        return nothing(estimate)
    ratio = std / reference if reference > 0.0 else math.inf
    if ratio < RULES.identified_below:
        low = -math.inf if parameter.sign == "not negative" else -Z95 * std
        zero = parameter.sign != "positive" and low <= value <= Z95 * std
        return replace(estimate, status="zero" if zero else "identified")
    weak = ratio < RULES.unobservable_above
    return replace(estimate, status="weak" if weak else "unobservable")


def nothing(estimate: Estimate) -> Estimate:
    """What is left of an estimate whose number means nothing."""
    return replace(estimate, value=None, std=None, std_given=0.0, status="unobservable")


def reference_values(estimates: Mapping[str, Estimate], arm: float) -> dict[str, float]:
    """What the standard deviation of each is divided by, of those with a value.

    Args:
        estimates: by name.
        arm: m, mean distance of the rotors from the geometric center.
    """
    found = {n: e.value for n, e in estimates.items() if e.value is not None}
    sizes = dict.fromkeys(estimates, math.nan) | found | {ARM: arm}
    return {name: REGISTRY[name].reference.size(value, sizes) for name, value in found.items()}


def of_rotors(rotors: list[dict[str, Estimate]]) -> tuple[dict[str, Estimate], ...]:
    """The coefficients of single rotors, each judged by its own interval."""
    return tuple(
        {
            name: by_interval(estimate, abs(estimate.value or 0.0), REGISTRY[name])
            for name, estimate in rotor.items()
        }
        for rotor in rotors
    )


ROTORS = "rotors"
"""Producer of objections that the airframe's rotors contradict the motion."""
READINGS = "readings"
"""Producer of objections that rotors differ by more than propellers do."""
LINES = "lines"
"""Producer of objections that the IMU is shaken otherwise than the rotors' speeds are read."""
SPINS = "spins"
"""Producer of objections that all rotors turn the other way."""
_OF_THE_MOTION = {
    "gyro": "the gyro",
    "saturation": "the IMU",
    "sensors": "the IMU",
    "frozen": "the IMU",
    "order": "the record",
    READINGS: "the rotors",
    "ages": "the rotors",
}
OF_THE_DATA = _OF_THE_MOTION | {
    "link": "the record",
    "clock": "the clock",
    "units": "the unit of the rotor speeds",
    LINES: "the unit of the rotor speeds",
    SPINS: "the spin of the rotors",
    "priors": "what was given",
    "sizes": "what was given",
}
"""What to look at, by the producer of an objection: the data, not the flying."""


def on_sound_data(objections: Iterable[Objection]) -> tuple[Objection, ...]:
    """Objections, without advice to fly more where motion is misread: the next would be so too."""
    every = tuple(objections)
    if not any(o.stated and o.by in _OF_THE_MOTION for o in every):
        return every
    return tuple(replace(o, how="", flying=False) if o.flying else o for o in every)


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
