"""Objections by the outcome: what of a complete identification the flight leaves open."""

from collections.abc import Iterator

from gcs_sysid.judgement.evidence import Evidence
from gcs_sysid.judgement.prediction import is_hover
from gcs_sysid.judgement.status import RULES, reference_values
from gcs_sysid.model.estimate import Objection
from gcs_sysid.model.parameters import CORE_OF, REGISTRY
from gcs_sysid.significance import Z95


def what_was_given(evidence: Evidence) -> Iterator[Objection]:
    """Errors of arm, scale and IMU as given: the same in every flight."""
    if evidence.given:
        yield Objection(
            "what was given is uncertain", widening=evidence.given, given=True, stated=False
        )


def contradicted_priors(evidence: Evidence) -> Iterator[Objection]:
    """Priors that the flight alone contradicts: one of the two is wrong, and no mean is right."""
    for name, found in evidence.contradicted.items():
        value, std = evidence.airframe.priors[name]
        half = Z95 * (found.std or 0.0)
        yield Objection(
            f"the flight has {name} {found.value:.3g} +- {half:.2g}, the prior {value:.3g} +- "
            f"{Z95 * std:.2g}: the prior is not used",
            frozenset({name}),
            verdict="partial",
            evidence={"flight": found.value or 0.0, "prior": value},
            how="check what the prior is of, and the mass, arm and spins that were given",
        )


def unmeasured(evidence: Evidence) -> Iterator[Objection]:
    """What is small against values that the flight does not show: it may be anything."""
    estimates = evidence.estimates
    unknown = frozenset(
        name
        for name, e in estimates.items()
        if e.status in ("zero", "identified", "weak")
        and any(
            other in estimates and estimates[other].status == "unobservable"
            for other in REGISTRY[name].reference.of
        )
    )
    if unknown:
        yield Objection(
            "what it is measured against is not known", unknown, cap="unobservable", stated=False
        )


def limited_by_given(evidence: Evidence) -> Iterator[Objection]:
    """Parameters that the flight determines well enough, but the given values do not.

    They are weak, however uncertain the givens are: they were observed.
    """
    references = reference_values(evidence.estimates, evidence.airframe.arm)
    limited = [
        name
        for name, e in evidence.estimates.items()
        if e.status == "identified" and e.std is not None and e.std_given
        if e.std >= RULES.identified_below * references[name]
    ]
    if limited:
        yield Objection(
            f"given values limit {', '.join(limited)}, not the flight",
            frozenset(limited),
            cap="weak",
            how="measure rotors, mass and IMU better and state it in [uncertainty]",
        )


def not_observed(evidence: Evidence) -> Iterator[Objection]:
    """Core parameters that are missing or weak."""
    core = CORE_OF[evidence.rotor_input]
    for status, words in (
        ("unobservable", "not observable from this flight"),
        ("weak", "weak"),
    ):
        names = [name for name in core if evidence.estimates[name].status == status]
        if names:
            yield Objection(f"{words}: {', '.join(names)}", frozenset(names), verdict="partial")


def one_scale(evidence: Evidence) -> Iterator[Objection]:
    """Yaw inertia and rotor torque that nothing separates."""
    test = evidence.fit.rigid_body_test
    if is_hover(evidence) or (test is not None and test.contradicted):
        return
    torque = evidence.rotor_input.torque
    if all(evidence.estimates[n].status in ("weak", "unobservable") for n in ("Izz", torque)):
        yield Objection(
            f"Izz and {torque} share one scale",
            frozenset({"Izz", torque}),
            verdict="partial",
            how="fly several axes at once, such as roll and yaw, to separate them",
            flying=True,
        )


def negative_torque(evidence: Evidence) -> Iterator[Objection]:
    """A drag torque that surely drives: the spins are the other way round."""
    ratio = evidence.estimates.get("moment_ratio")
    if ratio is None or ratio.value is None or ratio.std is None:
        return
    if ratio.value < RULES.impossible_below * ratio.std:
        torque = evidence.rotor_input.torque
        yield Objection(
            f"{torque} is negative",
            frozenset({torque, "moment_ratio"}),
            verdict="partial",
            how="check spin in the airframe file",
        )
