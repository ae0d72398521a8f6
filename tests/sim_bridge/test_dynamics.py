"""The physics against conservation laws, closed forms and MODEL.md's printed equations."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.model.parameters import GRAVITY
from sim_bridge.dynamics import Disturbance, Dynamics, State, rotate_to_body
from sim_bridge.simulated_vehicle import Vehicle, even, hover_thrusts
from sim_bridge.simulation import trim


def matrix(q: list[float]) -> np.ndarray:
    """Body to world."""
    return np.array([rotate_to_body(q, e) for e in np.eye(3)])


def inertia(v: Vehicle) -> np.ndarray:
    return np.array([[v.Ixx, v.Ixy, v.Ixz], [v.Ixy, v.Iyy, v.Iyz], [v.Ixz, v.Iyz, v.Izz]])


def random_state(rng: np.random.Generator, rotors: int = 4) -> State:
    q = rng.normal(size=4)
    q /= np.linalg.norm(q)
    body = [*rng.normal(size=6), *q, *rng.normal(scale=2.0, size=3)]
    return State([float(x) for x in body], [float(x) for x in rng.uniform(50, 250, rotors)])


def tumbling() -> State:
    return State([0.0] * 6 + [1.0, 0.0, 0.0, 0.0, 4.0, -3.0, 5.0], [0.0] * 4)


def test_free_tumbling_keeps_angular_momentum_and_energy(paper_vehicle: Vehicle) -> None:
    dynamics = Dynamics(paper_vehicle, gravity=0.0)
    J = inertia(paper_vehicle)
    state = tumbling()
    w = np.array(state.rates)
    momentum, energy = matrix(state.quaternion) @ J @ w, w @ J @ w
    for _ in range(5000):
        state = dynamics.step(state, [0.0] * 4)
    w = np.array(state.rates)
    assert np.linalg.norm(w - [4.0, -3.0, 5.0]) > 0.5  # it did tumble
    np.testing.assert_allclose(matrix(state.quaternion) @ J @ w, momentum, rtol=1e-9)
    assert w @ J @ w == pytest.approx(energy, rel=1e-10)


def test_rotors_that_speed_up_keep_the_total_angular_momentum(paper_vehicle: Vehicle) -> None:
    # Without thrust and drag torque all that is left is the exchange between rotors and body.
    v = replace(paper_vehicle, k_T=1e-30, k_M=0.0, rotor_inertia=2e-4)
    dynamics = Dynamics(v, gravity=0.0)
    state = State([0.0] * 6 + [1.0, 0.0, 0.0, 0.0, 1.0, -0.5, 0.3], [100.0, 120.0, 50.0, 40.0])
    spins = np.array([r.spin for r in v.rotors])

    def momentum(s: State) -> np.ndarray:
        h = np.array([0.0, 0.0, -v.rotor_inertia * spins @ s.speeds])
        return matrix(s.quaternion) @ (inertia(v) @ s.rates + h)

    before = momentum(state)
    for _ in range(1000):
        state = dynamics.step(state, [200.0, 150.0, 20.0, 10.0])
    np.testing.assert_allclose(momentum(state), before, rtol=1e-7)
    assert abs(state.rates[2] - 0.3) > 0.1


def test_a_command_that_lags_makes_thrust_lag_where_it_is_linear(paper_vehicle: Vehicle) -> None:
    # PX4's SIH: dT/dt = (T_c - T) / tau.
    v = replace(paper_vehicle, lag_of="command", thrust_curve=0.0, motor_lag=0.05)
    dynamics = Dynamics(v, step_size=0.004)
    state = State([*trim(v).body], [100.0, 150.0, 200.0, 50.0])
    targets = [180.0, 120.0, 200.0, 0.0]
    start, goal = v.k_T * np.square(state.speeds), v.k_T * np.square(targets)
    for k in range(1, 30):
        state = dynamics.step(state, targets)
        expected = goal + (start - goal) * math.exp(-0.004 * k / 0.05)
        np.testing.assert_allclose(v.k_T * np.square(state.speeds), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("curve", [0.3, 1.0])
def test_a_command_lags_before_the_thrust_curve(paper_vehicle: Vehicle, curve: float) -> None:
    v = replace(paper_vehicle, lag_of="command", thrust_curve=curve, motor_lag=0.05)
    state = State([*trim(v).body], [v.speed_of(0.3)] * 4)
    for _ in range(50):
        state = Dynamics(v).step(state, [v.speed_of(0.8)] * 4)
    expected = 0.8 - 0.5 * math.exp(-1.0)
    assert v.command_of(state.speeds[0]) == pytest.approx(expected, rel=1e-9)


def test_rotation_obeys_the_regression_of_the_model(paper_vehicle: Vehicle) -> None:
    """MODEL.md's three rows, in the article's rotor numbers, on random states."""
    v = paper_vehicle
    theta = [v.Ixx, v.Iyy, v.Izz, v.Ixy, v.Iyz, v.Ixz, v.cg_x, v.cg_y, v.k_M]
    rng = np.random.default_rng(0)
    dynamics = Dynamics(v)
    L = 0.25
    for _ in range(50):
        s = random_state(rng)
        dp, dq, dr = dynamics.derivative(s.body, dynamics.wrench(s.speeds, s.speeds))[10:]
        p, q, r = s.rates
        # Article 1, 2, 3, 4 = PX4 4, 1, 2, 3.
        o2, o3, o4, o1 = (x**2 for x in s.speeds)
        T = v.k_T * (o1 + o2 + o3 + o4)
        rows = [
            [dp, -q * r, q * r, dq - r * p, q**2 - r**2, dr + p * q, 0, -T, 0],
            [r * p, dq, -r * p, dp + q * r, dr - p * q, r**2 - p**2, T, 0, 0],
            [-p * q, p * q, dr, p**2 - q**2, dq + r * p, dp - q * r, 0, 0, -(o2 + o3 - o1 - o4)],
        ]
        right = [v.k_T * (o3 + o4 - o1 - o2) * L, v.k_T * (o2 + o4 - o1 - o3) * L, 0.0]
        np.testing.assert_allclose(np.array(rows) @ theta, right, atol=1e-12)


def test_translation_obeys_the_article(paper_vehicle: Vehicle) -> None:
    dynamics = Dynamics(paper_vehicle)
    rng = np.random.default_rng(1)
    for _ in range(20):
        s = random_state(rng)
        a, b, c, d = s.quaternion
        phi = math.atan2(2 * (a * b + c * d), 1 - 2 * (b * b + c * c))
        theta = math.asin(2 * (a * c - d * b))
        psi = math.atan2(2 * (a * d + b * c), 1 - 2 * (c * c + d * d))
        T = paper_vehicle.k_T * sum(x**2 for x in s.speeds)
        up = np.array(
            [
                math.cos(psi) * math.sin(theta) * math.cos(phi) + math.sin(psi) * math.sin(phi),
                math.sin(psi) * math.sin(theta) * math.cos(phi) - math.cos(psi) * math.sin(phi),
                math.cos(theta) * math.cos(phi),
            ]
        )
        expected = -T * up / paper_vehicle.mass + [0.0, 0.0, GRAVITY]
        got = dynamics.derivative(s.body, dynamics.wrench(s.speeds, s.speeds))[3:6]
        np.testing.assert_allclose(got, expected, atol=1e-12)


def test_trim_is_an_equilibrium(paper_vehicle: Vehicle) -> None:
    state = trim(paper_vehicle)
    dynamics = Dynamics(paper_vehicle)
    rates = dynamics.derivative(state.body, dynamics.wrench(state.speeds, state.speeds))
    np.testing.assert_allclose(rates, 0.0, atol=1e-12)
    # CG 10 cm forward and 5 cm right of the center: 0.4, 0.1, 0.3 and 0.2 of the weight.
    shares = np.array(hover_thrusts(paper_vehicle)) / (1.5 * GRAVITY)
    np.testing.assert_allclose(shares, [0.4, 0.1, 0.3, 0.2], atol=1e-12)


def test_accelerometer_at_the_cg_reads_the_thrust_alone(paper_vehicle: Vehicle) -> None:
    s = random_state(np.random.default_rng(3))
    gyro, force = Dynamics(paper_vehicle).imu(s, s.speeds)
    T = paper_vehicle.k_T * sum(x**2 for x in s.speeds)
    np.testing.assert_allclose(force, [0.0, 0.0, -T / 1.5], atol=1e-12)
    assert gyro == s.rates


def test_accelerometer_off_the_cg_reads_the_motion_of_its_place(paper_vehicle: Vehicle) -> None:
    arm = np.array([0.05, -0.03, 0.08])
    v = replace(paper_vehicle, imu_x=arm[0], imu_y=arm[1], imu_z=arm[2])
    h = 1e-4
    dynamics = Dynamics(v, step_size=h)
    states = [random_state(np.random.default_rng(4))]
    targets = list(states[0].speeds)
    for _ in range(2):
        states.append(dynamics.step(states[-1], targets))
    places = [np.array(s.position) + matrix(s.quaternion) @ arm for s in states]
    acceleration = (places[0] - 2 * places[1] + places[2]) / h**2 - [0.0, 0.0, GRAVITY]
    _, force = dynamics.imu(states[1], targets)
    np.testing.assert_allclose(force, matrix(states[1].quaternion).T @ acceleration, atol=2e-4)


@pytest.mark.parametrize("rotor_inertia", [0.0, 1e-4])
def test_what_a_step_remembers_of_the_last_one_changes_nothing(
    paper_vehicle: Vehicle, rotor_inertia: float
) -> None:
    v = replace(paper_vehicle, linear_drag=0.2, rotor_inertia=rotor_inertia)
    dynamics = Dynamics(v)
    rng = np.random.default_rng(5)
    state = again = random_state(rng)
    targets, gust = [200.0, 150.0, 120.0, 180.0], Disturbance()
    for k in range(60):
        if k % 7 == 3:
            targets = rng.uniform(100.0, 250.0, 4).tolist()
        if k % 5 == 2:
            gust = Disturbance((0.5 * k, -1.0, 2.0), (0.01, 0.02 * k, -0.03))
        if k % 3 == 0:
            felt = dynamics.imu(state, targets, gust)
            np.testing.assert_allclose(felt, Dynamics(v).imu(again, targets, gust), rtol=1e-11)
        state = dynamics.step(state, targets, gust)
        again = Dynamics(v).step(again, targets, gust)
        np.testing.assert_allclose(state.body, again.body, rtol=1e-12, atol=1e-13)
        assert state.speeds == again.speeds


def test_rotors_taken_all_at_once_are_those_taken_one_by_one(paper_vehicle: Vehicle) -> None:
    whole, single = Dynamics(paper_vehicle), Dynamics(replace(paper_vehicle, traits=even(4)))
    assert whole.uneven is None
    assert single.uneven is not None
    state = other = random_state(np.random.default_rng(6))
    gust = Disturbance((0.5, -1.0, 2.0), (0.01, 0.02, -0.03))
    for _ in range(100):
        state = whole.step(state, [200.0, 150.0, 120.0, 180.0], gust)
        other = single.step(other, [200.0, 150.0, 120.0, 180.0], gust)
    np.testing.assert_allclose(state.body, other.body, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(state.speeds, other.speeds, rtol=1e-13)
