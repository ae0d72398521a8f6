"""The offline estimator: maximum likelihood of a whole record, and its Cramer-Rao bound.

The rotation is a stochastic state-space model (`gcs_sysid.estimation.innovations`):

    w at the next sample = F(w, speeds; theta) + process noise,    gyro = w + bias + noise

with F the integral of w' = Q(theta) x over one sample (`gcs_sysid.estimation.propagation`).
Where the process noise is nothing this is the output-error method, otherwise filter error
(Maine and Iliff, NASA RP-1168; Jategaonkar, Flight Vehicle System Identification, ch. 4, 5);
levels and colours of the noises are what the record itself makes likeliest. First rates and
gyro biases are states with priors, so that they are integrated out exactly.

The likelihood is maximised by Gauss-Newton. The model is linearised about smoothed rates, not
about the noisy gyro; residuals and sensitivities pass one whitening filter; their products are
gradient and Fisher information.

Noise of the rotor speeds is in regressors and residuals at once, which pulls estimates towards
zero. The profile over the true speeds has no such pull: with L(theta) from speed noise to
residual, E[gradient] = tr(dL' S^-1 L) and the noise's part in the information
tr(dL' S^-1 dL) are taken out where the level is given (Fuller, Measurement Error Models, 1.2).
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from gcs_sysid.arrays import Array, complete_rows, runs
from gcs_sysid.estimation.innovations import (
    AxisNoise,
    Noise,
    Whitener,
    fit_noise,
    initial_std,
    make_whitener,
    rough_noise,
)
from gcs_sysid.estimation.propagation import (
    SPLINE_END,
    Propagator,
    Transition,
    impulse_weights,
)
from gcs_sysid.estimation.uncertainty import sandwich
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.signals.samples import Samples

MIN_RUN = 24
"""Samples; shorter pieces between gaps say little and are left out."""
MODEL_PRECISION = 1e-4
"""Share of the angular acceleration that no model explains. Rotors that follow held commands
(250 Hz, 30 ms lag) leave about that between any samples of their speeds. A third of it would
leave biases of a standard deviation, half as much again costs more accuracy than it saves."""
_MAX_ITERATIONS = 25
_NOISE_REFITS = 3
"""The noise model is fitted anew in so many first iterations, then where the search settles."""
_MAX_REFITS = 6
_ALIKE = 0.05
"""Relative change of the noise's levels that moves no estimate."""
_MAX_DAMPING = 1e9
_SMALL = 0.3
"""Standard deviations; a smaller step is taken unseen."""
_SETTLED = 0.02
"""Standard deviations; a smaller step ends the search."""
_WHITE = 0.01
"""Residuals whiter than this p-value pass as white."""
_LAGS = 20
_BATCH_TIME = 1.0
_RIDGE = 1e-12
"""Of the scaled information: an unseen direction keeps a huge, finite variance."""

Prior = tuple[Array, Array]
"""(N_THETA,) mean and (N_THETA, N_THETA) information matrix; zeros where nothing is known."""


@dataclass(frozen=True)
class LikelihoodFit:
    """The likeliest rotational parameters relative to k_T (`rigid_body.THETA`).

    Attributes:
        theta: (N_THETA,) estimate.
        covariance: (N_THETA, N_THETA); from the scatter of the score where residuals are not
            white.
        bound: (N_THETA,) Cramer-Rao standard deviations of this flight with the fitted noise;
            first rates, gyro biases and the prior, if any, included.
        noise: of each axis, as fitted.
        speed_process_std: (3,) rad/s^2, what the given rotor-speed noise does to the angular
            acceleration of one sample; zeros if none was given.
        whiteness: (3,) p-values of Ljung and Box on the whitened residuals of each axis: small
            ones mean that the model leaves something unexplained.
        lag_one: (3,) their autocorrelation at one sample.
        log_likelihood: of the record, prior excluded.
        rows: samples used; the first and last few beside a gap are not.
        seconds: rows times the sample time.
        converged: whether the last step was negligible.
    """

    theta: Array
    covariance: Array
    bound: Array
    noise: tuple[AxisNoise, AxisNoise, AxisNoise]
    speed_process_std: Array
    whiteness: Array
    lag_one: Array
    log_likelihood: float
    rows: int
    seconds: float
    converged: bool

    @property
    def std(self) -> Array:
        """(N_THETA,) standard deviations."""
        std: Array = np.sqrt(np.diag(self.covariance))
        return std


def maximise_likelihood(
    samples: Samples,
    geometry: Array,
    dt: float,
    start: Array,
    speed_std: float | Array | None = None,
    prior: Prior | None = None,
) -> LikelihoodFit | None:
    """Fit theta, noise levels and noise colours to a whole record.

    Args:
        samples: on a uniform grid; NaN in gyro, rates or speeds marks gaps.
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
        start: (N_THETA,) the online estimate (`RotationFit.theta`), physical.
        speed_std: rad/s, white noise of the rotor speeds, one value or (rotors,). None: what
            of it shows is taken as unmodelled acceleration.
        prior: on theta.

    Returns:
        The fit, or None if there is no piece of MIN_RUN samples without a gap, or fewer samples
        than twice the unknowns.

    Raises:
        ValueError: `start` is no rigid body's inertia.
    """
    if not rb.is_physical(start):
        raise ValueError("the starting point has an inertia that no rigid body has")
    record = _Record(samples, geometry, dt, speed_std)
    if record.rows < 2 * rb.N_THETA:
        return None
    return _search(record, start, prior)


def cramer_rao_bound(
    samples: Samples,
    geometry: Array,
    dt: float,
    theta: Array,
    noise: Noise,
    speed_std: float | Array | None = None,
) -> Array:
    """(N_THETA,) least standard deviations possible on this flight with this noise.

    Args:
        samples: with true (or well smoothed) body rates in `rates`.
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
        theta: (N_THETA,) where to linearise.
        noise: of the axes.
        speed_std: rad/s, white noise of the rotor speeds.

    Raises:
        ValueError: there is no piece of MIN_RUN samples without a gap.
    """
    record = _Record(samples, geometry, dt, speed_std)
    if record.rows == 0:
        raise ValueError(f"no {MIN_RUN} samples without a gap")
    point = _linearise(record, theta, record.rates)
    information = _weigh(record, point, noise, record.speed_process(theta)).information
    bound: Array = np.sqrt(np.diag(_inverse(information)))
    return bound


# ---- the record ------------------------------------------------------------------------------


class _Record:
    """Gapless runs of a record, ready to be integrated.

    Attributes:
        gyro: of each run, (n, 3) less the complementary filter's mean bias, rad/s.
        rates: of each run, (n, 3) rad/s.
        speed_variance: (rotors,) (rad/s)^2; zeros if not given.
    """

    def __init__(
        self, samples: Samples, geometry: Array, dt: float, speed_std: float | Array | None
    ) -> None:
        self.dt = dt
        self.geometry = geometry
        there = complete_rows(np.hstack([samples.gyro, samples.rates, samples.speeds]))
        parts = [part for part, ok in runs(there) if ok and part.stop - part.start >= MIN_RUN]
        self.gyro: list[Array] = []
        self.rates: list[Array] = []
        for part in parts:
            inner = slice(part.start + SPLINE_END, part.stop - SPLINE_END)
            gyro, rates = samples.gyro[inner], samples.rates[inner]
            self.gyro.append(gyro - np.mean(gyro - rates, axis=0))
            self.rates.append(rates)
        self.propagators = [Propagator(geometry, samples.speeds[part], dt) for part in parts]
        self.rows = sum(len(part) for part in self.gyro)
        rotors = geometry.shape[1]
        level = 0.0 if speed_std is None else np.asarray(speed_std, dtype=float)
        self.speed_variance: Array = np.broadcast_to(level, (rotors,)) ** 2
        squares = sum(np.sum(samples.speeds[part] ** 2, axis=0) for part in parts)
        self._mean_square = np.zeros(rotors) + squares / max(self.rows, 1)

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
        effect = self.speed_inputs() @ rb.forward_matrix(theta).T
        covariance: Array = effect.T @ effect
        return covariance


@dataclass(frozen=True)
class _Point:
    """Where the model is linearised."""

    theta: Array
    rates: list[Array]
    transitions: list[Transition]


def _linearise(record: _Record, theta: Array, rates: list[Array]) -> _Point:
    transitions = [
        propagator(theta, w) for propagator, w in zip(record.propagators, rates, strict=True)
    ]
    return _Point(theta, rates, transitions)


@dataclass(frozen=True)
class _Weighed:
    """A linearised model, weighed by a noise model.

    Attributes:
        whiteners: of each run.
        residuals: of each run, (n, 3), white and of unit variance if all is right.
        sensitivities: of each run, (n, 3, N_THETA), their derivatives by theta.
        excess: (N_THETA,) expected gradient at the truth, from noise of the speeds.
        gradient: (N_THETA,) of half the sum of squared residuals, corrected.
        scatter: (N_THETA, N_THETA) covariance of the gradient.
        information: (N_THETA, N_THETA) expected slope of the gradient.
        squares: half the sum of squared residuals, what the gradient belongs to. Without the
            determinant: noise of the speeds makes that change with theta, and the profile over
            the true speeds has none.
        log_determinant: of the innovations' covariances.
    """

    whiteners: list[Whitener]
    residuals: list[Array]
    sensitivities: list[Array]
    excess: Array
    gradient: Array
    scatter: Array
    information: Array
    squares: float
    log_determinant: float


def _weigh(record: _Record, point: _Point, noise: Noise, known: Array) -> _Weighed:
    """Weigh a linearised model.

    Args:
        record: of the flight.
        point: where it is linearised.
        noise: of the axes.
        known: (3, 3) covariance of what noise of the speeds does. Held while theta is searched
            for: the gradient is that of the squares at fixed weights.
    """
    rate_std = initial_std(noise, known, record.dt)
    whiteners, residuals, sensitivities = [], [], []
    gradient, scatter = np.zeros(rb.N_THETA), np.zeros((rb.N_THETA, rb.N_THETA))
    squares = log_determinant = 0.0
    for gyro, rates, by in zip(record.gyro, point.rates, point.transitions, strict=True):
        whitener = make_whitener(noise, known, by.by_rate, rate_std, record.dt)
        steps = np.concatenate([(by.rates - rates[1:])[..., None], by.by_theta], axis=2)
        measured = np.zeros((len(gyro), *steps.shape[1:]))
        measured[..., 0] = gyro - rates
        white = whitener.whiten(measured, steps)
        v, V = white[..., 0], white[..., 1:]
        columns = V.reshape(-1, rb.N_THETA)
        gradient += columns.T @ v.ravel()
        scatter += columns.T @ columns
        squares += 0.5 * float(np.sum(v * v))
        log_determinant += whitener.log_determinant
        whiteners.append(whitener)
        residuals.append(v)
        sensitivities.append(V)
    information, excess = scatter, np.zeros(rb.N_THETA)
    if record.speed_variance.any():
        excess, surplus = _speed_noise_terms(record, point, whiteners)
        information = scatter - surplus
    return _Weighed(
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
    record: _Record, point: _Point, whiteners: list[Whitener]
) -> tuple[Array, Array]:
    """What noise of the rotor speeds adds to gradient and information, by expectation.

    The response to one sample's noise, taken in the middle of the longest run, stands for all.
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
    Q, G = rb.forward_jacobian(point.theta)
    torque = record.speed_inputs()
    change = np.sqrt(record.speed_variance.sum())
    dH = rb.SIGNALS.index("dH")
    by_torque = np.einsum("kis,rs->kri", G, torque)
    by_change = change * G[:, :, dH]
    excess = np.einsum("kri,ij,rj->k", by_torque, energy[:3, :3], torque @ Q.T)
    excess += by_change @ energy[3:, 3:] @ (change * Q[:, dH])
    surplus = np.einsum("kri,ij,lrj->kl", by_torque, energy[:3, :3], by_torque)
    surplus += by_change @ energy[3:, 3:] @ by_change.T
    return record.rows * excess, record.rows * surplus


# ---- the search ------------------------------------------------------------------------------


def _search(record: _Record, start: Array, prior: Prior | None) -> LikelihoodFit:
    mean, weight = prior or (start, np.zeros((rb.N_THETA, rb.N_THETA)))

    def cost_of(weighed: _Weighed, theta: Array) -> float:
        off = theta - mean
        return weighed.squares + 0.5 * float(off @ weight @ off)

    point = _linearise(record, start, record.rates)
    noise = rough_noise(_defects(record, point), record.dt)
    known = record.speed_process(start)
    weighed: _Weighed | None = None
    damping, converged, refits = 0.0, False, 0
    for iteration in range(_MAX_ITERATIONS):
        if 0 < iteration < _NOISE_REFITS:
            noise, weighed = _fit_noise(record, point), None
            known = record.speed_process(point.theta)
        if weighed is None:
            weighed = _weigh(record, point, noise, known)
        cost = cost_of(weighed, point.theta)
        gradient = weighed.gradient + weight @ (point.theta - mean)
        information = weighed.information + weight
        scatter = weighed.scatter + weight
        found: _Point | None = None
        after: _Weighed | None = None
        while found is None and damping < _MAX_DAMPING:
            step = -_inverse(information, damping) @ gradient
            # In standard deviations, squared.
            size = float(step @ scatter @ step)
            if rb.is_physical(point.theta + step):
                candidate = _moved(record, point, weighed, step)
                if size < _SMALL**2:
                    # The cost changes by less than its linearisation's error.
                    found = candidate
                    continue
                after = _weigh(record, candidate, noise, known)
                pulled = float(weighed.excess @ step)
                if cost_of(after, candidate.theta) < cost + pulled + _SMALL**2:
                    found = candidate
                    continue
            damping = max(10.0 * damping, 1e-3)
        if found is None:
            break
        point, weighed = found, after
        if size < _SETTLED**2:
            # Settled for this noise; is it still the likeliest?
            refits += 1
            latest = _fit_noise(record, point) if refits < _MAX_REFITS else noise
            if _alike(noise, latest):
                converged = True
                break
            noise, weighed = latest, None
            known = record.speed_process(point.theta)
        damping = 0.1 * damping if damping > 1e-6 else 0.0
    if weighed is None:
        weighed = _weigh(record, point, noise, known)
    return _conclude(record, point, noise, weighed, weight, converged)


def _alike(one: Noise, other: Noise) -> bool:
    """Whether two noise models weigh alike."""

    def numbers(noise: Noise) -> Array:
        return np.array(
            [
                [n.white_std, n.process_std, n.corner or 1.0, n.zero, n.moment_std, n.moment_tau]
                for n in noise
            ]
        )

    a, b = numbers(one), numbers(other)
    same = all((m.corner is None) == (n.corner is None) for m, n in zip(one, other, strict=True))
    return same and bool(np.all(np.abs(a - b) <= _ALIKE * np.maximum(np.abs(a), np.abs(b))))


def _fit_noise(record: _Record, point: _Point) -> Noise:
    known = np.diag(record.speed_process(point.theta))
    changes = np.concatenate([np.diff(rates, axis=0) for rates in point.rates]) / record.dt
    floor = MODEL_PRECISION * np.sqrt(np.mean(changes * changes, axis=0))
    return fit_noise(_defects(record, point), known, floor, record.dt)


def _defects(record: _Record, point: _Point) -> list[Array]:
    """Of each run (n - 1, 3) increments of the gyro less those of the model, rad/s."""
    return [
        np.diff(gyro, axis=0) - (by.rates - rates[:-1])
        for gyro, rates, by in zip(record.gyro, point.rates, point.transitions, strict=True)
    ]


def _moved(record: _Record, point: _Point, weighed: _Weighed, step: Array) -> _Point:
    """The point a step of theta away, with the rates that are likeliest there."""
    rates = []
    for whitener, gyro, w, by in zip(
        weighed.whiteners, record.gyro, point.rates, point.transitions, strict=True
    ):
        rates.append(w + whitener.smooth(gyro - w, by.rates - w[1:] + by.by_theta @ step))
    return _linearise(record, point.theta + step, rates)


def _conclude(
    record: _Record,
    point: _Point,
    noise: Noise,
    weighed: _Weighed,
    weight: Array,
    converged: bool,
) -> LikelihoodFit:
    v = np.concatenate(weighed.residuals)
    # The noise's overall level once more, now with what the fit took counted.
    level = float(np.sum(v * v)) / (v.size - rb.N_THETA)
    bread = _inverse(weighed.information / level + weight)
    bound = np.sqrt(np.diag(bread))
    covariance = bread @ (weighed.scatter / level + weight) @ bread
    autocorrelation = _autocorrelation(weighed.residuals, _LAGS)
    whiteness = _ljung_box(autocorrelation, len(v))
    if np.any(whiteness < _WHITE):
        scores = _batch_scores(record, weighed) / level
        coloured = sandwich(bread, scores)
        missing = np.maximum(np.diag(covariance) - np.diag(coloured), 0.0)
        covariance = coloured + np.diag(missing)
    x, y, z = (axis.scaled(float(np.sqrt(level))) for axis in noise)
    return LikelihoodFit(
        theta=point.theta,
        covariance=covariance,
        bound=bound,
        noise=(x, y, z),
        speed_process_std=np.sqrt(np.diag(record.speed_process(point.theta))),
        whiteness=whiteness,
        lag_one=autocorrelation[0],
        log_likelihood=-weighed.squares
        - 0.5 * (weighed.log_determinant + v.size * float(np.log(2.0 * np.pi))),
        rows=record.rows,
        seconds=record.rows * record.dt,
        converged=converged,
    )


def _batch_scores(record: _Record, weighed: _Weighed) -> Array:
    length = max(1, round(_BATCH_TIME / record.dt))
    parts = []
    for v, V in zip(weighed.residuals, weighed.sensitivities, strict=True):
        products = np.einsum("ni,nik->nk", v, V) - weighed.excess / record.rows
        parts.append(np.add.reduceat(products, np.arange(0, len(v), length), axis=0))
    return np.concatenate(parts)


def _autocorrelation(residuals: list[Array], lags: int) -> Array:
    """(lags, 3); products across gaps are left out."""
    power = sum(np.sum(v * v, axis=0) for v in residuals)
    sums = [
        sum(np.sum(v[lag:] * v[:-lag], axis=0) for v in residuals) for lag in range(1, lags + 1)
    ]
    ratio: Array = np.array(sums) / power
    return ratio


def _ljung_box(autocorrelation: Array, n: int) -> Array:
    """(3,) p-values of (lags, 3) autocorrelations of n values."""
    lags = np.arange(1, len(autocorrelation) + 1)[:, None]
    statistic = n * (n + 2.0) * np.sum(autocorrelation**2 / (n - lags), axis=0)
    p: Array = chdtrc(len(autocorrelation), statistic)
    return p


def _inverse(information: Array, damping: float = 0.0) -> Array:
    """Inverse of an information matrix whose entries differ in size, perhaps damped."""
    d = np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information / np.outer(d, d)
    # Taking noise out can leave a direction that nothing moves without any information.
    lowest = float(np.linalg.eigvalsh(scaled)[0])
    ridge = damping + max(_RIDGE, _RIDGE - lowest)
    inverse: Array = np.linalg.inv(scaled + ridge * np.eye(len(d))) / np.outer(d, d)
    return inverse
