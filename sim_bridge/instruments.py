"""What the autopilot measures: the simulated truth with sensor noise, sampled on demand.

A sensor read twice at one instant gives one sample, so that messages of one instant agree.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_bridge.sensors import Channel
from sim_bridge.simulation import Simulation

Sample = list[float]

MAGNETIC_FIELD = (0.215, 0.010, 0.430)
"""Gauss, NED: about that of central Europe."""


class Instruments:
    """Noisy readings of one simulated vehicle.

    Attributes:
        simulation: what is measured.
    """

    def __init__(self, simulation: Simulation, channels: dict[str, Channel]) -> None:
        self.simulation = simulation
        self._channels = channels
        self._taken: dict[str, tuple[int, Any]] = {}
        self._gyro_noise: Sample = [0.0, 0.0, 0.0]

    def retime(self, sensor: str, interval: float) -> None:
        """The sensor is now read every so many seconds."""
        self._channels[sensor].retime(interval)

    def _once(self, sensor: str, read: Callable[[], Any]) -> Any:
        tick = self.simulation.tick
        taken = self._taken.get(sensor)
        if taken is None or taken[0] != tick:
            taken = (tick, read())
            self._taken[sensor] = taken
        return taken[1]

    def inertial(self) -> tuple[Sample, Sample]:
        """Gyro (rad/s) and accelerometer (m/s^2), body axes."""
        reading: tuple[Sample, Sample] = self._once("inertial", self._inertial)
        return reading

    def _inertial(self) -> tuple[Sample, Sample]:
        s = self.simulation
        (p, q, r), (x, y, z) = s.dynamics.imu(s.state, s.targets, s.disturbance)
        noise = self._gyro_noise = self._channels["gyro"].next()
        error = self._channels["accelerometer"].next()
        return (
            [p + noise[0], q + noise[1], r + noise[2]],
            [x + error[0], y + error[1], z + error[2]],
        )

    def attitude(self) -> Sample:
        """Roll, pitch and yaw, rad."""
        angles: Sample = self._once("attitude", self._attitude)
        return angles

    def _attitude(self) -> Sample:
        a, b, c, d = self.simulation.state.quaternion
        noise = self._channels["attitude"].next()
        roll = math.atan2(2.0 * (a * b + c * d), 1.0 - 2.0 * (b * b + c * c))
        pitch = math.asin(max(-1.0, min(1.0, 2.0 * (a * c - d * b))))
        yaw = math.atan2(2.0 * (a * d + b * c), 1.0 - 2.0 * (c * c + d * d))
        return [roll + noise[0], pitch + noise[1], wrap(yaw + noise[2])]

    def rates(self) -> Sample:
        """Body rates as the attitude filter has them: the gyro with its newest error, rad/s."""
        p, q, r = self.simulation.state.rates
        noise = self._gyro_noise
        return [p + noise[0], q + noise[1], r + noise[2]]

    def rotor_speeds(self) -> Sample:
        """Measured rotor speeds, rad/s, never below zero."""
        speeds: Sample = self._once("rotor", self._rotor_speeds)
        return speeds

    def _rotor_speeds(self) -> Sample:
        noise = self._channels["rotor"].next()
        return [
            max(0.0, speed + n)
            for speed, n in zip(self.simulation.state.speeds, noise, strict=True)
        ]

    def velocity(self) -> Sample:
        """Velocity, NED, m/s."""
        velocity: Sample = self._once("velocity", self._velocity)
        return velocity

    def _velocity(self) -> Sample:
        noise = self._channels["velocity"].next()
        return [v + n for v, n in zip(self.simulation.state.velocity, noise, strict=True)]

    def commands(self) -> Sample:
        """Commands u of the rotors, 0..1."""
        vehicle = self.simulation.vehicle
        return [float(vehicle.command_of(target)) for target in self.simulation.targets]


def wrap(angle: float) -> float:
    """The angle within -pi..pi."""
    return math.remainder(angle, 2.0 * math.pi)


def quaternion_of(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Body-to-world quaternion (w, x, y, z) of ZYX angles."""
    c_r, s_r = math.cos(0.5 * roll), math.sin(0.5 * roll)
    c_p, s_p = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    c_y, s_y = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    return (
        c_r * c_p * c_y + s_r * s_p * s_y,
        s_r * c_p * c_y - c_r * s_p * s_y,
        c_r * s_p * c_y + s_r * c_p * s_y,
        c_r * c_p * s_y - s_r * s_p * c_y,
    )


def quaternion_of_arrays(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same for (..., 3) arrays of angles: (..., 4)."""
    c_r, c_p, c_y = np.moveaxis(np.cos(0.5 * angles), -1, 0)
    s_r, s_p, s_y = np.moveaxis(np.sin(0.5 * angles), -1, 0)
    return np.stack(
        [
            c_r * c_p * c_y + s_r * s_p * s_y,
            s_r * c_p * c_y - c_r * s_p * s_y,
            c_r * s_p * c_y + s_r * c_p * s_y,
            c_r * c_p * s_y - s_r * s_p * c_y,
        ],
        axis=-1,
    )
