"""What lags behind the commands, as competing hypotheses on one set of moments."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit.priors import N_UNKNOWNS, Prior
from gcs_sysid.estimation.fit.rotation import RotationFit, fit_rotation
from gcs_sysid.estimation.rows.actuator_dynamics import ActuatorDynamics, LagPlace
from gcs_sysid.model import rigid_body as rb


def fit_lag_places(
    batches: Array,
    counts: NDArray[np.int64],
    basis: ActuatorDynamics,
    noise: Array,
    places: Sequence[LagPlace],
    independent: float,
    start: RotationFit | None = None,
    prior: Prior | None = None,
    doubt: float = 0.0,
    hint: RotationFit | None = None,
) -> RotationFit | None:
    """The fit with what lags behind the commands as a hypothesis; the others widen it.

    Estimates are those of the likeliest. By what those of the others differ from them, they may be
    off with these one's probability (Hoeting et al. (1999), Bayesian model averaging: a tutorial,
    Statistical Science 14, 382-417).

    Args:
        batches: as for `fit_rotation`, and so are all arguments not listed here.
        counts: rows in each batch.
        basis: of the elements; is left with the place that is taken.
        noise: of the inputs.
        places: hypotheses; the others start from the first one's fit.
        independent: how many rows there would be, did windows not overlap.
        start: an earlier fit.
        prior: what else is known.
        doubt: of the noise.
        hint: an earlier fit.
    """
    basis.lag_place = places[0]
    first = fit_rotation(batches, counts, basis, noise, start, prior, doubt, hint)
    if first is None:
        return None
    leak = slice(first.leak, first.leak + 1)
    fits = [first]
    for basis.lag_place in places[1:]:
        fit = fit_rotation(batches[:, leak], counts, basis, noise[leak], first, prior, doubt)
        fits.append(first if fit is None else replace(fit, leak=first.leak))
    cost = np.array([np.linalg.slogdet(fit.residual_covariance)[1] for fit in fits])
    weight = np.exp(-0.5 * independent * (cost - cost.min()))
    best = int(np.argmin(cost))
    basis.lag_place = places[best]
    away = np.stack([fit.unknowns - fits[best].unknowns for fit in fits])
    doubted = (away * (weight / weight.sum())[:, None]).T @ away
    return with_lag_doubt(fits[best], places[best], doubted)


def with_lag_doubt(fit: RotationFit, place: LagPlace, doubt: Array) -> RotationFit:
    """A fit with its place of the lag, and the (N_UNKNOWNS, N_UNKNOWNS) covariance of its error."""
    n = rb.N_THETA
    extended = fit.extended_covariance.copy()
    extended[:N_UNKNOWNS, :N_UNKNOWNS] += doubt
    return replace(
        fit,
        lag_place=place,
        lag_doubt=doubt,
        covariance=fit.covariance + doubt[:n, :n],
        full_covariance=fit.full_covariance + doubt,
        extended_covariance=extended,
        data_std=np.hypot(fit.data_std, np.sqrt(np.diag(doubt)[:n])),
    )
