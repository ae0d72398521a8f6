"""One damping for three axes: what it hides is in the intervals of what rests on it."""

import numpy as np
import pytest

from gcs_sysid.estimation.fit.problem import JointProblem
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.solver import minimize
from gcs_sysid.estimation.fit.window_fit import axis_damping_doubt
from gcs_sysid.estimation.rows.actuator_dynamics import PLAIN
from gcs_sysid.model import rigid_body as rb
from tests.known_theta import prior_of, theta_from

IZZ, RATIO = 2, rb.MOMENT_RATIO
THETA = theta_from(80.0, 81.0, 143.0, 6.6, 12.4, -8.1, 0.1, 0.05, 0.03, 100.0, 0.0)
N = 4000


def flown(yaw_share, together, seed=1, sigma=0.3):
    """A fit with one damping to a vehicle whose yaw is damped by a share of it.

    Args:
        yaw_share: of roll's and pitch's damping.
        together: rms of the rates of roll and pitch while it yaws, over those alone.
        seed: of noise and motion.
        sigma: rad/s^2 of noise.
    """
    rng = np.random.default_rng(seed)
    rates = rng.normal(size=(N, 3))
    rates[: N // 2, 2] = 0.0
    rates[N // 2 :, :2] *= together
    x = np.zeros((N, rb.N_SIGNALS))
    x[:, :4] = rng.normal(size=(N, 4)) * [60.0, 60.0, 2e3, 1e4]
    x[:, [rb.SIGNALS.index(name) for name in rb.RATE_SIGNALS]] = rb.rate_signals(rates)
    torque = np.zeros((3, rb.N_SIGNALS))
    torque[2, rb.SIGNALS.index("r")] = (1.0 - yaw_share) * THETA[rb.DAMPING]
    y = x @ rb.forward_matrix(THETA, torque).T + sigma * rng.normal(size=(N, 3))
    rows = np.column_stack([x, y])
    moments = rows.T @ rows
    problem = JointProblem(moments[None], N, PLAIN, None)
    start = np.concatenate([THETA, [0.0, 0.0, 1.0, 0.0, 0.0]])[None]
    point, _ = minimize(problem, start, 40)
    covariance = np.linalg.pinv(point.hessian[0], rcond=1e-14)
    theta = point.unknowns[0, : rb.N_THETA]
    fit = RotationFit(theta, covariance, point.residual[0], np.full(3, 0.99), N, converged=True)
    return fit, moments


def off(fit, place):
    """Of a fit in its standard deviations."""
    return abs(fit.theta[place] - THETA[place]) / fit.std[place]


@pytest.mark.parametrize("seed", range(3))
def test_yaw_that_is_hardly_damped_is_no_longer_a_false_inertia(seed):
    fit, moments = flown(0.0, 0.2, seed)
    assert off(fit, IZZ) > 4.0
    assert off(fit, RATIO) > 4.0
    wider = fit.widened(axis_damping_doubt(fit, moments, commands=True))
    assert off(wider, IZZ) < 2.0
    assert off(wider, RATIO) < 2.0
    assert wider.data_std[IZZ] == pytest.approx(wider.std[IZZ])
    np.testing.assert_allclose(wider.theta, fit.theta)
    # Roll and pitch know their damping themselves.
    assert (wider.std[:2] < 2.0 * fit.std[:2]).all()


def with_covariance(fit: RotationFit, times: float) -> RotationFit:
    """A fit that is as much less certain."""
    return RotationFit(
        fit.theta,
        times * fit.covariance,
        fit.residual_covariance,
        fit.r_squared,
        N,
        converged=True,
    )


def test_gyroscopic_torque_needs_no_common_damping():
    fit, moments = flown(1.0, 1.0)
    doubt = axis_damping_doubt(fit, moments, commands=True)
    assert 0.0 < doubt[IZZ, IZZ] < fit.covariance[IZZ, IZZ]


def test_colored_residuals_tell_less():
    fit, moments = flown(1.0, 0.3)
    colored = with_covariance(fit, 25.0)
    few, many = (axis_damping_doubt(f, moments, commands=True)[IZZ, IZZ] for f in (fit, colored))
    assert many > 2.0 * few


def test_where_no_inertia_is_known_nothing_is_added():
    fit, moments = flown(1.0, 1.0)
    lost = with_covariance(fit, 1e6)
    assert not axis_damping_doubt(lost, moments, commands=True).any()


def test_what_a_prior_knows_is_not_in_doubt():
    fit, moments = flown(0.0, 0.2)
    prior = prior_of({RATIO: (THETA[RATIO], 0.1 * fit.std[RATIO])})
    alone, known = (axis_damping_doubt(fit, moments, p, commands=True) for p in (None, prior))
    assert known[RATIO, RATIO] < 0.05 * alone[RATIO, RATIO]
