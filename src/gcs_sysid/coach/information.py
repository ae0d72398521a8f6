"""The information that a maneuver adds about the parameters, before it is flown.

What a swing adds is counted frequency by frequency (Whittle's likelihood): with s_j(f) what the
j-th unknown changes of the angular acceleration and S(f) the spectral density of what disturbs it,

    information = seconds * sum_f Re s_j(f)^* S(f)^-1 s_k(f)

A period has a few tens of frequencies, so that a library of maneuvers costs milliseconds; no
flight is simulated. The estimator's filters pass over both sides alike, so they are not in it.
"""

from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.coach.motion import Craft, Motion
from gcs_sysid.estimation.actuator_dynamics import CURVE, DELAY, LAG, N_COORDINATES, ROTOR_COLUMNS
from gcs_sysid.estimation.priors import N_UNKNOWNS
from gcs_sysid.model import rigid_body as rb

_SLOWEST = 0.5
"""Hz; lower frequencies carry no more information than this one: biases and gusts wander."""
_QUIETEST = 1e-12
"""rad^2/s^3; no sensor is perfect, but an emulated one may be."""
_EFFICIENCY = 0.75
"""Information that the online estimator's intervals show over what there is: it weighs all
frequencies alike, and never claims less scatter than white residuals have (measured on flights of
the emulator)."""


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
        density = density + _QUIETEST * np.eye(3)
        return density


def speed_noise(craft: Craft, std: Array, dt: float) -> Array:
    """(3, 3) `Noise.torque` of white noise of the rotors' inputs.

    Args:
        craft: in hover.
        std: (rotors,) of one sample: rad/s, or 1 for commands.
        dt: s between samples.
    """
    slope = np.ones_like(std) if craft.commands else 2.0 * np.sqrt(craft.mean_share)
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
    changes[rb.N_THETA + DELAY] = 1j * omega * driven
    if craft.commands:
        changes[rb.N_THETA + LAG] = -1j * omega / (1.0 + 1j * omega * lag) * driven
        changes[rb.N_THETA + CURVE] = Q[:, :4] @ np.fft.rfft(_bent(motion, craft), axis=0).T / n
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
