"""Flights of the article's vehicle, and what its sensors make of them."""

from dataclasses import fields
from functools import lru_cache

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.signals.complementary import ComplementaryFilter
from gcs_sysid.signals.records import Samples
from sim_bridge.ensemble import Flight, fly_ensemble
from sim_bridge.missions import MISSIONS
from sim_bridge.simulation import Change
from sim_bridge.vehicle_files import load_vehicle
from testbed.article import NAMES

VEHICLE = load_vehicle("paper")
GEOMETRY = load_airframe("paper").geometry
ARM = load_airframe("paper").arm
TRUTH = np.array([getattr(VEHICLE, name) for name in NAMES])
EXCITED_FROM = 2.0
"""s; the missions hover until then."""

PHYSICS_RATE = 1000.0
"""Hz."""
RPM = 2.0 * np.pi / 60.0
"""rad/s; ESC_STATUS carries whole ones."""


@lru_cache(maxsize=32)
def fly(
    mission: str,
    rate: float,
    seconds: float | None = None,
    changes: tuple[Change, ...] = (),
) -> Flight:
    """One flight without noise."""
    if rate == PHYSICS_RATE or seconds is not None or changes:
        return fly_ensemble(VEHICLE, MISSIONS[mission], rate, seconds, changes=changes)
    return fly_late(mission, rate, 0.0)


@lru_cache(maxsize=16)
def fly_late(mission: str, rate: float, delay: float) -> Flight:
    """The same with rotor speeds that are `delay` s (whole milliseconds) old when stamped."""
    fine = fly(mission, PHYSICS_RATE)  # flown once for all rates
    at = np.arange(0, len(fine.t), round(PHYSICS_RATE / rate))
    taken = {
        f.name: getattr(fine, f.name)[:, at]
        for f in fields(Flight)
        if f.name not in ("t", "speeds")
    }
    before = np.maximum(at - round(PHYSICS_RATE * delay), 0)  # the vehicle hovers before the start
    return Flight(t=fine.t[at], speeds=fine.speeds[:, before], **taken)


def measure(
    flight: Flight,
    noise: str,
    sigma: float,
    seed: int,
    *,
    rounded: bool = True,
    vibration: float = 0.0,
) -> Samples:
    """The flight as the program's chain sees it.

    Args:
        flight: one flight.
        noise: model, see `sim_bridge.sensors`.
        sigma: of the models that take one.
        seed: of the noise.
        rounded: rotor speeds in whole rpm, as telemetered; otherwise as they are.
        vibration: rad/s, amplitude that each rotor's imbalance puts on each axis of the gyro, at
            the frequency it turns with.
    """
    dt = flight.interval
    noisy = flight.with_noise(noise, sigma, [seed])
    gyro, speeds = noisy.gyro[0], noisy.speeds[0]
    if vibration:
        gyro = gyro + vibration * _imbalance(flight.speeds[0], dt, seed)
    if rounded:
        # Noise does not act on the flight, so without it all seeds, and all turns of a pattern that
        # is flown again, would share one rounding, and a study would show that one outcome. In a
        # flight the gyro's noise reaches the rotors: any rate loop turns the article's into more
        # than 1 rpm from sample to sample. An offset of each rotor's counter, a fraction of a
        # revolution per minute and another at each sample, makes roundings as different.
        offset = np.random.default_rng([seed, 0x4F5]).uniform(-0.5, 0.5, speeds.shape)
        speeds = (np.round(speeds / RPM + offset) - offset) * RPM
    complementary = ComplementaryFilter(dt)
    attitude = complementary.update(gyro, noisy.quaternion[0])
    return Samples(
        gyro=gyro,
        rates=gyro - complementary.biases,
        speeds=speeds,
        attitude=attitude,
        force=noisy.specific_force[0],
        velocity=noisy.velocity[0],
    )


def exact(flight: Flight) -> Samples:
    """The flight as it is."""
    return Samples(
        gyro=flight.gyro[0],
        rates=flight.gyro[0],
        speeds=flight.speeds[0],
        attitude=flight.quaternion[0],
        force=flight.specific_force[0],
        velocity=flight.velocity[0],
    )


def _imbalance(speeds: Array, dt: float, seed: int) -> Array:
    """(n, 3) sum over the rotors of a sine of each rotor's angle, at any phase."""
    random = np.random.default_rng([seed, 0x71B])
    phases = random.uniform(0.0, 2.0 * np.pi, (speeds.shape[1], 3))
    turned = np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * dt, axis=0)
    angle = np.vstack([np.zeros(speeds.shape[1]), turned])
    shaken: Array = np.sin(angle[:, :, None] + phases).sum(axis=1)
    return shaken
