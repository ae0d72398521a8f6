"""What errors of the given rotor positions, scale and IMU pose do to an estimate.

To first order, and for the fit at hand. A scale that is off by a share e moves all that is in
proportion to it by e: mass, k_T (T_max), inertia, k_M, damping and drag. An error eps of a rotor's
place or of the IMU's alignment is one of the forward form's known signals,

    x = (1 + eps L) x_true,  w' = (1 + eps E) w'_true    =>    residual = eps (E Q - Q L) x

which least squares, with normal equations H = sum G' W G of the derivatives G = dQ/dtheta x,
explains by

    dtheta/deps = H^-1 sum G' W (E Q - Q L) x

All sums follow from the moments of the rows. Where all arms are too long by one share this is
theta itself: inertia, CG, moment ratio, damping and rotor inertia over k_T go with the arm.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.online import Fit
from gcs_sysid.estimation.rotation import RotationFit
from gcs_sysid.estimation.scale import resolve_scale
from gcs_sysid.estimation.search import N_X, residual_maker
from gcs_sysid.estimation.status import RULES, Value
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.parameters import ARM, PARAMETERS, RotorInput
from gcs_sysid.model.scale_reference import Known, ScaleReference

_RIDGE = 1.0
"""Of what an entry of theta matters to: an error of what is given is not taken to move it by more.
It keeps directions that a flight does not tell from taking up everything; of an entry known to 5 %
it changes the outcome by a quarter of a percent."""
_COLUMN = {name: i for i, name in enumerate(rb.SIGNALS)}
_RATES = [_COLUMN[name] for name in "pqr"]
_PAIRS = [(1, 2), (2, 0), (0, 1), (0, 0), (1, 1), (2, 2)]
_PRODUCT = {frozenset(pair): _COLUMN["qr"] + i for i, pair in enumerate(_PAIRS)}
"""Column of the product of two rates."""


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


def given_stds(values: Mapping[str, Value], fit: Fit, given: Given) -> dict[str, float]:
    """Standard deviations that come from what was given, SI.

    Args:
        values: parameters by name.
        fit: that they come from.
        given: what they rest on.

    Returns:
        Name -> standard deviation, of parameters that have a value.
    """
    scale = resolve_scale(given.anchor, fit.translation, given.priors)
    lever = _lever_arm_share(fit, given.airframe)
    of_mass = of_thrust = 0.0
    if scale.mass is not None:
        own = given.anchor.kind == "mass"
        of_mass = math.hypot(scale.mass_given, 0.0 if own else lever)
    if scale.thrust is not None:
        own = given.anchor.kind in ("k_T", "T_max")
        of_thrust = math.hypot(scale.thrust_given, 0.0 if own else lever)
    theta_std, weight = _theta_stds(fit, given)
    out = {}
    for name, told in values.items():
        p = PARAMETERS.get(name)
        if p is None or told.value is None:
            continue
        if p.fit == "scale":
            out[name] = abs(told.value) * (of_mass if p.scale == "mass" else of_thrust)
        elif p.fit == "translation":
            out[name] = abs(told.value) * of_mass
        elif p.theta:
            at = rb.THETA.index(p.theta)
            relative = p.scale == "thrust"
            size = float(theta_std[at])
            if relative:
                size = math.hypot(size * (scale.thrust or 0.0), told.value * of_thrust)
            out[name] = float(weight[at]) * size
    return out


def with_given(values: Mapping[str, Value], stds: Mapping[str, float], arm: float) -> dict[str, Value]:
    """Values with the whole of their uncertainty: the flight's and that of what was given.

    What is no longer known to a twentieth of its yardstick is no longer identified; it remains
    weak, however wrong what was given may be, because the flight does tell it.

    Args:
        values: with standard deviations by the flight alone.
        stds: see `given_stds`.
        arm: m, mean rotor distance.
    """
    sizes = {n: v.value for n, v in values.items() if v.value is not None} | {ARM: arm}
    out = dict(values)
    for name, own in stds.items():
        told = values[name]
        if not own or told.value is None or told.std is None:
            continue
        std = math.hypot(told.std, own)
        wide = std >= RULES.identified_below * PARAMETERS[name].yardstick.size(told.value, sizes)
        status = "weak" if told.status == "identified" and wide else told.status
        out[name] = replace(told, std=std, status=status)
    return out


def _theta_stds(fit: Fit, given: Given) -> tuple[Array, Array]:
    """(N_THETA,) standard deviations of theta, and what the flight weighs beside priors."""
    n = rb.N_THETA
    rotation, airframe = fit.rotation, given.airframe
    if rotation is None:
        return np.zeros(n), np.ones(n)
    sigma = airframe.uncertainty
    columns = [rotation.theta * (sigma.arm.of(airframe.arm) / airframe.arm)]
    if fit.moments is not None:
        columns += list(sensitivities(rotation, fit.moments, airframe).T)
    weight = np.ones(n)
    if not given.anchor.origin:
        # What comes from a prior does not move with the arm. Before a change in flight it does.
        weight = np.minimum((rotation.std / np.maximum(rotation.data_std, 1e-300)) ** 2, 1.0)
    return np.sqrt(np.sum(np.square(columns), axis=0)), weight


def sensitivities(rotation: RotationFit, moments: Array, airframe: Airframe) -> Array:
    """(N_THETA, 2 rotors + 3) changes of theta with one standard deviation of each error.

    Args:
        rotation: the fit.
        moments: (WIDTH, WIDTH) sums of products of rows [x, y].
        airframe: with the uncertainty of each rotor's x and y, and of the IMU's alignment about
            each axis, in this order.
    """
    sigma = airframe.uncertainty
    place, turn = sigma.rotor_position.of(airframe.arm), math.radians(sigma.imu_rotation.amount)
    errors = [place * L for L in _rotor_errors(airframe)]
    Q, G = rb.forward_jacobian(rotation.theta)
    off = [-Q @ L for L in errors]
    off += [turn * (E @ Q - Q @ L) for E, L in map(_rotation_error, range(3))]
    T = residual_maker(Q)
    residual = T @ moments @ T.T
    W = np.linalg.inv(residual / max(rotation.rows, 1) + 1e-12 * np.trace(residual) * np.eye(3))
    inputs = moments[:N_X, :N_X]
    WG = W @ G  # (n, 3, N_X)
    # H = sum G' W G, and a ridge
    H = np.einsum("kix,xz,liz->kl", WG, inputs, G)
    size = _RIDGE * rb.counterparts(rotation.theta, airframe.arm)
    d = 1.0 / np.sqrt(np.diag(H) + 1.0 / size**2)
    H = H + np.diag(1.0 / size**2)
    downhill = np.einsum("kix,xz,siz->ks", WG, inputs, np.stack(off))
    # dtheta = H^-1 sum G' W (E Q - Q L) x
    moved: Array = d[:, None] * np.linalg.solve(d[:, None] * H * d, d[:, None] * downhill)
    return moved


def _rotor_errors(airframe: Airframe) -> list[Array]:
    """L, (N_X, N_X), of x and of y of each rotor, 1 m off.

    Thrusts of single rotors are not in the rows, only their sums; of more than four rotors they
    are taken to share what they make as evenly as can be, as mixers have them do.
    """
    mixer = rb.mixer(airframe.geometry)
    thrusts = np.linalg.pinv(mixer.T)  # (rotors, 4)
    out = []
    for signal, sign in (("pitch", 1.0), ("roll", -1.0)):
        for own in thrusts:
            L = np.zeros((N_X, N_X))
            L[_COLUMN[signal], :4] = sign * own
            out.append(L)
    return out


def _rotation_error(axis: int) -> tuple[Array, Array]:
    """E, (3, 3), and L, (N_X, N_X), of an IMU turned about an axis by 1 rad."""
    E = np.zeros((3, 3))
    first, second = (axis + 1) % 3, (axis + 2) % 3
    E[first, second], E[second, first] = 1.0, -1.0
    L = np.zeros((N_X, N_X))
    L[np.ix_(_RATES, _RATES)] = E
    for i, j in _PAIRS:
        at = _PRODUCT[frozenset((i, j))]
        for k in range(3):
            L[at, _PRODUCT[frozenset((k, j))]] += E[i, k]
            L[at, _PRODUCT[frozenset((i, k))]] += E[j, k]
    # r H is not among the signals, and rotors' angular momentum is small.
    pH, qH = _COLUMN["pH"], _COLUMN["qH"]
    L[pH, qH], L[qH, pH] = E[0, 1], E[1, 0]
    return E, L


def _lever_arm_share(fit: Fit, airframe: Airframe) -> float:
    """Relative error of thrust over mass by an IMU that is elsewhere; of an accelerometer's alone.

    What it reads too much along z, x (r p - q') + y (q r + p') - z (p^2 + q^2), is taken for
    thrust as far as it goes with thrust.
    """
    translation, moments = fit.translation, fit.moments
    if translation is None or translation.source != "accelerometer" or moments is None:
        return 0.0
    own = moments[_COLUMN["thrust"]]
    power = translation.kappa * own[_COLUMN["thrust"]]
    if not power:
        return 0.0
    along = (
        own[_COLUMN["rp"]] - own[N_X + 1],
        own[_COLUMN["qr"]] + own[N_X],
        own[_COLUMN["pp"]] + own[_COLUMN["qq"]],
    )
    return airframe.uncertainty.imu_position.amount * math.hypot(*along) / abs(float(power))
