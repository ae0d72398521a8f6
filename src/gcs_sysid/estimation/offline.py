"""The offline estimate of a flight: maximum likelihood, started from the online fit."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.disturbance import RULES, axis_floor
from gcs_sysid.estimation.likelihood import LikelihoodFit, maximise_likelihood
from gcs_sysid.estimation.online import Fit
from gcs_sysid.estimation.priors import N_UNKNOWNS, Prior
from gcs_sysid.estimation.rotation import RotationFit
from gcs_sysid.estimation.tracking import Tracker
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.signals.samples import Samples


@dataclass(frozen=True)
class OfflineFit:
    """The offline estimate.

    Attributes:
        fit: the online one with the rotation replaced.
        bounding_fit: the same with the Cramer-Rao bound as its covariance.
        likelihood: how the maximum looks.
    """

    fit: Fit
    bounding_fit: Fit
    likelihood: LikelihoodFit


def fit_offline(tracker: Tracker, online: Fit) -> OfflineFit | str:
    """Maximise the likelihood of the samples that the tracker kept.

    Args:
        tracker: with `keep`.
        online: its last fit.

    Returns:
        The fit, or why there is none.
    """
    rotation = online.rotation
    if rotation is None or not tracker.kept:
        return "no online estimate to start from"
    found = maximise_likelihood(
        join(tracker.kept),
        tracker.geometry,
        tracker.dt,
        rotation.theta,
        speed_std=tracker.estimator.speed_std,
        prior=_on_theta(tracker.estimator.prior),
        delay=rotation.delay,
        torque=rotation.deviating.torque(rotation.deviations),
    )
    if found is None:
        return "no gap-free stretch of flight is long enough"
    if not found.converged:
        return "the maximum-likelihood search did not converge"
    n = rb.N_THETA
    full = np.zeros((N_UNKNOWNS, N_UNKNOWNS))
    full[: n + 1, : n + 1] = found.covariance
    full[:n, :n] += _systematic(rotation, found.theta)
    fit = replace(
        rotation,
        theta=found.theta,
        covariance=full[:n, :n],
        full_covariance=full,
        coordinates=np.array([found.delay, *rotation.coordinates[1:]]),
        # Without a prior the data tell all there is, and more than they told online.
        data_std=rotation.data_std if tracker.estimator.prior is not None else found.std,
    )
    bounding = replace(fit, covariance=np.diag(found.bound**2))
    online = replace(online, aligned_by=rotation)
    return OfflineFit(replace(online, rotation=fit), replace(online, rotation=bounding), found)


def _systematic(online: RotationFit, theta: Array) -> Array:
    """(N_THETA, N_THETA) of errors that the likelihood does not show.

    In disturbed air, by what the two estimators are apart, and the floor of the online one. What
    deviations from the model leave open is as open offline, where they are taken as given.
    """
    n = rb.N_THETA
    out = np.zeros((n, n))
    strong = online.disturbance > RULES.detected
    if strong.any():
        apart = theta - online.theta
        out += np.outer(apart, apart)
        for axis in np.flatnonzero(strong):
            error = axis_floor(online, int(axis))
            out += np.outer(error, error)
    return out + online.open_covariance


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
