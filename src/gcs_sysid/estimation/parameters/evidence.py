"""Checks of a fit beyond its own statistics: prediction of the last part of the flight.

A standard deviation is the fit's own opinion. Where the held-out part of a flight is predicted
badly, where its residuals are not noise, or where nothing could be held out, no parameter of that
axis is `identified`, however small its standard deviation is.
"""

from dataclasses import dataclass, replace

import numpy as np

from gcs_sysid.arrays import Mask
from gcs_sysid.estimation.checks.layout_test import LEAST_RATE
from gcs_sysid.estimation.fit.priors import Unknown
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import Parameter
from gcs_sysid.model.rotor_input import THROUGH_MOTORS, RotorInput

AXES = ("roll", "pitch", "yaw")


@dataclass(frozen=True)
class EvidenceRules:
    """From where the held-out part of a flight contradicts a fit."""

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
    crossed: tuple[float, float] = (0.95, 0.5)
    """Shares of roll and pitch explained, above which, and of yaw, below which, two rotors of six
    or more must be swapped: neighbors hardly differ in roll and pitch, but turn yaw against itself.
    Of 30 recorded flights none with roll and pitch so well explained has less than 0.98 on yaw; an
    octocopter with rotors 1 and 2 swapped has 0.99, 0.99 and 0.24."""

    unexplained: float = 0.1
    """Share of what was flown on an axis, below which rotors may be in another order. Two hexas
    with rotors 1 and 2 swapped have 0.00 and 0.02 on yaw, and one a CG that was off by 34 and
    52 %; an octocopter in wind has 0.24."""


RULES = EvidenceRules()


@dataclass(frozen=True)
class Evidence:
    """What was found, as a cap on every axis.

    Attributes:
        capped: roll, pitch and yaw: whether nothing there is `identified`.
        reasons: in words; any of them keeps the verdict from being `identified`.
        unmoved: axes that are capped because motion is not predicted, which parameters known from
            the mean torque (the CG, known best in hover) do not need.
    """

    capped: tuple[bool, bool, bool] = (False, False, False)
    reasons: tuple[str, ...] = ()
    unmoved: tuple[bool, bool, bool] = (False, False, False)
    still: bool = False
    """Whether hardly any rotation was flown on any axis: other reasons follow from that one."""
    misplaced: bool = False
    """Whether rotors explain nothing of what was flown on an axis: their order may be wrong, and
    with it the CG. The order of four shows on roll and pitch, that of more on yaw too."""
    motors: bool = False
    """Whether lag and thrust curve are capped, as roll or pitch, which they are found from, is not
    predicted; and T_max, gravity over the share of full thrust at hover, which the curve gives."""

    def cap(self, value: Estimate, parameter: Parameter) -> Estimate:
        """The value, at most `weak` where an axis of the parameter is capped."""
        capped = [axis for axis in parameter.axes if self.capped[axis]]
        if parameter.mean_torque and self.misplaced:
            capped = list(parameter.axes)
        elif parameter.mean_torque:
            capped = [axis for axis in capped if not self.unmoved[axis]]
        doubted = capped or (self.motors and parameter.inputs == THROUGH_MOTORS)
        return replace(value, status="weak") if doubted and value.status == "identified" else value


def evidence_of(
    fit: Fit, rotor_input: RotorInput, dt: float, *, filtered: bool = False, rotors: int = 4
) -> Evidence:
    """Judge a fit by its validation.

    Args:
        fit: with a validation, or without while a flight goes on.
        rotor_input: that it was fitted to.
        dt: s between samples.
        filtered: whether the gyro comes through a low-pass, which colors its noise: whiteness then
            says nothing.
        rotors: how many.
    """
    if fit.rotation is None:
        return Evidence()
    still, rest = _still(fit)
    hovered = bool(still.all())
    found = fit.validation
    if found is None:
        if fit.running:
            return Evidence(reasons=rest, still=True) if hovered else Evidence()
        why = "the flight is too short to hold out a part of it: nothing checks the fit"
        motors = _motors(fit, (True, True))
        every = (True, True, True)
        return Evidence(every, (why, *(rest if hovered else ())), still=hovered, motors=motors)
    whitened = bool(fit.rotation.whiteners)
    fine = whitened or not rotor_input.motors
    limit = RULES.whiteness if fine else RULES.whiteness_commands
    unpredicted = ~(found.r_squared >= RULES.least_r2)
    colored = (found.whiteness > limit) & (found.whiteness_p < RULES.whiteness_p)
    colored &= not (filtered or (not rotor_input.motors and dt > RULES.slow))
    reasons = []
    if unpredicted.any() and not hovered:
        worst = int(np.argmin(found.r_squared))
        share = max(0.0, 100.0 * float(found.r_squared[worst]))
        reasons.append(
            f"the held-out part of the flight is not predicted on {_named(unpredicted)} "
            f"({share:.0f} % on {AXES[worst]})"
        )
    if colored.any():
        worst = int(np.argmax(np.where(colored, found.whiteness, 0.0)))
        reasons.append(
            f"residuals on {_named(colored)} are not noise (whiteness {found.whiteness[worst]:.1f} "
            f"on {AXES[worst]}): the model lacks something there"
        )
    reasons += rest
    explained = fit.rotation.r_squared
    high, low = RULES.crossed
    if rotors > 4 and not still[2] and explained[:2].min() > high and explained[2] < low:
        share = max(0.0, 100.0 * float(explained[2]))
        why = (
            f"the rotors explain roll and pitch but only {share:.0f} % of yaw: two rotors of "
            "opposite spin look swapped; check motor order and spin in the airframe file"
        )
        return Evidence((True, True, True), (why, *reasons))
    least = RULES.least_whitened_r2 if whitened else RULES.least_r2
    capped = tuple(bool(c) for c in ~(found.r_squared >= least) | colored | still)
    unmoved = (unpredicted | still) & ~colored
    flown = ~still & (np.arange(3) < (3 if rotors > 4 else 2))
    misplaced = bool((explained[flown] < RULES.unexplained).any())
    axes = tuple(map(bool, unmoved))
    untold = ~(found.r_squared >= least) | still
    motors = _motors(fit, tuple(untold[:2].tolist()))
    return Evidence(capped, tuple(reasons), axes, hovered, misplaced, motors)  # type: ignore[arg-type]


def _motors(fit: Fit, untold: tuple[bool, ...]) -> bool:
    """Whether motors are in doubt that were found from commands and (2,) roll and pitch."""
    assert fit.rotation is not None
    return any(untold) and bool(fit.rotation.full_covariance[Unknown.CURVE, Unknown.CURVE] > 0.0)


def _still(fit: Fit) -> tuple[Mask, tuple[str, ...]]:
    """Axes that hardly turn, and what to fly there."""
    rates = None if fit.moments is None else fit.moments.rates
    if rates is None:
        return np.zeros(3, dtype=bool), ()
    still: Mask = rates < RULES.still
    if not still.any():
        return still, ()
    return still, (
        f"hardly any rotation in {_named(still)} "
        f"({', '.join(f'{rate:.2g}' for rate in rates[still])} rad/s rms): fly doublets there",
    )


def _named(axes: Mask) -> str:
    return ", ".join(name for name, there in zip(AXES, axes, strict=True) if there)
