"""Where a search of the rotational cost starts: a rough fit, or what is known beforehand."""

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit.priors import COORDINATES, Prior
from gcs_sysid.estimation.fit.problem import N_X, Problem
from gcs_sysid.estimation.rows.actuator_dynamics import PLAIN
from gcs_sysid.model import rigid_body as rb


def first_guess(total: Array, rows: int, at: Array, prior: Prior | None) -> Array | None:
    """(N_UNKNOWNS,) to start from: a rough fit, or the prior's mean where that fits better."""
    rough = _starting_point(total)
    if rough is not None:
        rough = np.concatenate([rough, at])
    if prior is None:
        return rough
    guess = np.where(prior.known, prior.mean, 0.0 if rough is None else rough)
    guess[COORDINATES] = at
    if not rb.is_physical(guess):
        return rough
    if rough is None:
        return guess
    problem = Problem(total[None], rows, PLAIN, prior)
    both = np.stack([rough, guess])
    costs = [float(problem.evaluate(u[None]).cost[0]) for u in both]
    chosen: Array = both[int(np.argmin(costs))]
    return chosen


def _starting_point(total: Array) -> Array | None:
    """A rough theta from the response to torques: no guess by the user is needed."""
    Rxx, Rxy = total[:N_X, :N_X], total[:N_X, N_X:]
    scale = np.sqrt(np.maximum(np.diag(Rxx), 0.0))
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
