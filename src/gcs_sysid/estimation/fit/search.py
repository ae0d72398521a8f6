"""Where a search of the rotational cost starts: a rough fit, then every node of the actuators."""

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation.fit.priors import COORDINATES, Prior
from gcs_sysid.estimation.fit.problem import N_X, Evaluation, JointProblem
from gcs_sysid.estimation.fit.solver import minimize
from gcs_sysid.estimation.rows.actuator_dynamics import PLAIN, WIDTH
from gcs_sysid.model import rigid_body as rb

MAX_ITERATIONS = 40
_NODES_AT_ONCE = 16
"""Of a basis, whose moments are made in one step."""


def scan(problem: JointProblem, unknowns: Array) -> Array:
    """Fit at every node of the basis; (starts, leaks, N_UNKNOWNS) the best ones of each leak."""
    basis, leaks = problem.basis, len(problem.moments)
    nodes = len(basis.nodes)
    if nodes == 1:
        return unknowns[None]
    every = np.repeat(unknowns, nodes, axis=0)
    every[:, COORDINATES] = np.tile(basis.nodes, (leaks, 1))
    P = basis.maps(basis.nodes)[:, 0]
    parts = []
    for start in range(0, nodes, _NODES_AT_ONCE):
        some = P[start : start + _NODES_AT_ONCE]
        parts.append(some @ problem.moments @ np.swapaxes(some, 1, 2))
    there = np.concatenate(parts, axis=1).reshape(-1, WIDTH, WIDTH)
    rows = np.repeat(problem.rows, nodes)
    given = JointProblem(there, rows, PLAIN, problem.prior)
    point, _ = minimize(given, every, 8)
    cost = point.cost + problem.weak_cost(every) / rows
    starts = 1 if len(basis.free) == 1 else 4
    best = np.argsort(cost.reshape(leaks, nodes), axis=1)[:, :starts]
    # Rows as they are have no coordinates to move; those of the node are where each search goes on.
    found = point.unknowns.copy()
    found[:, COORDINATES] = every[:, COORDINATES]
    found = found.reshape(leaks, nodes, -1)
    chosen: Array = np.swapaxes(np.take_along_axis(found, best[..., None], axis=1), 0, 1)
    return chosen


def search(problem: JointProblem, starts: Array) -> tuple[Evaluation, Mask]:
    """The best minimum that (starts, leaks, N_UNKNOWNS) lead to, for each leak."""
    s, leaks, _ = starts.shape
    wide = problem.part(np.tile(np.arange(leaks), s))
    point, converged = minimize(wide, starts.reshape(s * leaks, -1), MAX_ITERATIONS)
    best = np.argmin(point.cost.reshape(s, leaks), axis=0) * leaks + np.arange(leaks)
    return point.part(best), converged[best]


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
    problem = JointProblem(total[None], rows, PLAIN, prior)
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
