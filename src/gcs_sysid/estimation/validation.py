"""Does a fit predict what it has not seen?

The parameters are fitted on the first part of the flight and predict the angular acceleration of
the rest. Both parts are sums of moments, so no sample is needed again.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.priors import Prior
from gcs_sysid.estimation.rotation import N_X, fit_rotation, moments_at
from gcs_sysid.model import rigid_body as rb

FITTED_SHARE = 0.6
"""Share of the flight that is fitted; the rest is predicted."""
_MIN_BATCHES = 10


@dataclass(frozen=True)
class Validation:
    """How well the first part of a flight predicts the rest, per axis.

    Attributes:
        r_squared: (3,) share of the angular acceleration's power that is predicted.
        theil: (3,) Theil's inequality coefficient, rms error over the sum of the rms values of
            measured and predicted: 0 is perfect, 1 is worthless.
        fitted_share: share of the rows that were fitted.
    """

    r_squared: Array
    theil: Array
    fitted_share: float


def validate(
    batches: Array,
    counts: NDArray[np.int64],
    delays: Array,
    noise: Array,
    prior: Prior | None = None,
) -> Validation | None:
    """Fit the first batches, predict the others.

    Args:
        batches: (k, leaks, delays, WIDTH, WIDTH), as of `fit_rotation`; the prediction is judged
            on the first leak.
        counts: (k,) rows in each.
        delays: (delays,) s.
        noise: (leaks, WIDTH, WIDTH).
        prior: what else is known.

    Returns:
        None while the flight is too short to be divided.
    """
    k = len(counts)
    cut = round(FITTED_SHARE * k)
    if k < _MIN_BATCHES:
        return None
    fit = fit_rotation(batches[:cut], counts[:cut], delays, noise, prior=prior)
    if fit is None:
        return None
    rest = moments_at(batches[cut:, 0].sum(axis=0), delays, fit.delay)
    Q = rb.forward_matrix(fit.theta)
    Rxx, Rxy, Ryy = rest[:N_X, :N_X], rest[:N_X, N_X:], rest[N_X:, N_X:]
    measured = np.diag(Ryy)
    predicted = np.diag(Q @ Rxx @ Q.T)
    error = np.maximum(measured - 2.0 * np.diag(Q @ Rxy) + predicted, 0.0)
    tiny = 1e-300
    return Validation(
        r_squared=1.0 - error / np.maximum(measured, tiny),
        theil=np.sqrt(error) / np.maximum(np.sqrt(measured) + np.sqrt(predicted), tiny),
        fitted_share=float(counts[:cut].sum() / counts.sum()),
    )
