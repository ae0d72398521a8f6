"""What a maneuver asks of a vehicle, and the information that it adds, before it is flown.

What a swing adds is counted frequency by frequency (Whittle's likelihood): with s_j(f) what the
j-th unknown changes of the angular acceleration and S(f) the spectral density of what disturbs it,

    information = seconds * sum_f Re s_j(f)^* S(f)^-1 s_k(f)

A period has a few tens of frequencies, so that a library of maneuvers costs milliseconds; no
flight is simulated. The estimator's filters pass over both sides alike, so they are not in it.

Before a flight, vehicle and sensors are what is usual for the airframe's size and mass.

What is known now and what would be known afterwards are both a `Fit`, so that expected intervals
pass through the very rules that intervals of a flight do: scale, Student's factor for few batches,
and the factor of one who looks all the time.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from gcs_sysid.arrays import Array
from gcs_sysid.coach.manoeuvre_library import Manoeuvre
from gcs_sysid.estimation.fit.deviations import AXIS_DAMPING, OF_AXES
from gcs_sysid.estimation.fit.priors import (
    COORDINATE_MEAN,
    COORDINATE_STD,
    COORDINATES,
    N_UNKNOWNS,
    Unknown,
)
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.translation import TranslationFit
from gcs_sysid.estimation.noise.uncertainty import bartlett
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.online.thrust_estimator import MIN_MOMENTUM_SECONDS
from gcs_sysid.estimation.rows.actuator_dynamics import ROTOR_COLUMNS, Coordinate
from gcs_sysid.judgement.status import RULES
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.parameters import GRAVITY, REGISTRY
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.significance import Z95

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
    """

    geometry: Array
    theta: Array
    thrust: float
    rotor_input: RotorInput = RotorInput.SPEED
    most: float | None = None

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
    return np.fft.irfft(spectrum, len(signal))


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
    return dt * scaled @ scaled.T


def information(motion: Motion, craft: Craft, noise: Noise, lag: float = 0.0) -> Array:
    """(N_UNKNOWNS, N_UNKNOWNS) that each second of a motion at full swing adds.

    How the axes' dampings differ is found too, and marginalized, as of each motion by itself.

    `lag` is s, of the motors, where commands are the input.
    """
    n = len(motion.signals)
    spectrum = np.fft.rfft(motion.signals, axis=0).T / n
    omega = 2.0 * np.pi / motion.period * np.arange(spectrum.shape[1])
    Q, G = rb.forward_jacobian(craft.theta, others=OF_AXES)
    changes = np.zeros((N_UNKNOWNS + len(OF_AXES), 3, len(omega)), dtype=complex)
    changes[: rb.N_THETA] = G[: rb.N_THETA] @ spectrum
    changes[N_UNKNOWNS:] = G[rb.N_THETA :] @ spectrum
    rotors = list(ROTOR_COLUMNS)
    driven = Q[:, rotors] @ spectrum[rotors]
    changes[Unknown.DELAY] = 1j * omega * driven
    if craft.rotor_input.motors:
        changes[Unknown.LAG] = -1j * omega / (1.0 + 1j * omega * lag) * driven
        changes[Unknown.CURVE] = Q[:, :4] @ np.fft.rfft(_bent(motion, craft), axis=0).T / n
    weight = np.linalg.inv(noise.at(omega))
    # All but the constant (and the fastest) stand for a negative frequency as well.
    twice = np.full(len(omega), 2.0)
    twice[0] = 1.0
    weighted = np.einsum("fab,jbf->jaf", weight, changes) * twice
    every = _EFFICIENCY * np.einsum("jaf,kaf->jk", changes.conj(), weighted).real
    own, cross = every[N_UNKNOWNS:, N_UNKNOWNS:], every[:N_UNKNOWNS, N_UNKNOWNS:]
    usual = (AXIS_DAMPING * craft.theta[rb.MOMENTS]) ** -2.0
    return every[:N_UNKNOWNS, :N_UNKNOWNS] - cross @ np.linalg.solve(own + np.diag(usual), cross.T)


def _bent(motion: Motion, craft: Craft) -> Array:
    """(n, 4) what the thrust curve changes of the rotors' signals: w^2 - w."""
    w = np.clip(motion.shares, 0.0, 1.0)
    return (w * w - w) @ rb.mixer(craft.geometry)


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


_OF_AXIS = tuple(
    [i for i, name in enumerate(rb.THETA) if axis in REGISTRY[name].axes] for axis in range(3)
)
"""Of theta: parameters that an axis' equation determines."""
_THRUST_SHARE = 1.2e-3
"""Relative standard deviation of k_T / m after MIN_MOMENTUM_SECONDS of flight: measured on flights
of the emulator; it falls with the square root of time."""
_FREEDOMS = np.concatenate([np.arange(1.0, 20.0, 0.25), np.geomspace(20.0, 1e4, 40)])
_FACTORS = stdtrit(_FREEDOMS, 0.975) / Z95
"""Falling: Student's factor at each number of degrees of freedom."""


@dataclass(frozen=True)
class PredictedInformation:
    """Information on a vehicle at one instant of its flight, or before it.

    Attributes:
        fit: of the flight; without a rotation while that has no information.
        craft: the best guess: the fit, as far as it is one, else what is assumed.
        noise: that maneuvers are flown in.
        information: (N_UNKNOWNS, N_UNKNOWNS) about theta and coordinates, of the flight and of
            what is assumed.
        freedom: (N_UNKNOWNS,) degrees of freedom of each one's standard deviation.
        coordinates: (3,) rotor delay, motor lag, thrust curve.
        free: (N_UNKNOWNS,) which unknowns are not given.
        kappa: thrust over mass, as far as it is known.
    """

    fit: Fit
    craft: Craft
    noise: Noise
    information: Array
    freedom: Array
    coordinates: Array
    free: Array
    kappa: float

    def after(self, added: Array | None = None, seconds: float = 0.0, full: float = 0.0) -> Fit:
        """What is expected to be known after a maneuver; of now without one.

        Args:
            added: (N_UNKNOWNS, N_UNKNOWNS) information of a second at full swing.
            seconds: from its start to its end.
            full: as many at full swing have as much information.
        """
        n = rb.N_THETA
        covariance, freedom = self._spread(added, full)
        widening = np.interp(freedom, _FREEDOMS, _FACTORS)
        covariance *= np.outer(widening, widening)
        rotation = RotationFit(
            theta=self.craft.theta,
            covariance=covariance[:n, :n],
            residual_covariance=np.eye(3),
            r_squared=np.ones(3),
            rows=1,
            converged=True,
            coordinates=self.coordinates,
            full_covariance=covariance,
        )
        flown = self.fit.seconds + seconds
        return Fit(
            rotation,
            self._translation(flown),
            flown,
            rigid_body_test=self.fit.rigid_body_test,
            running=True,
        )

    def then(self, added: Array, seconds: float, full: float) -> "PredictedInformation":
        """What is known once a maneuver has been flown as expected; arguments as of `after`."""
        after = self.after(added, seconds, full)
        fit = replace(after, translation=self.fit.translation, running=False)
        _, freedom = self._spread(added, full)
        return replace(self, fit=fit, information=self.information + full * added, freedom=freedom)

    def _spread(self, added: Array | None, full: float) -> tuple[Array, Array]:
        """(N_UNKNOWNS, N_UNKNOWNS) covariance without Student's factor, and its freedom."""
        free = self.free
        gained = np.zeros((N_UNKNOWNS, N_UNKNOWNS)) if added is None else full * added
        total = (self.information + gained)[np.ix_(free, free)]
        scale = np.sqrt(np.diag(total))
        inverse = np.linalg.inv(total / np.outer(scale, scale)) / np.outer(scale, scale)
        covariance = np.zeros_like(self.information)
        covariance[np.ix_(free, free)] = inverse
        # Satterthwaite again: of what is old, and of the maneuver's batches of a second.
        fresh = np.diag(covariance @ gained @ covariance)
        old = np.maximum(np.diag(covariance) - fresh, 0.0)
        spread = old**2 / self.freedom + fresh**2 / _even_freedom(full)
        freedom = (old + fresh) ** 2 / np.maximum(spread, 1e-300)
        return covariance, np.where(spread > 0.0, freedom, _FREEDOMS[-1])

    def _translation(self, seconds: float) -> TranslationFit:
        before, began = self.fit.translation, self.fit.seconds
        if before is None or (before.source == "accelerometer" and began < MIN_MOMENTUM_SECONDS):
            # Velocity takes over soon; before, there is the accelerometer and its bias.
            share = _THRUST_SHARE * np.sqrt(MIN_MOMENTUM_SECONDS / max(seconds, 1e-3))
            share = share if seconds > MIN_MOMENTUM_SECONDS else 0.02
            return TranslationFit(self.kappa, share * self.kappa, np.nan, np.nan, "momentum")
        later = np.sqrt(began / max(seconds, began)) if before.source == "momentum" else 1.0
        return replace(
            before, kappa_std=before.kappa_std * later, delta_std=before.delta_std * later
        )


def predicted_information(
    fit: Fit, prior_vehicle: PriorVehicle, noise: Noise, free_coordinates: tuple[int, ...] = (0,)
) -> PredictedInformation:
    """What is known, from a fit and what is assumed.

    The fit is `Fit(None, None, 0.0)` before a flight; `free_coordinates` of
    `estimation.rows.actuator_dynamics` are estimated.
    """
    kappa = prior_vehicle.kappa
    if fit.translation is not None and fit.translation.kappa > 0.0:
        kappa = fit.translation.kappa
        prior_vehicle = prior_vehicle.at(kappa)
    free = np.array([*range(rb.N_THETA), *(rb.N_THETA + i for i in free_coordinates)])
    mean = np.concatenate([prior_vehicle.craft.theta, COORDINATE_MEAN])
    margin = np.diag(1.0 / prior_vehicle.std**2)
    information, freedom = margin.copy(), np.full(N_UNKNOWNS, _FREEDOMS[-1])
    unknowns = mean.copy()
    rotation = fit.rotation
    if rotation is not None:
        added, freedom = _information_of(rotation, prior_vehicle, free)
        information += added
        found = added @ rotation.unknowns + margin @ mean
        d = np.sqrt(np.diag(information))
        unknowns = np.linalg.solve(information / np.outer(d, d), found / d) / d
    theta = unknowns[: rb.N_THETA]
    if not (rb.is_physical(theta) and theta[rb.MOMENT_RATIO] > 0.0):
        theta = prior_vehicle.craft.theta
    coordinates = unknowns[COORDINATES].copy()
    coordinates[Coordinate.LAG] = max(coordinates[Coordinate.LAG], 0.0)
    craft = replace(prior_vehicle.craft, theta=theta, thrust=GRAVITY / kappa)
    return PredictedInformation(fit, craft, noise, information, freedom, coordinates, free, kappa)


def _information_of(
    rotation: RotationFit, prior_vehicle: PriorVehicle, free: Array
) -> tuple[Array, Array]:
    """(N_UNKNOWNS, N_UNKNOWNS) information and (N_UNKNOWNS,) freedom of a flight."""
    freedom = np.full(N_UNKNOWNS, _FREEDOMS[-1])
    widening = np.ones(N_UNKNOWNS)
    if rotation.warm_start is not None:
        # Deviations from the model are fitted between theta and the coordinates.
        deviating = slice(rb.N_THETA, rb.N_THETA + len(rotation.deviations))
        own = np.delete(rotation.warm_start.widening, deviating)
        if len(own) == len(free):
            widening[free] = own
        else:
            # Whitened rows of commands have asymmetry and exponent of the lag besides.
            every = np.arange(N_UNKNOWNS)
            curve = Unknown.CURVE
            widening[every if curve in free else np.delete(every, curve)] = own
        freedom[free] = np.interp(widening[free], _FACTORS[::-1], _FREEDOMS[::-1])
    covariance = rotation.full_covariance / np.outer(widening, widening)
    for axis, of_axis in enumerate(_OF_AXIS):
        if rotation.r_squared[axis] < RULES.explained(whitened=rotation.of_steps)[1]:
            # Where gusts turn the vehicle more than its rotors do, the scatter is deceptive.
            covariance[of_axis, of_axis] += (10.0 * prior_vehicle.std[of_axis]) ** 2
    information = np.zeros_like(covariance)
    there = free[np.diag(covariance)[free] > 0.0]
    part = covariance[np.ix_(there, there)]
    d = np.sqrt(np.diag(part))
    scaled = part / np.outer(d, d) + 1e-12 * np.eye(len(d))
    information[np.ix_(there, there)] = np.linalg.inv(scaled) / np.outer(d, d)
    return information, freedom


def _even_freedom(seconds: float) -> float:
    """Degrees of freedom of so many batches of one second, with equal information."""
    count = max(round(seconds), 1)
    weights = bartlett(count)
    shared = sum(w * w * (count - lag) for lag, w in enumerate(weights, 1))
    return float(count * count / (count + 2.0 * shared))
