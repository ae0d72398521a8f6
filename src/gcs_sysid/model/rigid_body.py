"""Rotation of a multirotor as equations that estimators can use.

    J w' + w x (J w + h) + h' = M,        h = -J_r H z,   H = sum s_i Omega_i
    M = sum (r_i - r_cg) x (-T_i z) + sum s_i k_M Omega_i^2 z,   T_i = k_T Omega_i^2

Body axes are forward, right, down; s_i = +1 for a rotor that turns counter-clockwise seen
from above. J holds matrix elements, so products of inertia carry no minus sign.

One common factor on J, k_T, k_M, damping and J_r changes no signal. Everything here is
therefore *relative*: divided by the thrust coefficient k_T (with commands as the input, by
T_max). `theta` is, in the order of `model.parameters`,

    [Ixx, Iyy, Izz, Ixy, Iyz, Ixz] / k_T,  cg_x, cg_y,  k_M/k_T,  damping / k_T,  J_r / k_T

The **forward form** is w' = Q(theta) x with x the `SIGNALS` below, Q = J^-1 B(theta) and B
linear in theta: the noisy derivative is the output, known signals are the inputs.
The **direct form** (the article's) moves everything known to the right-hand side.
"""

import re
from collections.abc import Mapping

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.model.parameters import ARM, INERTIA, REGISTRY
from gcs_sysid.model.parameters import THETA as THETA

N_THETA = len(THETA)
N_INERTIA = len(INERTIA)
CG_X, CG_Y, MOMENT_RATIO, DAMPING, ROTOR_INERTIA = map(
    THETA.index, ("cg_x", "cg_y", "moment_ratio", "rotational_damping", "rotor_inertia")
)
MOMENTS = slice(0, 3)
"""Ixx, Iyy, Izz among theta's entries."""
ELEMENTS = slice(0, N_INERTIA)
"""All of the inertia matrix."""
RELATIVE = np.array([REGISTRY[name].scale != "none" for name in THETA])
"""(N_THETA,) which entries are relative to k_T (T_max); the others are lengths."""

_PRODUCTS = ("qr", "rp", "pq", "pp", "qq", "rr")
_TERMS = [(name, *term) for name in THETA for term in REGISTRY[name].torque]
_ABSOLUTE = tuple(
    dict.fromkeys(signal for *_, signal, _ in _TERMS if re.fullmatch(r"[pqr]\|[pqr]\|", signal))
)
"""Products such as "p|q|", of those entries of theta that have them."""
RATE_SIGNALS = (*_PRODUCTS, "p", "q", "r", *_ABSOLUTE)
"""Names of those inputs that are functions of the body rates alone, see `rate_signals`."""
SIGNALS = (
    "roll", "pitch", "thrust", "yaw",  # -sum y O, sum x O, sum O, sum s O, with O = Omega^2
    *RATE_SIGNALS,
    "qH", "pH", "dH",  # H = sum s Omega and its derivative
)  # fmt: skip
"""Names of the forward form's inputs."""

N_SIGNALS = len(SIGNALS)
OF_RATES = slice(SIGNALS.index(RATE_SIGNALS[0]), SIGNALS.index(RATE_SIGNALS[-1]) + 1)
"""The `RATE_SIGNALS` among the signals."""
_COLUMN = {name: i for i, name in enumerate(SIGNALS)}


def _inertia_basis() -> Array:
    basis = np.zeros((N_INERTIA, 3, 3))
    for k, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))):
        basis[k, i, j] = basis[k, j, i] = 1.0
    return basis


def _input_basis() -> tuple[Array, Array]:
    """B(theta) = constant + sum theta_k slope[k]: right-hand side of J w' = B x."""
    constant = np.zeros((3, N_SIGNALS))
    slope = np.zeros((N_THETA, 3, N_SIGNALS))

    def put(name: str, row: int, signal: str, value: float) -> None:
        slope[THETA.index(name), row, _COLUMN[signal]] += value

    constant[0, _COLUMN["roll"]] = 1.0
    constant[1, _COLUMN["pitch"]] = 1.0
    # -(w x J w), term by term.
    put("Iyy", 0, "qr", 1.0)
    put("Izz", 0, "qr", -1.0)
    put("Ixy", 0, "rp", 1.0)
    put("Ixz", 0, "pq", -1.0)
    put("Iyz", 0, "qq", -1.0)
    put("Iyz", 0, "rr", 1.0)
    put("Izz", 1, "rp", 1.0)
    put("Ixx", 1, "rp", -1.0)
    put("Ixy", 1, "qr", -1.0)
    put("Iyz", 1, "pq", 1.0)
    put("Ixz", 1, "pp", 1.0)
    put("Ixz", 1, "rr", -1.0)
    put("Ixx", 2, "pq", 1.0)
    put("Iyy", 2, "pq", -1.0)
    put("Ixz", 2, "qr", 1.0)
    put("Iyz", 2, "rp", -1.0)
    put("Ixy", 2, "pp", -1.0)
    put("Ixy", 2, "qq", 1.0)
    # Thrust acts at the geometric center, the CG is (cg_x, cg_y) from it.
    for name, row, signal, factor in _TERMS:
        put(name, row, signal, factor)
    return constant, slope


INERTIA_BASIS = _inertia_basis()
"""(6, 3, 3): J = sum theta_k basis[k]."""
INPUT_CONSTANT, INPUT_SLOPE = _input_basis()
_FLAT_SLOPE = INPUT_SLOPE.reshape(N_THETA, -1)


def theta_of(values: Mapping[str, float], thrust: float = 1.0) -> Array:
    """(N_THETA,) of parameters by name; what is left out is zero.

    Args:
        values: SI.
        thrust: k_T or T_max, which theta is relative to.
    """
    theta = np.array([values.get(name, 0.0) for name in THETA], dtype=float)
    return np.where(RELATIVE, theta / thrust, theta)


def counterparts(theta: Array, arm: float) -> Array:
    """(N_THETA,) what each entry is compared with: itself, or what its reference value is made of.

    Args:
        theta: (N_THETA,).
        arm: m, mean distance of the rotors.
    """
    values = dict(zip(THETA, theta.tolist(), strict=True)) | {ARM: arm}
    return np.array(
        [REGISTRY[name].reference.counterpart(values) or abs(values[name]) for name in THETA]
    )


_ELEMENT = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2]])


def inertia_matrix(elements: Array) -> Array:
    """The 3 x 3 matrices of (..., 6 or more) [Ixx, Iyy, Izz, Ixy, Iyz, Ixz] (any unit)."""
    return elements[..., _ELEMENT]


def are_physical(elements: Array) -> Mask:
    """(...) whether a rigid body can have the inertia matrices of (..., 6 or more) elements.

    That is so when the second-moment matrix tr(J)/2 - J is positive definite, which holds both
    J > 0 and the triangle inequality of the principal moments.
    """
    xx, yy, zz, xy, yz, xz = (elements[..., i] for i in range(N_INERTIA))
    # Sylvester's criterion on tr(J)/2 - J.
    with np.errstate(over="ignore", invalid="ignore"):  # of numbers like 1e308: no rigid body
        a, b, c = 0.5 * (yy + zz - xx), 0.5 * (zz + xx - yy), 0.5 * (xx + yy - zz)
        minor = a * b - xy * xy
        determinant = c * minor - a * yz * yz - b * xz * xz - 2.0 * xy * yz * xz
    return np.asarray((a > 0.0) & (minor > 0.0) & (determinant > 0.0))


def least_second_moment(elements: Array) -> tuple[Array, Array]:
    """(...) least principal second moment of (..., 6 or more) elements, and (..., 6) derivatives.

    That is, the least eigenvalue of tr(J)/2 - J.
    """
    J = inertia_matrix(elements[..., :N_INERTIA])
    values, vectors = np.linalg.eigh(J)
    axis = vectors[..., -1]
    trace = np.trace(INERTIA_BASIS, axis1=1, axis2=2)
    along = (axis[..., None, None, :] @ INERTIA_BASIS @ axis[..., None, :, None])[..., 0, 0]
    return 0.5 * values.sum(axis=-1) - values[..., -1], 0.5 * trace - along


def is_physical(elements: Array) -> bool:
    """Whether a rigid body can have this inertia matrix; one set of elements, see above."""
    return bool(are_physical(elements))


def forward_matrix(theta: Array, torque: Array | float = 0.0) -> Array:
    """Q(theta) of w' = Q x, shape (..., 3, N_SIGNALS), theta of shape (..., N_THETA).

    Args:
        theta: (..., N_THETA).
        torque: (..., 3, N_SIGNALS) that is added to B, see `estimation.fit.deviations`.

    Raises:
        numpy.linalg.LinAlgError: an inertia matrix is singular.
    """
    return np.linalg.inv(inertia_matrix(theta)) @ (_input_matrix(theta) + torque)


def forward_jacobian(
    theta: Array, torque: Array | float = 0.0, others: Array = INPUT_SLOPE[:0]
) -> tuple[Array, Array]:
    """Q(theta) and its derivatives by theta and by what m other torques are multiplied with.

    Args:
        theta: (..., N_THETA).
        torque: as above.
        others: (m, 3, N_SIGNALS).

    Returns:
        (..., 3, N_SIGNALS) and (..., N_THETA + m, 3, N_SIGNALS).
    """
    J_inv = np.linalg.inv(inertia_matrix(theta))
    Q = J_inv @ (_input_matrix(theta) + torque)
    slope = np.empty((*theta.shape[:-1], N_THETA + len(others), 3, N_SIGNALS))
    slope[..., :N_THETA, :, :], slope[..., N_THETA:, :, :] = INPUT_SLOPE, others
    slope[..., :N_INERTIA, :, :] -= INERTIA_BASIS @ Q[..., None, :, :]
    return Q, J_inv[..., None, :, :] @ slope


def _input_matrix(theta: Array) -> Array:
    """B(theta) of J w' = B x."""
    return INPUT_CONSTANT + (theta @ _FLAT_SLOPE).reshape(*theta.shape[:-1], 3, N_SIGNALS)


def rotor_signals(geometry: Array, speeds: Array) -> tuple[Array, Array]:
    """The four torque and thrust signals, and H.

    Args:
        geometry: (3, n_rotors) x, y, spin (`Airframe.geometry`).
        speeds: (..., n_rotors) rad/s.

    Returns:
        (..., 4) roll, pitch, thrust, yaw in rad^2/s^2 (m rad^2/s^2 for the first two), and
        (...) H = sum s_i Omega_i in rad/s.
    """
    return (speeds * speeds) @ mixer(geometry), speeds @ geometry[2]


def mixer(geometry: Array) -> Array:
    """(n_rotors, 4) what makes roll, pitch, thrust and yaw signals of the rotors' thrusts."""
    x, y, s = geometry
    return np.stack([-y, x, np.ones_like(x), s], axis=1)


_LEFT, _RIGHT = np.array([1, 2, 0, 0, 1, 2]), np.array([2, 0, 1, 0, 1, 2])
_SIGNED, _SIZED = ([("pqr").index(signal[i]) for signal in _ABSOLUTE] for i in (0, 2))


def rate_products(rates: Array) -> Array:
    """(..., 6) qr, rp, pq, pp, qq, rr of (..., 3) body rates."""
    return rates[..., _LEFT] * rates[..., _RIGHT]


def rate_signals(rates: Array) -> Array:
    """(..., len(RATE_SIGNALS)) signals of (..., 3) body rates, in the order of `RATE_SIGNALS`."""
    signals = [rate_products(rates), rates]
    if _ABSOLUTE:
        signals.append(rates[..., _SIGNED] * np.abs(rates[..., _SIZED]))
    return np.concatenate(signals, axis=-1)


def direct_rows(rates: Array, accelerations: Array, rotors: Array) -> tuple[Array, Array]:
    """The article's regression, corrected: phi theta = y, three rows a sample.

    Args:
        rates: (n, 3) p, q, r in rad/s.
        accelerations: (n, 3) their derivatives in rad/s^2.
        rotors: (n, 4) roll, pitch, thrust, yaw as of `rotor_signals`.

    Returns:
        phi (n, 3, 9) for [Ixx, Iyy, Izz, Ixy, Iyz, Ixz] / k_T, cg_x, cg_y, k_M/k_T, and
        y (n, 3), whose third row is zero: noise in the accelerations pulls this form's
        estimates of everything in that row towards zero.
    """
    p, q, r = rates.T
    dp, dq, dr = accelerations.T
    roll, pitch, thrust, yaw = rotors.T
    zero = np.zeros_like(p)
    rows = [
        [dp, -q * r, q * r, dq - r * p, q * q - r * r, dr + p * q, zero, -thrust, zero],
        [r * p, dq, -r * p, dp + q * r, dr - p * q, r * r - p * p, thrust, zero, zero],
        [-p * q, p * q, dr, p * p - q * q, dq + r * p, dp - q * r, zero, zero, -yaw],
    ]
    phi = np.array(rows).transpose(2, 0, 1)
    return phi, np.stack([roll, pitch, zero], axis=1)


def rms_rates(moments: Array, rows: int) -> Array:
    """(3,) rms of the body rates p, q and r, rad/s.

    Args:
        moments: (N_SIGNALS or more, the same) sum of products of rows that begin with `SIGNALS`.
        rows: in it, at least 1.
    """
    squares = np.diag(moments)[[SIGNALS.index(rate) for rate in "pqr"]]
    return np.sqrt(np.maximum(squares, 0.0) / rows)
