"""Rows at any delay and lag are sums of the elements' rows."""

import numpy as np
import pytest
from scipy.signal import lfilter

from gcs_sysid.estimation.record.tuning import COMMANDS, EstimatorTuning
from gcs_sysid.estimation.rows.actuator_dynamics import (
    SIGNALS,
    ActuatorDynamics,
    motor_filter,
    response,
)
from gcs_sysid.signals.smoothers import cosine_window

SLOW = 2.0 * np.pi * np.array([0.3, 1.0, 2.0, 2.7])
"""rad/s, where vehicles are excited."""


def speeds(half_width):
    return ActuatorDynamics(EstimatorTuning().delays, half_width=half_width)


def commands(half_width):
    nodes = COMMANDS.delays, COMMANDS.lags, COMMANDS.curves
    return ActuatorDynamics(*nodes, motors=True, half_width=half_width)


@pytest.mark.parametrize(
    ("basis", "half_width", "error"),
    # At high sample rates, and with four samples a side at 20 and 10 Hz; of what passes the window.
    [
        (speeds(0.1), 0.1, 2e-5),
        (speeds(0.2), 0.2, 1e-6),
        (commands(0.2), 0.2, 3e-4),
        (commands(0.4), 0.4, 1e-4),
    ],
)
def test_elements_make_up_any_delay_and_lag(basis, half_width, error):
    lags = np.unique(np.linspace(basis.low[1], basis.high[1], 9))
    delay, lag = (c.ravel() for c in np.meshgrid(np.linspace(-0.015, 0.03, 10), lags))
    at = np.column_stack([delay, lag, np.ones_like(lag)])
    # Of the roll signal's column, the set that the curve leaves.
    weights = basis.maps(at)[:, 0, 0, : basis.width].reshape(len(at), -1)
    weights = weights[:, weights.any(axis=0)]
    elements = basis.elements
    own = response(
        SLOW,
        np.array([basis.delays[e.delay] for e in elements]),
        np.array([basis.lags[e.lag] for e in elements]),
    )
    # A constant stays what it is: otherwise every moment of inertia is off by as much.
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-9)
    window = cosine_window(100, half_width / 100.0)
    passed = np.cos(np.outer(SLOW, np.linspace(-half_width, half_width, 201))) @ window.average
    wanted = response(SLOW, delay, lag)
    np.testing.assert_allclose(passed * (weights @ own), passed * wanted, atol=error)


@pytest.mark.parametrize(("delay", "lag"), [(0.004, 0.03), (-0.01, 0.1), (0.01, 0.06)])
def test_rows_of_one_step_hold_motion_to_a_thousandth(delay, lag):
    """Up to 6 Hz, above which torque falls off: there is no window that takes the rest away."""
    basis = commands(None)
    omega = 2.0 * np.pi * np.linspace(0.0, 6.0, 61)
    weights = basis.maps(np.array([[delay, lag, 0.0]]))[0, 0, 0]
    weights = weights[np.flatnonzero(weights)]
    delays = np.array([basis.delays[e.delay] for e in basis.elements])
    lags = np.array([basis.lags[e.lag] for e in basis.elements])
    wanted = response(omega, np.array([delay]), np.array([lag]))[0]
    np.testing.assert_allclose(weights @ response(omega, delays, lags), wanted, atol=1e-3)


@pytest.mark.parametrize("dt", [0.0, 0.008, 0.02])
def test_rows_of_one_step_hold_delays_at_any_rate(dt):
    basis = ActuatorDynamics(EstimatorTuning().delays, half_width=None, dt=dt)
    omega, delay = 2.0 * np.pi * np.linspace(0.0, 6.0, 61), 0.004
    weights = basis.maps(np.array([[delay, 0.0, 1.0]]))[0, 0, 0, : basis.late : SIGNALS]
    made = weights @ np.exp(1j * np.outer(basis.delays, omega))
    np.testing.assert_allclose(made, np.exp(1j * omega * delay), atol=3e-3)


@pytest.mark.parametrize("lag", [0.02, 0.033, 0.05, 0.07])
def test_squares_of_the_elements_make_up_the_square(lag):
    """The thrust curve rests on what is of second order; of weights that heed only the first, 0.1
    to 0.5 of it are lost."""
    basis = commands(0.2)
    elements = basis.elements
    delays = np.array([basis.delays[e.delay] for e in elements])
    lags = np.array([basis.lags[e.lag] for e in elements])
    delay = -0.002
    at = np.array([[delay, lag, 1.0]])
    weights = basis.maps(at)[0, 0, 0, : basis.late].reshape(-1, 2, 5)[:, 1, 0]
    own = response(SLOW, delays, lags)
    wanted = response(SLOW, np.array([delay]), np.array([lag]))[0]
    for other in (own, own.conj()):
        made = (own[:, :, None] * other[:, None, :]).T @ weights
        second = wanted if other is own else wanted.conj()
        np.testing.assert_allclose(made, np.outer(second, wanted), atol=0.015)


def test_motors_between_slow_samples_pass_what_motors_pass():
    """Commands of 2.5 Hz at 50 Hz: straight lines between them turn torque by 0.4 %."""
    dt, delay, lag, omega = 0.02, 0.005, 0.05, 2.0 * np.pi * 2.5
    command = np.exp(1j * omega * dt * np.arange(200))
    wanted = response(np.array([omega]), np.array(delay), np.array(lag))[0]

    def made(told):
        nodes = COMMANDS.delays, COMMANDS.lags, COMMANDS.curves
        basis = ActuatorDynamics(*nodes, motors=True, half_width=0.2, dt=told)
        weights = basis.maps(np.array([[delay, lag, 0.0]]))[0, 0, 0]
        weights = weights[np.flatnonzero(weights)]
        passed = 0.0
        for weight, element in zip(weights, basis.elements, strict=True):
            a, b0, b1 = motor_filter(dt, basis.lags[element.lag])
            late = np.exp(1j * omega * basis.delays[element.delay])
            passed += weight * late * lfilter([b0, b1], [1.0, -a], command)[-1] / command[-1]
        return passed

    assert abs(made(dt) / wanted - 1.0) < 1e-3
    assert abs(made(0.0) / wanted - 1.0) > 3e-3


def test_a_motor_follows_straight_commands_exactly():
    """w + tau w' = u on a ramp of slope one: w = t - tau (1 - exp(-t / tau))."""
    dt, lag = 0.02, 0.05
    a, b0, b1 = motor_filter(dt, lag)
    t = dt * np.arange(30)
    w = lfilter([b0, b1], [1.0, -a], t)
    np.testing.assert_allclose(w, t - lag * (1.0 - np.exp(-t / lag)), atol=1e-12)
    assert (b0 + b1) / (1.0 - a) == pytest.approx(1.0)
    assert motor_filter(dt, 0.0) == (0.0, 1.0, 0.0)


def test_thrust_is_mixed_of_lags_and_sets_without_delay():
    dynamics = commands(0.2)
    assert speeds(0.1).thrust_weights(np.zeros(3)).tolist() == [1.0]
    at = np.array([0.03, 0.05, 0.4, 0.0, 0.0])
    weights = dynamics.thrust_weights(at).reshape(len(dynamics.lags), 2)
    np.testing.assert_allclose(weights.sum(axis=0), [0.6, 0.4])
    own = response(SLOW, np.zeros_like(dynamics.lags), dynamics.lags)
    wanted = response(SLOW, np.zeros(1), np.array([0.05]))[0]
    np.testing.assert_allclose(weights.sum(axis=1) @ own, wanted, atol=1e-3)
