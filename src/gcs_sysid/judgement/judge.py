"""The only place where a status, a verdict and its reasons are made.

Evidence against estimates comes as `Objection`s; what follows from all of them is decided here. A
new objection is a function from `Evidence` and a row of `PRODUCERS`.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from math import hypot
from typing import Any, NamedTuple, TypeVar

from gcs_sysid.judgement import imu_faults, outcome, plausibility, prediction, received
from gcs_sysid.judgement.evidence import Evidence
from gcs_sysid.judgement.status import (
    LINES,
    SPINS,
    by_interval,
    nothing,
    on_sound_data,
    reference_values,
)
from gcs_sysid.model.estimate import Estimate, Objection, Status, Verdict
from gcs_sysid.model.parameters import CORE_OF, REGISTRY


class Stage(IntEnum):
    """What the estimates have been through when a producer sees them."""

    WIDENING = 0
    """Nothing yet: they have no status, and their intervals are the fit's own."""
    FLIGHT = 1
    """Statuses by their intervals."""
    GIVEN = 2
    """The caps of all that this flight shows, and the errors of what was given."""
    OUTCOME = 3
    """The caps by what was given, too: these statuses make the verdict."""
    BELIEF = 4
    """As `GIVEN`: whether what the flight shows can be true, however well it is known. A cap from
    here leaves a result `partial`, not refused."""


class Producer(NamedTuple):
    """Who objects.

    Attributes:
        by: name in results.
        objections: by the evidence.
        stage: of the estimates that it sees.
        first: whether its reasons are stated where there is no fit; all others follow from that.
    """

    by: str
    objections: Callable[[Evidence], Iterable[Objection]]
    stage: Stage
    first: bool = False


PRODUCERS = (
    Producer("vehicle", received.vehicle, Stage.BELIEF, first=True),
    Producer("layout", received.layout, Stage.BELIEF, first=True),
    Producer("clock", received.wrong_clock, Stage.WIDENING),
    Producer("estimator", received.estimator, Stage.BELIEF, first=True),
    Producer("data", received.missing_data, Stage.BELIEF, first=True),
    Producer("data", received.without_attitude, Stage.BELIEF),
    Producer("arm", plausibility.placeholder_arm, Stage.BELIEF),
    Producer("scale", plausibility.own_units, Stage.BELIEF),
    Producer("units", plausibility.reread_speeds, Stage.BELIEF),
    Producer("units", plausibility.assumed_unit, Stage.BELIEF),
    Producer(LINES, plausibility.unshaken_speeds, Stage.BELIEF),
    Producer("readings", plausibility.differing_rotors, Stage.WIDENING),
    Producer("readings", plausibility.unlike_spins, Stage.WIDENING),
    Producer("readings", plausibility.unseen_rotors, Stage.FLIGHT),
    Producer("ages", plausibility.aged_readings, Stage.FLIGHT),
    Producer("plausibility", plausibility.implausible, Stage.BELIEF),
    Producer("spin", plausibility.unseen_spins, Stage.BELIEF),
    Producer("gyro", imu_faults.misread_gyro, Stage.BELIEF),
    Producer("saturation", imu_faults.saturated_sensors, Stage.BELIEF),
    Producer("rate", received.slow_imu, Stage.BELIEF),
    Producer("frozen", received.frozen_samples, Stage.BELIEF),
    Producer("order", received.disordered_samples, Stage.BELIEF),
    Producer("prediction", prediction.held_out, Stage.FLIGHT),
    Producer("whiteness", prediction.white, Stage.FLIGHT),
    Producer("motion", prediction.flown, Stage.FLIGHT),
    Producer("explained", prediction.explained, Stage.FLIGHT),
    Producer("motor order", prediction.misplaced, Stage.FLIGHT),
    Producer("sign", prediction.wrong_sign, Stage.FLIGHT),
    Producer("observability", outcome.not_observed, Stage.OUTCOME),
    Producer("rigid body", prediction.rigid_body, Stage.WIDENING),
    Producer("rigid body", plausibility.edge_of_bodies, Stage.BELIEF),
    Producer("one scale", outcome.one_scale, Stage.OUTCOME),
    Producer(SPINS, outcome.negative_torque, Stage.OUTCOME),
    Producer("priors", outcome.contradicted_priors, Stage.BELIEF),
    Producer("givens", outcome.what_was_given, Stage.WIDENING),
    Producer("givens", outcome.limited_by_given, Stage.GIVEN),
    Producer("reference", outcome.unmeasured, Stage.GIVEN),
    Producer("link", received.problems, Stage.BELIEF, first=True),
    Producer("loss", received.lost_samples, Stage.BELIEF),
    Producer("unit", plausibility.unseen_speeds, Stage.BELIEF),
)
"""In the order of their reasons in a result."""

R = TypeVar("R")
_STATUSES: tuple[Status, ...] = ("unobservable", "weak", "zero", "identified")
_VERDICTS: tuple[Verdict, ...] = ("refused", "partial", "identified")


@dataclass(frozen=True)
class Judgement:
    """What is claimed.

    Attributes:
        estimates: with status, interval and the objections to them.
        verdict: of the whole.
        reasons: in words; what limits the verdict, and notes.
        objections: behind the reasons.
    """

    estimates: dict[str, Estimate]
    verdict: Verdict
    reasons: tuple[str, ...]
    objections: tuple[Objection, ...]


def judge(evidence: Evidence) -> Judgement:
    """Decide what is claimed of a flight.

    In this order: (1) Widenings. A status is a statement on the interval that is shown, so it has
    to come after all that makes it wider. (2) The status by value and interval, the flight's own:
    errors of what was given are the same in every flight, and do not make a parameter unobservable
    that was observed. (3) Caps, by the lowest of which each parameter is limited, so that the order
    of producers is of no account. Those of the flight first, as plausibility is asked of what the
    flight seems to show, and the verdict by them and by what was given: a vehicle that is known too
    well to be true is known in part. (4) What a refused result has is at best weak.

    Args:
        evidence: with estimates that have no status.
    """
    shown, counted, found = _limited(evidence)
    missing = evidence.fit.rotation is None
    core = (counted[name].status for name in CORE_OF[evidence.rotor_input] if name in counted)
    verdict: Verdict = "identified" if {"identified", "zero"} & set(core) else "refused"
    verdict = _lowest(verdict, [o for _, o in found])
    raised = on_sound_data(
        o for producer, o in found if o.stated and (producer.first or not missing)
    )
    if verdict == "refused":
        shown = {name: _capped(estimate, "weak") for name, estimate in shown.items()}
    stated = [o for o in raised if verdict != "identified" or o.verdict == "identified"]
    return Judgement(shown, verdict, tuple(o.words for o in stated), tuple(stated))


def judged(evidence: Evidence, upto: Stage = Stage.BELIEF) -> dict[str, Estimate]:
    """The estimates alone, as of one segment of a flight.

    Args:
        evidence: with estimates that have no status.
        upto: last stage that counts; `FLIGHT` leaves what this flight shows by itself.
    """
    return _limited(evidence, upto)[0]


def object_to(result: R, objections: Sequence[Objection]) -> R:
    """A result with what became known after it was judged, and concerns none of its numbers.

    Args:
        result: with `verdict`, `reasons` and `objections`.
        objections: to the whole of it; see `Objection.verdict`.
    """
    whole: Any = result
    verdict = _lowest(whole.verdict, objections)
    stated = [o for o in objections if verdict != "identified" or o.verdict == "identified"]
    changed: R = replace(
        whole,
        verdict=verdict,
        reasons=(*whole.reasons, *(o.words for o in stated)),
        objections=(*whole.objections, *stated),
    )
    return changed


_Found = list[tuple[Producer, Objection]]


def _limited(
    evidence: Evidence, upto: Stage = Stage.BELIEF
) -> tuple[dict[str, Estimate], dict[str, Estimate], _Found]:
    """Estimates as shown, those that make the verdict, and objections in the producers' order."""
    by_row: dict[int, list[Objection]] = {}

    def collect(stage: Stage, estimates: Mapping[str, Estimate]) -> list[Objection]:
        seen = replace(evidence, estimates=estimates)
        raised: list[Objection] = []
        for row, producer in enumerate(PRODUCERS):
            if producer.stage == stage <= upto:
                own = [o if o.by else replace(o, by=producer.by) for o in producer.objections(seen)]
                by_row[row] = own
                raised += own
        return raised

    early = collect(Stage.WIDENING, evidence.estimates)
    widened = _widened(evidence.estimates, [o for o in early if not o.given])
    references = reference_values(widened, evidence.airframe.arm)
    plain = {
        name: by_interval(estimate, references.get(name, 0.0), REGISTRY[name])
        for name, estimate in widened.items()
    }
    by_flight = _limit(plain, [*early, *collect(Stage.FLIGHT, plain)])
    whole = _widened(by_flight, [o for o in early if o.given])
    counted = _limit(whole, collect(Stage.GIVEN, whole))
    collect(Stage.OUTCOME, counted)
    shown = _limit(counted, collect(Stage.BELIEF, whole))
    found = [(PRODUCERS[row], o) for row in sorted(by_row) for o in by_row[row]]
    stated = [o for _, o in found]
    shown = {
        name: replace(e, objections=tuple(o for o in stated if name in o.parameters))
        for name, e in shown.items()
    }
    return shown, counted, found


def _widened(
    estimates: Mapping[str, Estimate], objections: Iterable[Objection]
) -> dict[str, Estimate]:
    """Estimates with the standard deviations that objections add; what is given exactly stays."""
    out = dict(estimates)
    for objection in objections:
        for name, own in objection.widening.items():
            estimate = out.get(name)
            if not own or estimate is None or estimate.value is None or estimate.std is None:
                continue
            if objection.given:
                std, given = hypot(estimate.std, own), hypot(estimate.std_given, own)
                out[name] = replace(estimate, std=std, std_given=given)
            elif estimate.std:
                out[name] = replace(estimate, std=hypot(estimate.std, own))
    return out


def _limit(
    estimates: Mapping[str, Estimate], objections: Iterable[Objection]
) -> dict[str, Estimate]:
    """Estimates below all caps; given ones stay given."""
    out = dict(estimates)
    for objection in objections:
        if objection.cap is None:
            continue
        for name in objection.parameters & out.keys():
            estimate = out[name]
            if objection.void and estimate.status != "given":
                estimate = nothing(estimate)
            out[name] = _capped(estimate, objection.cap)
    return out


def _capped(estimate: Estimate, cap: Status) -> Estimate:
    if estimate.status is None or estimate.status == "given":
        return estimate
    return replace(estimate, status=min(estimate.status, cap, key=_STATUSES.index))


def _lowest(verdict: Verdict, objections: Iterable[Objection]) -> Verdict:
    """The best verdict that objections leave."""
    return min((verdict, *(o.verdict for o in objections if o.verdict)), key=_VERDICTS.index)
