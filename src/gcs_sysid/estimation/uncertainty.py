"""Covariance that stays true when residuals are coloured."""

import numpy as np
from scipy.special import stdtrit

from gcs_sysid.arrays import Array


def sandwich(bread: Array, scores: Array) -> Array:
    """Covariance of an estimate from the scatter of its batch scores.

    Args:
        bread: (p, p) inverse information.
        scores: (k, p) gradient of the cost, batch by batch, in time order.

    Returns:
        (p, p); never below `bread`'s own variances, which white residuals would give.
    """
    k, p = scores.shape
    meat = scores.T @ scores
    if k > 2:
        lagged = scores[1:].T @ scores[:-1]
        meat = meat + 0.5 * (lagged + lagged.T)
        # At the minimum the scores are smaller than the errors by what was fitted.
        meat *= k / max(k - p / 3.0, 1.0)
    covariance = bread @ meat @ bread
    short = np.maximum(np.diag(bread) - np.diag(covariance), 0.0)
    result: Array = covariance + np.diag(short)
    return result


def student_factor(shares: Array) -> Array:
    """What makes 1.96 standard deviations a 95 % interval when batches are few.

    A variance told by the scatter of few batches is uncertain itself; the estimate over its
    standard deviation then follows Student's t, not the normal law. The degrees of freedom are
    Satterthwaite's for the sum over batches and neighbours that `sandwich` forms,

        nu = (sum w)^2 / (sum w^2 + 1/2 sum w w+)

    with w the variance that each batch is expected to add (as in the small-sample theory of
    cluster-robust covariances by Bell and McCaffrey) and w+ the next batch's.

    Args:
        shares: (k, p) expected share of each batch in the variance of each unknown, any scale.

    Returns:
        (p,) factors on the standard deviations: quantile of t over quantile of the normal.
    """
    w = np.maximum(shares, 0.0)
    spread = (w * w).sum(axis=0) + 0.5 * (w[1:] * w[:-1]).sum(axis=0)
    total = w.sum(axis=0)
    freedom = np.where(spread > 0.0, total * total / np.where(spread > 0.0, spread, 1.0), 1.0)
    factor: Array = stdtrit(np.maximum(freedom, 1.0), 0.975) / _NORMAL
    return factor


_NORMAL = 1.959963984540054
