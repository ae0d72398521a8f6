"""What the autopilot measures: the simulated truth with sensor noise, sampled on demand.

A sensor's error is drawn once an instant, so that messages of one instant agree. Messages that
only repeat what another has measured ask for the last error (`fresh=False`) and so do not move
the random sequence.
"""

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from sim_bridge.autopilot import VehicleClock
from sim_bridge.fault_injection import FaultInjector
from sim_bridge.sensors import Channel
from sim_bridge.simulation import Simulation

Sample = list[float]

GROUND_NOISE = 0.15
"""Noise of gyro and accelerometer at rest, of that in flight: nothing shakes them."""


class Instruments:
    """Noisy readings of one simulated vehicle.

    Attributes:
        simulation: what is measured.
        clock: the vehicle's.
        faults: what spoils the readings.
    """

    def __init__(
        self,
        simulation: Simulation,
        channels: dict[str, Channel],
        clock: VehicleClock,
        faults: FaultInjector,
    ) -> None:
        self.simulation = simulation
        self.clock = clock
        self.faults = faults
        self._channels = channels
        self._drawn: dict[str, tuple[int, Sample]] = {}
        sensor_faults = faults.sensor_faults
        self._imu_age = round(sensor_faults.imu_late / simulation.step_size)
        self._rotor_age = round(sensor_faults.rotor_late / simulation.step_size)
        self._attitude_age = round(sensor_faults.attitude_late / simulation.step_size)
        self._averaged = round(sensor_faults.gyro_average / simulation.step_size)
        # One element a physics step, the newest last; empty unless something looks back.
        self._inertial: deque[tuple[Sample, Sample]] = deque(
            maxlen=self._imu_age + self._averaged + 1
        )
        self._rotors: deque[tuple[Sample, Sample]] = deque(maxlen=self._rotor_age + 1)
        self._attitudes: deque[Sample] = deque(maxlen=self._attitude_age + 1)

        self._looks_back = bool(
            self._imu_age or self._averaged or self._rotor_age or self._attitude_age
        )

    @property
    def imu_age(self) -> float:
        """S by which the gyro is older than its stamp."""
        return (self._imu_age + 0.5 * self._averaged) * self.simulation.step_size

    @property
    def rotor_age(self) -> float:
        """S by which rotor speeds are older than their stamp."""
        return self._rotor_age * self.simulation.step_size

    def advance(self) -> None:
        """Take note of this physics step; call it at every one."""
        if self.faults.spoils:
            self.faults.now = self.simulation.time
        if not self._looks_back:
            return
        if self._imu_age or self._averaged:
            self._inertial.append(self.simulation.imu())
        if self._rotor_age:
            s = self.simulation
            self._rotors.append((s.state.speeds, s.targets))
        if self._attitude_age:
            self._attitudes.append(self.simulation.state.quaternion)

    @property
    def now_us(self) -> int:
        """The vehicle's clock, us since it was switched on."""
        return self.clock.at(self.simulation.tick)

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
        drawn = self._drawn.get(sensor)
        if drawn is not None:
            age = tick - drawn[0]
            if age == 0:
                return drawn[1]
            interval = self._channels[sensor].interval
            if not fresh and age <= 2.0 * interval / self.simulation.step_size:
                return drawn[1]
        sample = self._channels[sensor].next()
        self._drawn[sensor] = tick, sample
        return sample

    def inertial(self) -> tuple[Sample, Sample]:
        """Gyro (rad/s) and accelerometer (m/s^2), body axes."""
        return self.faults.inertial(*self._with_noise(*self._true_inertial()))

    def _true_inertial(self) -> tuple[Sample, Sample]:
        """As perfect sensors that may be late and may average have it."""
        past = self._inertial
        if not past:
            return self.simulation.imu()
        last = max(0, len(past) - 1 - self._imu_age)
        if not self._averaged:
            return past[last]
        first = max(0, last - self._averaged)
        if first == last:
            return past[last]
        # The mean over the interval by the trapezium rule.
        weights = [1.0] * (last - first + 1)
        weights[0] = weights[-1] = 0.5
        scale = 1.0 / (last - first)
        gyro, accelerometer = [0.0] * 3, [0.0] * 3
        for i, weight in zip(range(first, last + 1), weights, strict=True):
            w, f = past[i]
            for k in range(3):
                gyro[k] += scale * weight * w[k]
                accelerometer[k] += scale * weight * f[k]
        return gyro, accelerometer

    def _with_noise(self, gyro: Sample, accelerometer: Sample) -> tuple[Sample, Sample]:
        p, q, r = gyro
        x, y, z = accelerometer
        noise = self._noise("gyro", True)
        error = self._noise("accelerometer", True)
        if self.simulation.grounded:
            noise = [GROUND_NOISE * n for n in noise]
            error = [GROUND_NOISE * n for n in error]
        return (
            [p + noise[0], q + noise[1], r + noise[2]],
            [x + error[0], y + error[1], z + error[2]],
        )

    def attitude(self, fresh: bool = True) -> Sample:
        """Roll, pitch and yaw, rad."""
        late = self._attitudes
        a, b, c, d = late[0] if late else self.simulation.state.quaternion
        noise = self._noise("attitude", fresh)
        roll = math.atan2(2.0 * (a * b + c * d), 1.0 - 2.0 * (b * b + c * c))
        pitch = math.asin(max(-1.0, min(1.0, 2.0 * (a * c - d * b))))
        yaw = math.atan2(2.0 * (a * d + b * c), 1.0 - 2.0 * (c * c + d * d))
        angles = [roll + noise[0], pitch + noise[1], wrap(yaw + noise[2])]
        return self.faults.angles(angles) if fresh else angles

    def rates(self) -> Sample:
        """Body rates as the attitude filter has them: the gyro with its last error, rad/s."""
        p, q, r = self.simulation.rates()
        noise = self._noise("gyro", False)
        return [p + noise[0], q + noise[1], r + noise[2]]

    def rotor_speeds(self) -> Sample:
        """Measured rotor speeds, rad/s, never below zero."""
        speeds, targets = self._rotor_state()
        if self.faults.sensor_faults.rpm_command:
            return list(targets)
        noise = self._noise("rotor", True)
        noisy = [speed + n for speed, n in zip(speeds, noise, strict=True)]
        return noisy if min(noisy) > 0.0 else [max(0.0, speed) for speed in noisy]

    def _rotor_state(self) -> tuple[Sample, Sample]:
        """Rotor speeds and their targets, rad/s, as old as they reach the messages."""
        if self._rotors:
            return self._rotors[0]
        return self.simulation.state.speeds, self.simulation.targets

    def velocity(self, fresh: bool = True) -> Sample:
        """Velocity, NED, m/s."""
        noise = self._noise("velocity", fresh)
        return [v + n for v, n in zip(self.simulation.state.velocity, noise, strict=True)]

    def commands(self) -> Sample:
        """Commands u of the rotors, 0..1."""
        command_of = self.simulation.vehicle.command_of
        return [float(command_of(target)) for target in self._rotor_state()[1]]


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
