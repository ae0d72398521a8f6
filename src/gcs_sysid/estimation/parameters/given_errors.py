"""Effect of errors in the given rotor positions and scale on an estimate.

Not observable in any flight are the scale reference, the scale common to all arms and the middle of
the rotors. A share e of the scale reference moves mass, k_T (T_max), inertia, k_M, damping and drag
by e. A share e of all arms moves theta as a whole by e: inertia, CG, moment ratio, damping and
rotor inertia, all over k_T. The CG is counted from the middle. These errors are the same in all
flights of a vehicle.

Nor are rotors that are unlike in a way that shifts the center of thrust and does nothing else; none
of four are, whose control of one axis then turns another, too.

How rotors lie otherwise, and how the IMU is turned and where it is, a flight shows: these are
unknowns of the fits (`estimation.fit.deviations`, `estimation.fit.translation`).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.parameters.scale import resolve_scale
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.airframe import Airframe, Known, ScaleReference
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import PARAMETERS
from gcs_sysid.model.rotor_input import RotorInput


@dataclass(frozen=True)
class Given:
    """What was given, as far as its errors matter.

    Attributes:
        airframe: with rotor positions and the uncertainty of all.
        anchor: that sets the scale.
        rotor_input: what the fit is relative to.
        priors: on parameters.
    """

    airframe: Airframe
    anchor: ScaleReference
    rotor_input: RotorInput
    priors: Mapping[str, Known]


CAUSES = ("scale", "arm", "cant", "center_x", "center_y")
"""What is given and may be off, each by itself: the scale reference, the scale of all arms, what
canted rotors add with these, and the center of thrust along each axis."""
_SCALE, _ARM, _CANT, _CENTER = range(4)


def given_effects(values: Mapping[str, Estimate], fit: Fit, given: Given) -> dict[str, Array]:
    """What one standard deviation of each thing given does to the parameters.

    One error moves all that depends on it: a mass 1 % too large makes k_T and inertia 1 % too
    large, an arm inertia alone.

    Args:
        values: parameters by name.
        fit: that they come from.
        given: what they rest on.

    Returns:
        Name -> (causes,) change, SI, of parameters that have a value; `CAUSES`.
    """
    scale = resolve_scale(given.anchor, fit.translation, given.priors)
    airframe = given.airframe
    arm, middle = _common_errors(airframe)
    center = np.hypot(middle, unseen_shift(airframe))
    of_mass, of_thrust = np.zeros((2, len(CAUSES)))
    of_mass[_SCALE], of_thrust[_SCALE] = scale.mass_given, scale.thrust_given
    of_theta = np.zeros((rb.N_THETA, len(CAUSES)))
    # As long as the arms are wrong, so is what cant adds.
    of_theta[rb.MOMENT_RATIO, _CANT] = arm * airframe.cant
    of_theta[rb.CG_X, _CENTER], of_theta[rb.CG_Y, _CENTER + 1] = center
    if fit.rotation is not None:
        theta = fit.rotation.theta
        of_theta[:, _ARM] = arm * theta
        if not given.anchor.origin:
            # A prior does not move with the arm; relative to k_T it does with the scale. One from
            # before a change in flight moves as this fit does.
            held = of_theta.copy()
            scaled = [rb.THETA.index(p.theta) for n in given.priors
                      if (p := PARAMETERS.get(n)) and p.theta and p.scale == "thrust"]  # fmt: skip
            held[scaled, _SCALE] = scale.thrust_given * theta[scaled]
            of_theta -= fit.rotation.by_prior @ held
    out = {}
    for name, entry in values.items():
        p = PARAMETERS.get(name)
        if p is None or entry.value is None:
            continue
        if p.theta:
            effect = of_theta[rb.THETA.index(p.theta)]
            if p.scale == "thrust":
                effect = entry.value * of_thrust + (scale.thrust or 0.0) * effect
            out[name] = effect
        elif p.fit in ("scale", "translation"):
            out[name] = entry.value * (of_mass if p.scale == "mass" else of_thrust)
    return out


def given_stds(values: Mapping[str, Estimate], fit: Fit, given: Given) -> dict[str, float]:
    """Standard deviations that come from what was given, and which no flight makes smaller.

    Args:
        values: parameters by name.
        fit: that they come from.
        given: what they rest on.

    Returns:
        Name -> standard deviation, SI, of parameters that have a value.
    """
    return {n: float(np.linalg.norm(e)) for n, e in given_effects(values, fit, given).items()}


def _common_errors(airframe: Airframe) -> tuple[float, float]:
    """Standard deviations of the scale of all arms, relative, and of the rotors' middle, m."""
    sigma, n = airframe.uncertainty, len(airframe.rotors)
    single = sigma.rotor_position.of(airframe.arm)
    places = airframe.geometry[:2]
    reach = float(np.linalg.norm(places - places.mean(axis=1, keepdims=True)))
    arm = math.hypot(sigma.arm.of(airframe.arm) / airframe.arm, single / reach)
    return arm, single / math.sqrt(n)


def unseen_shift(airframe: Airframe) -> Array:
    """(2,) standard deviations, m, of the center of thrust by rotors that are unlike and no more.

    With thrusts (1 + e_i) of the mean torque e_i (-y_i, x_i) O_i is added, O_i of the four signals
    as in `estimation.fit.deviations`. What is in proportion to thrust is a shift, what roll and
    pitch do to each other alike is inertia. A flight shows what yaw does to both, and what they do
    to each other otherwise.
    """
    x, y, _ = geometry = airframe.geometry
    roll, pitch, _, yaw = np.linalg.pinv(rb.mixer(geometry))
    shown = np.array([np.ones(len(x)), y * yaw, x * yaw, y * pitch + x * roll])
    unseen = np.linalg.svd(shown)[2][np.linalg.matrix_rank(shown) :]
    each = airframe.uncertainty.rotor_thrust.of(1.0) / len(x)
    return each * np.linalg.norm(unseen @ np.array([x, y]).T, axis=0)
