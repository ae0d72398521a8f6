"""A recorded flight as the offline estimator takes it: linearized, whitened and weighed."""

import math
from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array, complete_rows, runs
from gcs_sysid.estimation.fit.priors import Unknown
from gcs_sysid.estimation.offline.innovations import (
    KalmanWhitener,
    Noise,
    initial_std,
    make_whitener,
)
from gcs_sysid.estimation.offline.propagation import (
    SPLINE_END,
    Propagator,
    Transition,
    impulse_weights,
)
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.signals.samples import Samples

MIN_RUN = 24
"""Samples; shorter pieces between gaps carry little information and are left out."""
N_FITTED = Unknown.DELAY + 1
"""Unknowns: theta, then the delay of the rotor speeds."""


class OfflineRecord:
    """Gapless runs of a record, ready to be integrated.

    Attributes:
        gyro: of each run, (n, 3) less the complementary filter's mean bias, rad/s.
        rates: of each run, (n, 3) rad/s.
        speed_variance: (rotors,) (rad/s)^2; zeros if not given.
        delay: s, of the rotor speeds, as aligned.
        delay_bounds: s, within which it may be moved.
        propagators: of each run.
        torque: (3, N_SIGNALS) of deviations from the model.
    """

    def __init__(
        self,
        samples: Samples,
        geometry: Array,
        dt: float,
        speed_std: float | Array | None,
        delay: float = 0.0,
        reach: float = 0.0,
        torque: Array | float = 0.0,
    ) -> None:
        self.dt = dt
        self.torque = torque
        self.geometry = geometry
        self.delay_bounds = delay - reach, delay + reach
        margin = SPLINE_END + math.ceil((abs(delay) + reach) / dt - 1e-9)
        there = complete_rows(np.hstack([samples.gyro, samples.rates, samples.speeds]))
        least = MIN_RUN + 2 * (margin - SPLINE_END)
        parts = [part for part, ok in runs(there) if ok and part.stop - part.start >= least]
        self.gyro: list[Array] = []
        self.rates: list[Array] = []
        for part in parts:
            inner = slice(part.start + margin, part.stop - margin)
            gyro, rates = samples.gyro[inner], samples.rates[inner]
            self.gyro.append(gyro - np.mean(gyro - rates, axis=0))
            self.rates.append(rates)
        self._speeds = [samples.speeds[part] for part in parts]
        self._margin = margin
        self.delay = math.nan
        self.align(delay)
        self.rows = sum(len(part) for part in self.gyro)
        rotors = geometry.shape[1]
        level = 0.0 if speed_std is None else np.asarray(speed_std, dtype=float)
        self.speed_variance: Array = np.broadcast_to(level, (rotors,)) ** 2
        squares = sum(np.sum(samples.speeds[part] ** 2, axis=0) for part in parts)
        self._mean_square = np.zeros(rotors) + squares / max(self.rows, 1)

    def align(self, delay: float) -> None:
        """Take the rotor speeds as stamped `delay` s late from now on."""
        if delay == self.delay:
            return
        self.delay = delay
        self.propagators = [
            Propagator(self.geometry, speeds, self.dt, self._margin, delay, self.torque)
            for speeds in self._speeds
        ]

    def speed_inputs(self) -> Array:
        """(rotors, N_SIGNALS) what one standard deviation of each speed's noise does to the
        signals of one sample, rms over the record; the derivative of H left out.
        """
        x, y, s = self.geometry
        inputs = np.zeros((len(x), rb.N_SIGNALS))
        size = 2.0 * np.sqrt(self._mean_square * self.speed_variance)
        inputs[:, :4] = np.stack([-y, x, np.ones_like(x), s], axis=1) * size[:, None]
        return inputs

    def speed_process(self, theta: Array) -> Array:
        """(3, 3) covariance of the angular acceleration that noise of the speeds makes."""
        effect = self.speed_inputs() @ rb.forward_matrix(theta, self.torque).T
        covariance: Array = effect.T @ effect
        return covariance


@dataclass(frozen=True)
class Linearization:
    """Where the model is linearized."""

    theta: Array
    rates: list[Array]
    transitions: list[Transition]


def linearize(record: OfflineRecord, theta: Array, rates: list[Array]) -> Linearization:
    """The model at (N_THETA,) theta about (n, 3) rates of each run, with the delay in force."""
    transitions = [
        propagator(theta, w) for propagator, w in zip(record.propagators, rates, strict=True)
    ]
    return Linearization(theta, rates, transitions)


@dataclass(frozen=True)
class Weighed:
    """A linearized model, weighed by a noise model.

    Attributes:
        whiteners: of each run.
        residuals: of each run, (n, 3), white and of unit variance if all is right.
        sensitivities: of each run, (n, 3, N_FITTED), their derivatives by theta and delay.
        excess: (N_FITTED,) expected gradient at the truth, from noise of the speeds.
        gradient: (N_FITTED,) of half the sum of squared residuals, corrected.
        scatter: (N_FITTED, N_FITTED) covariance of the gradient.
        information: (N_FITTED, N_FITTED) expected slope of the gradient.
        squares: half the sum of squared residuals, what the gradient belongs to. Without the
            determinant: noise of the speeds makes that change with theta, and the profile over
            the true speeds has none.
        log_determinant: of the innovations' covariances.
    """

    whiteners: list[KalmanWhitener]
    residuals: list[Array]
    sensitivities: list[Array]
    excess: Array
    gradient: Array
    scatter: Array
    information: Array
    squares: float
    log_determinant: float


def weigh(record: OfflineRecord, point: Linearization, noise: Noise, known: Array) -> Weighed:
    """Weigh a linearized model.

    Args:
        record: of the flight.
        point: where it is linearized.
        noise: of the axes.
        known: (3, 3) covariance of what noise of the speeds does. Held while theta is searched
            for: the gradient is that of the squares at fixed weights.

    Raises:
        numpy.linalg.LinAlgError: covariances overflow.
    """
    rate_std = initial_std(noise, known, record.dt)
    whiteners, residuals, sensitivities = [], [], []
    gradient, scatter = np.zeros(N_FITTED), np.zeros((N_FITTED, N_FITTED))
    squares = log_determinant = 0.0
    for gyro, rates, by in zip(record.gyro, point.rates, point.transitions, strict=True):
        whitener = make_whitener(noise, known, by.by_rate, rate_std, record.dt)
        missed = (by.rates - rates[1:])[..., None]
        steps = np.concatenate([missed, by.by_theta, by.by_delay[..., None]], axis=2)
        measured = np.zeros((len(gyro), *steps.shape[1:]))
        measured[..., 0] = gyro - rates
        white = whitener.whiten(measured, steps)
        v, V = white[..., 0], white[..., 1:]
        columns = V.reshape(-1, N_FITTED)
        gradient += columns.T @ v.ravel()
        scatter += columns.T @ columns
        squares += 0.5 * float(np.sum(v * v))
        log_determinant += whitener.log_determinant
        whiteners.append(whitener)
        residuals.append(v)
        sensitivities.append(V)
    information, excess = scatter.copy(), np.zeros(N_FITTED)
    if record.speed_variance.any():
        excess, surplus = _speed_noise_terms(record, point, whiteners)
        information -= surplus
    return Weighed(
        whiteners,
        residuals,
        sensitivities,
        excess,
        gradient - excess,
        scatter,
        information,
        squares,
        log_determinant,
    )


def _speed_noise_terms(
    record: OfflineRecord, point: Linearization, whiteners: list[KalmanWhitener]
) -> tuple[Array, Array]:
    """What noise of the rotor speeds adds to gradient and information, by expectation.

    The response to one sample's noise, taken in the middle of the longest run, represents all.
    """
    longest = max(range(len(whiteners)), key=lambda i: len(point.rates[i]))
    n = len(point.rates[longest])
    steps = np.zeros((n - 1, 3, 6))
    # Torque noise acts in the intervals around the sample; that of the change of H adds in one
    # what it takes in the next.
    weights = impulse_weights(record.dt)
    reach = min(len(weights) // 2, n // 2)
    for k in range(-reach, reach - 1):
        steps[n // 2 + k, :, :3] = weights[len(weights) // 2 + k] * record.dt * np.eye(3)
    steps[n // 2 - 1, :, 3:] = np.eye(3)
    steps[n // 2, :, 3:] = -np.eye(3)
    white = whiteners[longest].whiten(np.zeros((n, 3, 6)), steps)
    energy = np.einsum("nik,nil->kl", white, white)
    Q, G = rb.forward_jacobian(point.theta, record.torque)
    torque = record.speed_inputs()
    change = np.sqrt(record.speed_variance.sum())
    dH = rb.SIGNALS.index("dH")
    by_torque = np.einsum("kis,rs->kri", G, torque)
    by_change = change * G[:, :, dH]
    at = torque @ Q.T
    n = rb.N_THETA
    excess, surplus = np.zeros(N_FITTED), np.zeros((N_FITTED, N_FITTED))
    excess[:n] = np.einsum("kri,ij,rj->k", by_torque, energy[:3, :3], at)
    excess[:n] += by_change @ energy[3:, 3:] @ (change * Q[:, dH])
    surplus[:n, :n] = np.einsum("kri,ij,lrj->kl", by_torque, energy[:3, :3], by_torque)
    surplus[:n, :n] += by_change @ energy[3:, 3:] @ by_change.T
    # A later stamp moves torque from one interval to the next, as a change of H does.
    excess[Unknown.DELAY] = np.einsum("ri,ij,rj->", at, energy[3:, :3], at)
    surplus[Unknown.DELAY, Unknown.DELAY] = np.einsum("ri,ij,rj->", at, energy[3:, 3:], at)
    across = np.einsum("kri,ij,rj->k", by_torque, energy[:3, 3:], at)
    surplus[:n, Unknown.DELAY] = surplus[Unknown.DELAY, :n] = across
    return record.rows * excess, record.rows * surplus
