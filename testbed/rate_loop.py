"""Flights of one vehicle under a rate loop that answers moments from outside, as samples.

A moment d that acts on the body from outside (gusts, blade flapping, a swinging battery) is
answered by the rate loop, so that the rotors' torque is correlated with it. The vehicle is the
article's with a CG offset of a centimeter: rigid body, motors of 30 ms, a PI rate loop with a
lagged derivative term that runs on the noisy gyro at 1 kHz. Flights are integrated side by side.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.parameters import GRAVITY, INERTIA
from gcs_sysid.signals.records import Samples

STEP = 1e-3
"""s, of the loop and of the integration."""
GYRO_STD = 0.01 * np.pi / 180.0 * np.sqrt(0.5 / STEP)
"""rad/s of a sample: MEMS, 0.01 deg/s per root Hz up to half the loop's rate."""
SPEED_STD = 0.5
"""rad/s of a telemetered rotor speed."""
FORCE_STD = 0.05
"""m/s^2 of a sample of the accelerometer."""


@dataclass(frozen=True)
class Vehicle:
    """The vehicle flown; SI units throughout.

    Attributes:
        mass: kg.
        inertia: Ixx, Iyy, Izz, Ixy, Iyz, Ixz, kg m^2.
        cg: x, y of the CG from the geometric center, m.
        k_T, k_M: N s^2, N m s^2.
        arms: (3, rotors) as of `Airframe.geometry`.
        motor_lag: s.
        gains: P (1/s), I (1/s^2) and D (1) of the rate loop, on angular acceleration.
    """

    mass: float = 1.5
    inertia: tuple[float, ...] = (0.0165, 0.0167, 0.0294, 0.00035, 0.00054, -0.00046)
    cg: tuple[float, float] = (0.01, -0.005)
    k_T: float = 2.05e-4
    k_M: float = 6.14e-6
    arms: tuple[tuple[float, ...], ...] = (
        (0.25, -0.25, 0.25, -0.25),
        (0.25, -0.25, -0.25, 0.25),
        (1.0, 1.0, -1.0, -1.0),
    )
    motor_lag: float = 0.03
    gains: tuple[float, float, float] = (18.0, 40.0, 0.35)

    @property
    def geometry(self) -> Array:
        """(3, rotors)"""
        return np.array(self.arms)

    @property
    def theta(self) -> Array:
        """(N_THETA,) relative to k_T, see `rigid_body.THETA`."""
        known = [*self.inertia, *self.cg, self.k_M / self.k_T]
        names = (*INERTIA, "cg_x", "cg_y", "moment_ratio")
        return rb.theta_of(dict(zip(names, known, strict=True)), self.k_T)


Excitation = Callable[[Array, int, np.random.Generator], Array]
"""(n,) s and a number of flights to (n, flights, 3) rad/s that are asked for."""


def doublets(t: Array, flights: int, rng: np.random.Generator) -> Array:
    """Rate doublets of 1.5 rad/s on one axis after the other, half a second either way."""
    wanted = np.zeros((len(t), flights, 3))
    shift = rng.uniform(0.0, 1.5, flights)
    late = t[:, None] + shift
    axis = (late // 1.5).astype(int) % 3
    phase = late % 1.5
    rate = np.where(phase < 0.5, 1.5, np.where(phase < 1.0, -1.5, 0.0))
    np.put_along_axis(wanted, axis[..., None], rate[..., None], axis=2)
    return wanted


def multisine(
    t: Array, flights: int, rng: np.random.Generator, rms: float, band: tuple[float, float]
) -> Array:
    """Nine sines an axis with random phases, all axes at once."""
    f = np.linspace(*band, 27).reshape(9, 3)
    phase = rng.uniform(0.0, 2.0 * np.pi, (9, flights, 3))
    sines = (np.sin(2.0 * np.pi * np.outer(t, f[k])[:, None] + phase[k]) for k in range(9))
    wanted: Array = rms * np.sqrt(2.0 / 9.0) * sum(sines, np.zeros((len(t), flights, 3)))
    return wanted


EXCITATIONS: dict[str, Excitation] = {
    "doublets": doublets,
    "gentle": partial(multisine, rms=0.25, band=(0.2, 1.2)),
    "aggressive": partial(multisine, rms=1.5, band=(0.3, 2.7)),
}


class Disturbance:
    """Angular acceleration that the loop has to answer, one axis independent of the other.

    Args:
        std: rad/s^2, of roll and pitch; yaw, with its longer arms and smaller faces, has a third.
        tau: s; of an Ornstein-Uhlenbeck process, or of the gusts.
        gusts: Dryden's lateral form, (1 + sqrt(3) tau s) / (1 + tau s)^2, behind 50 ms of the
            air's own inertia, in place of an Ornstein-Uhlenbeck process.
    """

    def __init__(self, std: float = 0.0, tau: float = 1.0, *, gusts: bool = False) -> None:
        self.std, self.tau, self.gusts = std, tau, gusts

    def of(self, steps: int, flights: int, rng: np.random.Generator) -> Array:
        """(steps, flights, 3) rad/s^2."""
        out = np.zeros((steps, flights, 3))
        if not self.std:
            return out
        a = np.exp(-STEP / self.tau)
        x, y = rng.standard_normal((2, flights, 3))
        lag = np.zeros((flights, 3))
        drive = np.sqrt(1.0 - a * a)
        for k in range(steps):
            x = a * x + drive * rng.standard_normal((flights, 3))
            if self.gusts:
                # (1 + sqrt3 tau s)/(1 + tau s)^2 = sqrt3/(1 + tau s) + (1 - sqrt3)/(1 + tau s)^2
                y = y + (1.0 - a) * (x - y)
                gust = np.sqrt(3.0) * x + (1.0 - np.sqrt(3.0)) * y
                lag += STEP / 0.05 * (gust - lag)
            out[k] = lag if self.gusts else x
        scale = np.sqrt((out * out).mean()) if self.gusts else 1.0
        shaped: Array = out * (self.std / scale) * np.array([1.0, 1.0, 0.3])
        return shaped


DISTURBANCES = {
    "none": Disturbance(),
    "ou1": Disturbance(1.0),
    "ou3.5": Disturbance(3.5),
    "ou7": Disturbance(7.0),
    "wind": Disturbance(4.0, 0.7, gusts=True),
}


def fly(
    vehicle: Vehicle,
    excitation: Excitation,
    disturbance: Disturbance,
    *,
    flights: int,
    seconds: float,
    rate: float,
    seed: int,
) -> list[Samples]:
    """Flights of one cell, side by side.

    Args:
        vehicle: that flies.
        excitation: asks for rates.
        disturbance: acts from outside.
        flights: how many.
        seconds: length of each.
        rate: Hz of the samples, a divisor of the loop's.
        seed: of everything random.
    """
    rng = np.random.default_rng(seed)
    steps, every = round(seconds / STEP), round(1.0 / (rate * STEP))
    t = np.arange(steps) * STEP
    wanted, d = excitation(t, flights, rng), disturbance.of(steps, flights, rng)
    gyro_noise = GYRO_STD * rng.standard_normal((steps, flights, 3))
    J = rb.inertia_matrix(np.array(vehicle.inertia))
    J_inv = np.linalg.inv(J)
    x, y, s = vehicle.geometry
    torque = np.stack(
        [
            vehicle.k_T * (vehicle.cg[1] - y),
            vehicle.k_T * (x - vehicle.cg[0]),
            vehicle.k_M * s,
            np.full(len(x), vehicle.k_T),
        ],
        axis=1,
    )  # (rotors, 4) roll, pitch, yaw moment and thrust of Omega^2
    share = np.linalg.pinv(torque)
    gain_p, gain_i, gain_d = vehicle.gains
    fade, half = np.exp(-STEP / vehicle.motor_lag), np.exp(-0.5 * STEP / vehicle.motor_lag)
    weight = vehicle.mass * GRAVITY
    w, total = np.zeros((2, flights, 3))
    Omega = np.sqrt(np.tile(np.array([0.0, 0.0, 0.0, weight]) @ share, (flights, 1)))
    slope, last = np.zeros((flights, 3)), np.zeros((flights, 3))
    lift = weight * (1.0 + 0.1 * np.sin(2.0 * np.pi * 0.4 * t))
    kept = np.empty((steps // every, flights, 3 + len(x)))
    asked_of = np.empty((flights, 4))
    moments, yzx, zxy = torque[:, :3], np.array([1, 2, 0]), np.array([2, 0, 1])
    for k in range(steps):
        gyro = w + gyro_noise[k]
        if k % every == 0:
            kept[k // every, :, :3], kept[k // every, :, 3:] = gyro, Omega
        # The derivative term looks through 8 ms of low-pass.
        slope += STEP / 0.008 * ((gyro - last) / STEP - slope)
        last = gyro
        off = wanted[k] - gyro
        total = total + STEP * off
        asked_of[:, :3] = (gain_p * off + gain_i * total - gain_d * slope) @ J
        asked_of[:, 3] = lift[k]
        command = np.sqrt(np.maximum(asked_of @ share, 400.0))
        middle = command + (Omega - command) * half

        def change(w: Array, speeds: Array, d: Array = d[k]) -> Array:
            momentum = w @ J
            # numpy.cross does the same, and would take half of the time.
            turning = w[:, yzx] * momentum[:, zxy] - w[:, zxy] * momentum[:, yzx]
            turned: Array = ((speeds * speeds) @ moments - turning) @ J_inv + d
            return turned

        w = w + STEP * change(w + 0.5 * STEP * change(w, Omega), middle)
        Omega = command + (Omega - command) * fade
    asked = wanted[::every][: steps // every]
    return [_samples(kept[:, i], asked[:, i], vehicle, rng) for i in range(flights)]


def _samples(kept: Array, asked: Array, vehicle: Vehicle, rng: np.random.Generator) -> Samples:
    """What is measured of (n, 3 + rotors) gyro and true rotor speeds, and (n, 3) setpoints."""
    gyro, Omega = kept[:, :3], kept[:, 3:]
    n = len(gyro)
    force = np.zeros((n, 3))
    force[:, 2] = -vehicle.k_T / vehicle.mass * (Omega * Omega).sum(axis=1)
    return Samples(
        gyro=gyro,
        rates=gyro,
        speeds=Omega + SPEED_STD * rng.standard_normal(Omega.shape),
        attitude=np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        force=force + FORCE_STD * rng.standard_normal((n, 3)),
        velocity=np.full((n, 3), np.nan),
        setpoint=asked,
    )
