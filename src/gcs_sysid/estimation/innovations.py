"""Noise models of the gyro and the model, and the filter that whitens by them.

For each axis, with z^-1 the delay by one sample of dt,

    gyro = w + b + n,    n = (1 - c z^-1) / (1 - a z^-1) g,    g white, a = exp(-corner dt)
    w at the next sample = model(w) + u - dt (e + e at the next sample) / 2

n is white for c = a, and white noise through a high-pass s / (s + corner) for c = 1. e is what
noise of the rotor speeds, known beforehand, does to the angular acceleration; u is white: wind
and all that the model leaves out. The likelihood follows from the innovations of the Kalman
filter for this model (Schweppe 1965; Jategaonkar, Flight Vehicle System Identification, ch. 5).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from gcs_sysid.arrays import Array

_N = 9
"""States: w, the noise's slow part, the bias; three each."""
_RATE, _SLOW, _BIAS = slice(0, 3), slice(3, 6), slice(6, 9)
BIAS_STD = 0.02
"""rad/s, prior of the gyro's bias around the complementary filter's."""
_DIFFUSE = 100.0
"""The first rate's prior, in standard deviations of the gyro's noise."""
MIN_STD = 1e-6
"""rad/s, of gyro noise; keeps everything definite where there is none."""
_TAPER_LOSS = 35.0 / 18.0
"""Independent values that a Hann taper costs: neighbours in the spectrum are correlated."""
_MIN_RUN = 64
"""Samples in a run worth a spectrum."""


@dataclass(frozen=True)
class AxisNoise:
    """Noise of one axis.

    Attributes:
        white_std: rad/s, of g, the driving noise of one sample.
        corner: rad/s, corner of the colouring; None for white noise.
        zero: c, between a and 1; 1 for a high-pass.
        process_std: rad/s^2, of the unmodelled angular acceleration of one sample.
    """

    white_std: float
    corner: float | None
    zero: float
    process_std: float

    def pole(self, dt: float) -> float:
        """a; without colour both zero and pole are 0."""
        return 0.0 if self.corner is None else float(np.exp(-self.corner * dt))

    def scaled(self, factor: float) -> "AxisNoise":
        """All levels times a factor."""
        return replace(
            self, white_std=factor * self.white_std, process_std=factor * self.process_std
        )


Noise = tuple[AxisNoise, AxisNoise, AxisNoise]


# ---- choosing a noise model ------------------------------------------------------------------


def fit_noise(defects: list[Array], known: Array, dt: float) -> Noise:
    """The likeliest noise of each axis.

    Args:
        defects: for each run (n, 3) gyro increments less the model's, rad/s.
        known: (3,) variances of e, (rad/s^2)^2.
        dt: s between samples.
    """
    spectra = [_spectrum(run) for run in defects if len(run) >= _MIN_RUN]
    if not spectra:
        return rough_noise(defects, dt)
    frequency = np.concatenate([f for f, _ in spectra])
    power = np.concatenate([p for _, p in spectra])
    x, y, z = (_fit_axis(frequency, power[:, i], float(known[i]), dt) for i in range(3))
    return x, y, z


def rough_noise(defects: list[Array], dt: float) -> Noise:
    """White noises that allow for a model that is still wrong; arguments as of `fit_noise`."""
    joined = np.concatenate(defects)
    # All of it as gyro noise, and all of it as acceleration.
    size = np.maximum(np.sqrt(np.mean(joined * joined, axis=0)), MIN_STD)
    x, y, z = (AxisNoise(float(s) / np.sqrt(2.0), None, 0.0, float(s) / dt) for s in size)
    return x, y, z


def _spectrum(defects: Array) -> tuple[Array, Array]:
    """(k,) frequencies in rad a sample and (k, 3) power, so scaled that white noise has its
    variance. The Hann taper keeps power from leaking to where a high-pass leaves none.
    """
    n = len(defects)
    taper = np.hanning(n + 2)[1:-1, None]
    transform = np.fft.rfft(defects * taper, axis=0)[1 : (n - 1) // 2 + 1]
    power = np.abs(transform) ** 2 / np.sum(taper * taper)
    return 2.0 * np.pi * np.arange(1, len(power) + 1) / n, power


def _fit_axis(frequency: Array, power: Array, known: float, dt: float) -> AxisNoise:
    """Maximum likelihood of the spectrum (Whittle), the number of unknowns chosen by BIC."""
    one, cos = 2.0 - 2.0 * np.cos(frequency), np.cos(frequency)
    rotor = known * dt * dt * (2.0 + 2.0 * cos) / 4.0
    floor = MIN_STD**2 * one

    def unpack(values: Array, colour: str, process: bool) -> AxisNoise:
        rest = list(values[1:])
        # The level of unmodelled acceleration, relative to gyro noise, comes last.
        u = float(np.exp(values[0] + rest.pop())) / dt if process else 0.0
        white = float(np.exp(values[0]))
        if colour == "white":
            return AxisNoise(white, None, 0.0, u)
        corner = float(np.exp(rest[0]))
        if colour == "high-pass":
            return AxisNoise(white, corner, 1.0, u)
        a = float(np.exp(-corner * dt))
        return AxisNoise(white, corner, a + (1.0 - a) / (1.0 + float(np.exp(-rest[1]))), u)

    def misfit(values: Array, colour: str, process: bool) -> float:
        noise = unpack(values, colour, process)
        a, c = noise.pole(dt), noise.zero
        gain = (1.0 + c * c - 2.0 * c * cos) / (1.0 + a * a - 2.0 * a * cos)
        model = noise.white_std**2 * one * gain + (noise.process_std * dt) ** 2 + rotor + floor
        return float(np.sum(np.log(model) + power / model)) / _TAPER_LOSS

    level = 0.5 * np.log(np.mean(np.maximum(power, floor) / (one + 0.01)))
    corner = np.log(5.0)
    highest, lowest = np.log(1.0 / dt), np.log(0.05)
    # log level; log corner; logit of where c is between a and 1; log process over gyro noise.
    # Gyro noise that is stronger at low frequency is not offered: it would pass for any motion
    # that the model misses, which is process noise.
    candidates = [
        ("white", [], []),
        ("high-pass", [corner], [(lowest, highest)]),
        ("partial", [corner, 1.0], [(lowest, highest), (-4.0, 8.0)]),
    ]
    best, best_score = AxisNoise(1.0, None, 0.0, 0.0), np.inf
    for colour, start, bounds in candidates:
        for process in (False, True):
            x0 = np.array([level, *start, *([-1.5] if process else [])])
            limits = [(level - 12.0, level + 6.0), *bounds, *([(-8.0, 8.0)] if process else [])]
            found = minimize(misfit, x0, args=(colour, process), bounds=limits, method="L-BFGS-B")
            score = float(found.fun) + 0.5 * len(x0) * np.log(len(power))
            if score < best_score:
                best, best_score = unpack(found.x, colour, process), score
    return replace(best, white_std=float(np.hypot(best.white_std, MIN_STD)))


# ---- the whitening filter --------------------------------------------------------------------


@dataclass(frozen=True)
class Whitener:
    """The Kalman filter's gains for one run; they do not depend on the measurements.

    Attributes:
        roots: (n, 3, 3) inverse Cholesky factors of the innovation covariances.
        log_determinant: of all innovation covariances together.
    """

    roots: Array
    log_determinant: float
    _loops: Array
    _gains: Array
    _covariances: Array

    def whiten(self, measured: Array, steps: Array) -> Array:
        """Innovations of unit covariance, column by column.

        Args:
            measured: (n, 3, m) gyro less nominal rates.
            steps: (n - 1, 3, m) model's rate at the next sample less the nominal one.

        Returns:
            (n, 3, m).
        """
        return self.roots @ self._innovations(measured, steps)[0]

    def smooth(self, measured: Array, steps: Array) -> Array:
        """(n, 3) corrections to nominal rates, given all measurements (n, 3), steps (n - 1, 3).

        Backward recursion of Bryson and Frazier, as in Durbin and Koopman, Time Series Analysis
        by State Space Methods, 4.4.
        """
        v, states = self._innovations(measured[..., None], steps[..., None])
        weighted = np.swapaxes(self.roots, 1, 2) @ (self.roots @ v)
        adjoint = np.empty((len(v), _N, 1))
        later = np.zeros((_N, 1))
        back = np.swapaxes(self._loops, 1, 2)
        into = _observe_adjoint(weighted)
        for k in range(len(v) - 1, -1, -1):
            later = into[k] + back[k] @ later
            adjoint[k] = later
        corrected: Array = (states + self._covariances @ adjoint)[:, _RATE, 0]
        return corrected

    def _innovations(self, measured: Array, steps: Array) -> tuple[Array, Array]:
        n, _, m = measured.shape
        inputs = self._gains @ measured
        inputs[:-1, _RATE] += steps
        states = np.zeros((n, _N, m))
        state = states[0]
        loops = self._loops
        for k in range(n - 1):
            state = loops[k] @ state
            state += inputs[k]
            states[k + 1] = state
        return measured - _observe(states), states


def make_whitener(
    noise: Noise, known: Array, by_rate: Array, rate_std: Array, dt: float
) -> Whitener:
    """Run the filter's covariances through one gapless run.

    Args:
        noise: of the axes.
        known: (3, 3) covariance of e, (rad/s^2)^2.
        by_rate: (n - 1, 3, 3) of `propagation.Transition`.
        rate_std: (3,) rad/s, prior of the first rate around the nominal one.
        dt: s between samples.
    """
    n = len(by_rate) + 1
    white = np.array([axis.white_std for axis in noise]) ** 2
    pole = np.array([axis.pole(dt) for axis in noise])
    slow = np.array([axis.zero for axis in noise]) - pole
    unmodelled = np.array([axis.process_std * dt for axis in noise]) ** 2

    # With w* = w + dt e / 2 as the state, noise of the rotor speeds is white; it is then in the
    # measurement too.
    R = np.diag(white) + 0.25 * dt * dt * known
    Q = np.zeros((_N, _N))
    Q[_RATE, _RATE] = np.diag(unmodelled) + dt * dt * known
    Q[_SLOW, _SLOW] = np.diag(slow * slow * white)
    C = np.zeros((_N, 3))
    C[_RATE] = 0.5 * dt * dt * known
    C[_SLOW] = np.diag(slow * white)
    P = np.zeros((_N, _N))
    P[_RATE, _RATE] = np.diag(rate_std**2)
    P[_SLOW, _SLOW] = np.diag(slow * slow * white / (1.0 - pole * pole))
    P[_BIAS, _BIAS] = np.eye(3) * BIAS_STD**2
    F = np.zeros((n, _N, _N))
    F[:-1, _RATE, _RATE] = by_rate
    F[-1, _RATE, _RATE] = np.eye(3)
    F[:, _SLOW, _SLOW] = np.diag(pole)
    F[:, _BIAS, _BIAS] = np.eye(3)

    covariances, gains = np.empty((n, _N, _N)), np.empty((n, _N, 3))
    loops, S_all = np.empty((n, _N, _N)), np.empty((n, 3, 3))
    for k in range(n):
        PH = P[:, _RATE] - P[:, _SLOW] + P[:, _BIAS]
        S = PH[_RATE] - PH[_SLOW] + PH[_BIAS] + R
        K = (F[k] @ PH + C) @ np.linalg.inv(S)
        covariances[k], gains[k], S_all[k] = P, K, S
        # Joseph's form, which rounding cannot make negative.
        loop = F[k] - _observe_adjoint_columns(K)
        shared = K @ C.T
        P = loop @ P @ loop.T + (Q - shared - shared.T + K @ R @ K.T)
        P = 0.5 * (P + P.T)
        loops[k] = loop
    factors = np.linalg.cholesky(0.5 * (S_all + np.swapaxes(S_all, 1, 2)))
    diagonal = np.diagonal(factors, axis1=1, axis2=2)
    return Whitener(
        np.linalg.inv(factors), 2.0 * float(np.log(diagonal).sum()), loops, gains, covariances
    )


def initial_std(noise: Noise, known: Array, dt: float) -> Array:
    """(3,) a prior of the first rate that says next to nothing, rad/s."""
    white = np.array([axis.white_std for axis in noise])
    std: Array = _DIFFUSE * np.hypot(white, dt * np.sqrt(np.diag(known)))
    return std


def _observe(states: Array) -> Array:
    """What the gyro shows of (..., 9, m) states."""
    shown: Array = states[..., _RATE, :] - states[..., _SLOW, :] + states[..., _BIAS, :]
    return shown


def _observe_adjoint(values: Array) -> Array:
    """(..., 9, m) from (..., 3, m): the transpose of `_observe`."""
    return np.concatenate([values, -values, values], axis=-2)


def _observe_adjoint_columns(gains: Array) -> Array:
    """(..., 9, 9): gains (..., 9, 3) times what `_observe` does."""
    return np.concatenate([gains, -gains, gains], axis=-1)
