"""Noise models of the gyro and the model, and the filter that whitens by them.

For each axis, with z^-1 the delay by one sample of dt,

    gyro = w + b + n,    n = (1 - c z^-1) / (1 - a z^-1) g,    g white, a = exp(-corner dt)
    w at the next sample = model(w) + dt d + u - dt ((1 - f) e + f e at the next sample)
    d at the next sample = exp(-dt / tau) d + white noise

n is white for c = a, and white noise through a high-pass s / (s + corner) for c = 1. e is what
noise of the rotor speeds, known beforehand, does to the angular acceleration. u is white: torque
noise, under which the rate walks. d, an Ornstein-Uhlenbeck process, is the angular acceleration
of slow moments that the model leaves out: gusts, aerodynamics, a swinging load. The rate loop
answers it, so that rotor torque and d are correlated; as a state it is followed by the filter,
and what is left, the innovations, is uncorrelated with torques of the past. A spline through
noisy speeds, integrated over one interval, passes noise of low frequency by
1 - (omega dt)^2 / 12; so does f (1 - f) = 1/12.

The likelihood follows from the innovations of the Kalman filter for this model (Schweppe 1965;
Jategaonkar, Flight Vehicle System Identification, ch. 5).
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.linalg.lapack import dposv

from gcs_sysid.arrays import Array

_N = 9
"""States: w, the noise's slow part, the bias; three each. Where there is a moment, d follows."""
_RATE, _SLOW, _BIAS, _MOMENT = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
_NEXT = 0.5 - np.sqrt(0.25 - 1.0 / 12.0)
"""f above."""
_TAU = (0.05, 10.0)
"""s, least and greatest time constant of a moment: faster is torque noise, slower a trim."""
BIAS_STD = 0.02
"""rad/s, prior of the gyro's bias around the complementary filter's."""
_DIFFUSE = 100.0
"""The first rate's prior, in standard deviations of the gyro's noise."""
MIN_STD = 1e-6
"""rad/s, of gyro noise; keeps everything definite where there is none."""
_TAPER_LOSS = 35.0 / 18.0
"""Independent values that a Hann taper costs: neighbors in the spectrum are correlated."""
_MAX_SCORING = 50
_SCORING_GAIN = 1e-4
"""Of log likelihood; less ends the search."""
_MIN_RUN = 64
"""Samples in a run worth a spectrum."""


@dataclass(frozen=True)
class AxisNoise:
    """Noise of one axis.

    Attributes:
        white_std: rad/s, of g, the driving noise of one sample.
        corner: rad/s, corner of the coloring; None for white noise.
        zero: c, between a and 1; 1 for a high-pass.
        process_std: rad/s^2, of the unmodeled angular acceleration of one sample.
        moment_std: rad/s^2, of the Ornstein-Uhlenbeck moment over inertia; 0: there is none.
        moment_tau: s, its time constant.
    """

    white_std: float
    corner: float | None
    zero: float
    process_std: float
    moment_std: float = 0.0
    moment_tau: float = 1.0

    def pole(self, dt: float) -> float:
        """a; without color both zero and pole are 0."""
        return 0.0 if self.corner is None else float(np.exp(-self.corner * dt))

    def scaled(self, factor: float) -> "AxisNoise":
        """All levels times a factor."""
        return replace(
            self,
            white_std=factor * self.white_std,
            process_std=factor * self.process_std,
            moment_std=factor * self.moment_std,
        )


Noise = tuple[AxisNoise, AxisNoise, AxisNoise]


# ---- choosing a noise model ------------------------------------------------------------------


def fit_noise(defects: list[Array], known: Array, floor: Array, dt: float) -> Noise:
    """The likeliest noise of each axis.

    Args:
        defects: for each run (n, 3) gyro increments less the model's, rad/s.
        known: (3,) variances of e, (rad/s^2)^2.
        floor: (3,) least process_std, rad/s^2.
        dt: s between samples.
    """
    long = [run for run in defects if len(run) >= _MIN_RUN]
    if not long:
        return rough_noise(defects, dt)
    bins, powers = zip(*(_periodogram(run) for run in long), strict=True)
    frequency, power = np.concatenate(bins, axis=1), np.concatenate(powers)
    x, y, z = (
        _fit_axis(frequency, power[:, i], float(known[i]), float(floor[i]), dt) for i in range(3)
    )
    return x, y, z


def rough_noise(defects: list[Array], dt: float) -> Noise:
    """White noises that allow for a model that is still wrong; arguments as of `fit_noise`."""
    joined = np.concatenate(defects)
    # All of it as gyro noise, and all of it as acceleration.
    size = np.maximum(np.sqrt(np.mean(joined * joined, axis=0)), MIN_STD)
    x, y, z = (AxisNoise(float(s) / np.sqrt(2.0), None, 0.0, float(s) / dt) for s in size)
    return x, y, z


def _periodogram(defects: Array) -> tuple[Array, Array]:
    """(3, k) frequencies of each bin and its neighbors in rad a sample, and (k, 3) power.

    White noise has its variance as power. The Hann taper keeps power from leaking to where a
    high-pass leaves none.
    """
    n = len(defects)
    taper = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(n) / n)[:, None]
    bins = np.arange(1, (n - 1) // 2)
    power = np.abs(np.fft.rfft(defects * taper, axis=0)[bins]) ** 2 / np.sum(taper * taper)
    return 2.0 * np.pi / n * np.stack([bins - 1, bins, bins + 1]), power


_HANN = np.array([1.0, 4.0, 1.0]) / 6.0
"""What a Hann taper mixes into a bin's expected power from its neighbors and itself."""


def _fit_axis(frequency: Array, power: Array, known: float, floor: float, dt: float) -> AxisNoise:
    """Maximum likelihood of the spectrum (Whittle), the number of unknowns chosen by BIC."""
    cos = np.cos(frequency)
    one = 2.0 - 2.0 * cos
    fixed = (
        known * dt * dt * (1.0 - _NEXT * (1.0 - _NEXT) * one) + (floor * dt) ** 2 + MIN_STD**2 * one
    )
    level = 0.5 * np.log(np.mean(np.maximum(power, fixed[1]) / (one[1] + 0.01)))
    # Gyro noise that is stronger at low frequency is not offered: it would pass for any motion
    # that the model misses, which is process noise.
    best, best_score = AxisNoise(MIN_STD, None, 0.0, 0.0), np.inf
    for color, process, moment in product((0, 1, 2), (False, True), (False, True)):
        spectrum = _NoiseSpectrum(one, cos, fixed, dt, color, process, moment)
        values = spectrum.start(float(level))
        misfit, values = _maximize(spectrum, power, values)
        score = misfit + 0.5 * len(values) * np.log(len(power))
        if score < best_score:
            best, best_score = spectrum.noise(values), score
    return replace(
        best,
        white_std=float(np.hypot(best.white_std, MIN_STD)),
        process_std=float(np.hypot(best.process_std, floor)),
    )


@dataclass(frozen=True)
class _NoiseSpectrum:
    """A family of spectra of gyro increments, over (3, k) frequencies: bins with neighbors.

    Unknowns, in this order: log white_std; from color 1 on log corner; with color 2 the logit
    of where c lies between a and 1; with process noise log of process_std dt; with a moment log of
    moment_std dt and log of tau.
    """

    one: Array
    cos: Array
    fixed: Array
    dt: float
    color: int
    process: bool
    moment: bool = False

    @property
    def _process(self) -> int:
        """Place of the process noise's level."""
        return 1 + self.color

    def start(self, level: float) -> Array:
        """A first guess."""
        colors = ([], [np.log(5.0)], [np.log(5.0), 1.0])[self.color]
        process = [level - 1.5] if self.process else []
        moment = [level - 1.0, 0.0] if self.moment else []
        return np.array([level, *colors, *process, *moment])

    def limits(self, values: Array) -> Array:
        """Unknowns kept where they mean something."""
        values = values.copy()
        values[0] = np.clip(values[0], np.log(MIN_STD), 5.0)
        if self.color >= 1:
            values[1] = np.clip(values[1], np.log(0.05), np.log(1.0 / self.dt))
        if self.color == 2:
            values[2] = np.clip(values[2], -4.0, 8.0)
        if self.process:
            at = self._process
            values[at] = np.clip(values[at], values[0] - 10.0, values[0] + 10.0)
        if self.moment:
            values[-2] = np.clip(values[-2], values[0] - 10.0, values[0] + 10.0)
            values[-1] = np.clip(values[-1], *np.log(_TAU))
        return values

    def noise(self, values: Array) -> AxisNoise:
        """What the unknowns mean."""
        white = float(np.exp(values[0]))
        u = float(np.exp(values[self._process])) / self.dt if self.process else 0.0
        d = (float(np.exp(values[-2])) / self.dt, float(np.exp(values[-1]))) if self.moment else ()
        if self.color == 0:
            return AxisNoise(white, None, 0.0, u, *d)
        corner = float(np.exp(values[1]))
        a = float(np.exp(-corner * self.dt))
        c = 1.0 if self.color == 1 else a + (1.0 - a) / (1.0 + float(np.exp(-values[2])))
        return AxisNoise(white, corner, c, u, *d)

    def __call__(self, values: Array) -> tuple[Array, Array]:
        """(k,) expected power and (k, unknowns) its derivatives."""
        noise = self.noise(values)
        a, c = noise.pole(self.dt), noise.zero
        above = 1.0 + c * c - 2.0 * c * self.cos
        below = 1.0 + a * a - 2.0 * a * self.cos
        gyro = noise.white_std**2 * self.one * above / below
        slopes = [2.0 * gyro]
        if noise.corner is not None:
            by_c = noise.white_std**2 * self.one * 2.0 * (c - self.cos) / below
            by_a = -gyro * 2.0 * (a - self.cos) / below
            share = (c - a) / (1.0 - a)
            if self.color == 2:
                by_a = by_a + (1.0 - share) * by_c
            slopes.append(by_a * -a * noise.corner * self.dt)
            if self.color == 2:
                slopes.append(by_c * (1.0 - a) * share * (1.0 - share))
        model = gyro + self.fixed
        if self.process:
            u = np.full_like(model, (noise.process_std * self.dt) ** 2)
            model = model + u
            slopes.append(2.0 * u)
        if self.moment:
            # dt^2 sigma^2 (1 - k^2) / |1 - k z^-1|^2 with k = exp(-dt / tau).
            k = float(np.exp(-self.dt / noise.moment_tau))
            around = 1.0 + k * k - 2.0 * k * self.cos
            d = (noise.moment_std * self.dt) ** 2 * (1.0 - k * k) / around
            by_k = d * (-2.0 * k / (1.0 - k * k) - 2.0 * (k - self.cos) / around)
            model = model + d
            slopes += [2.0 * d, by_k * k * self.dt / noise.moment_tau]
        mean: Array = np.tensordot(_HANN, model, 1)
        return mean, np.stack([np.tensordot(_HANN, slope, 1) for slope in slopes], axis=1)


def _maximize(spectrum: _NoiseSpectrum, power: Array, values: Array) -> tuple[float, Array]:
    """Fisher scoring with Levenberg-Marquardt damping; minus log likelihood and the unknowns."""
    damping = 1e-3
    values = spectrum.limits(values)
    model, slopes = spectrum(values)
    misfit = float(np.sum(np.log(model) + power / model))
    for _ in range(_MAX_SCORING):
        relative = slopes / model[:, None]
        gradient = relative.T @ (1.0 - power / model)
        information = relative.T @ relative
        diagonal = np.diag(np.diag(information) + 1e-9)
        gain = 0.0
        while damping < 1e6:
            step = -np.linalg.solve(information + damping * diagonal, gradient)
            candidate = spectrum.limits(values + np.clip(step, -1.5, 1.5))
            new_model, new_slopes = spectrum(candidate)
            new_misfit = float(np.sum(np.log(new_model) + power / new_model))
            gain = misfit - new_misfit
            if gain >= 0.0:
                values, model, slopes, misfit = candidate, new_model, new_slopes, new_misfit
                damping *= 0.1
                break
            damping *= 10.0
        if gain < _SCORING_GAIN:
            break
    return misfit / _TAPER_LOSS, values


# ---- the whitening filter --------------------------------------------------------------------


@dataclass(frozen=True)
class KalmanWhitener:
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
        adjoint = np.empty((len(v), self._loops.shape[1], 1))
        later = np.zeros(adjoint.shape[1:])
        back = np.swapaxes(self._loops, 1, 2)
        into = _observe_adjoint(weighted, adjoint.shape[1])
        for k in range(len(v) - 1, -1, -1):
            later = into[k] + back[k] @ later
            adjoint[k] = later
        corrected: Array = (states + self._covariances @ adjoint)[:, _RATE, 0]
        return corrected

    def _innovations(self, measured: Array, steps: Array) -> tuple[Array, Array]:
        n, _, m = measured.shape
        inputs = self._gains @ measured
        inputs[:-1, _RATE] += steps
        states = np.zeros((n, self._loops.shape[1], m))
        state = states[0]
        loops = self._loops
        for k in range(n - 1):
            state = loops[k] @ state
            state += inputs[k]
            states[k + 1] = state
        return measured - _observe(states), states


def make_whitener(
    noise: Noise, known: Array, by_rate: Array, rate_std: Array, dt: float
) -> KalmanWhitener:
    """Run the filter's covariances through one gapless run.

    Args:
        noise: of the axes.
        known: (3, 3) covariance of e, (rad/s^2)^2.
        by_rate: (n - 1, 3, 3) of `propagation.Transition`.
        rate_std: (3,) rad/s, prior of the first rate around the nominal one.
        dt: s between samples.

    Raises:
        numpy.linalg.LinAlgError: covariances overflow.
    """
    n = len(by_rate) + 1
    white = np.array([axis.white_std for axis in noise]) ** 2
    pole = np.array([axis.pole(dt) for axis in noise])
    slow = np.array([axis.zero for axis in noise]) - pole
    unmodeled = np.array([axis.process_std * dt for axis in noise]) ** 2

    # With w* = w + f dt e as the state, noise of the rotor speeds is white; it is then in the
    # measurement too.
    moment = np.array([axis.moment_std for axis in noise])
    kept = np.exp(-dt / np.array([axis.moment_tau for axis in noise]))
    states = _N + 3 * bool(moment.any())
    R = np.diag(white) + (_NEXT * dt) ** 2 * known
    Q = np.zeros((states, states))
    Q[_RATE, _RATE] = np.diag(unmodeled) + dt * dt * known
    Q[_SLOW, _SLOW] = np.diag(slow * slow * white)
    C = np.zeros((states, 3))
    C[_RATE] = _NEXT * dt * dt * known
    C[_SLOW] = np.diag(slow * white)
    P = np.zeros((states, states))
    P[_RATE, _RATE] = np.diag(rate_std**2)
    P[_SLOW, _SLOW] = np.diag(slow * slow * white / (1.0 - pole * pole))
    P[_BIAS, _BIAS] = np.eye(3) * BIAS_STD**2
    F = np.zeros((n, states, states))
    F[:-1, _RATE, _RATE] = by_rate
    F[-1, _RATE, _RATE] = np.eye(3)
    F[:, _SLOW, _SLOW] = np.diag(pole)
    F[:, _BIAS, _BIAS] = np.eye(3)

    if states > _N:
        P[_MOMENT, _MOMENT] = np.diag(moment**2)
        Q[_MOMENT, _MOMENT] = np.diag(moment**2 * (1.0 - kept**2))
        F[:, _MOMENT, _MOMENT] = np.diag(kept)
        F[:-1, _RATE, _MOMENT] = dt * np.eye(3)

    covariances, gains = np.empty((n, states, states)), np.empty((n, states, 3))
    S_all = np.empty((n, 3, 3))
    for k in range(n):
        F_k = F[k]
        PH = P[:, _RATE] - P[:, _SLOW] + P[:, _BIAS]
        S = PH[_RATE] - PH[_SLOW] + PH[_BIAS] + R
        cross = F_k @ PH + C
        _, K_transposed, _ = dposv(S, cross.T)
        covariances[k], gains[k], S_all[k] = P, K_transposed.T, S
        P = F_k @ P @ F_k.T + Q - cross @ K_transposed
        P = 0.5 * (P + P.T)
    factors = np.linalg.cholesky(0.5 * (S_all + np.swapaxes(S_all, 1, 2)))
    diagonal = np.diagonal(factors, axis1=1, axis2=2)
    # F - K H
    loops = F.copy()
    loops[..., :_N] -= np.concatenate([gains, -gains, gains], axis=-1)
    return KalmanWhitener(
        np.linalg.inv(factors), 2.0 * float(np.log(diagonal).sum()), loops, gains, covariances
    )


def initial_std(noise: Noise, known: Array, dt: float) -> Array:
    """(3,) a nearly uninformative prior of the first rate, rad/s."""
    white = np.array([axis.white_std for axis in noise])
    std: Array = _DIFFUSE * np.hypot(white, dt * np.sqrt(np.diag(known)))
    return std


def _observe(states: Array) -> Array:
    """What the gyro shows of (..., 9, m) states."""
    shown: Array = states[..., _RATE, :] - states[..., _SLOW, :] + states[..., _BIAS, :]
    return shown


def _observe_adjoint(values: Array, states: int) -> Array:
    """(..., states, m) from (..., 3, m): the transpose of `_observe`."""
    unseen = np.zeros((*values.shape[:-2], states - _N, values.shape[-1]))
    return np.concatenate([values, -values, values, unseen], axis=-2)
