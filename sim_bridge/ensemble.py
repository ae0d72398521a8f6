"""Many flights at once, as arrays: for Monte Carlo studies.

The physics is the same code as for one vehicle, run on arrays of shape (N,). Vehicles of an
ensemble fly one mission in the same weather; each has its own parameters. Noise does not act on
the flight (the controller knows the true state), so a study over seeds alone flies once and adds
noise many times.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_bridge.instruments import quaternion_of_arrays
from sim_bridge.missions import Mission
from sim_bridge.physics import IDEAL, Physics
from sim_bridge.sensors import make_channels
from sim_bridge.simulated_vehicle import Vehicle
from sim_bridge.simulation import Change, Simulation

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Flight:
    """Samples of N flights at K instants.

    Attributes:
        t: (K,) s after the start.
        gyro: (N, K, 3) body rates, rad/s.
        specific_force: (N, K, 3) accelerometer, m/s^2.
        quaternion: (N, K, 4) body to world, w, x, y, z.
        speeds: (N, K, n) rotor speeds, rad/s, in motor order.
        commands: (N, K, n) commands u, 0..1.
        velocity: (N, K, 3) NED, m/s.
        voltage: (N, K) of the battery, V.
    """

    t: Array
    gyro: Array
    specific_force: Array
    quaternion: Array
    speeds: Array
    commands: Array
    velocity: Array
    voltage: Array

    @property
    def count(self) -> int:
        """N."""
        return len(self.gyro)

    @property
    def interval(self) -> float:
        """Seconds between samples."""
        return float(self.t[1] - self.t[0])

    def repeated(self, count: int) -> "Flight":
        """A single flight as an ensemble of `count` equal ones, to put noise on (no copy)."""
        fields = {
            name: np.broadcast_to(values, (count, *values.shape[1:]))
            for name, values in vars(self).items()
            if name != "t"
        }
        return replace(self, **fields)

    def with_noise(self, model: str, sigma: float, seeds: Sequence[int]) -> "Flight":
        """The same flights as sensors with noise see them.

        A seed gives here the very noise that `sim-bridge --seed` puts into its messages, where
        all sensors are read at the same rate (up to 50 Hz; above that the messages carry attitude
        and velocity at lower rates, with noise drawn at those).

        Args:
            model: one of `NOISE_MODELS`.
            sigma: of the models that take one.
            seeds: N of them.

        Raises:
            ValueError: the number of seeds is not N.
        """
        if len(seeds) != self.count:
            raise ValueError(f"{self.count} flights need as many seeds, got {len(seeds)}")
        samples, rotors = self.speeds.shape[1:]
        dt = self.interval
        intervals = dict.fromkeys(("gyro", "accelerometer", "attitude", "rotor", "velocity"), dt)
        drawn: dict[str, list[Array]] = {sensor: [] for sensor in intervals}
        for seed in seeds:
            _, own = np.random.SeedSequence(seed).spawn(2)
            for sensor, channel in make_channels(model, sigma, intervals, rotors, own).items():
                drawn[sensor].append(channel.block(samples))
        noise = {sensor: np.stack(blocks) for sensor, blocks in drawn.items()}
        return replace(
            self,
            gyro=self.gyro + noise["gyro"],
            specific_force=self.specific_force + noise["accelerometer"],
            quaternion=quaternion_of_arrays(self.angles() + noise["attitude"]),
            speeds=np.maximum(self.speeds + noise["rotor"], 0.0),
            velocity=self.velocity + noise["velocity"],
        )

    def angles(self) -> Array:
        """(N, K, 3) roll, pitch and yaw, rad."""
        a, b, c, d = np.moveaxis(self.quaternion, -1, 0)
        return np.stack(
            [
                np.arctan2(2.0 * (a * b + c * d), 1.0 - 2.0 * (b * b + c * c)),
                np.arcsin(np.clip(2.0 * (a * c - d * b), -1.0, 1.0)),
                np.arctan2(2.0 * (a * d + b * c), 1.0 - 2.0 * (c * c + d * d)),
            ],
            axis=-1,
        )


def fly_ensemble(
    vehicle: Vehicle,
    mission: Mission,
    rate: float,
    duration: float | None = None,
    seed: int = 0,
    turbulence: float | None = None,
    changes: Sequence[Change] = (),
    physics: Physics = IDEAL,
) -> Flight:
    """Fly the mission with every vehicle and sample without noise.

    Args:
        vehicle: one vehicle, or an ensemble (see `stack_vehicles`).
        mission: what to fly.
        rate: samples a second; they fall on the 1 kHz grid of the physics.
        duration: s; None for the mission's own.
        seed: of the turbulence.
        turbulence: rate wobble in rad/s rms; None for the mission's own.
        changes: of the vehicles in flight.
        physics: what is switched on; gusts and random forces are the same for all.
    """
    gusts, _ = np.random.SeedSequence(seed).spawn(2)
    sim = Simulation(vehicle, mission, gusts, turbulence, changes, physics=physics)
    several = np.shape(vehicle.mass)
    steps = round((mission.duration if duration is None else duration) * 1000.0)
    count = int(np.floor(steps * rate / 1000.0 + 1e-9)) + 1
    # The instants at which a stream of messages of this rate falls due.
    due = np.ceil(np.arange(count) * 1000.0 / rate - 5e-4).astype(int)
    due = due[due <= steps]
    wanted = set(due.tolist())
    n = len(vehicle.rotors)
    rows: list[list[Any]] = []
    for tick in range(int(due[-1]) + 1):
        if tick:
            sim.step()
        if tick not in wanted:
            continue
        gyro, force = sim.imu()
        commands = [sim.vehicle.command_of(target) for target in sim.targets]
        values = [
            *gyro,
            *force,
            *sim.state.quaternion,
            *sim.state.velocity,
            *sim.state.speeds,
            *commands,
            sim.voltage,
        ]
        rows.append([np.broadcast_to(value, several) for value in values] if several else values)
    table = np.array(rows, dtype=float)
    table = np.moveaxis(table, -1, 0) if several else table[None]
    parts = np.split(table, np.cumsum([3, 3, 4, 3, n, n]), axis=-1)
    gyro_, force_, quaternion, velocity, speeds, commands_, voltage = parts
    return Flight(
        due * 1e-3, gyro_, force_, quaternion, speeds, commands_, velocity, voltage[..., 0]
    )
