"""The offline estimate of a flight, started from the online fit.

Where rows are whitened, the samples are processed a second time with the maximum-likelihood noise
model (`filter_error`). Where they are those of the window, at slow rates and behind a low-pass, the
likelihood of the whole record is maximized (`estimation.offline.likelihood`). By what the estimate
differs from the online one beyond chance its intervals are wider.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.changes.tracking import Tracker
from gcs_sysid.estimation.fit.priors import N_UNKNOWNS, Prior
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.offline.filter_error import likeliest_noise, offline_bank, residual_runs
from gcs_sysid.estimation.offline.instrumental_variables import combined, fit_by_instruments
from gcs_sysid.estimation.offline.likelihood import (
    LikelihoodFit,
    NoInformationError,
    maximize_likelihood,
    most_passes,
)
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.online.online import OnlineEstimator
from gcs_sysid.estimation.record.input_noise import with_sparse_readings
from gcs_sysid.intervals import Z95
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.signals.one_step import step_for
from gcs_sysid.signals.samples import Samples

_LOOKS = 3
"""Most second looks: the noise is that of residuals, which change with the fit."""
_SETTLED = 0.1
"""Standard deviations that another look at the noise moves the moments of inertia by at most."""

Progress = Callable[[str, float], None]
"""Called with the current step and the share of it that is done, 0 to 1."""


@dataclass(frozen=True)
class OfflineFit:
    """The offline estimate.

    Attributes:
        fit: the online one with the rotation replaced.
        bounding_fit: the same with the Cramer-Rao bound as its covariance.
        method: which estimator it is of, in words.
        likelihood: how the maximum looks; None where the noise alone was looked for.
        apart: (N_THETA,) by how much it differs from the online one, beyond chance and more than
            its own standard deviation; else 0. Its intervals hold that.
    """

    fit: Fit
    bounding_fit: Fit
    method: str
    likelihood: LikelihoodFit | None = None
    apart: Array = field(default_factory=lambda: np.zeros(rb.N_THETA))


def fit_offline(
    tracker: Tracker, online: Fit, progress: Progress | None = None
) -> OfflineFit | str:
    """Estimate offline from the samples that the tracker kept.

    Args:
        tracker: with `keep`.
        online: its last fit.
        progress: called with the current step and the share of it that is done.

    Returns:
        The fit, or why there is none.
    """
    if online.rotation is None or not tracker.kept:
        return "no online estimate to start from"
    on_progress = progress or (lambda what, share: None)
    if online.rotation.whiteners:
        # White process noise is no model of disturbed air, and in calm air no better one.
        found = _second_look(tracker, online, on_progress)
        return found or "the fit by the likeliest noise did not converge"
    return _maximum(tracker, online, on_progress)


def _second_look(tracker: Tracker, online: Fit, on_progress: Progress) -> OfflineFit | None:
    """By the likeliest noise of each axis; None where the record is too short for that."""
    assert online.rotation is not None
    dt, T = tracker.dt, step_for(tracker.dt).time
    judges, rotation = online.rotation.whiteners, online.rotation
    found: tuple[Fit, Array] | None = None
    chosen = False
    what = f"filter error over {sum(len(part.gyro) for part in tracker.kept)} samples"
    for look in range(_LOOKS):
        on_progress(what, look / _LOOKS)
        left = residual_runs(tracker.kept, tracker.geometry, dt, rotation)
        if not left:
            break
        models = likeliest_noise(left, T, rotation.whiteners)
        likelier = any(model.gain for model in models)
        if look and not likelier:
            break  # nothing new to see
        estimator = OnlineEstimator(
            tracker.geometry, dt, tracker.tuning, offline_bank(T, models, judges)
        )
        before = tracker.estimator
        estimator.prior, estimator.prior_source = before.prior, before.prior_source
        estimator.accelerometer_gain = before.accelerometer_gain
        for part in tracker.kept:
            estimator.update(part)
        fit = estimator.fit()
        if fit.rotation is None or not fit.rotation.converged:
            break
        moved = np.abs(fit.rotation.theta - rotation.theta)[:3] / fit.rotation.std[:3]
        found, rotation, chosen = (fit, estimator.bound), fit.rotation, chosen or likelier
        if moved.max() < _SETTLED:
            break
    on_progress(what, 1.0)
    if found is None:
        return None
    fit, bound = found
    assert fit.rotation is not None
    own, apart = _widened(fit.rotation, online.rotation)
    # With a fit's own residuals: those above are of the fit before.
    left = residual_runs(tracker.kept, tracker.geometry, dt, fit.rotation)
    own, instrumented = combined(own, fit_by_instruments(left, fit.rotation, T))
    fit = replace(fit, rotation=own, aligned_by=fit.rotation, other_layout=online.other_layout)
    bounded = replace(fit, rotation=replace(own, covariance=np.diag(bound**2)))
    method = "filter error" if chosen else "whitener bank"
    method = f"{method}, instruments" if instrumented else method
    return OfflineFit(fit, bounded, method, apart=apart)


def _widened(fit: RotationFit, online: RotationFit) -> tuple[RotationFit, Array]:
    """Disagreement beyond chance between two estimates of one flight counts as error of either.

    The online one weighs the same rows less well, so that by chance they differ by the difference
    of their variances (Hausman 1978, Econometrica 46, 1251-1271).
    """
    apart = fit.theta - online.theta
    # Two estimates differ by so much by chance.
    chance = Z95**2 * np.maximum(online.std**2 - fit.std**2, 0.0)
    error = np.sqrt(np.maximum(apart**2 - chance, 0.0)) * np.sign(apart)
    shown = np.where(np.abs(error) > fit.std, error, 0.0)
    return fit.widened(np.outer(error, error)), shown


def _maximum(tracker: Tracker, online: Fit, on_progress: Progress) -> OfflineFit | str:
    """By the maximum of the whole record's likelihood."""
    rotation = online.rotation
    assert rotation is not None
    samples = join(tracker.kept)
    what = f"maximum likelihood of {len(samples.gyro)} samples"
    passes = most_passes(len(samples.gyro))
    if not passes:
        return f"{what} is beyond its budget: analyze a part of the flight (--start, --end)"
    try:
        found = maximize_likelihood(
            samples,
            tracker.geometry,
            tracker.dt,
            rotation.theta,
            speed_std=tracker.estimator.speed_std,
            prior=_on_theta(tracker.estimator.prior),
            delay=rotation.delay,
            torque=rotation.deviating.torque(rotation.deviations),
            progress=lambda done: on_progress(f"{what}, at most {passes} passes", done),
        )
    except NoInformationError as error:
        return f"no {what}: {error}"
    if found is None:
        return "no gap-free stretch of flight is long enough"
    if not found.converged:
        if found.passes >= passes:
            return f"the {what} ran out of its budget of {passes} passes"
        return "the maximum-likelihood search did not converge"
    n = rb.N_THETA
    full = np.zeros((N_UNKNOWNS, N_UNKNOWNS))
    full[: n + 1, : n + 1] = found.covariance
    # What deviations from the model leave open is as open here, where they are taken as given.
    full[:n, :n] += rotation.open_covariance
    fit = replace(
        rotation,
        theta=found.theta,
        covariance=full[:n, :n],
        full_covariance=full,
        coordinates=np.array([found.delay, *rotation.coordinates[1:]]),
        # Without a prior the data determine all, and more than online.
        data_std=rotation.data_std if tracker.estimator.prior is not None else found.std,
    )
    if online.moments is not None:
        fit = with_sparse_readings(fit, tracker.tuning.speed_interval, online.moments.window)
    fit, apart = _widened(fit, rotation)
    bounding = replace(fit, covariance=np.diag(found.bound**2))
    online = replace(online, aligned_by=rotation)
    return OfflineFit(
        replace(online, rotation=fit),
        replace(online, rotation=bounding),
        "maximum likelihood",
        found,
        apart,
    )


def join(parts: Sequence[Samples]) -> Samples:
    """Blocks of samples as one."""
    return Samples(
        **{
            f.name: np.concatenate([getattr(part, f.name) for part in parts])
            for f in fields(Samples)
        }
    )


def _on_theta(prior: Prior | None) -> tuple[Array, Array] | None:
    if prior is None:
        return None
    n = rb.N_THETA
    return prior.mean[:n], prior.information[:n, :n]
