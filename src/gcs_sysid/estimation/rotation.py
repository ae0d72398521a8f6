"""Fit of the rotational parameters to the moments of the forward form.

The cost  sum_rows (y - Q(theta) x)' W (y - Q(theta) x)  is an exact quadratic in Q, so it and
its derivatives follow from the moments alone. It is minimised by Gauss-Newton with
Levenberg-Marquardt damping; W is the inverse of the residual covariance, which the same moments
give (iterated to the maximum-likelihood point). See `gcs_sysid.model.rigid_body` for Q.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.uncertainty import sandwich
from gcs_sysid.model import rigid_body as rb

N_X = rb.N_SIGNALS
WIDTH = N_X + 3
"""Width of a row [x, y]."""

_MAX_ITERATIONS = 60
_WARM_ITERATIONS = 4
_CONVERGED = 1e-12
_EPSILON = 1e-15


@dataclass(frozen=True)
class RotationFit:
    """Rotational parameters relative to k_T, with their uncertainty.

    Attributes:
        theta: (N_THETA,) estimate, see `rigid_body.THETA`.
        covariance: (N_THETA, N_THETA), corrected for coloured residuals.
        residual_covariance: (3, 3) of one row's residual, (rad/s^2)^2.
        r_squared: (3,) share of each axis' angular acceleration that the model explains.
        rows: how many rows it rests on.
        converged: whether the minimiser was reached.
    """

    theta: Array
    covariance: Array
    residual_covariance: Array
    r_squared: Array
    rows: int
    converged: bool

    @property
    def std(self) -> Array:
        """(N_THETA,) standard deviations."""
        std: Array = np.sqrt(np.diag(self.covariance))
        return std


def fit_rotation(
    batches: Array, counts: NDArray[np.int64], start: Array | None = None
) -> RotationFit | None:
    """Fit theta to batches of moments.

    Args:
        batches: (k, WIDTH, WIDTH) moments of rows [x, y].
        counts: (k,) rows in each.
        start: (N_THETA,) an earlier estimate: a few steps from there follow a growing record
            at little cost. None: from the data alone, to the minimum.

    Returns:
        The fit, or None while the data cannot even start one (fewer rows than unknowns, or no
        response to roll and pitch torque).
    """
    total = batches.sum(axis=0)
    rows = int(counts.sum())
    if rows < 3 * rb.N_THETA:
        return None
    starts = [s for s in (_starting_point(total), start) if s is not None]
    if not starts:
        return None
    # An earlier estimate from too little motion may lie in a valley of its own.
    first = min(starts, key=lambda s: _cost(total, rows, s))
    limit = _MAX_ITERATIONS if start is None else _WARM_ITERATIONS
    theta, converged = _minimise(total, rows, first, limit)
    residual = _residual_moment(total, rb.forward_matrix(theta)) / rows
    power = np.diag(total)[N_X:] / rows
    r_squared = 1.0 - np.diag(residual) / np.maximum(power, 1e-300)
    W = _inverse_spd(residual)
    covariance = _covariance(batches, theta, W)
    return RotationFit(theta, covariance, residual, r_squared, rows, converged)


def _residual_moment(total: Array, Q: Array) -> Array:
    T = np.hstack([-Q, np.eye(3)])
    # Without noise only rounding is left of the large terms: floored at that, it stays definite.
    rounding = _EPSILON * (np.abs(T) @ np.sqrt(np.diag(total))) ** 2
    moment: Array = T @ total @ T.T + np.diag(rounding)
    return moment


def _cost(total: Array, rows: int, theta: Array) -> float:
    residual = _residual_moment(total, rb.forward_matrix(theta)) / rows
    return float(np.linalg.slogdet(residual)[1])


def _starting_point(total: Array) -> Array | None:
    """A rough theta from the response to torques: no guess by the user is needed."""
    Rxx, Rxy = total[:N_X, :N_X], total[:N_X, N_X:]
    scale = np.sqrt(np.diag(Rxx))
    scale[scale == 0.0] = 1.0
    # Columns in units of their own size; the ridge settles directions without excitation.
    A = Rxx / np.outer(scale, scale) + 1e-9 * np.eye(N_X)
    Q = (np.linalg.solve(A, Rxy / scale[:, None]) / scale[:, None]).T
    if not (Q[0, 0] > 0.0 and Q[1, 1] > 0.0):
        return None
    theta = np.zeros(rb.N_THETA)
    theta[0], theta[1] = 1.0 / Q[0, 0], 1.0 / Q[1, 1]
    # A flat body has Izz = Ixx + Iyy; a real multirotor comes close.
    theta[2] = 0.9 * (theta[0] + theta[1])
    theta[rb.MOMENT_RATIO] = max(Q[2, 3] * theta[2], 1e-4)
    theta[rb.CG_Y] = Q[0, 2] / Q[0, 0]
    theta[rb.CG_X] = -Q[1, 2] / Q[1, 1]
    return theta if rb.is_physical(theta) else None


def _minimise(total: Array, rows: int, theta: Array, limit: int) -> tuple[Array, bool]:
    """Levenberg-Marquardt on log det of the residual covariance (W concentrated out)."""
    damping = 1e-3
    Q, G = rb.forward_jacobian(theta)
    S = _residual_moment(total, Q) / rows
    cost = np.linalg.slogdet(S)[1]
    for _ in range(limit):
        gradient, hessian = _normal_equations(total, Q, G, _inverse_spd(S))
        d = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
        step = None
        while damping < 1e12:
            H = hessian / np.outer(d, d) + damping * np.eye(len(d))
            candidate = theta + np.linalg.solve(H, gradient / d) / d
            if rb.is_physical(candidate):
                Qc, Gc = rb.forward_jacobian(candidate)
                Sc = _residual_moment(total, Qc) / rows
                new_cost = np.linalg.slogdet(Sc)[1]
                if new_cost <= cost + 1e-14 * abs(cost):
                    step = candidate - theta
                    break
            damping *= 10.0
        if step is None:
            return theta, False
        moved = float(np.max(np.abs(step) * d) / np.sqrt(rows))
        theta, Q, G, S, cost = candidate, Qc, Gc, Sc, new_cost
        damping = max(damping * 0.1, 1e-15)
        if moved < _CONVERGED:
            return theta, True
    return theta, False


def _normal_equations(total: Array, Q: Array, G: Array, W: Array) -> tuple[Array, Array]:
    Rxx, Ryx = total[:N_X, :N_X], total[N_X:, :N_X]
    WG = np.einsum("ij,kjm->kim", W, G)
    gradient = np.einsum("kim,im->k", WG, Ryx - Q @ Rxx)
    hessian = np.einsum("kim,lim->kl", WG, G @ Rxx)
    return gradient, hessian


def _covariance(batches: Array, theta: Array, W: Array) -> Array:
    """Sandwich covariance: what the scores of the batches really scatter."""
    Q, G = rb.forward_jacobian(theta)
    _, hessian = _normal_equations(batches.sum(axis=0), Q, G, W)
    Rxx, Ryx = batches[:, :N_X, :N_X], batches[:, N_X:, :N_X]
    WG = np.einsum("ij,kjm->kim", W, G)
    scores = np.einsum("kim,bim->bk", WG, Ryx - Q @ Rxx)
    d = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    # A direction that the data do not see at all keeps a huge, finite variance.
    bread = np.linalg.inv(hessian / np.outer(d, d) + 1e-12 * np.eye(len(d)))
    return sandwich(bread, scores / d) / np.outer(d, d)


def _inverse_spd(S: Array) -> Array:
    """Inverse of a covariance that may be singular on data without noise."""
    floor = 1e-12 * max(float(np.trace(S)) / len(S), 1e-300)
    return np.linalg.inv(S + floor * np.eye(len(S)))
