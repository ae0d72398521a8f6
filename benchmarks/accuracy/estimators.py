"""The program's own estimators, and the bound that no estimator beats on average."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit.deviations import DeviationChoice
from gcs_sysid.estimation.fit.problem import residual_maker
from gcs_sysid.estimation.noise.whitening import NONE, Whitener, corrected, torque_noise
from gcs_sysid.estimation.offline.kept_rows import SpeedRows, at_delay
from gcs_sysid.estimation.offline.likeliest_noise import innovations
from gcs_sysid.estimation.offline.prediction_error import estimate
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.online.online import OnlineEstimator
from gcs_sysid.estimation.record.input_noise import SpeedNoise
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.airframe import ScaleReference
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.results.summary import values_of
from gcs_sysid.signals.records import Samples
from sim_bridge.sensors import CORNER
from testbed.article import NAMES
from testbed.article_flights import ARM, GEOMETRY, TRUTH, VEHICLE, exact, fly

Outcome = dict[str, list[float]]
"""error and std of the ten parameters, both in % of the truth."""
Noise = tuple[float, Callable[[float, float], Whitener]]
"""(rad/s)^2 of the gyro, and the whitener of that for T in s and torque noise to so many Hz."""


def true_theta() -> Array:
    """(N_THETA,) of the vehicle flown."""
    return rb.theta_of(VEHICLE.truth(), VEHICLE.k_T)


def online(samples: Samples, dt: float, tuning: EstimatorTuning | None = None) -> Fit:
    """The online estimator at the end of a flight."""
    estimator = OnlineEstimator(GEOMETRY, dt, tuning or EstimatorTuning())
    estimator.update(samples)
    return estimator.fit()


def offline(samples: Samples, dt: float, start: Fit) -> Fit:
    """The prediction-error estimate, from the online one; the translation stays the online one.

    Args:
        samples: of a flight.
        dt: s between them.
        start: the online estimate.
    """
    assert start.rotation is not None
    known = replace(start.rotation, coordinates=at_delay(0.0))
    rows = SpeedRows([samples], GEOMETRY, dt, 0.0, 0.0, speed_noise(samples, dt))
    found = estimate(rows, known, choice=DeviationChoice(GEOMETRY))
    assert found is not None
    return replace(start, rotation=found.fit.rotation)


def speed_noise(samples: Samples, dt: float) -> Array:
    """(5, 5) covariance of the rotors' signals in a sample, as the program finds it."""
    noise = SpeedNoise(GEOMETRY, dt)
    noise.update(samples.speeds)
    return noise.of_signals


def at_known_mass(fit: Fit) -> dict[str, Estimate]:
    """The physical parameters at the scale of the known mass, as the program reports them."""
    return values_of(fit, ScaleReference("mass", VEHICLE.mass), ARM, {})


def outcome(fit: Fit) -> Outcome:
    """Errors of the physical parameters at the scale of the known mass."""
    found = at_known_mass(fit)
    values = [found[name] for name in NAMES]
    value = np.array([np.nan if v.value is None else v.value for v in values])
    std = np.array([np.nan if v.std is None else v.std for v in values])
    return in_percent(value, std)


def in_percent(value: Array, std: Array) -> Outcome:
    """Estimates of the ten parameters as errors; five digits are plenty."""
    return {
        "error": _short(100.0 * (value / TRUTH - 1.0)),
        "std": _short(100.0 * std / np.abs(TRUTH)),
    }


def _short(values: Array) -> list[float]:
    return [float(f"{v:.5g}") for v in values]


# ---- the bound -------------------------------------------------------------------------------


def article_noise(sigma: float, dt: float) -> Noise:
    """Of the gyro in the "paper" noise model: white noise through s / (s + corner)."""
    pole = float(np.exp(-CORNER * dt))
    return 0.5 * (1.0 + pole) * sigma**2, lambda T, f_u: corrected(T, CORNER, f_u)


def white_noise(sigma: float) -> Noise:
    """The same standard deviation, white."""
    return sigma**2, torque_noise


def bound(mission: str, rate: float, noise: Noise, *, rounded: bool) -> list[float]:
    """Ten least standard deviations in % (Cramér-Rao), scale known; NaN for k_T."""
    samples, theta = exact(fly(mission, rate)), true_theta()
    covariance = speed_noise(samples, 1.0 / rate) if rounded else np.zeros((5, 5))
    rows = SpeedRows([samples], GEOMETRY, 1.0 / rate, 0.0, 0.0, covariance)
    basis = rows.basis(at_delay(0.0))
    Q, G = rb.forward_jacobian(theta)
    P = basis.map_at(basis.at)
    TP = residual_maker(Q) @ P
    # Rounding of the speeds acts as torque noise does.
    walks = np.diag(TP @ rows.noise(basis, [NONE])[0] @ TP.T) * rows.time**2
    r, whitener_for = noise
    exceeded = np.sqrt(walks / r) / (2.0 * np.pi * rows.time)
    whiteners = [whitener_for(rows.time, float(f_u)) for f_u in exceeded]
    information = np.zeros((rb.N_THETA, rb.N_THETA))
    for run in rows.made(basis):
        for axis, whitener in enumerate(whiteners):
            x = innovations(run @ P[: rb.N_SIGNALS].T, whitener) @ G[:, axis].T
            information += x.T @ x * rows.time**2 * whitener.gyro_share / r
    d = np.sqrt(np.diag(information))
    std = np.sqrt(np.diag(np.linalg.inv(information / np.outer(d, d)))) / d
    core = [*range(rb.CG_Y + 1), rb.MOMENT_RATIO]
    percent = 100.0 * std[core] / np.abs(theta[core])
    # k_T rests on the translation, which this bound says nothing of.
    return [*percent[:8].tolist(), float("nan"), float(percent[8])]
