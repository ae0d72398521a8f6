"""Covariance that stays true when residuals are coloured."""

import numpy as np

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
