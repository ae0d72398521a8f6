"""What others would use: the article's chains and general-purpose estimators.

All are given the momentum balance's k_T / m, so that it is the rotation that is compared. Each
filter's length, and the filter's level of noise, is the one of the list with the least error on
TUNING_SEEDS, known truth and all, which no user could do better.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.signal import savgol_filter
from statsmodels.regression.recursive_ls import RecursiveLS

from benchmarks.accuracy.estimators import Outcome, in_percent, online, outcome
from gcs_sysid.arrays import Array
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.record.article_estimator import Method
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.signals.samples import Samples
from testbed.article_flights import GEOMETRY, VEHICLE, fly, measure
from testbed.study import in_processes

TUNING_SEEDS = (100001, 100002, 100003)
"""The unscented filter, which takes long, is tuned on the first alone."""
_LABELS: dict[Method, str] = {
    "article": "article, as printed",
    "article-usual-td": "article, usual TD",
    "article-stepwise": "article, stepwise",
    "central-difference": "central differences + RLS",
}
_WINDOWS = {"paper": (3, 5, 7, 9, 11, 15), "mems": (5, 9, 15, 31, 51, 75, 101)}
_LEVELS = (0.03, 0.1, 0.3, 1.0)
START = np.array([80.0, 80.0, 140.0, 0.0, 0.0, 0.0, 0.08, 0.04, 0.03])
"""Start of the iterative ones: moments to a few per cent, as from a drawing; no products."""
_SIZE = np.array([80.0, 80.0, 140.0, 10.0, 10.0, 10.0, 0.1, 0.1, 0.03])

Peer = Callable[[Samples, float, float], tuple[Array, Array]]
"""Samples, dt and setting to theta (9,) and its standard deviation, relative to k_T."""


def _smoothed(samples: Samples, dt: float, setting: float) -> tuple[Array, Array, Array]:
    """Rates, accelerations and rotor signals, all through one Savitzky-Golay filter.

    It is cubic, but for the shortest: three points hold a parabola.
    """
    n = int(setting)
    order = min(3, n - 1)
    rotors, _ = rb.rotor_signals(GEOMETRY, samples.speeds)
    rates = savgol_filter(samples.rates, n, order, axis=0)
    accelerations = savgol_filter(samples.rates, n, order, deriv=1, delta=dt, axis=0)
    return rates, accelerations, savgol_filter(rotors, n, order, axis=0)


def nonlinear_least_squares(samples: Samples, dt: float, setting: float) -> tuple[Array, Array]:
    """scipy.optimize.least_squares on the Newton-Euler equation's angular acceleration."""
    rates, accelerations, rotors = _smoothed(samples, dt, setting)
    x = np.column_stack([rotors, rb.rate_products(rates)])

    def residual(scaled: Array) -> Array:
        theta = np.append(scaled * _SIZE, np.zeros(rb.N_THETA - 9))
        Q = rb.forward_matrix(theta)[:, : x.shape[1]]
        return np.asarray((accelerations - x @ Q.T).ravel())

    found = least_squares(residual, START / _SIZE)
    variance = 2.0 * found.cost / (len(found.fun) - len(START))
    covariance = variance * np.linalg.inv(found.jac.T @ found.jac)
    return found.x * _SIZE, np.sqrt(np.diag(covariance)) * _SIZE


def recursive_least_squares(samples: Samples, dt: float, setting: float) -> tuple[Array, Array]:
    """Statsmodels RecursiveLS on the article's linear form.

    In any order the recursion ends alike, but the hover at the start of a flight has so little
    information that its diffuse start loses all digits there. Shuffled rows spare it that.
    """
    phi, y = rb.direct_rows(*_smoothed(samples, dt, setting))
    order = np.random.default_rng(0).permutation(y.size)
    found = RecursiveLS(y.ravel()[order], phi.reshape(-1, 9)[order] * _SIZE).fit()
    return np.asarray(found.params) * _SIZE, np.asarray(found.bse) * _SIZE


def _least_squares(samples: Samples, dt: float, setting: float) -> tuple[Array, Array]:
    """What the recursion ends with, at once: enough to choose the filter by."""
    phi, y = rb.direct_rows(*_smoothed(samples, dt, setting))
    found = np.linalg.lstsq(phi.reshape(-1, 9) * _SIZE, y.ravel(), rcond=None)[0]
    return found * _SIZE, np.full(9, np.nan)


def unscented_filter(samples: Samples, dt: float, setting: float) -> tuple[Array, Array]:
    """Filterpy's UKF on rates and parameters together; setting scales the gyro's noise."""
    spline = CubicSpline(np.arange(len(samples.speeds)) * dt, samples.speeds)
    halves, _ = rb.rotor_signals(GEOMETRY, spline(np.arange(2 * len(samples.speeds) - 1) * dt / 2))

    def advance(state: Array, _: float, u: Array) -> Array:
        w = state[:3]
        Q = rb.forward_matrix(np.append(state[3:] * _SIZE, np.zeros(rb.N_THETA - 9)))[:, :10]
        drive = u @ Q[:, :4].T
        products = Q[:, 4:]

        def slope(k: int, w: Array) -> Array:
            p, q, r = w
            turning: Array = products @ np.array([q * r, r * p, p * q, p * p, q * q, r * r])
            turning += drive[k]
            return turning

        a = slope(0, w)
        b = slope(1, w + 0.5 * dt * a)
        c = slope(1, w + 0.5 * dt * b)
        d = slope(2, w + dt * c)
        return np.concatenate([w + dt / 6.0 * (a + 2.0 * b + 2.0 * c + d), state[3:]])

    points = MerweScaledSigmaPoints(12, alpha=0.1, beta=2.0, kappa=0.0)
    ukf = UnscentedKalmanFilter(12, 3, dt, lambda state: state[:3], advance, points)
    sigma = 0.02 * setting
    ukf.x = np.concatenate([samples.rates[0], START / _SIZE])
    ukf.P = np.diag([sigma**2] * 3 + [0.1**2] * 3 + [0.3**2] * 3 + [0.3**2] * 2 + [0.1**2])
    ukf.R = sigma**2 * np.eye(3)
    ukf.Q = np.diag([1e-8] * 3 + [0.0] * 9) + 1e-14 * np.eye(12)
    for k in range(1, len(samples.rates)):
        ukf.predict(u=halves[2 * k - 2 : 2 * k + 1])
        ukf.update(samples.rates[k])
    return ukf.x[3:] * _SIZE, np.sqrt(np.diag(ukf.P)[3:]) * _SIZE


OUTSIDE: dict[str, Peer] = {
    "scipy least_squares, Savitzky-Golay": nonlinear_least_squares,
    "statsmodels RecursiveLS, Savitzky-Golay": recursive_least_squares,
    "filterpy UKF, joint state": unscented_filter,
}


def settings_of(peer: str, noise: str) -> tuple[float, ...]:
    """What is tried; the UKF takes a minute and more a flight at 250 Hz, and is left out there."""
    if "UKF" in peer:
        return _LEVELS if noise == "paper" else ()
    return _WINDOWS[noise]


def _physical(theta: Array, std: Array, fit: Fit) -> Outcome:
    assert fit.translation is not None
    k_T = fit.translation.kappa * VEHICLE.mass
    scale = np.array([k_T] * 6 + [1.0, 1.0, k_T])
    value, std = theta * scale, std * scale
    k_T_std = fit.translation.kappa_std * VEHICLE.mass
    return in_percent(
        np.concatenate([value[:8], [k_T], value[8:]]),
        np.concatenate([std[:8], [k_T_std], std[8:]]),
    )


def _flown(noise: str, seed: int) -> tuple[Samples, float]:
    rate = 20 if noise == "paper" else 250
    return measure(fly("paper", rate), noise, 0.02, seed), 1.0 / rate


def _score(task: tuple[str, str, float]) -> float:
    """Mean error of the ten parameters with a setting, in %."""
    noise, name, setting = task
    peer = _least_squares if "RecursiveLS" in name else OUTSIDE[name]
    errors = []
    for seed in TUNING_SEEDS[:1] if "UKF" in name else TUNING_SEEDS:
        samples, dt = _flown(noise, seed)
        found = _physical(*peer(samples, dt, setting), online(samples, dt))
        errors.append(found["error"])
    return float(np.mean(np.abs(errors)))


@lru_cache
def tune(noise: str) -> dict[str, float]:
    """The setting of each outside estimator with the least error."""
    _flown(noise, TUNING_SEEDS[0])
    names = [name for name in OUTSIDE if settings_of(name, noise)]
    tasks = [(noise, name, s) for name in names for s in settings_of(name, noise)]
    tasks.sort(key=lambda task: "UKF" not in task[1])  # the long ones first
    scores = dict(zip(tasks, in_processes(_score, tasks), strict=True))
    return {
        name: min(settings_of(name, noise), key=lambda s: scores[noise, name, s]) for name in names
    }


def all_of(samples: Samples, dt: float, fit: Fit, noise: str) -> dict[str, Any]:
    """Every peer on one flight; {label: outcome}, and the settings chosen."""
    out: dict[str, Any] = {}
    for method, label in _LABELS.items():
        out[label] = outcome(online(samples, dt, EstimatorTuning(method=method)))
    chosen = tune(noise)
    for name, setting in chosen.items():
        out[name] = _physical(*OUTSIDE[name](samples, dt, setting), fit)
    out["settings"] = chosen
    return out
