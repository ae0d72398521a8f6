"""The search's cost, its derivatives and its steps, against rows written out."""

import numpy as np
import pytest

from gcs_sysid.estimation.fit.priors import (
    COORDINATE_MEAN,
    COORDINATE_STD,
    COORDINATES,
    N_UNKNOWNS,
    Unknown,
)
from gcs_sysid.estimation.fit.problem import Problem
from gcs_sysid.estimation.fit.search import first_guess
from gcs_sysid.estimation.fit.solver import minimize, scales
from gcs_sysid.estimation.fit.whitener_choice import BankProblem, with_possible_noise
from gcs_sysid.estimation.rows.actuator_dynamics import BODY, PLAIN, WIDTH, ActuatorDynamics
from gcs_sysid.model import rigid_body as rb
from tests.estimation.rows_fit import moments_as
from tests.known_theta import prior_of, sizes, theta_from

VALUES = (80.0, 81.0, 143.0, 6.6, 12.4, -8.1, 0.1, 0.05, 0.03, 20.0, 0.3)
THETA, SIZE = theta_from(*VALUES), np.abs(sizes(*VALUES))
SPEEDS = ActuatorDynamics((-0.01, 0.0, 0.01))
COMMANDS = ActuatorDynamics((-0.01, 0.0, 0.01), (0.0, 0.05, 0.1), (0.0, 1.0), motors=True)
N = 400
MAX_ITERATIONS = 40
STEP = np.append(np.maximum(1e-6 * np.abs(THETA), 1e-8), [1e-7, 1e-7, 1e-6, 1e-6, 1e-6])


def rows_of(dynamics, at, seed=1, sigma=0.5):
    """(N, width) rows of elements whose outputs are those of THETA at some coordinates."""
    rng = np.random.default_rng(seed)
    size = np.array([60.0, 60.0, 2e3, 1e4, *[1.0] * len(rb.RATE_SIGNALS), 20.0, 20.0, 10.0])
    if dynamics is PLAIN:
        rows = rng.normal(size=(N, WIDTH))
        rows[:, : rb.N_SIGNALS] *= size
    else:
        # Elements hang together as filters of one signal do.
        rows = rng.normal(size=(N, dynamics.width))
        rotors = dynamics.width - BODY
        signals = rng.normal(size=(N, 5)) * [60.0, 60.0, 2e3, 1e4, 10.0]
        elements = rotors // 5
        rows[:, :rotors] = np.tile(signals, elements) * (1.0 + 0.2 * rng.normal(size=(N, rotors)))
    P = dynamics.map_at(at)
    x = (rows @ P.T)[:, : rb.N_SIGNALS]
    rows[:, -3:] = x @ rb.forward_matrix(THETA).T + sigma * rng.normal(size=(N, 3))
    return rows


def residuals(dynamics, rows, unknowns):
    """(N, 3) y - Q x at the unknowns."""
    z = rows @ dynamics.map_at(unknowns[COORDINATES]).T
    return z[:, -3:] - z[:, : rb.N_SIGNALS] @ rb.forward_matrix(unknowns[: rb.N_THETA]).T


CASES = pytest.mark.parametrize(
    ("dynamics", "at"),
    [
        (PLAIN, [0.0, 0.0, 1.0, 0.0, 0.0]),
        (SPEEDS, [0.004, 0.0, 1.0, 0.0, 0.0]),
        (COMMANDS, [0.004, 0.03, 0.4, 0.0, 0.0]),
    ],
    ids=["plain", "speeds", "commands"],
)


def problem_at(dynamics, at, prior=None):
    rows = rows_of(dynamics, np.array(at))
    unknowns = np.append(1.03 * THETA, at)
    return Problem((rows.T @ rows)[None], N, dynamics, prior), rows, unknowns


@CASES
def test_cost_is_the_log_power_of_what_is_left_on_each_axis(dynamics, at):
    problem, rows, unknowns = problem_at(dynamics, at)
    point = problem.evaluate(unknowns[None])
    left = residuals(dynamics, rows, unknowns)
    S = np.diag((left**2).mean(axis=0))
    np.testing.assert_allclose(point.residual[0], S, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(point.W[0], np.linalg.inv(S), rtol=1e-5)
    away = (unknowns[COORDINATES] - COORDINATE_MEAN) / COORDINATE_STD
    weak = sum(away[i] ** 2 for i in dynamics.free)
    assert point.cost[0] == pytest.approx(np.linalg.slogdet(S)[1] + weak / N, rel=1e-8)


@CASES
def test_gradient_and_curvature_are_those_of_the_rows(dynamics, at):
    problem, rows, unknowns = problem_at(dynamics, at)
    point = problem.evaluate(unknowns[None])
    free = problem.free
    assert problem.p == len(free) == rb.N_THETA + len(dynamics.free)
    slopes, columns = [], []
    for i in free:
        move = np.eye(N_UNKNOWNS)[i] * STEP
        ahead, behind = (unknowns + s * move for s in (1.0, -1.0))
        costs = [problem.evaluate(u[None]).cost[0] for u in (ahead, behind)]
        slopes.append((costs[0] - costs[1]) / (2.0 * STEP[i]))
        moved = [residuals(dynamics, rows, u) for u in (ahead, behind)]
        columns.append((moved[0] - moved[1]) / (2.0 * STEP[i]))
    d = scales(point.hessian)[0]
    # Downhill of half the cost of all rows.
    np.testing.assert_allclose(point.gradient[0] / d, -0.5 * N * np.array(slopes) / d, atol=1e-3)
    J = np.stack(columns)
    hessian = np.einsum("inr,rs,jns->ij", J, point.W[0], J)
    for k, i in enumerate(free[rb.N_THETA :]):
        hessian[rb.N_THETA + k, rb.N_THETA + k] += COORDINATE_STD[i - rb.N_THETA] ** -2.0
    scale = np.outer(d, d)
    np.testing.assert_allclose(point.hessian[0] / scale, hessian / scale, atol=1e-5)


def test_a_prior_costs_its_squared_distance_a_row():
    prior = prior_of({2: (150.0, 5.0), Unknown.DELAY: (0.003, 0.001)})
    problem, _, unknowns = problem_at(SPEEDS, [0.004, 0.0, 1.0, 0.0, 0.0], prior)
    plain, _, _ = problem_at(SPEEDS, [0.004, 0.0, 1.0, 0.0, 0.0])
    difference = problem.evaluate(unknowns[None]).cost - plain.evaluate(unknowns[None]).cost
    away = (1.03 * THETA[2] - 150.0) / 5.0
    assert difference[0] == pytest.approx((away**2 + 1.0) / N)
    information = problem.prior_information
    assert information.shape == (rb.N_THETA + 1, rb.N_THETA + 1)
    np.testing.assert_allclose(np.diag(information)[[2, rb.N_THETA]], [0.04, 1e6])
    pull = problem.prior_pull(unknowns)
    np.testing.assert_allclose(pull[[2, rb.N_THETA]], [-away / 5.0, -1e3])
    assert np.count_nonzero(pull) == 2


@CASES
def test_the_minimum_is_where_the_gradient_vanishes(dynamics, at):
    problem, _, unknowns = problem_at(dynamics, at)
    point, converged = minimize(problem, unknowns[None], MAX_ITERATIONS)
    assert converged.all()
    step = np.linalg.solve(point.hessian[0], point.gradient[0])
    assert step @ point.gradient[0] < 1e-4**2  # of a deviation
    again, _ = minimize(problem, point.unknowns, 1)
    assert again.cost[0] == pytest.approx(point.cost[0], abs=1e-12)
    start = np.append(1.5 * THETA, at)[None]
    few, reached = minimize(problem, start, 3)
    assert not reached.any()
    assert point.cost[0] < few.cost[0] < problem.evaluate(start).cost[0]


def test_a_prior_moves_the_minimum_to_where_both_balance():
    prior = prior_of({2: (160.0, 1.0)})
    problem, _, unknowns = problem_at(PLAIN, [0.0, 0.0, 1.0, 0.0, 0.0], prior)
    point, converged = minimize(problem, unknowns[None], MAX_ITERATIONS)
    assert converged.all()
    total = point.gradient[0] + problem.prior_pull(point.unknowns[0])
    d = scales(point.hessian)[0]
    assert np.abs(total / d).max() < 1e-3
    assert np.abs(point.gradient[0] / d).max() > 0.1


@pytest.mark.parametrize("axis", [0, 1])
def test_no_guess_where_nothing_responds_in_the_right_sense(axis):
    rows = rows_of(PLAIN, np.array([0.0, 0.0, 1.0, 0.0, 0.0]), sigma=1e-3)
    rows[:, rb.N_SIGNALS + axis] *= -1.0
    total, at = rows.T @ rows, np.array([0.0, 0.0, 1.0, 0.0, 0.0])
    assert first_guess(total, N, at, None) is None
    # What is known beforehand will do instead; what is not stays zero.
    prior = prior_of({i: (THETA[i], 0.1 * abs(THETA[i])) for i in range(6)})
    known = first_guess(total, N, at, prior)
    np.testing.assert_array_equal(known, [*THETA[:6], *[0.0] * (rb.N_THETA - 6), *at])
    unphysical = prior_of({0: (1.0, 0.1), 1: (1.0, 0.1), 2: (9.0, 0.1)})
    assert first_guess(total, N, at, unphysical) is None


def test_a_fit_without_any_noise_keeps_its_weights_finite():
    rows = rows_of(PLAIN, np.array([0.0, 0.0, 1.0, 0.0, 0.0]), sigma=0.0)
    total = rows.T @ rows
    problem = Problem(total[None], N, PLAIN, None)
    guess = first_guess(total, N, np.array([0.0, 0.0, 1.0, 0.0, 0.0]), None)
    point, _ = minimize(problem, guess[None], MAX_ITERATIONS)
    assert np.isfinite(point.W).all()
    np.testing.assert_allclose((point.unknowns[0, : rb.N_THETA] - THETA) / SIZE, 0.0, atol=1e-4)
    # At the truth rounding alone is left, of either sign.
    exact = problem.evaluate(np.append(THETA, [0.0, 0.0, 1.0, 0.0, 0.0])[None])
    assert np.linalg.eigvalsh(exact.W).min() > 0.0


def test_a_search_goes_on_along_the_edge_of_physical_inertias():
    """Steps that lead beyond it were cut short until none was left, far from the minimum there."""
    beyond = theta_from(80.0, 81.0, 175.0, *VALUES[3:])
    rows = rows_of(PLAIN, np.array([0.0, 0.0, 1.0, 0.0, 0.0]))
    x = rows[:, : rb.N_SIGNALS]
    noise = np.random.default_rng(2).normal(size=(N, 3))
    rows[:, -3:] = x @ rb.forward_matrix(beyond).T + 0.5 * noise
    problem = Problem((rows.T @ rows)[None], N, PLAIN, None)
    start = np.append(0.8 * THETA, [0.0, 0.0, 1.0, 0.0, 0.0])[None]
    point, _ = minimize(problem, start, 5 * MAX_ITERATIONS)
    margin, inward = problem.margin(point.unknowns)
    assert 0.0 < margin[0] < 1e-3 * THETA[0]
    # All that still pulls leads outward.
    way = np.linalg.solve(point.hessian[0], inward[0])
    left = point.gradient[0] - inward[0] * (way @ point.gradient[0]) / (way @ inward[0])
    assert left @ np.linalg.solve(point.hessian[0], left) < 1.0  # within a standard deviation
    assert way @ point.gradient[0] < 0.0


@pytest.mark.parametrize("counts", [[], [5, 5]])
def test_a_record_that_has_hardly_begun_starts_no_search(counts):
    """Between two flights rows of the window are none yet: powers were divided by zero."""
    width = COMMANDS.width
    moments = np.zeros((len(counts), 1, width, width)), np.array(counts, dtype=int)
    data = moments_as(*moments, np.zeros((1, width, width)))
    prior = prior_of({i: (THETA[i], 0.1 * abs(THETA[i])) for i in range(6)})
    assert BankProblem(data, COMMANDS, prior).scanned() is None
    assert with_possible_noise(data, COMMANDS, prior) is data
