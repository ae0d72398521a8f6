"""Objections by what a fit says of the flight: what it explains, predicts and leaves over.

A standard deviation is the fit's own opinion. Where the held-out part of a flight is predicted
badly, where its residuals are not noise, or where nothing could be held out, no parameter of that
axis is `identified`, however small its standard deviation is. What is known to be small stays so.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation.checks.model_tests import LEAST_RATE
from gcs_sysid.estimation.checks.validation import Validation
from gcs_sysid.estimation.fit.priors import Unknown
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.judgement.evidence import Evidence
from gcs_sysid.judgement.status import READINGS
from gcs_sysid.judgement.status import RULES as STATUS_RULES
from gcs_sysid.model.estimate import Objection, Status
from gcs_sysid.model.parameters import AXES, REGISTRY, TIMING, Parameter
from gcs_sysid.model.rotor_input import THROUGH_MOTORS


@dataclass(frozen=True)
class PredictionRules:
    """From where a flight contradicts the fit to it."""

    least_r2: float = 0.5
    """Share of an axis' acceleration that must be predicted."""
    least_whitened_r2: float = 0.25
    """The same of whitened rows, much of which is noise: for a status. A verdict needs
    `least_r2`."""
    whiteness: float = 3.0
    """Slow power of residuals over that of white noise, with rotor speeds. Flights inside the model
    have 0.5 to 2.5 in all simulators tried, biased ones mostly more."""
    whiteness_commands: float = 6.5
    """The same with commands and rows of the window: mostly 0.8 to 1.4 inside the model, 4 to 8
    where rotors have inertia
    or the battery sags. Flights on all axes at once have 5 to 6 inside the model too, and
    intervals that hold; where thrust lags in place of speed they have 7 to 8, and intervals that
    do not."""
    slow: float = 0.008
    """s between samples of speeds, above which what happened between them colors residuals. At 50
    and 100 Hz flights inside the model, whose intervals hold, have 1.5 to 4.6."""
    whiteness_p: float = 0.05
    """Significance level of the tests."""
    still: tuple[float, float, float] = (LEAST_RATE, LEAST_RATE, 0.05)
    """rad/s rms, below which an axis hardly turns: what it answers is then noise of rotors and
    gyro, or crosstalk. Hovers have 0.003 to 0.06, flights with input on an axis 0.25 and more, in
    yaw 0.08 and more."""
    unexplained: float = 0.1
    """Share of what was flown on an axis, below which rotors may be in another order. Two hexas
    with rotors 1 and 2 swapped have 0.00 and 0.02 on yaw, and one a CG that was off by 34 and
    52 %; an octocopter in wind has 0.24."""
    not_rigid: float = 0.005
    """Relative error of the remaining parameters where the rigid-body test contradicts the
    model."""


RULES = PredictionRules()


def explained(evidence: Evidence) -> Iterator[Objection]:
    """Axes that gusts or anything else turn more than the rotors do.

    Delays are those of all axes together.
    """
    rotation = evidence.fit.rotation
    if rotation is None:
        return
    shares = rotation.r_squared
    limits = STATUS_RULES.explained(whitened=rotation.of_steps)
    caps: tuple[Status, ...] = ("weak", "unobservable")
    for below, cap in zip(limits, caps, strict=True):
        axes = ~(shares >= below)
        if axes.any():
            worst = int(np.argmin(shares))
            yield Objection(
                f"the rotors explain {_percent(shares[worst])} of the motion in {AXES[worst]}",
                _resting_on(evidence, axes, lambda p: not p.mean_torque),
                cap=cap,
                stated=False,
                evidence=_by_axis(shares),
            )
    if not shares.min() >= limits[1]:
        yield Objection(
            "the rotors explain too little for a delay to show",
            frozenset(TIMING) & evidence.estimates.keys(),
            cap="unobservable",
            void=True,
            stated=False,
            evidence=_by_axis(shares),
        )


def wrong_sign(evidence: Evidence) -> Iterator[Objection]:
    """What must be positive, and is not: the airframe's spins are wrong."""
    negative = frozenset(
        name
        for name, e in evidence.estimates.items()
        if REGISTRY[name].sign == "positive" and e.value is not None and e.value <= 0.0
    )
    if negative and evidence.fit.rotation is not None:
        how = "check spin in the airframe file"
        reason = "not positive, as it must be"
        yield Objection(reason, negative, cap="weak", stated=False, how=how)


def rigid_body(evidence: Evidence) -> Iterator[Objection]:
    """Gyroscopic torque that does not agree with the inertia: the rest is doubted, too."""
    test, rotation = evidence.fit.rigid_body_test, evidence.fit.rotation
    if test is None or rotation is None or not test.contradicted:
        return
    share = ", ".join(f"{value:.2f}" for value in test.share)
    yield Objection(
        "the vehicle does not move like a rigid body (gyroscopic torque on roll, pitch, yaw "
        f"{share} times expected): Izz, products of inertia and rotor torque are not observable",
        evidence.names(lambda p: p.rigid_body),
        cap="unobservable",
        verdict="partial",
        widening=evidence.share_of(
            evidence.names(lambda p: bool(p.theta) and p.scale == "thrust" and not p.rigid_body),
            RULES.not_rigid,
        ),
        evidence=_by_axis(test.share),
    )
    least = STATUS_RULES.explained(whitened=rotation.of_steps)[0]
    if rotation.r_squared.min() < least and not evidence.rotor_input.motors:
        # A gust leaves gyroscopic torque as it is; a speed read wrong spoils both, and the CG.
        yield Objection(
            "neither the motion on every axis nor gyroscopic torque agrees with the rotors' speeds",
            evidence.names(lambda p: bool(p.theta) or p.fit == "translation"),
            cap="weak",
            verdict="partial",
            how="check the motor order, and that every ESC reads true: its pole count first",
            by=READINGS,
        )


def held_out(evidence: Evidence) -> Iterator[Objection]:
    """The part of the flight that the fit has not seen, and does not predict.

    The CG is known best in hover, where there is nothing to predict.
    """
    fit, found = evidence.fit, evidence.fit.validation
    if fit.rotation is None or not evidence.checked or (found is None and fit.running):
        return
    if found is None:
        yield Objection(
            "the flight is too short to hold out a part of it: nothing checks the fit",
            _on(evidence, np.ones(3, dtype=bool)) | _motors(evidence, np.ones(3, dtype=bool)),
            cap="weak",
            verdict="partial",
        )
        return
    unpredicted = ~(found.r_squared >= RULES.least_r2)
    unclaimed = _unclaimed(fit.rotation, found)
    worst = int(np.argmin(found.r_squared))
    reason = (
        f"the held-out part of the flight is not predicted on {_named(unpredicted)} "
        f"({_percent(found.r_squared[worst])} on {AXES[worst]})"
    )
    # Other reasons follow from a hover.
    stated = bool(unpredicted.any()) and not is_hover(evidence)
    if stated or unclaimed.any():
        names = _on(evidence, unclaimed, lambda p: not p.mean_torque)
        yield Objection(
            reason,
            names | _motors(evidence, unclaimed),
            cap="weak",
            verdict="partial" if stated else None,
            stated=stated,
            evidence=_by_axis(found.r_squared),
        )


def white(evidence: Evidence) -> Iterator[Objection]:
    """Residuals that are not noise; a filtered gyro and slow speeds color those of any model."""
    rotation, found = evidence.fit.rotation, evidence.fit.validation
    if rotation is None or found is None or not evidence.checked or evidence.filtered:
        return
    by_speed = not evidence.rotor_input.motors
    if by_speed and evidence.interval > RULES.slow:
        return
    fine = by_speed or rotation.of_steps
    limit = RULES.whiteness if fine else RULES.whiteness_commands
    colored = (found.whiteness > limit) & (found.whiteness_p < RULES.whiteness_p)
    if colored.any():
        worst = int(np.argmax(np.where(colored, found.whiteness, 0.0)))
        yield Objection(
            f"residuals on {_named(colored)} are not noise (whiteness {found.whiteness[worst]:.1f} "
            f"on {AXES[worst]}): the model lacks something there",
            _on(evidence, colored),
            cap="weak",
            verdict="partial",
            evidence=_by_axis(found.whiteness),
        )


def flown(evidence: Evidence) -> Iterator[Objection]:
    """Axes that hardly turn, and what to fly there."""
    fit = evidence.fit
    still = still_axes(fit)
    if fit.rotation is None or fit.moments is None or not evidence.checked or not still.any():
        return
    if fit.validation is None and not still.all():
        return  # it is early
    rates = fit.moments.rates
    assert rates is not None
    there = ", ".join(f"{rate:.2g}" for rate in rates[still])
    names = _on(evidence, still, lambda p: not p.mean_torque) | _motors(evidence, still)
    yield Objection(
        f"hardly any rotation in {_named(still)} ({there} rad/s rms)",
        frozenset() if fit.validation is None else names,
        cap="weak",
        verdict="partial",
        evidence=_by_axis(rates),
        how="fly doublets there",
        flying=True,
    )


def misplaced(evidence: Evidence) -> Iterator[Objection]:
    """Rotors that explain nothing of what was flown on an axis: the CG is in doubt, too.

    The order of four shows on roll and pitch, that of more on yaw too.
    """
    rotation = evidence.fit.rotation
    if rotation is None or evidence.fit.validation is None or not evidence.checked:
        return
    axes = ~still_axes(evidence.fit)
    axes[2] &= len(evidence.airframe.rotors) > 4
    unexplained = axes & (rotation.r_squared < RULES.unexplained)
    if unexplained.any():
        yield Objection(
            f"the rotors explain nothing of what was flown in {_named(unexplained)}: their order "
            "may be wrong, and with it the CG",
            _on(evidence, np.ones(3, dtype=bool), lambda p: p.mean_torque),
            cap="weak",
            stated=False,
            evidence=_by_axis(rotation.r_squared),
        )


def parted(
    departures: Mapping[str, tuple[float, float, float]],
    allowed: float,
    what: str = "response",
    how: str = "check mass, thrust curve, delay and layout, or analyze this flight",
) -> Iterator[Objection]:
    """A measured frequency response that parts from the identified model's.

    Gains rest on it, so `tune` asks; a result that was written stays as it was judged.

    Args:
        departures: axis -> share of the response, its lower bound, and the frequency, rad/s.
        allowed: share.
        what: departs, in words.
        how: what to do.
    """
    for axis, (share, least, omega) in departures.items():
        if least > allowed:
            yield Objection(
                f"the measured {what} departs from the model's on {axis} by {_percent(share)} at "
                f"{omega:.0f} rad/s, surely by {_percent(least)}: the model lacks something there",
                evidence={axis: share},
                how=how,
                by="frequency response",
            )


def still_axes(fit: Fit) -> Mask:
    """(3,) whether an axis hardly turns; False where that is not known."""
    rates = None if fit.moments is None else fit.moments.rates
    if rates is None:
        return np.zeros(3, dtype=bool)
    still: Mask = rates < RULES.still
    return still


def is_still(rate: float, axis: str) -> bool:
    """Whether an axis of this rms rate, rad/s, hardly turns."""
    return rate < RULES.still[AXES.index(axis)]


def is_hover(evidence: Evidence) -> bool:
    """Whether hardly any rotation was flown on any axis: other reasons follow from that one."""
    if evidence.fit.rotation is None or not evidence.checked:
        return False
    return bool(still_axes(evidence.fit).all())


def _unclaimed(rotation: RotationFit, found: Validation) -> Mask:
    """(3,) axes of which so little is predicted that nothing there is `identified`."""
    least = RULES.least_whitened_r2 if rotation.of_steps else RULES.least_r2
    unclaimed: Mask = ~(found.r_squared >= least)
    return unclaimed


def _motors(evidence: Evidence, axes: Mask) -> frozenset[str]:
    """Parameters of motors that were found from commands and roll or pitch, where that is among
    (3,) axes; and T_max, gravity over the share of full thrust at hover, which the curve gives.
    """
    rotation = evidence.fit.rotation
    if rotation is None or not axes[:2].any():
        return frozenset()
    if not rotation.full_covariance[Unknown.CURVE, Unknown.CURVE] > 0.0:
        return frozenset()
    return evidence.names(lambda p: p.inputs == THROUGH_MOTORS)


def _on(
    evidence: Evidence, axes: Mask, which: Callable[[Parameter], bool] = lambda _: True
) -> frozenset[str]:
    """Parameters that rest on any of (3,) axes, but for those that are known to be small."""
    small = {name for name, e in evidence.estimates.items() if e.status == "zero"}
    return _resting_on(evidence, axes, which) - small


def _resting_on(
    evidence: Evidence, axes: Mask, which: Callable[[Parameter], bool]
) -> frozenset[str]:
    return evidence.names(lambda p: any(axes[axis] for axis in p.axes) and which(p))


def _percent(share: float) -> str:
    return f"{max(0.0, 100.0 * float(share)):.0f} %"


def _named(axes: Mask) -> str:
    return ", ".join(name for name, there in zip(AXES, axes, strict=True) if there)


def _by_axis(values: Array) -> dict[str, float]:
    return dict(zip(AXES, np.asarray(values, dtype=float).tolist(), strict=True))
