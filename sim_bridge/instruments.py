"""What the autopilot measures: the simulated truth with sensor noise, sampled on demand.

A sensor's error is drawn once an instant, so that messages of one instant agree. Messages that
only repeat what another has measured ask for the last error (`fresh=False`) and so do not move
the random sequence.
"""

import math

import numpy as np
from numpy.typing import NDArray

from sim_bridge.autopilot import BOOT_US, STEP_US
from sim_bridge.dynamics import STEP
from sim_bridge.sensors import Channel
from sim_bridge.simulation import Simulation

Sample = list[float]


class Instruments:
    """Noisy readings of one simulated vehicle.

    Attributes:
        simulation: what is measured.
    """

    def __init__(self, simulation: Simulation, channels: dict[str, Channel]) -> None:
        self.simulation = simulation
        self._channels = channels
        self._drawn: dict[str, tuple[int, Sample]] = {}

    @property
    def now_us(self) -> int:
        """The vehicle's clock, us since it was switched on."""
        return BOOT_US + self.simulation.tick * STEP_US

    @property
    def now_ms(self) -> int:
        """The same in ms, as 32 bits hold it."""
        return (self.now_us // 1000) & 0xFFFFFFFF

    def retime(self, sensor: str, interval: float) -> None:
        """The sensor is now read every so many seconds."""
        self._channels[sensor].retime(interval)

    def _noise(self, sensor: str, fresh: bool) -> Sample:
        """The sensor's error: drawn once an instant, or its last one where that will do.

        The last one will not do for ever: when the message that draws is switched off, the
        others draw for themselves.
        """
        tick = self.simulation.tick
        channel = self._channels[sensor]
        drawn = self._drawn.get(sensor)
        oldest = 0.0 if fresh else 2.0 * channel.interval / STEP
        if drawn is None or tick - drawn[0] > oldest:
            drawn = (tick, channel.next())
            self._drawn[sensor] = drawn
        return drawn[1]

    def inertial(self) -> tuple[Sample, Sample]:
        """Gyro (rad/s) and accelerometer (m/s^2), body axes."""
        s = self.simulation
        (p, q, r), (x, y, z) = s.dynamics.imu(s.state, s.targets, s.disturbance)
        noise = self._noise("gyro", True)
        error = self._noise("accelerometer", True)
        return (
            [p + noise[0], q + noise[1], r + noise[2]],
            [x + error[0], y + error[1], z + error[2]],
        )

    def attitude(self, fresh: bool = True) -> Sample:
        """Roll, pitch and yaw, rad."""
        a, b, c, d = self.simulation.state.quaternion
        noise = self._noise("attitude", fresh)
        roll = math.atan2(2.0 * (a * b + c * d), 1.0 - 2.0 * (b * b + c * c))
        pitch = math.asin(max(-1.0, min(1.0, 2.0 * (a * c - d * b))))
        yaw = math.atan2(2.0 * (a * d + b * c), 1.0 - 2.0 * (c * c + d * d))
        return [roll + noise[0], pitch + noise[1], wrap(yaw + noise[2])]

    def rates(self) -> Sample:
        """Body rates as the attitude filter has them: the gyro with its last error, rad/s."""
        p, q, r = self.simulation.state.rates
        noise = self._noise("gyro", False)
        return [p + noise[0], q + noise[1], r + noise[2]]

    def rotor_speeds(self) -> Sample:
        """Measured rotor speeds, rad/s, never below zero."""
        noise = self._noise("rotor", True)
        return [
            max(0.0, speed + n)
            for speed, n in zip(self.simulation.state.speeds, noise, strict=True)
        ]

    def velocity(self, fresh: bool = True) -> Sample:
        """Velocity, NED, m/s."""
        noise = self._noise("velocity", fresh)
        return [v + n for v, n in zip(self.simulation.state.velocity, noise, strict=True)]

    def commands(self) -> Sample:
        """Commands u of the rotors, 0..1."""
        vehicle = self.simulation.vehicle
        return [float(vehicle.command_of(target)) for target in self.simulation.targets]


def wrap(angle: float) -> float:
    """The angle within -pi..pi."""
    return math.remainder(angle, 2.0 * math.pi)


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
