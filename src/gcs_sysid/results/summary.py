"""From fits, anchors and events to the words and numbers of a result."""

import math
from collections.abc import Collection, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.changes.change_hypotheses import describe
from gcs_sysid.estimation.changes.tracking import TrackingEvent
from gcs_sysid.estimation.noise.uncertainty import watched_factor
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.parameters.physical_parameters import physical_parameters, rests_on_prior
from gcs_sysid.model.airframe import NOT_CANTED, Cant, Known, ScaleReference
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import AXES, REGISTRY
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.results.result import Result
from gcs_sysid.results.result_data import Scale
from gcs_sysid.results.snapshot import LinkState, Snapshot
from gcs_sysid.results.words import WRONG_AIRFRAME, disturbance_text
from gcs_sysid.significance import Z95

MIN_SECONDS = 3.0
"""Flight time in s below which nothing is claimed, unless an earlier segment determines most of
it."""

_WORDS = {
    "mass_change": "the mass changed",
    "payload": "a payload changed mass and CG",
    "cg_shift": "the center of gravity moved",
    "inertia_change": "the inertia changed",
    "rotor_failure": "a rotor lost thrust",
    "passing": "a disturbance",
    "change": "the vehicle changed",
}


def before_data(snapshot: Snapshot) -> bool:
    """Whether there is too little flight for any estimate, and more may come."""
    return snapshot.used_seconds < MIN_SECONDS and snapshot.link.state is not LinkState.ENDED


def contradicted(result: Result) -> str:
    """Why an airframe is wrong, where the vehicle itself says so and nothing is identified."""
    first = result.reasons[0] if result.reasons else ""
    is_wrong = result.verdict == "refused" and first.startswith(WRONG_AIRFRAME)
    return first if is_wrong else ""


def priors_for(known: Mapping[str, Known], rotor_input: RotorInput) -> Mapping[str, Known]:
    """Those priors that make sense with this input."""
    return {name: value for name, value in known.items() if rotor_input in REGISTRY[name].inputs}


def values_of(
    fit: Fit,
    anchor: ScaleReference,
    arm: float,
    known: Mapping[str, Known],
    rotor_input: RotorInput = RotorInput.SPEED,
    lateness: float = 0.0,
    cant: Cant = NOT_CANTED,
) -> dict[str, Estimate]:
    """Physical parameters of a fit, not judged, or nothing but the anchor while it is too early.

    While the flight continues, every estimate is seen and may be taken once `identified`: intervals
    are then wide enough to hold at all times.
    """
    if fit.running:
        fit = _widened(fit, watched_factor(fit.seconds / MIN_SECONDS))
    early = fit.seconds < MIN_SECONDS and not anchor.origin
    rotation = None if early else fit.rotation
    return physical_parameters(
        anchor,
        rotation,
        fit.translation,
        arm,
        known,
        rotor_input,
        lateness,
        cant,
        fit.seconds,
    )


def _widened(fit: Fit, factor: float) -> Fit:
    """The fit with standard deviations times a factor."""
    rotation, translation = fit.rotation, fit.translation
    if rotation is not None:
        rotation = replace(
            rotation,
            covariance=factor**2 * rotation.covariance,
            full_covariance=factor**2 * rotation.full_covariance,
            extended_covariance=factor**2 * rotation.extended_covariance,
        )
    if translation is not None:
        translation = replace(
            translation,
            kappa_std=factor * translation.kappa_std,
            delta_std=factor * translation.delta_std,
        )
    return replace(fit, rotation=rotation, translation=translation)


def complete(
    estimates: Mapping[str, Estimate],
    fit: Fit,
    anchor: ScaleReference,
    bounds: Mapping[str, Estimate] = MappingProxyType({}),
) -> dict[str, Estimate]:
    """Estimates as a result has them: within physical bounds, and with what they rest on.

    `bounds` are estimates whose `std` are the Cramer-Rao bounds, where they were computed.
    """
    leaning = rests_on_prior(fit.rotation) if fit.rotation is not None else frozenset()
    support = anchor.origin or "prior"
    return {
        name: replace(
            estimate,
            bound=bounds[name].std if name in bounds else None,
            rests_on=support if name in leaning else None,
        ).bounded
        for name, estimate in estimates.items()
    }


def in_units(estimates: Mapping[str, Estimate], own: Collection[str]) -> dict[str, Estimate]:
    """Estimates that say what they are per, as of `Airframe.own_units`."""
    return {
        name: replace(estimate, unit=REGISTRY[name].unit_per(own)) if own else estimate
        for name, estimate in estimates.items()
    }


def scale_of(anchor: ScaleReference) -> Scale:
    """The anchor as a result names it."""
    unit = REGISTRY["mass" if anchor.kind == "added_mass" else anchor.kind].unit
    return Scale(
        anchor.kind, anchor.value, unit, anchor.std, anchor.origin, anchor.given * anchor.value
    )


def next_anchor(
    anchor: ScaleReference,
    values: Mapping[str, Estimate],
    until: float,
    mass_ratio: tuple[float, float] | None = None,
) -> ScaleReference:
    """The anchor after a change of the body: the rotors are the same, so their thrust stays.

    Where the flight before was too short to determine thrust as well as the change determines the
    ratio of masses, the mass before times that ratio.

    Args:
        anchor: in force before.
        values: parameters before, with k_T (rotor speeds) or T_max (commands).
        until: s, session time of the change.
        mass_ratio: mass after over mass before, and its standard deviation; None: not known.
    """
    kind = next(kind.thrust for kind in RotorInput if kind.thrust in values)
    thrust = values[kind]
    origin = f"the flight before {until:.1f} s"
    if anchor.kind == kind:
        return ScaleReference(kind, anchor.value, anchor.std, origin, given=anchor.given)
    share = math.inf
    if thrust.value and thrust.std is not None:
        share = thrust.std / thrust.value
    if anchor.kind == "mass" and mass_ratio is not None and mass_ratio[1] < share * mass_ratio[0]:
        ratio, std = mass_ratio
        mass, spread = anchor.value * ratio, math.hypot(anchor.value * std, anchor.std * ratio)
        return ScaleReference("mass", mass, spread, origin, given=anchor.given)
    if thrust.value is None or thrust.std is None:
        return anchor
    return ScaleReference(kind, thrust.value, thrust.std, origin, given=anchor.given)


def validation_of(fit: Fit) -> dict[str, Any]:
    """The validation as a result's dictionary."""
    found = fit.validation
    if found is None:
        return {}

    def axes(values: Array) -> dict[str, float | None]:
        return {
            axis: value if math.isfinite(value) else None
            for axis, value in zip(AXES, np.asarray(values).tolist(), strict=True)
        }

    out = {
        "fitted_share": found.fitted_share,
        "r_squared": axes(found.r_squared),
        "theil": axes(found.theil),
        "whiteness": axes(found.whiteness),
        "whiteness_p": axes(found.whiteness_p),
    }
    if fit.rigid_body_test is not None:
        out["gyroscopic"] = {
            "share": axes(fit.rigid_body_test.share),
            "std": axes(fit.rigid_body_test.std),
        }
    return out


def event_of(
    event: TrackingEvent, before: Mapping[str, Estimate], after: Mapping[str, Estimate] | None
) -> dict[str, Any]:
    """A change as a result reports it.

    `after` is None where there is no segment behind.
    """
    out: dict[str, Any] = {
        "t": event.onset,
        "kind": "change" if event.cause is None else event.cause.kind,
        "detected": event.detected,
        "channel": event.channel or "landing",
    }
    if event.decided is not None:
        out["decided"] = event.decided
    if event.cause is not None and event.cause.kind == "passing":
        out["kind"] = "disturbance"
        out["cause"] = event.cause.disturbance
        out["undecided"] = event.decided is None
    if event.cause is not None and event.cause.kind == "rotor_failure":
        half = Z95 * event.cause.loss_std
        out["rotor"] = event.cause.rotor
        out["loss"] = {
            "value": event.cause.loss,
            "ci95": [event.cause.loss - half, event.cause.loss + half],
        }
    if after is not None:
        # What a flight cannot determine has not changed in it, whatever its fit says.
        first, second = (
            {n: (v.value, v.std) for n, v in side.items() if v.status != "unobservable"}
            for side in (before, after)
        )
        description = describe(first, second)
        if description["kind"] != "change":
            out["kind"] = description["kind"]
        out["parameters"] = description["parameters"]
    return out


def note_of(event: TrackingEvent, rotor_input: RotorInput = RotorInput.SPEED) -> str:
    """A line for the event log."""
    thrust = rotor_input.thrust
    if event.channel is None:
        return (
            f"the vehicle differs since the landing at {event.onset:.1f} s: "
            f"{thrust} stays, the rest is identified again"
        )
    cause = event.cause
    kind = "change" if cause is None else cause.kind
    text = f"{_WORDS[kind]} at {event.onset:.2f} s"
    if cause is not None and cause.disturbance is not None:
        passed = {"cause": cause.disturbance, "undecided": event.decided is None}
        return f"{event.onset:.2f} s: {disturbance_text(passed)}"
    if cause is not None and cause.rotor is not None:
        return f"{text}: rotor {cause.rotor + 1}, {100.0 * cause.loss:.0f} %; identification stops"
    if kind == "passing":
        return f"{text}; the estimate continues"
    ratio = "" if cause is None else f" (mass x {cause.mass_ratio:.3f})"
    return f"{text}{ratio}: {thrust} stays, the rest is identified again"
