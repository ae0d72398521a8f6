"""The air, the ground and uneven rotors against their closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.model.parameters import GRAVITY
from sim_bridge.aerodynamics import Aerodynamics
from sim_bridge.dynamics import CALM, Dynamics, State
from sim_bridge.ground_effect import GEAR, thrust_gain
from sim_bridge.physics import Physics
from sim_bridge.simulated_vehicle import RotorTraits, Vehicle, allocation, hover_thrusts
from sim_bridge.simulation import trim
from sim_bridge.surroundings import Surroundings
from sim_bridge.vehicle_files import load_vehicle

AIR = Physics(rotor_drag=0.3, inflow=0.6, forward_lift=0.003, flapping=1.5, quadratic_drag=20.0)
STEP = 0.004


@pytest.fixture(scope="module")
def hexa() -> Vehicle:
    return replace(load_vehicle("px4-hexa-x"), rotor_z=-0.04)


def hover_speeds(vehicle: Vehicle) -> list[float]:
    return [(thrust / vehicle.k_T) ** 0.5 for thrust in hover_thrusts(vehicle)]


def test_wrench_is_the_sum_over_the_rotors(hexa: Vehicle) -> None:
    air = Aerodynamics(hexa, replace(AIR, quadratic_drag=0.0, forward_lift=0.0))
    rng = np.random.default_rng(0)
    for _ in range(10):
        V, w, speeds = rng.normal(size=3), rng.normal(size=3), rng.uniform(200, 800, 6)
        force, moment = np.zeros(3), np.zeros(3)
        for rotor, speed in zip(hexa.rotors, speeds, strict=True):
            arm = np.array([rotor.x - hexa.cg_x, rotor.y - hexa.cg_y, hexa.rotor_z])
            u, v, down = V + np.cross(w, arm)
            f = -speed * np.array([air.k_D * u, air.k_D * v, air.k_z * down])
            force += f
            moment += np.cross(arm, f) - air.k_f * speed * np.array([V[1], -V[0], 0.0])
        got = air.wrench(V, w, speeds)
        np.testing.assert_allclose(got, [*force, *moment], rtol=1e-12, atol=1e-15)


def test_in_hover_coefficients_are_what_they_are_called(hexa: Vehicle) -> None:
    air, speeds = Aerodynamics(hexa, AIR), hover_speeds(hexa)
    still = (0.0, 0.0, 0.0)
    climb = Aerodynamics(hexa, Physics(inflow=0.6)).wrench((0.0, 0.0, -2.0), still, speeds)
    assert climb[2] == pytest.approx(0.6 * 2.0 * hexa.mass)  # down: thrust is lost
    lift = Aerodynamics(hexa, Physics(forward_lift=0.003)).wrench((3.0, 4.0, 0.0), still, speeds)
    assert lift[2] == pytest.approx(-0.003 * 25.0 * hexa.mass * GRAVITY)
    drag = Aerodynamics(hexa, Physics(rotor_drag=0.3)).wrench((2.0, 0.0, 0.0), still, speeds)
    assert drag[0] == pytest.approx(-0.3 * 2.0 * hexa.mass)
    assert drag[4] == pytest.approx(hexa.rotor_z * drag[0])
    flap = Aerodynamics(hexa, Physics(flapping=1.5)).wrench((2.0, 0.0, 0.0), still, speeds)
    assert flap[4] == pytest.approx(1.5 * 2.0 * 0.5 * (hexa.Ixx + hexa.Iyy))
    assert air.wrench(still, still, speeds) == (0.0,) * 6


def test_a_fall_ends_at_its_terminal_speed(paper_vehicle: Vehicle) -> None:
    v = replace(paper_vehicle, linear_drag=0.0)
    dynamics = Dynamics(v)
    around = Surroundings(v, Physics(quadratic_drag=20.0), 1e-3, np.random.SeedSequence(0))
    state = State([0.0] * 6 + [1.0] + [0.0] * 6, [0.0] * 4)
    for k in range(1, 8001):
        state = dynamics.step(state, [0.0] * 4, around.disturbance(dynamics, state, CALM))
        if k in (1000, 8000):
            expected = 20.0 * math.tanh(GRAVITY * 1e-3 * k / 20.0)
            assert state.velocity[2] == pytest.approx(expected, rel=1e-4)


def test_wind_carries_what_has_drag(paper_vehicle: Vehicle) -> None:
    v = replace(paper_vehicle, linear_drag=1.5)
    dynamics = Dynamics(v, gravity=0.0)
    # From 30 degrees east of north: blown south and a little west.
    around = Surroundings(v, Physics(wind=(4.0, math.pi / 6)), 1e-3, np.random.SeedSequence(0))
    state = State([0.0] * 6 + [1.0] + [0.0] * 6, [0.0] * 4)
    for _ in range(1000):
        state = dynamics.step(state, [0.0] * 4, around.disturbance(dynamics, state, CALM))
    carried = -4.0 * (1.0 - math.exp(-1.0))
    expected = [carried * math.cos(math.pi / 6), carried * math.sin(math.pi / 6), 0.0]
    np.testing.assert_allclose(state.velocity, expected, rtol=1e-3, atol=1e-9)


def test_each_axis_decays_at_its_own_rate(paper_vehicle: Vehicle) -> None:
    v = replace(paper_vehicle, Ixy=0.0, Iyz=0.0, Ixz=0.0)
    v = Physics(damping=(0.5, 0.3, 0.05)).of_vehicle(v, np.random.default_rng(0))
    for axis, rate in enumerate((0.5, 0.3, 0.05)):
        dynamics = Dynamics(v, gravity=0.0, step_size=0.01)
        body = [0.0] * 6 + [1.0] + [0.0] * 6
        body[10 + axis] = 2.0
        state = State(body, [0.0] * 4)
        for _ in range(200):
            state = dynamics.step(state, [0.0] * 4)
        assert state.rates[axis] == pytest.approx(2.0 * math.exp(-2.0 * rate), rel=1e-9)


def test_thrust_near_the_ground_is_cheeseman_and_bennetts() -> None:
    for height in (0.0, 0.1, 1.0):
        z = height + GEAR * 0.15
        assert thrust_gain(height, 0.15) == pytest.approx(1.0 / (1.0 - (0.15 / (4 * z)) ** 2) - 1.0)
    assert thrust_gain(10.0, 0.15) < 2e-5


def test_the_ground_carries_a_vehicle_above_it(paper_vehicle: Vehicle) -> None:
    dynamics, state = Dynamics(paper_vehicle), trim(paper_vehicle)
    state.body[2] = -0.05
    around = Surroundings(
        paper_vehicle, Physics(ground_effect=0.5), STEP, np.random.SeedSequence(0)
    )
    held = around.disturbance(dynamics, state, CALM)
    arm = np.mean([math.hypot(r.x, r.y) for r in paper_vehicle.rotors])
    gain = thrust_gain(0.05, 0.5 * arm)
    assert held.force[2] == pytest.approx(-gain * paper_vehicle.mass * GRAVITY)
    np.testing.assert_allclose(held.torque, 0.0, atol=1e-12)  # trimmed about the CG


@pytest.mark.parametrize("tilt", [0.0, 0.07])
def test_uneven_and_canted_rotors_pull_along_their_axes(hexa: Vehicle, tilt: float) -> None:
    rng = np.random.default_rng(1)
    traits = RotorTraits(tuple(rng.uniform(0.9, 1.1, 6)), tuple(rng.uniform(0.9, 1.1, 6)), tilt)
    v = replace(hexa, traits=traits)
    speeds = rng.uniform(200, 800, 6)
    force, moment = np.zeros(3), np.zeros(3)
    for i, rotor in enumerate(v.rotors):
        around = np.array([-rotor.y, rotor.x, 0.0]) / math.hypot(rotor.x, rotor.y)
        axis = rotor.spin * math.sin(tilt) * around - [0.0, 0.0, math.cos(tilt)]
        pull = traits.thrust[i] * v.k_T * speeds[i] ** 2 * axis
        arm = [rotor.x - v.cg_x, rotor.y - v.cg_y, v.rotor_z]
        force += pull
        moment += np.cross(arm, pull)
        moment -= rotor.spin * traits.torque[i] * v.k_M * speeds[i] ** 2 * axis
    dynamics = Dynamics(v)
    T, m_x, m_y, m_z, _, _ = dynamics.wrench(list(speeds), list(speeds))
    np.testing.assert_allclose([T, m_x, m_y, m_z], [-force[2], *moment], rtol=1e-10)
    assert dynamics.uneven is not None
    np.testing.assert_allclose(dynamics.uneven.side_force(list(speeds)), force[:2], atol=1e-12)


def test_canted_rotors_are_allocated_as_built(hexa: Vehicle) -> None:
    v = Physics(tilt=0.07).of_vehicle(hexa, np.random.default_rng(0))
    wanted = np.array([20.0, 0.3, -0.2, 0.15])
    speeds = [(np.dot(row, wanted) / v.k_T) ** 0.5 for row in allocation(v)]
    np.testing.assert_allclose(Dynamics(v).wrench(speeds, speeds)[:4], wanted, rtol=1e-9)


@pytest.mark.parametrize("lag_of", ["speed", "thrust", "command"])
def test_rotor_inertia_keeps_angular_momentum_behind_any_lag(
    paper_vehicle: Vehicle, lag_of: str
) -> None:
    v = replace(
        paper_vehicle,
        k_T=1e-16,
        T_max=1e-16 * 300.0**2,
        k_M=0.0,
        rotor_inertia=2e-4,
        thrust_curve=0.4,
        lag_of=lag_of,
    )
    dynamics = Dynamics(v, gravity=0.0)
    speeds = [100.0, 120.0, 80.0, 90.0]
    state = State([0.0] * 6 + [1.0] + [0.0] * 5 + [0.3], speeds)
    v = replace(v, Ixy=0.0, Iyz=0.0, Ixz=0.0)
    dynamics.use(v)
    before = v.Izz * 0.3 - v.rotor_inertia * sum(
        r.spin * s for r, s in zip(v.rotors, speeds, strict=True)
    )
    for _ in range(100):
        state = dynamics.step(state, [200.0, 150.0, 60.0, 50.0])
    after = v.Izz * state.rates[2] - v.rotor_inertia * sum(
        r.spin * s for r, s in zip(v.rotors, state.speeds, strict=True)
    )
    assert after == pytest.approx(before, rel=1e-5)
    assert abs(state.rates[2] - 0.3) > 0.2


def test_thrust_lags_with_its_own_time_constant(paper_vehicle: Vehicle) -> None:
    v = replace(paper_vehicle, lag_of="thrust", motor_lag=0.05)
    dynamics, state = Dynamics(v), State([*trim(v).body], [100.0] * 4)
    for _ in range(50):
        state = dynamics.step(state, [180.0] * 4)
    expected = 180.0**2 + (100.0**2 - 180.0**2) * math.exp(-1.0)
    assert state.speeds[0] ** 2 == pytest.approx(expected, rel=1e-9)
