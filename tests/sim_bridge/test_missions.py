"""What the missions make the vehicle do."""

import numpy as np
import pytest

from sim_bridge.ensemble import Flight, fly_ensemble
from sim_bridge.missions import MISSIONS, PITCH, ROLL, YAW
from sim_bridge.simulated_vehicle import Vehicle
from sim_bridge.simulation import mass_step
from sim_bridge.vehicle_files import load_vehicle, vehicle_names


def rms(values: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def tilt(flight: Flight) -> np.ndarray:
    """Degrees, (N, K)."""
    _, b, c, _ = np.moveaxis(flight.quaternion, -1, 0)
    return np.degrees(np.arccos(1.0 - 2.0 * (b * b + c * c)))


def thrusts(flight: Flight, vehicle: Vehicle) -> np.ndarray:
    return np.asarray(vehicle.k_T * flight.speeds**2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mode", "start", "own"), [(0, 2.0, 0.85), (1, 22.0, 0.88), (2, 42.0, 0.56)]
)
def test_paper_modes_reach_their_body_rates(
    flights: dict[str, Flight], mode: int, start: float, own: float
) -> None:
    flight = flights["paper"]
    inside = (flight.t >= start) & (flight.t < start + 20.0)
    got = rms(flight.gyro[0, inside])
    expected = np.full(3, own / 4.0)
    expected[mode] = own
    np.testing.assert_allclose(got, expected, rtol=0.15)


@pytest.mark.parametrize("mission", ["paper", "all-axes", "hover"])
def test_tilt_height_and_rotors_stay_within_bounds(
    flights: dict[str, Flight], paper_vehicle: Vehicle, mission: str
) -> None:
    flight = flights[mission]
    assert tilt(flight).max() < 30.0
    assert abs(flight.velocity[..., 2]).max() < 0.5
    lifted = thrusts(flight, paper_vehicle)
    assert lifted.min() > 0.2
    assert lifted.max() < 0.8 * paper_vehicle.T_max
    # The commands never touched the limits either: 1 % of T_max is the controller's floor.
    floor = paper_vehicle.command_of((0.01 * 15.0 / paper_vehicle.k_T) ** 0.5)
    assert flight.commands.min() > 1.01 * floor


@pytest.mark.parametrize("multisine", [ROLL, PITCH, YAW])
def test_multisines_stay_in_their_band_and_are_scaled(multisine) -> None:  # type: ignore[no-untyped-def]
    assert min(multisine.frequencies) >= 0.3
    assert max(multisine.frequencies) <= 2.7
    t = np.arange(0.0, 20.0, 0.01)
    swings = np.array([multisine(x) for x in t])
    assert rms(swings[:, 1]) == pytest.approx(1.0, rel=1e-9)
    h = 1e-5
    for at in (0.3, 7.7, 15.1):
        slope = (np.array(multisine(at + h)) - np.array(multisine(at - h))) / (2 * h)
        np.testing.assert_allclose(slope[:3], multisine(at)[1:], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("name", ["paper", "all-axes"])
@pytest.mark.parametrize("around", [1.0, 2.5, 12.0, 22.4, 31.0, 61.9, 62.3, 90.0])
def test_set_points_are_derivatives_of_each_other(name: str, around: float) -> None:
    mission = MISSIONS[name]
    h = 1e-4
    before, here, after = (mission.reference(around + k * h) for k in (-1, 0, 1))
    for low, high in (
        ("position", "velocity"),
        ("velocity", "acceleration"),
        ("rate", "angular_acceleration"),
    ):
        slope = np.subtract(getattr(after, low), getattr(before, low)) / (2 * h)
        np.testing.assert_allclose(slope, getattr(here, high), atol=1e-4)


@pytest.mark.parametrize("factor", [1.2, 0.7])
def test_a_mass_step_leaves_the_vehicle_stable(paper_vehicle: Vehicle, factor: float) -> None:
    flight = fly_ensemble(
        paper_vehicle, MISSIONS["all-axes"], 50.0, duration=16.0, changes=[mass_step(6.0, factor)]
    )
    assert tilt(flight).max() < 32.0
    late = flight.t > 14.0
    assert abs(flight.velocity[0, late, 2]).max() < 0.2
    weight = thrusts(flight, paper_vehicle).sum(axis=-1)[0]
    ratio = weight[late].mean() / weight[flight.t < 2.0].mean()
    assert ratio == pytest.approx(factor, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=[] if "hexa" in n else pytest.mark.thorough)
        for n in vehicle_names()
        if n != "paper"
    ],
)
def test_every_vehicle_flies_the_hardest_mission(name: str) -> None:
    vehicle = load_vehicle(name)
    flight = fly_ensemble(vehicle, MISSIONS["all-axes"], 50.0, duration=12.0)
    assert tilt(flight).max() < 30.0
    lifted = thrusts(flight, vehicle)
    assert lifted.min() > 0.01 * vehicle.T_max
    assert lifted.max() < 0.98 * vehicle.T_max
    assert (rms(flight.gyro[0, flight.t > 3.0]) > [0.75, 0.75, 0.4]).all()
