"""The program's own estimators, and the bound that no estimator beats on average."""

from dataclasses import replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit.priors import N_UNKNOWNS, Unknown
from gcs_sysid.estimation.offline.innovations import AxisNoise, Noise
from gcs_sysid.estimation.offline.likelihood import cramer_rao_bound, maximize_likelihood
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.online.online import OnlineEstimator
from gcs_sysid.estimation.record.input_noise import ROUNDING_STD
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.scale_reference import ScaleReference
from gcs_sysid.results.summary import values_of
from gcs_sysid.signals.samples import Samples
from sim_bridge.sensors import CORNER
from testbed.article import NAMES
from testbed.article_flights import ARM, GEOMETRY, TRUTH, VEHICLE, exact, fly

Outcome = dict[str, list[float]]
"""error and std of the ten parameters, both in % of the truth."""


def true_theta() -> Array:
    """(N_THETA,) of the vehicle flown."""
    return rb.theta_of(VEHICLE.truth(), VEHICLE.k_T)


def online(samples: Samples, dt: float, tuning: EstimatorTuning | None = None) -> Fit:
    """The online estimator at the end of a flight."""
    estimator = OnlineEstimator(GEOMETRY, dt, tuning or EstimatorTuning())
    estimator.update(samples)
    return estimator.fit()


def offline(samples: Samples, dt: float, start: Fit, speed_std: float | None) -> Fit:
    """Maximum likelihood, from the online estimate; the translation stays the online one."""
    assert start.rotation is not None
    found = maximize_likelihood(samples, GEOMETRY, dt, start.rotation.theta, speed_std)
    assert found is not None
    full = np.zeros((N_UNKNOWNS, N_UNKNOWNS))
    full[: Unknown.DELAY + 1, : Unknown.DELAY + 1] = found.covariance
    n = rb.N_THETA
    rotation = replace(
        start.rotation, theta=found.theta, covariance=full[:n, :n], full_covariance=full
    )
    return replace(start, rotation=rotation)


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
    drive = sigma * np.sqrt(0.5 * (1.0 + np.exp(-CORNER * dt)))
    axis = AxisNoise(float(drive), CORNER, 1.0, 0.0)
    return axis, axis, axis


def white_noise(sigma: float) -> Noise:
    """The same standard deviation, white."""
    axis = AxisNoise(sigma, None, 0.0, 0.0)
    return axis, axis, axis


def bound(mission: str, rate: float, noise: Noise, *, rounded: bool) -> list[float]:
    """Ten least standard deviations in % (Cramér-Rao), scale known; NaN for k_T."""
    samples = exact(fly(mission, rate))
    level = ROUNDING_STD if rounded else None
    std = cramer_rao_bound(samples, GEOMETRY, 1.0 / rate, true_theta(), noise, level)
    core = [*range(rb.CG_Y + 1), rb.MOMENT_RATIO]
    percent = 100.0 * std[core] / np.abs(true_theta()[core])
    # k_T rests on the translation, which this bound says nothing of.
    return [*percent[:8].tolist(), float("nan"), float(percent[8])]
