"""The offline estimator: maximum likelihood of a whole record, and its Cramer-Rao bound.

The rotation is a stochastic state-space model (`gcs_sysid.estimation.offline.innovations`):

    w at the next sample = F(w, speeds; theta) + process noise,    gyro = w + bias + noise

with F the integral of w' = Q(theta) x over one sample (`gcs_sysid.estimation.offline.propagation`).
Where the process noise is nothing this is the output-error method, otherwise filter error
(Maine and Iliff, NASA RP-1168; Jategaonkar, Flight Vehicle System Identification, ch. 4, 5);
levels and colors of the noises are what the record itself makes likeliest. First rates and
gyro biases are states with priors, so that they are integrated out exactly.

The likelihood is maximized by Gauss-Newton. The model is linearized about smoothed rates, not
about the noisy gyro; residuals and sensitivities pass one whitening filter; their products are
gradient and Fisher information.

Noise of the rotor speeds is in regressors and residuals at once, which pulls estimates towards
zero. The profile over the true speeds has no such pull: with L(theta) from speed noise to
residual, E[gradient] = tr(dL' S^-1 L) and the noise's part in the information
tr(dL' S^-1 dL) are taken out where the level is given (Fuller, Measurement Error Models, 1.2).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit.priors import Unknown
from gcs_sysid.estimation.noise.uncertainty import sandwich
from gcs_sysid.estimation.offline.innovations import (
    AxisNoise,
    Noise,
    fit_noise,
    rough_noise,
)
from gcs_sysid.estimation.offline.offline_record import (
    MIN_RUN,
    N_FITTED,
    Linearization,
    OfflineRecord,
    Weighed,
    linearize,
    weigh,
)
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.signals.samples import Samples

MODEL_PRECISION = 1e-4
"""Share of the angular acceleration that no model explains. Rotors that follow held commands
(250 Hz, 30 ms lag) leave about that between any samples of their speeds. A third of it would
leave biases of a standard deviation, half as much again costs more accuracy than it saves."""
_MAX_ITERATIONS = 25
_BUDGET = 3_000_000
"""Samples times passes: about five minutes of a processor, and a gigabyte for so many samples that
only _FEWEST passes are left."""
_FEWEST = 12
"""Passes; most searches settle in fewer."""
_NOISE_REFITS = 3
"""The noise model is refitted in this many first iterations, then where the search settles."""
_MAX_REFITS = 6
_ALIKE = 0.05
"""Relative change of the noise's levels that moves no estimate."""
_MAX_DAMPING = 1e9
_FIXED = 1e-9
"""s, of a delay that is not estimated."""
_SMALL = 0.3
"""Standard deviations; a smaller step is taken unseen."""
_SETTLED = 0.02
"""Standard deviations; a smaller step ends the search."""
DELAY_STD = 0.003
"""s, prior of the delay around the online estimate's: that depends on the window, and is off by 1.5
ms under unmodeled moments."""
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
        delay: s, of the rotor speeds.
        covariance: (N_FITTED, N_FITTED) of theta and delay; from the scatter of the score
            where residuals are not white.
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
        passes: of the search over the record.
    """

    theta: Array
    delay: float
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
    passes: int = 0

    @property
    def std(self) -> Array:
        """(N_THETA,) standard deviations of theta."""
        std: Array = np.sqrt(np.diag(self.covariance))[: rb.N_THETA]
        return std


class NoInformationError(ArithmeticError):
    """A flight has none on some unknown."""


def maximize_likelihood(
    samples: Samples,
    geometry: Array,
    dt: float,
    start: Array,
    speed_std: float | Array | None = None,
    prior: Prior | None = None,
    delay: float | None = None,
    torque: Array | float = 0.0,
    progress: Callable[[float], None] | None = None,
) -> LikelihoodFit | None:
    """Fit theta, noise levels and noise colors to a whole record.

    Args:
        samples: on a uniform grid; NaN in gyro, rates or speeds marks gaps.
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
        start: (N_THETA,) the online estimate (`RotationFit.theta`), physical.
        speed_std: rad/s, white noise of the rotor speeds, one value or (rotors,). None: what
            of it shows is taken as unmodeled acceleration.
        prior: on theta.
        delay: s, of the speeds' stamps behind the gyro's, as known from the online estimate; it is
            estimated too, within 3 DELAY_STD of that. None: there is none.
        torque: (3, N_SIGNALS) of deviations from the model, as the online estimate has them.
        progress: called with the share of the maximum number of passes that is done.

    Returns:
        The fit, or None if there is no piece of MIN_RUN samples without a gap, or fewer samples
        than twice the unknowns.

    Raises:
        NoInformationError: on some unknown, as noise of the rotor speeds outweighs the motion.
        ValueError: `start` is no rigid body's inertia.
    """
    if not rb.is_physical(start):
        raise ValueError("the starting inertia is not that of a rigid body")
    reach = 0.0 if delay is None else 3.0 * DELAY_STD
    record = OfflineRecord(samples, geometry, dt, speed_std, delay or 0.0, reach, torque)
    if record.rows < 2 * rb.N_THETA:
        return None
    # A step too far overflows, costs more than any other, and is taken back.
    with np.errstate(over="ignore", invalid="ignore"):
        return _search(record, start, prior, progress or (lambda share: None))


def most_passes(samples: int) -> int:
    """Maximum number of passes over a record; 0: it is too long."""
    passes = min(_BUDGET // max(samples, 1), _MAX_ITERATIONS)
    return passes if passes >= _FEWEST else 0


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
        theta: (N_THETA,) where to linearize.
        noise: of the axes.
        speed_std: rad/s, white noise of the rotor speeds.

    Raises:
        ValueError: there is no piece of MIN_RUN samples without a gap.
    """
    record = OfflineRecord(samples, geometry, dt, speed_std)
    if record.rows == 0:
        raise ValueError(f"no {MIN_RUN} samples without a gap")
    point = linearize(record, theta, record.rates)
    n = rb.N_THETA
    information = weigh(record, point, noise, record.speed_process(theta)).information[:n, :n]
    bound: Array = np.sqrt(np.diag(_inverse(information)))
    return bound


# ---- the search ------------------------------------------------------------------------------


def _search(
    record: OfflineRecord, start: Array, prior: Prior | None, progress: Callable[[float], None]
) -> LikelihoodFit:
    mean, weight = np.append(start, record.delay), np.zeros((N_FITTED, N_FITTED))
    if prior is not None:
        mean[: rb.N_THETA], weight[: rb.N_THETA, : rb.N_THETA] = prior
    free = record.delay_bounds[1] > record.delay_bounds[0]
    # Next to a fixed delay's weight nothing counts.
    weight[Unknown.DELAY, Unknown.DELAY] = 1.0 / (DELAY_STD if free else _FIXED) ** 2

    def cost_of(weighed: Weighed, unknowns: Array) -> float:
        off = unknowns - mean
        return weighed.squares + 0.5 * float(off @ weight @ off)

    point = linearize(record, start, record.rates)
    noise = rough_noise(_defects(record, point), record.dt)
    known = record.speed_process(start)
    weighed: Weighed | None = None
    damping, converged, refits = 0.0, False, 0
    before, reweighted = 0.0, True
    passes = max(most_passes(record.rows), _FEWEST)
    for iteration in range(passes):
        progress(iteration / passes)
        if 0 < iteration < _NOISE_REFITS:
            noise, weighed, reweighted = _fit_noise(record, point), None, True
            known = record.speed_process(point.theta)
        if weighed is None:
            weighed = weigh(record, point, noise, known)
        unknowns = np.append(point.theta, record.delay)
        cost = cost_of(weighed, unknowns)
        gradient = weighed.gradient + weight @ (unknowns - mean)
        information = weighed.information + weight
        if not (np.diag(information) > 0.0).all():
            raise NoInformationError("noise of the rotor speeds outweighs the motion")
        scatter = weighed.scatter + weight
        # Fast changes of the speeds, noise among them, make more of the delay's information than
        # there is: steps fall short by one share, which two of them show (Aitken).
        wanted = -float((_inverse(information) @ gradient)[Unknown.DELAY])
        short = 0.0 if not before or reweighted else wanted / before
        ahead = 1.0 / (1.0 - short) if 0.2 < short < 0.9 else 1.0
        before, reweighted = (0.0 if ahead > 1.0 else wanted), False
        found: Linearization | None = None
        after: Weighed | None = None
        while found is None and damping < _MAX_DAMPING:
            step = -_inverse(information, damping) @ gradient
            to = np.clip(
                unknowns[Unknown.DELAY] + ahead * step[Unknown.DELAY], *record.delay_bounds
            )
            step[Unknown.DELAY] = to - unknowns[Unknown.DELAY]
            # In standard deviations, squared.
            size = float(step @ scatter @ step)
            if rb.is_physical(point.theta + step[: rb.N_THETA]):
                candidate = _moved(record, point, weighed, step)
                if size < _SMALL**2:
                    # The cost changes by less than its linearization's error.
                    found = candidate
                    continue
                after = _weigh_far(record, candidate, noise, known)
                pulled = float(weighed.excess @ step)
                most = cost + pulled + _SMALL**2
                if after is not None and cost_of(after, unknowns + step) < most:
                    found = candidate
                    continue
                record.align(unknowns[Unknown.DELAY])
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
            noise, weighed, reweighted = latest, None, True
            known = record.speed_process(point.theta)
        damping = 0.1 * damping if damping > 1e-6 else 0.0
    if weighed is None:
        weighed = weigh(record, point, noise, known)
    progress(1.0)
    done = replace(
        _conclude(record, point, noise, weighed, weight, converged), passes=iteration + 1
    )
    return done


def _weigh_far(
    record: OfflineRecord, point: Linearization, noise: Noise, known: Array
) -> Weighed | None:
    """A step's end weighed; None so far off that the filter's covariances overflow."""
    try:
        return weigh(record, point, noise, known)
    except np.linalg.LinAlgError:
        return None


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


def _fit_noise(record: OfflineRecord, point: Linearization) -> Noise:
    known = np.diag(record.speed_process(point.theta))
    changes = np.concatenate([np.diff(rates, axis=0) for rates in point.rates]) / record.dt
    floor = MODEL_PRECISION * np.sqrt(np.mean(changes * changes, axis=0))
    return fit_noise(_defects(record, point), known, floor, record.dt)


def _defects(record: OfflineRecord, point: Linearization) -> list[Array]:
    """Of each run (n - 1, 3) increments of the gyro less those of the model, rad/s."""
    return [
        np.diff(gyro, axis=0) - (by.rates - rates[:-1])
        for gyro, rates, by in zip(record.gyro, point.rates, point.transitions, strict=True)
    ]


def _moved(
    record: OfflineRecord, point: Linearization, weighed: Weighed, step: Array
) -> Linearization:
    """The point a step away, with the rates that are likeliest there; the record is aligned."""
    rates = []
    for whitener, gyro, w, by in zip(
        weighed.whiteners, record.gyro, point.rates, point.transitions, strict=True
    ):
        moved = by.by_theta @ step[: rb.N_THETA] + by.by_delay * step[Unknown.DELAY]
        rates.append(w + whitener.smooth(gyro - w, by.rates - w[1:] + moved))
    record.align(record.delay + step[Unknown.DELAY])
    return linearize(record, point.theta + step[: rb.N_THETA], rates)


def _conclude(
    record: OfflineRecord,
    point: Linearization,
    noise: Noise,
    weighed: Weighed,
    weight: Array,
    converged: bool,
) -> LikelihoodFit:
    v = np.concatenate(weighed.residuals)
    # The noise's overall level once more, now with what the fit took counted.
    level = float(np.sum(v * v)) / (v.size - rb.N_THETA)
    bread = _inverse(weighed.information / level + weight)
    bound = np.sqrt(np.diag(bread))[: rb.N_THETA]
    covariance = bread @ (weighed.scatter / level + weight) @ bread
    autocorrelation = _autocorrelation(weighed.residuals, _LAGS)
    whiteness = _ljung_box(autocorrelation, len(v))
    if np.any(whiteness < _WHITE):
        scores = _batch_scores(record, weighed) / level
        colored = sandwich(bread, scores)
        missing = np.maximum(np.diag(covariance) - np.diag(colored), 0.0)
        covariance = colored + np.diag(missing)
    x, y, z = (axis.scaled(float(np.sqrt(level))) for axis in noise)
    return LikelihoodFit(
        theta=point.theta,
        delay=record.delay,
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


def _batch_scores(record: OfflineRecord, weighed: Weighed) -> Array:
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
