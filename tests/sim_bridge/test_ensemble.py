"""An ensemble is the same flights, only many at once."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim_bridge.cli import main
from sim_bridge.ensemble import fly_ensemble
from sim_bridge.missions import MISSIONS
from sim_bridge.simulated_vehicle import Vehicle, stack_vehicles

FIELDS = ("gyro", "specific_force", "quaternion", "speeds", "commands", "velocity")


@pytest.mark.slow
def test_an_ensemble_equals_its_single_flights(paper_vehicle: Vehicle) -> None:
    vehicles = [
        replace(
            paper_vehicle,
            Ixx=0.0165 * (1 + 0.1 * i),
            cg_x=0.1 - 0.03 * i,
            mass=1.5 + 0.2 * i,
            motor_lag=0.03 + 0.005 * i,
            linear_drag=0.1 * i,
            rotor_inertia=1e-5 * i,
        )
        for i in range(3)
    ]
    mission = MISSIONS["all-axes"]
    together = fly_ensemble(stack_vehicles(vehicles), mission, 100.0, duration=2.0, turbulence=0.01)
    assert together.gyro.shape == (3, 201, 3)
    for i, vehicle in enumerate(vehicles):
        alone = fly_ensemble(vehicle, mission, 100.0, duration=2.0, turbulence=0.01)
        for name in FIELDS:
            got, expected = getattr(together, name)[i], getattr(alone, name)[0]
            scale = max(1.0, abs(expected).max())
            assert abs(got - expected).max() < 1e-12 * scale, name


def test_noise_equals_that_of_the_messages(
    paper_vehicle: Vehicle, tmp_path: Path, read_tlog: Callable[[Path], Any]
) -> None:
    path = tmp_path / "f.tlog"
    options = "--rate 20 --noise paper --sigma 0.03 --seed 11 --duration 4 --mission all-axes"
    assert main([*options.split(), "--tlog", str(path)]) == 0
    messages = [m for _, m in read_tlog(path)]
    imu = [m for m in messages if m.get_type() == "HIGHRES_IMU"]
    attitude = [m for m in messages if m.get_type() == "ATTITUDE_QUATERNION"]
    flight = fly_ensemble(paper_vehicle, MISSIONS["all-axes"], 20.0, duration=4.0, seed=11)
    noisy = flight.with_noise("paper", 0.03, [11])
    gyro = np.array([[m.xgyro, m.ygyro, m.zgyro] for m in imu])
    force = np.array([[m.xacc, m.yacc, m.zacc] for m in imu])
    quaternion = np.array([[m.q1, m.q2, m.q3, m.q4] for m in attitude])
    np.testing.assert_allclose(gyro, noisy.gyro[0], atol=1e-6)
    np.testing.assert_allclose(force, noisy.specific_force[0], atol=1e-5)
    np.testing.assert_allclose(quaternion, noisy.quaternion[0], atol=1e-6)
