"""The article's vehicle as the coach reckons with it."""

import numpy as np
import pytest

from gcs_sysid.coach.information import Craft, Noise, speed_noise
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.parameters import GRAVITY
from sim_bridge.vehicle_files import load_vehicle
from tests.known_theta import theta_from

GYRO = np.radians(0.01)
"""rad/s per root hertz, one-sided, of the emulator's MEMS gyro."""


@pytest.fixture(scope="session")
def vehicle():
    return load_vehicle("paper")


@pytest.fixture(scope="session")
def craft(vehicle):
    v = vehicle
    inertia = np.array([v.Ixx, v.Iyy, v.Izz, v.Ixy, v.Iyz, v.Ixz]) / v.k_T
    theta = theta_from(*inertia, v.cg_x, v.cg_y, v.k_M / v.k_T, 0.0, 0.0)
    weight = v.mass * GRAVITY
    geometry = load_airframe("paper").geometry
    return Craft(geometry, theta, weight / v.k_T, most=4.0 * v.T_max / weight)


@pytest.fixture(scope="session")
def noise(craft):
    """Of the emulator's MEMS sensors at 100 Hz."""
    return Noise(0.5 * GYRO**2 * np.eye(3), speed_noise(craft, np.full(4, 0.5), 0.01))
