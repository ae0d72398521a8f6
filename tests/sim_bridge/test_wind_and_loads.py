"""Random and swinging things against the laws they are drawn from."""

import math

import numpy as np
import pytest

from gcs_sysid.model.parameters import GRAVITY
from sim_bridge.battery import CELL_FULL, CELLS, RELAXATION, Battery
from sim_bridge.dynamics import CALM, Dynamics, State
from sim_bridge.loads import SLOSH_DAMPING, Slosh, Swing
from sim_bridge.physics import Physics
from sim_bridge.random_forces import RandomForces
from sim_bridge.simulated_vehicle import Vehicle, hover_thrusts
from sim_bridge.surroundings import Surroundings
from sim_bridge.wind import LEAST_SPEED, FirstOrder, SecondOrder, Wind


def autocorrelation(x: np.ndarray, lag: int) -> float:
    return float(np.mean(x[lag:] * x[:-lag]) / np.mean(x * x))


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "at_T"), [(FirstOrder, 1.0), (SecondOrder, 0.5)])
def test_gusts_have_dryden_s_variance_and_correlation(kind: type, at_T: float) -> None:
    component = kind(1.7, 0.8, 0.08)
    rng = np.random.default_rng(3)
    component.start(*rng.standard_normal(2).tolist())
    x = np.array([component.next(n, m) for n, m in rng.standard_normal((150_000, 2)).tolist()])
    assert x.std() == pytest.approx(1.7, rel=0.02)
    for lag, level in ((10, at_T), (20, 1.0 if at_T == 1.0 else 0.0)):
        expected = level * math.exp(-0.1 * lag)
        assert autocorrelation(x, lag) == pytest.approx(expected, abs=0.03)


def test_wind_comes_from_where_it_is_said_to() -> None:
    seed = np.random.SeedSequence(1)
    steady = Wind(Physics(wind=(6.0, 0.5 * math.pi)), 0.5, 0.004, seed)
    assert steady.velocity == pytest.approx((0.0, -6.0, 0.0), abs=1e-12)
    gusty = Wind(Physics(wind=(6.0, 0.0), gusts=1.5), 0.5, 0.5, seed)
    seen = []
    for _ in range(60_000):
        gusty.advance()
        seen.append(gusty.velocity)
    mean, spread = np.mean(seen, axis=0), np.std(seen, axis=0)
    np.testing.assert_allclose(mean, [-6.0, 0.0, 0.0], atol=0.15)
    np.testing.assert_allclose(spread[:2], 1.5, rtol=0.05)
    assert spread[2] < 0.7 * spread[0]
    assert LEAST_SPEED == 2.0


def test_unmodelled_moment_and_force_are_ornstein_uhlenbeck() -> None:
    forces = RandomForces(
        Physics(ou_moment=(2.0, 0.5), ou_force=(0.4, 2.0)), 0.05, np.random.SeedSequence(5)
    )
    x = np.array([forces.next() for _ in range(60_000)])
    np.testing.assert_allclose(x[:, :3].std(axis=0), 2.0, rtol=0.05)
    np.testing.assert_allclose(x[:, 3:].std(axis=0), 0.4, rtol=0.08)
    assert autocorrelation(x[:, 0], 10) == pytest.approx(math.exp(-1.0), abs=0.04)
    assert autocorrelation(x[:, 4], 40) == pytest.approx(math.exp(-1.0), abs=0.06)
    assert abs(np.corrcoef(x.T) - np.eye(6)).max() < 0.1


def test_the_unmodelled_moment_is_an_angular_acceleration(paper_vehicle: Vehicle) -> None:
    on = Physics(ou_moment=(2.0, 0.5))
    around = Surroundings(paper_vehicle, on, 0.004, np.random.SeedSequence(6))
    dynamics = Dynamics(paper_vehicle, gravity=0.0)
    state = State([0.0] * 6 + [1.0] + [0.0] * 6, [0.0] * 4)
    twin = RandomForces(on, 0.004, np.random.SeedSequence(6).spawn(2)[0])
    for _ in range(3):
        gust = around.disturbance(dynamics, state, CALM)
        k = dynamics.derivative(state.body, (0.0,) * 6, gust)
        np.testing.assert_allclose(k[10:], twin.next()[:3], rtol=1e-9)


def test_a_battery_that_sags_slows_the_rotors_as_its_voltage_falls(paper_vehicle: Vehicle) -> None:
    battery = Battery(Physics(battery=(0.1, 60.0)), paper_vehicle, 0.004)
    speeds = [(t / paper_vehicle.k_T) ** 0.5 for t in hover_thrusts(paper_vehicle)]
    battery.advance(30.0, speeds)
    assert battery.ratio == pytest.approx(0.95)
    assert battery.voltage == pytest.approx(0.95 * CELLS * CELL_FULL)
    # Behind its resistance: half the power again drops half of what hover does.
    loaded = Battery(Physics(battery_drop=0.04), paper_vehicle, 0.001)
    more = [1.5 ** (1.0 / 3.0) * s for s in speeds]
    for k in range(300):
        loaded.advance(0.001 * k, more)
    expected = 1.0 - 0.5 * 0.04 * (1.0 - math.exp(-0.3 / RELAXATION))
    assert loaded.ratio == pytest.approx(expected, abs=1e-4)


def test_a_liquid_sloshes_at_its_frequency_and_dies_out(paper_vehicle: Vehicle) -> None:
    slosh = Slosh(paper_vehicle, 0.2, 2.0, 1e-3)
    slosh._place = (0.01, 0.0)
    x = []
    for _ in range(5000):
        slosh.wrench((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        x.append(slosh._place[0])
    crossings = np.flatnonzero(np.diff(np.sign(x)) > 0)
    damped = 2.0 * math.sqrt(1.0 - SLOSH_DAMPING**2)
    assert np.diff(crossings).mean() * 1e-3 == pytest.approx(1.0 / damped, rel=5e-3)
    decay = np.abs(x).reshape(10, -1).max(axis=1)
    assert decay[5] / decay[4] == pytest.approx(
        math.exp(-SLOSH_DAMPING * 4 * math.pi * 0.5), rel=0.05
    )


def test_sloshing_keeps_the_momentum_of_body_and_liquid(paper_vehicle: Vehicle) -> None:
    h = 1e-3
    around = Surroundings(paper_vehicle, Physics(slosh=(0.2, 1.5)), h, np.random.SeedSequence(0))
    slosh = around._slosh
    assert slosh is not None
    slosh._place, slosh._z = (0.02, 0.0), 0.0
    dynamics = Dynamics(paper_vehicle, gravity=0.0, step_size=h)
    state = State([0.0] * 6 + [1.0] + [0.0] * 6, [0.0] * 4)
    fastest = 0.0
    for _ in range(1000):
        state = dynamics.step(state, [0.0] * 4, around.disturbance(dynamics, state, CALM))
        fastest = max(fastest, abs(state.velocity[0]))
    moved = paper_vehicle.mass * state.velocity[0] + slosh._mass * slosh._speed[0]
    assert fastest > 0.01
    assert abs(moved) < 0.01 * paper_vehicle.mass * fastest


def test_a_payload_swings_as_a_pendulum(paper_vehicle: Vehicle) -> None:
    swing = Swing(paper_vehicle, 0.1, 0.8, 1e-3)
    x = []
    for _ in range(8000):
        swing.pull((0.0, 0.0, -GRAVITY))
        x.append(swing._n[0])
    crossings = np.flatnonzero(np.diff(np.sign(x)) > 0)
    period = 2.0 * math.pi * math.sqrt(0.8 / GRAVITY)
    assert np.diff(crossings).mean() * 1e-3 == pytest.approx(period, rel=2e-3)
    assert max(x[-2000:]) == pytest.approx(math.sin(0.05), rel=0.01)
