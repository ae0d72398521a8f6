"""Effect of errors in the given rotor positions, scale and IMU pose on an estimate.

**Not observable in any flight** are the scale reference, the scale common to all arms, the middle
of the rotors, and with the accelerometer as source of thrust over mass the IMU's place. A share e
of the scale reference moves mass, k_T (T_max), inertia, k_M, damping and drag by e. A share e of
all arms moves theta as a whole by e: inertia, CG, moment ratio, damping and rotor inertia, all over
k_T. The CG is counted from the middle. These errors are the same in all flights of a vehicle.

**Observable in flight** are the rotors' relative positions and the IMU's rotation, as unknowns eps
with the given standard deviations as a prior. An error is one of the known signals,

    x = (1 + eps L) x_true,  w' = (1 + eps E) w'_true    =>    residual = eps D x,  D = E Q - Q L

With the derivatives G = dQ/dtheta, normal equations H = sum G' W G and C = sum G' W D, it moves the
estimate by S eps, S = H^-1 C, and is known by the part of it that theta cannot explain:

    I = sum D' W D - C' S,   g = sum D' W r - S' sum G' W r
    P = ((f I^-1 + F)^-1 + 1)^-1,   eps = P (1 + I F / f)^-1 g / f

with eps in its prior's standard deviations, f the factor by which colored residuals widen the
covariance of theta, and F what air and unequal rotors imitate. All sums follow from the moments of
the rows. An IMU that is turned by 1 degree makes Izz, Ixz and Iyz wrong by several percent; a
minute of doublets determines it to 0.3 degrees.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit.deviations import PER_TURN, Deviations, missed_by, rotation_of, turned
from gcs_sysid.estimation.fit.priors import N_UNKNOWNS
from gcs_sysid.estimation.fit.problem import N_X, residual_maker
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.parameters.scale import resolve_scale
from gcs_sysid.estimation.rows.actuator_dynamics import WIDTH
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.airframe import Airframe, Known, ScaleReference
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import PARAMETERS
from gcs_sysid.model.rotor_input import RotorInput

_RIDGE = 1.0
"""Bound on how far a given error may move an entry of theta, relative to its reference value. It
keeps unobservable directions from absorbing everything; for an entry known to 5 % it changes the
result by a quarter of a percent."""
_KNOWN_TO = 0.2
"""Of the same: entries that are known better show how much colored residuals widen intervals."""
_IMITATED = math.radians(0.3)
"""rad, what air and unequal rotors may look like: rotorpy's vehicles, whose IMU is not turned at
all, are read as if it were by 0.1 to 1 degree, where noise alone would leave 0.1."""
_COLUMN = {name: i for i, name in enumerate(rb.SIGNALS)}
_AXES = 3


@dataclass(frozen=True)
class Given:
    """What was given, as far as its errors matter.

    Attributes:
        airframe: with rotor positions and the uncertainty of all.
        anchor: that sets the scale.
        rotor_input: what the fit is relative to.
        priors: on mass and k_T.
    """

    airframe: Airframe
    anchor: ScaleReference
    rotor_input: RotorInput
    priors: Mapping[str, Known]


CAUSES = ("scale", "lever_arm", "arm", "cant", "center_x", "center_y")
"""What is given and may be off, each by itself: the scale reference, the IMU's place, the scale of
all arms, what canted rotors add with these, and the middle of the rotors."""
_SCALE, _LEVER, _ARM, _CANT, _CENTER = range(5)


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
    lever, airframe = _lever_arm_share(fit, given.airframe), given.airframe
    arm, middle = _common_errors(airframe)
    own = given.anchor.kind
    of_mass, of_thrust = np.zeros((2, len(CAUSES)))
    of_mass[_SCALE], of_thrust[_SCALE] = scale.mass_given, scale.thrust_given
    # An accelerometer that reads too much makes k_T too large, or else the mass too small.
    if own in ("k_T", "T_max"):
        of_mass[_LEVER] = -lever
    elif own == "mass":
        of_thrust[_LEVER] = lever
    else:
        of_mass[_LEVER], of_thrust[_LEVER] = -lever, lever
    weight = np.ones(rb.N_THETA)
    if fit.rotation is not None and not given.anchor.origin:
        # What comes from a prior does not move with the arm. Before a change in flight it does.
        std, by_data = fit.rotation.std, np.maximum(fit.rotation.data_std, 1e-300)
        weight = np.minimum((std / by_data) ** 2, 1.0)
    out = {}
    for name, entry in values.items():
        p = PARAMETERS.get(name)
        if p is None or entry.value is None:
            continue
        if p.theta:
            by_thrust = p.scale == "thrust"
            effect = entry.value * of_thrust if by_thrust else np.zeros(len(CAUSES))
            effect[_ARM] = arm * entry.value
            at = rb.THETA.index(p.theta)
            if p.mean_torque:
                effect[_CENTER + (at == rb.CG_Y)] = middle
            if at == rb.MOMENT_RATIO:  # as long as the arms are wrong, so is what cant adds
                effect[_CANT] = arm * airframe.cant * (scale.thrust or 0.0 if by_thrust else 1.0)
            out[name] = float(weight[at]) * effect
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


@dataclass(frozen=True)
class Alignment:
    """Rotor and IMU poses identified from a flight, and their effect on its estimate.

    Attributes:
        shift: (N_THETA + m,) to be added to theta and to the m deviations of the fit.
        covariance: (N_THETA + m, N_THETA + m) of the shift.
        turned: (3,) rotation of the IMU about roll, pitch and yaw, rad.
        turned_std: (3,) its standard deviation.
    """

    shift: Array
    covariance: Array
    turned: Array
    turned_std: Array


def alignment_of(fit: Fit, airframe: Airframe) -> Alignment | None:
    """Find rotors and IMU from the moments of a fit; None where they are exact or not identifiable.

    Args:
        fit: with moments.
        airframe: where they are given, and how well.
    """
    rotation, moments = fit.aligned_by or fit.rotation, fit.moments
    errors = _errors(airframe)
    if rotation is None or moments is None or not any(error.any() for error in errors):
        return None
    size, n = rb.counterparts(rotation.theta, airframe.arm), rb.N_THETA
    W = np.linalg.inv(rotation.residual_covariance)
    # Rotors that differ imitate an IMU that is turned: what is free in the fit is free here.
    free, eps = np.concatenate([rotation.theta, rotation.deviations]), np.zeros(len(errors))
    now = first = _Normal.at(free, moments.rows, W, errors, size, rotation.deviating)
    entry = rotation.data_std < _KNOWN_TO * size
    entry[[rb.CG_X, rb.CG_Y, rb.DAMPING]] = False  # of slow errors of their own
    f = float((rotation.data_std**2 / first.variance[:n])[entry].max()) if entry.any() else np.inf
    turn = math.radians(airframe.uncertainty.imu_rotation.amount)
    imitated = np.zeros(len(errors))
    imitated[-_AXES:] = (_IMITATED / turn) ** 2 if turn else 0.0
    # Gauss-Newton; a degree needs two steps.
    for _ in range(3):
        P, weight = _weighed(now.information / f, imitated)
        step = P @ (weight @ now.gradient / f - eps)
        moved = free - now.S @ step + (now.pull - first.pull)
        if not rb.is_physical(moved):
            break
        free, eps = moved, eps + step
        A = _undoing(errors, eps, turn)
        now = _Normal.at(free, A @ moments.rows @ A.T, W, errors, size, rotation.deviating)
    P, _ = _weighed(now.information / f, imitated)
    return Alignment(
        free - np.concatenate([rotation.theta, rotation.deviations]),
        now.S @ P @ now.S.T,
        turn * eps[-_AXES:],
        turn * np.sqrt(np.diag(P)[-_AXES:]),
    )


def _weighed(information: Array, imitated: Array) -> tuple[Array, Array]:
    """Covariance of errors whose prior is 1, and what weighs the gradient.

    Args:
        information: (p, p) of the flight.
        imitated: (p,) variance of what else looks like these errors.
    """
    # (I^-1 + F)^-1 = (1 + I F)^-1 I
    weight = np.linalg.inv(np.eye(len(imitated)) + information * imitated)
    return np.linalg.inv(weight @ information + np.eye(len(imitated))), weight


def aligned(fit: Fit, alignment: Alignment | None) -> Fit:
    """The fit with rotors and IMU at their identified poses."""
    rotation, n = fit.rotation, rb.N_THETA
    if rotation is None or alignment is None:
        return fit
    theta, own = rotation.theta + alignment.shift[:n], alignment.covariance[:n, :n]
    extended = rotation.extended_covariance.copy()
    deviations = rotation.deviations
    if rb.is_physical(theta):
        deviations = deviations + alignment.shift[n:]
    else:
        theta = rotation.theta
    places = [*range(n), *range(N_UNKNOWNS, N_UNKNOWNS + len(deviations))]
    if len(extended) == N_UNKNOWNS + len(deviations):
        extended[np.ix_(places, places)] += alignment.covariance
    full = rotation.full_covariance.copy()
    full[:n, :n] += own
    rotation = replace(
        rotation,
        theta=theta,
        deviations=deviations,
        covariance=rotation.covariance + own,
        full_covariance=full,
        extended_covariance=extended,
        data_std=np.sqrt(rotation.data_std**2 + np.diag(own)),
    )
    return replace(fit, rotation=rotation)


@dataclass(frozen=True)
class _Normal:
    """The normal equations of theta and errors at a point; symbols as above.

    Attributes:
        variance: (N_THETA + m,) diagonal of H^-1.
        S: (N_THETA + m, errors).
        pull: (N_THETA + m,) step to the minimum in theta and deviations, H^-1 sum G' W r.
        information: (errors, errors), I.
        gradient: (errors,) downhill, sum D' W r - S' sum G' W r.
    """

    variance: Array
    S: Array
    pull: Array
    information: Array
    gradient: Array

    @classmethod
    def at(
        cls,
        free: Array,
        rows: Array,
        W: Array,
        errors: Sequence[Array],
        size: Array,
        deviating: Deviations,
    ) -> "_Normal":
        """At theta and deviations.

        Args:
            free: (N_THETA + m,).
            rows: (3, WIDTH, WIDTH) moments.
            W: (3, 3) weight; diagonal where axes have rows of their own.
            errors: (WIDTH, WIDTH) each, what one standard deviation does to a row.
            size: (N_THETA,) what each entry matters to.
            deviating: m deviations from the model.
        """
        theta, phi = free[: rb.N_THETA], free[rb.N_THETA :]
        Q, G = rb.forward_jacobian(theta, deviating.torque(phi))
        G = np.concatenate([G, np.linalg.inv(rb.inertia_matrix(theta)) @ deviating.torques])
        D = missed_by(np.stack(errors), Q)
        inputs = rows[:, :N_X, :N_X]
        left = W @ (residual_maker(Q)[:, None] @ rows)[:, 0, :N_X]  # W r x', by axis
        weighted = W @ (G[:, :, None] @ inputs)[:, :, 0]
        own = np.einsum("kaz,laz->kl", weighted, G)
        ridge = np.concatenate([(_RIDGE * size) ** -2.0, deviating.information])
        d = 1.0 / np.sqrt(np.maximum(np.diag(own), 0.0) + ridge)
        H = _not_negative(d[:, None] * own * d) + np.diag(d * d * ridge)
        inverse = np.linalg.inv(H) * np.outer(d, d)
        C = np.einsum("kaz,saz->ks", weighted, D)
        S = inverse @ C
        downhill = np.einsum("kax,ax->k", G, left)
        downhill[rb.N_THETA :] -= phi * deviating.information
        information = np.einsum("saz,taz->st", W @ (D[:, :, None] @ inputs)[:, :, 0], D) - C.T @ S
        gradient = np.einsum("sax,ax->s", D, left) - S.T @ downhill
        information = _not_negative(information)
        return cls(np.diag(inverse), S, inverse @ downhill, information, gradient)


def _not_negative(information: Array) -> Array:
    """(p, p) with negative eigenvalues removed: inputs there hardly exceed the noise removed."""
    values, vectors = np.linalg.eigh(0.5 * (information + information.T))
    return (vectors * np.maximum(values, 0.0)) @ vectors.T


def _errors(airframe: Airframe) -> list[Array]:
    """(WIDTH, WIDTH) each: what one standard deviation does to a row [x, y], to first order.

    Of the 2 rotors - 3 ways in which rotors can lie wrongly beside a common shift and scale, then
    of the IMU's rotation about roll, pitch and yaw. Thrusts of single rotors are not in the rows,
    only their sums; of more than four rotors they are taken to share what they make as evenly as
    can be, as mixers have them do.
    """
    sigma, n = airframe.uncertainty, len(airframe.rotors)
    places = airframe.geometry[:2]
    centered = places - places.mean(axis=1, keepdims=True)
    common = np.stack([np.repeat([1.0, 0.0], n), np.repeat([0.0, 1.0], n), centered.ravel()])
    ways = np.linalg.svd(common)[2][len(common) :].reshape(-1, 2, n)  # the null space
    thrusts = np.linalg.pinv(rb.mixer(airframe.geometry).T)  # (rotors, 4)
    out = []
    for x, y in sigma.rotor_position.of(airframe.arm) * ways:
        error = np.zeros((WIDTH, WIDTH))
        error[_COLUMN["pitch"], :4] = x @ thrusts
        error[_COLUMN["roll"], :4] = -y @ thrusts
        out.append(error)
    turn = math.radians(sigma.imu_rotation.amount)
    return [*out, *(turn * PER_TURN)]


def _undoing(errors: Sequence[Array], eps: Array, turn: float) -> Array:
    """(WIDTH, WIDTH) that makes rows without errors of rows with them."""
    rotors = sum((e * L for e, L in zip(eps[:-_AXES], errors, strict=False)), np.eye(WIDTH))
    return turned(rotation_of(turn * eps[-_AXES:])) @ np.linalg.inv(rotors)


def _lever_arm_share(fit: Fit, airframe: Airframe) -> float:
    """Relative error of thrust over mass by an IMU that is elsewhere; of an accelerometer's alone.

    What it reads too much along z, x (r p - q') + y (q r + p') - z (p^2 + q^2), is taken for
    thrust as far as it goes with thrust.
    """
    translation = fit.translation
    if translation is None or translation.source != "accelerometer" or fit.moments is None:
        return 0.0
    own = fit.moments.window[_COLUMN["thrust"]]
    power = translation.kappa * own[_COLUMN["thrust"]]
    if not power:
        return 0.0
    along = (
        own[_COLUMN["rp"]] - own[N_X + 1],
        own[_COLUMN["qr"]] + own[N_X],
        own[_COLUMN["pp"]] + own[_COLUMN["qq"]],
    )
    return airframe.uncertainty.imu_position.amount * math.hypot(*along) / abs(float(power))
