"""Rows at any delay and lag are sums of the elements' rows."""

import numpy as np
import pytest
from scipy.signal import lfilter

from gcs_sysid.estimation.record.tuning import COMMANDS, EstimatorTuning
from gcs_sysid.estimation.rows.actuator_dynamics import (
    BODY,
    PLAIN,
    ROTOR_COLUMNS,
    SIGNALS,
    WIDTH,
    ActuatorDynamics,
    Element,
    LagPlace,
    motor_filter,
    response,
)
from gcs_sysid.model import rigid_body as rb
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


def test_coordinates_with_one_value_are_given():
    speeds_, commands_ = speeds(0.1), commands(0.2)
    assert speeds_.free == (0,)
    assert commands_.free == (0, 1, 2)
    assert ActuatorDynamics((0.01,), (0.0, 0.05), (0.5,), motors=True).free == (1,)
    np.testing.assert_allclose(commands_.low, [-0.015, 0.0, -0.2, 0.0, 0.0])
    np.testing.assert_allclose(commands_.high, [0.03, 0.13, 1.2, 0.0, 0.0])


def test_elements_are_the_lags_at_the_middle_delay_and_the_delays_at_a_usual_lag():
    assert ActuatorDynamics((-0.01, 0.0, 0.01)).elements == tuple(Element(0, j) for j in range(3))
    both = ActuatorDynamics((-0.01, 0.0, 0.01, 0.02), (0.0, 0.05, 0.1), motors=True)
    assert both.elements == (
        Element(0, 2), Element(1, 2), Element(2, 2), Element(1, 0), Element(1, 1), Element(1, 3),
    )  # fmt: skip
    assert both.width == 6 * 2 * SIGNALS + BODY
    two = ActuatorDynamics((-0.01, 0.01), (0.0, 0.05), motors=True)
    assert two.elements == (Element(0, 1), Element(1, 1), Element(1, 0))


def test_bends_are_at_every_other_lag_from_the_longest_down():
    def bent(n, dt=0.005):
        lags = np.linspace(0.0, 0.1, n)
        basis = ActuatorDynamics((0.0, 0.01), lags, (0.0, 1.0), motors=True, dt=dt, coupled=True)
        assert basis.bends == 4 * len(basis.bent_lags)
        return basis.bent_lags

    assert [bent(n) for n in (2, 3, 4, 7)] == [(1,), (2,), (1, 3), (2, 4, 6)]
    # Of commands every 20 ms, squares between samples are not known.
    assert bent(7, dt=0.02) == ()


def test_products_with_speeds_take_the_past_of_twenty_and_forty_milliseconds():
    def shifts(delays, dt, coupled=True):
        basis = ActuatorDynamics(delays, dt=dt, coupled=coupled)
        # Of q H and p H each, the present is a column of the body.
        assert basis.products == 2 * max(len(basis.coupled_shifts) - 1, 0)
        return basis.coupled_shifts

    two, three = (0.0, 0.01), (-0.01, 0.0, 0.01)
    assert shifts(two, 0.005) == shifts(three, 0.005) == (0, 4, 8)
    assert shifts(three, 0.0025) == (0, 8, 16)
    assert shifts(three, 0.05) == (0, 1, 2)
    # A delay that is given needs no mixture.
    assert shifts((0.01,), 0.005) == shifts(three, 0.005, coupled=False) == ()


@pytest.mark.parametrize("hover", [0.02, 0.05, 0.4])
@pytest.mark.parametrize("curve", [0.1, 0.4, 0.9])
def test_a_bend_near_no_thrust_comes_with_its_derivative(hover, curve):
    """Where a rotor all but stands, the root of thrust is held at its least."""
    place = LagPlace("speed", hover, 0.03)
    (ahead, _), (behind, _) = (place.bend(np.array([curve + h])) for h in (1e-6, -1e-6))
    _, slope = place.bend(np.array([curve]))
    np.testing.assert_allclose(slope, (ahead - behind) / 2e-6, rtol=1e-5, atol=1e-6)


def test_searches_start_from_nodes_over_the_whole_range():
    dynamics = ActuatorDynamics(
        (-0.02, 0.0, 0.06), np.linspace(0.0, 0.1, 9), (-0.2, 1.2), motors=True
    )
    delays, lags, curves = (np.unique(dynamics.nodes[:, i]) for i in range(3))
    # No fewer than five of each, no more than eight delays, six lags and five curves.
    np.testing.assert_allclose(delays, np.linspace(-0.02, 0.06, 5))
    np.testing.assert_allclose(lags, np.linspace(0.0, 0.1, 6))
    np.testing.assert_allclose(curves, np.linspace(-0.2, 1.2, 5))
    assert len(dynamics.nodes) == 5 * 6 * 5
    # Nearest to no delay, half of the lag, half of the curve.
    at = dynamics.nodes[dynamics.middle]
    np.testing.assert_allclose(at[[0, 2]], [0.0, 0.5])
    assert at[1] in (pytest.approx(0.04), pytest.approx(0.06))
    assert len(np.unique(ActuatorDynamics(np.linspace(0.0, 0.11, 12)).nodes[:, 0])) == 8
    assert ActuatorDynamics(np.linspace(0.0, 0.07, 8)).nodes.shape == (8, 5)
    np.testing.assert_allclose(
        ActuatorDynamics((0.01,), (0.02,), (0.3,)).nodes, [[0.01, 0.02, 0.3, 0.0, 0.0]]
    )
    # Whatever the units: a lag of 0.1 s off weighs as much as the whole range of curves.
    wide = ActuatorDynamics((-0.05, 0.01), (0.0, 0.001), (0.0, 100.0), motors=True)
    np.testing.assert_allclose(wide.nodes[wide.middle], [-0.005, 0.0005, 50.0, 0.0, 0.0])


def test_rows_hold_rotors_and_body_in_their_places():
    dynamics = commands(0.2)
    row = np.arange(1.0, dynamics.width + 1)
    x = dynamics.map_at(np.array([0.0, 0.0, 0.0])) @ row
    body = [i for i in range(WIDTH) if i not in ROTOR_COLUMNS]
    np.testing.assert_array_equal(x[body], row[-BODY:])
    # Curve 0: the first set, of w; the first element is no lag at the middle delay, here 7.5 ms.
    at = np.array([0.0075, 0.0, 0.0])
    np.testing.assert_allclose(
        dynamics.map_at(at)[ROTOR_COLUMNS, :][:, : dynamics.width - BODY] @ row[:-BODY],
        row[:SIGNALS],
        atol=0.01,
    )
    # Curve 1: the second, of w^2.
    at = np.array([0.0075, 0.0, 1.0])
    np.testing.assert_allclose(
        dynamics.map_at(at)[ROTOR_COLUMNS, :][:, : dynamics.width - BODY] @ row[:-BODY],
        row[SIGNALS : 2 * SIGNALS],
        atol=0.01,
    )
    products = [rb.SIGNALS.index(name) for name in ("qr", "rr")]
    places = dynamics.body_places(products)
    np.testing.assert_array_equal(row[places], x[products])


def test_moments_and_noise_of_commands_are_mapped_alike():
    dynamics = commands(0.2)
    rows = np.random.default_rng(1).normal(size=(50, dynamics.width))
    at = np.array([0.01, 0.05, 0.4])
    mapped = rows @ dynamics.map_at(at).T
    np.testing.assert_allclose(dynamics.moments_at(rows.T @ rows, at), mapped.T @ mapped)
    np.testing.assert_allclose(dynamics.noise_at(rows.T @ rows, at), mapped.T @ mapped)
    given = np.eye(WIDTH)
    assert speeds(0.1).noise_at(given, at) is given


def test_thrust_is_mixed_of_lags_and_sets_without_delay():
    dynamics = commands(0.2)
    assert speeds(0.1).thrust_weights(np.zeros(3)).tolist() == [1.0]
    at = np.array([0.03, 0.05, 0.4, 0.0, 0.0])
    weights = dynamics.thrust_weights(at).reshape(len(dynamics.lags), 2)
    np.testing.assert_allclose(weights.sum(axis=0), [0.6, 0.4])
    own = response(SLOW, np.zeros_like(dynamics.lags), dynamics.lags)
    wanted = response(SLOW, np.zeros(1), np.array([0.05]))[0]
    np.testing.assert_allclose(weights.sum(axis=1) @ own, wanted, atol=1e-3)


@pytest.mark.parametrize("free", [0, 1, 2])
def test_maps_come_with_their_derivatives(free):
    dynamics = commands(0.2)
    at = np.array([[0.008, 0.04, 0.4], [0.0, 0.1, 1.0]])
    step = np.zeros(3)
    step[free] = 1e-5
    ahead, behind = (dynamics.maps(at + s * step)[:, 0] for s in (1.0, -1.0))
    np.testing.assert_allclose(
        dynamics.maps(at)[:, 1 + free], (ahead - behind) / 2e-5, atol=1e-4, rtol=1e-4
    )


def test_plain_rows_are_rows_as_they_are():
    assert PLAIN.width == WIDTH
    assert PLAIN.free == ()
    maps = PLAIN.maps(np.zeros((3, 3)))
    assert maps.shape == (3, 1, WIDTH, WIDTH)
    np.testing.assert_array_equal(maps[2, 0], np.eye(WIDTH))
    np.testing.assert_array_equal(PLAIN.nodes, [[0.0, 0.0, 1.0, 0.0, 0.0]])


def test_what_is_not_told_is_as_for_speeds_at_high_rates():
    told = ActuatorDynamics((0.0, 0.01), (0.0,), (1.0,), motors=False, half_width=0.1, dt=0.0)
    plain = ActuatorDynamics((0.0, 0.01))
    at = np.array([[0.004, 0.0, 1.0]])
    np.testing.assert_array_equal(plain.maps(at), told.maps(at))
    np.testing.assert_array_equal(plain.nodes, told.nodes)
    wide = ActuatorDynamics((0.0, 0.01), half_width=0.2)
    assert np.abs(wide.maps(at) - told.maps(at)).max() > 1e-6
    lagged = (0.0, 0.05), (0.0, 0.05), (0.0, 1.0)
    at = np.array([[0.004, 0.02, 0.5]])
    np.testing.assert_array_equal(
        ActuatorDynamics(*lagged, motors=True).maps(at),
        ActuatorDynamics(*lagged, motors=True, half_width=0.1, dt=0.0, coupled=False).maps(at),
    )
