"""What a maneuver asks of a vehicle, and the information that it adds, before it is flown.

What a swing adds is counted frequency by frequency (Whittle's likelihood): with s_j(f) what the
j-th unknown changes of the angular acceleration and S(f) the spectral density of what disturbs it,

    information = seconds * sum_f Re s_j(f)^* S(f)^-1 s_k(f)

A period has a few tens of frequencies, so that a library of maneuvers costs milliseconds; no
flight is simulated. The estimator's filters pass over both sides alike, so they are not in it.

Before a flight, vehicle and sensors are what is usual for the airframe's size and mass.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.coach.manoeuvre_library import Manoeuvre
from gcs_sysid.estimation.fit.priors import COORDINATE_STD, N_UNKNOWNS, Unknown
from gcs_sysid.estimation.rows.actuator_dynamics import N_COORDINATES, ROTOR_COLUMNS
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.parameters import GRAVITY, REGISTRY
from gcs_sysid.model.rotor_input import RotorInput

_POINTS = 96
"""In a period; the fastest products of the fastest pace take eight of them."""
_LEAST_THRUST = 0.15
"""Of the mean hover thrust of a rotor: what each has to keep."""
_MOST_THRUST = 2.0
"""The same, what each may give where the greatest thrust is not known."""
_SHRUNK = (1.0, 0.7, 0.5, 0.35, 0.25)
"""Swings that are tried where the rotors cannot give a whole one."""
_SLOWEST = 0.5
"""Hz; lower frequencies carry no more information than this one: biases and gusts wander."""
_EFFICIENCY = 0.75
"""Information that the online estimator's intervals show over what there is: it weighs all
frequencies alike, and never claims less scatter than white residuals have (measured on flights of
the emulator)."""


@dataclass(frozen=True)
class Craft:
    """What is known, or assumed, of the vehicle.

    Attributes:
        geometry: (3, rotors) x, y, spin.
        theta: (N_THETA,) see `rigid_body.THETA`.
        thrust: sum of the rotors' Omega^2 in hover; of T / T_max with commands.
        rotor_input: what drives it.
        most: greatest thrust of a rotor over its mean hover share; None: not known.
        curve: thrust curve with commands, see `estimation.rows.actuator_dynamics`.
    """

    geometry: Array
    theta: Array
    thrust: float
    rotor_input: RotorInput = RotorInput.SPEED
    most: float | None = None
    curve: float = 1.0

    @property
    def mean_share(self) -> float:
        """Thrust of a rotor in hover, on average, in units of `thrust`."""
        return self.thrust / float(self.geometry.shape[1])


@dataclass(frozen=True)
class Motion:
    """One period of a maneuver at full swing.

    Attributes:
        signals: (n, N_SIGNALS) of the forward form.
        rates: (n, 3) body rates, rad/s.
        shares: (n, rotors) thrust of each, in units of `Craft.thrust`.
        period: s.
    """

    signals: Array
    rates: Array
    shares: Array
    period: float


def within_reach(manoeuvre: Manoeuvre, craft: Craft) -> tuple[Manoeuvre, Motion] | None:
    """The maneuver with no more swing than the rotors can give, and its motion.

    Yaw is given up first, as rotors have least to turn it with. None: not even a small one.
    """
    for smaller in _SHRUNK:
        tilted = replace(
            manoeuvre,
            roll=_whole(smaller * manoeuvre.roll),
            pitch=_whole(smaller * manoeuvre.pitch),
            climb=smaller * manoeuvre.climb,
        )
        for weaker in _SHRUNK if manoeuvre.yaw else (1.0,):
            tried = replace(tilted, yaw=_whole(weaker * manoeuvre.yaw))
            if not tried.can_be_seen:
                break
            motion = motion_of(tried, craft)
            if _is_within(motion.shares, craft):
                return tried, motion
    return None


def _whole(angle: float) -> float:
    """rad, in whole steps of a degree."""
    return math.radians(round(math.degrees(angle)))


def _is_within(shares: Array, craft: Craft) -> bool:
    most = _MOST_THRUST if craft.most is None else 0.9 * craft.most
    return bool(
        shares.min() >= _LEAST_THRUST * craft.mean_share and shares.max() <= most * craft.mean_share
    )


def motion_of(manoeuvre: Manoeuvre, craft: Craft) -> Motion:
    """The motion that the maneuver is, and the rotors' part in it."""
    paces = [manoeuvre.pace] if not manoeuvre.yaw else [manoeuvre.pace, manoeuvre.yaw_pace]
    period = 1.0 / min(paces)
    t = np.arange(_POINTS) * (period / _POINTS)
    angles = manoeuvre.angles(t).T
    roll, pitch = angles[:2]
    roll_rate, pitch_rate, yaw_rate, _ = (_derivative(a, period) for a in angles)
    up = _derivative(_derivative(angles[3], period), period)
    rates = np.stack(
        [
            roll_rate - yaw_rate * np.sin(pitch),
            pitch_rate * np.cos(roll) + yaw_rate * np.cos(pitch) * np.sin(roll),
            yaw_rate * np.cos(pitch) * np.cos(roll) - pitch_rate * np.sin(roll),
        ],
        axis=1,
    )
    turning = np.stack([_derivative(w, period) for w in rates.T], axis=1)
    thrust = craft.thrust * (1.0 + up / GRAVITY) / (np.cos(roll) * np.cos(pitch))
    x = np.zeros((_POINTS, rb.N_SIGNALS))
    x[:, rb.OF_RATES] = rb.rate_signals(rates)
    x[:, 2] = thrust
    # What the rotors have to give on top of what these signals do by themselves.
    theta = craft.theta.copy()
    theta[rb.ROTOR_INERTIA] = 0.0
    J = rb.inertia_matrix(theta)
    left = turning @ J.T - x @ (J @ rb.forward_matrix(theta)).T
    x[:, 0], x[:, 1] = left[:, 0], left[:, 1]
    x[:, 3] = left[:, 2] / theta[rb.MOMENT_RATIO]
    shares = x[:, :4] @ np.linalg.pinv(rb.mixer(craft.geometry))
    speeds = np.sqrt(np.maximum(shares, 0.0))
    H = (shares if craft.rotor_input.motors else speeds) @ craft.geometry[2]
    x[:, -3:-1] = rates[:, 1::-1] * H[:, None]  # q H, p H
    x[:, -1] = _derivative(H, period)
    return Motion(x, rates, shares, period)


def _derivative(signal: Array, period: float) -> Array:
    """Of a periodic signal, exactly up to half the points' frequency."""
    spectrum = np.fft.rfft(signal)
    spectrum *= 2j * np.pi / period * np.arange(len(spectrum))
    derived: Array = np.fft.irfft(spectrum, len(signal))
    return derived


@dataclass(frozen=True)
class Noise:
    """What disturbs the angular acceleration: two-sided spectral densities.

    Attributes:
        gyro: (3, 3) of the gyro, rad^2/s; grows with frequency squared in the acceleration.
        torque: (3, 3) of the acceleration itself, rad^2/s^3: rotor speeds, gusts.
    """

    gyro: Array
    torque: Array

    def at(self, omega: Array) -> Array:
        """(n, 3, 3) of the angular acceleration at (n,) rad/s."""
        slowest = 2.0 * np.pi * _SLOWEST
        density: Array = (omega**2 + slowest**2)[:, None, None] * self.gyro + self.torque
        # No sensor is perfect, but an emulated one may be.
        density = density + 1e-12 * np.eye(3)
        return density


def speed_noise(craft: Craft, std: Array, dt: float) -> Array:
    """(3, 3) `Noise.torque` of white noise of the rotors' inputs.

    Args:
        craft: in hover.
        std: (rotors,) of one sample: rad/s, or 1 for commands.
        dt: s between samples.
    """
    slope = np.ones_like(std) if craft.rotor_input.motors else 2.0 * np.sqrt(craft.mean_share)
    forward = rb.forward_matrix(craft.theta)[:, :4] @ rb.mixer(craft.geometry).T
    scaled = forward * (slope * std)
    density: Array = dt * scaled @ scaled.T
    return density


def information(motion: Motion, craft: Craft, noise: Noise, lag: float = 0.0) -> Array:
    """(N_UNKNOWNS, N_UNKNOWNS) that each second of a motion at full swing adds.

    Args:
        motion: of the maneuver.
        craft: it is flown with.
        noise: what disturbs.
        lag: s, of the motors, where commands are the input.
    """
    n = len(motion.signals)
    spectrum = np.fft.rfft(motion.signals, axis=0).T / n
    omega = 2.0 * np.pi / motion.period * np.arange(spectrum.shape[1])
    Q, G = rb.forward_jacobian(craft.theta)
    changes = np.zeros((N_UNKNOWNS, 3, len(omega)), dtype=complex)
    changes[: rb.N_THETA] = G @ spectrum
    rotors = list(ROTOR_COLUMNS)
    driven = Q[:, rotors] @ spectrum[rotors]
    changes[Unknown.DELAY] = 1j * omega * driven
    if craft.rotor_input.motors:
        changes[Unknown.LAG] = -1j * omega / (1.0 + 1j * omega * lag) * driven
        changes[Unknown.CURVE] = Q[:, :4] @ np.fft.rfft(_bent(motion, craft), axis=0).T / n
    assert len(changes) == rb.N_THETA + N_COORDINATES
    weight = np.linalg.inv(noise.at(omega))
    # All but the constant (and the fastest) stand for a negative frequency as well.
    twice = np.full(len(omega), 2.0)
    twice[0] = 1.0
    weighted = np.einsum("fab,jbf->jaf", weight, changes) * twice
    total: Array = _EFFICIENCY * np.einsum("jaf,kaf->jk", changes.conj(), weighted).real
    return total


def _bent(motion: Motion, craft: Craft) -> Array:
    """(n, 4) what the thrust curve changes of the rotors' signals: w^2 - w."""
    w = np.clip(motion.shares, 0.0, 1.0)
    bent: Array = (w * w - w) @ rb.mixer(craft.geometry)
    return bent


@dataclass(frozen=True)
class UsualVehicle:
    """What is expected of a vehicle of which little is known.

    Attributes:
        gyration: radius of gyration in roll and pitch over the arm; 0.54 to 0.57 of a Crazyflie,
            an Iris and the default vehicle of PX4's SIH.
        hover_speed: rad/s, of the rotors, where k_T is not known.
        hover_command: thrust in hover over the greatest, where T_max is not known.
        acceleration_density: rad^2/s^3: with commands, motion of the motors that their commands
            do not explain.
    """

    gyration: float = 0.55
    hover_speed: float = 500.0
    hover_command: float = 0.4
    acceleration_density: float = 3e-4


USUAL = UsualVehicle()

GYRO_DENSITY = 0.01 * np.pi / 180.0
"""rad/s per root hertz, one-sided: a usual MEMS gyro in flight."""
SPEED_STD = 0.5
"""rad/s, of one sample of a rotor's speed."""
RATE = 250.0
"""Hz, of IMU and rotors."""


class PriorVehicle(NamedTuple):
    """A vehicle of its size and mass, with wide margins.

    Attributes:
        craft: for predictions.
        std: (N_UNKNOWNS,) of theta and of delay, lag and curve.
        kappa: thrust over mass, k_T / m or T_max / m.
    """

    craft: Craft
    std: Array
    kappa: float

    def at(self, kappa: float) -> "PriorVehicle":
        """The same vehicle where flight determines its thrust over mass."""
        factor = np.full(rb.N_THETA, self.kappa / kappa)
        factor[~rb.RELATIVE] = 1.0
        craft = replace(self.craft, theta=factor * self.craft.theta, thrust=GRAVITY / kappa)
        std = np.concatenate([factor * self.std[: rb.N_THETA], self.std[rb.N_THETA :]])
        return PriorVehicle(craft, std, kappa)


def prior_vehicle(airframe: Airframe, rotor_input: RotorInput = RotorInput.SPEED) -> PriorVehicle:
    """The vehicle that an airframe file lets one expect; its priors replace rules of thumb."""
    rotors, arm = len(airframe.rotors), airframe.arm
    known = {name: value for name, (value, _) in airframe.priors.items()}
    mass = airframe.mass or known.get("mass") or 1.0
    weight = mass * GRAVITY
    load = USUAL.hover_command if rotor_input.motors else USUAL.hover_speed**2
    thrust = (
        getattr(airframe, rotor_input.thrust)
        or known.get(rotor_input.thrust)
        or weight / (rotors * load)
    )
    around = mass * (USUAL.gyration * arm) ** 2
    usual = np.array([REGISTRY[name].usual for name in rb.THETA])
    theta, std = np.where(rb.RELATIVE, around / thrust, arm) * usual.T
    for name, value in known.items():
        parameter = REGISTRY[name]
        if parameter.theta:
            relative = parameter.scale == "thrust"
            theta[rb.THETA.index(parameter.theta)] = value / (thrust if relative else 1.0)
    most = None if airframe.T_max is None else airframe.T_max * rotors / weight
    craft = Craft(airframe.geometry, theta, weight / thrust, rotor_input, most)
    coordinates = COORDINATE_STD.copy()
    return PriorVehicle(craft, np.concatenate([std, coordinates]), thrust / mass)


def prior_noise(craft: Craft) -> Noise:
    """Of usual sensors: see GYRO_DENSITY, SPEED_STD and RATE."""
    gyro = 0.5 * GYRO_DENSITY**2 * np.eye(3)
    if craft.rotor_input.motors:
        return Noise(gyro, USUAL.acceleration_density * np.eye(3))
    std = np.full(craft.geometry.shape[1], SPEED_STD)
    return Noise(gyro, speed_noise(craft, std, 1.0 / RATE))
