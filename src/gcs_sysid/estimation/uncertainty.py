"""Covariance that stays true when residuals are coloured."""

import numpy as np

from gcs_sysid.arrays import Array

_RIDGE = 1e-12
"""Of the scaled information: an unseen direction keeps a huge, finite variance."""


def sandwich(bread: Array, scores: Array) -> Array:
    """Covariance of an estimate from the scatter of its batch scores.

    Args:
        bread: (p, p) inverse information.
        scores: (k, p) gradient of the cost, batch by batch, in time order.

    Returns:
        (p, p); in no direction below `bread`, which white residuals would give.
    """
    root = symmetric_roots(bread, 0.0)[0]
    covariance: Array = root @ inflation(root, meat(scores)) @ root
    return covariance


def meat(scores: Array) -> Array:
    """(p, p) covariance of the whole score, from (k, p) scores of batches in time order."""
    k, p = scores.shape
    total: Array = scores.T @ scores
    if k > 2:
        lagged = scores[1:].T @ scores[:-1]
        total = total + 0.5 * (lagged + lagged.T)
        # At the minimum the scores are smaller than the errors by what was fitted.
        total *= k / max(k - p / 3.0, 1.0)
    return total


def inflation(inverse_root: Array, scatter: Array) -> Array:
    """By how much the score scatters more than the information says, at least once.

    Args:
        inverse_root: (p, p) symmetric root of the inverse information.
        scatter: (p, p) covariance of the score.

    Returns:
        (p, p) A, to which inverse_root A inverse_root is the covariance of the estimate.
    """
    values, vectors = np.linalg.eigh(inverse_root @ scatter @ inverse_root)
    spread: Array = (vectors * np.maximum(values, 1.0)) @ vectors.T
    return spread


def symmetric_roots(matrix: Array, ridge: float = _RIDGE) -> tuple[Array, Array]:
    """Symmetric roots of a (p, p) matrix, ridge added, and of its inverse."""
    values, vectors = np.linalg.eigh(matrix)
    roots = np.sqrt(np.maximum(values, 0.0) + max(ridge, 1e-300))
    return (vectors * roots) @ vectors.T, (vectors / roots) @ vectors.T
