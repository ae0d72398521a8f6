"""Rows at any delay and lag are sums of the elements' rows."""

import numpy as np
import pytest
from scipy.signal import lfilter

from gcs_sysid.estimation.actuator_dynamics import ActuatorDynamics, motor_filter, response
from gcs_sysid.estimation.tuning import COMMANDS, Tuning

SLOW = 2.0 * np.pi * np.array([0.3, 1.0, 2.0, 2.7])
"""rad/s, where vehicles are excited."""


def speeds(half_width):
    return ActuatorDynamics(Tuning().delays, half_width=half_width)


def commands(half_width):
    nodes = COMMANDS.delays, COMMANDS.lags, COMMANDS.curves
    return ActuatorDynamics(*nodes, commands=True, half_width=half_width)


@pytest.mark.parametrize(
    ("basis", "error"),
    # At high sample rates, and with four samples a side at 20 and 10 Hz.
    [(speeds(0.1), 2e-5), (speeds(0.2), 1e-6), (commands(0.2), 5e-4), (commands(0.4), 2e-4)],
)
def test_elements_make_up_any_delay_and_lag(basis, error):
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
    np.testing.assert_allclose(weights @ own, response(SLOW, delay, lag), atol=error)


def test_motors_between_slow_samples_pass_what_motors_pass():
    """Commands of 2.5 Hz at 50 Hz: straight lines between them turn torque by 0.4 %."""
    dt, delay, lag, omega = 0.02, 0.005, 0.05, 2.0 * np.pi * 2.5
    command = np.exp(1j * omega * dt * np.arange(200))
    wanted = response(np.array([omega]), np.array(delay), np.array(lag))[0]

    def made(told):
        nodes = COMMANDS.delays, COMMANDS.lags, COMMANDS.curves
        basis = ActuatorDynamics(*nodes, commands=True, half_width=0.2, dt=told)
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
