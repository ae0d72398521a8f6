"""Covariance that stays true when residuals are colored."""

import numpy as np
from scipy.special import stdtrit

from gcs_sysid.arrays import Array, long_run
from gcs_sysid.significance import Z95

_REACH = 2
"""Neighbors of a batch with correlated scores: innovations have little memory."""


def meat(scores: Array) -> Array:
    """(p, p) covariance of the whole score, from (k, p) scores of batches in time order.

    Neighboring batches correlate.
    """
    k, p = scores.shape
    lags = len(bartlett(k))
    total = long_run(scores, lags)
    if k > 2:
        # At the minimum the scores are smaller than the errors by what was fitted.
        total *= k / max(k - p * (lags + 1) / 6.0, 1.0)
    return total


def bartlett(k: int) -> Array:
    """Weights of lags 1, 2, ... between k batches, as far as they reach and can be resolved."""
    reach = min(round(k ** (1.0 / 3.0)) if k > 2 else 0, _REACH)
    return 1.0 - np.arange(1, reach + 1) / (reach + 1.0)


def inflation(inverse_root: Array, scatter: Array, least: float = 1.0) -> Array:
    """Ratio of the score's scatter to the information, at least that of white residuals.

    Args:
        inverse_root: (p, p) symmetric root of the inverse information.
        scatter: (p, p) covariance of the score.
        least: ratio.

    Returns:
        (p, p) A, to which inverse_root A inverse_root is the covariance of the estimate.
    """
    values, vectors = np.linalg.eigh(inverse_root @ scatter @ inverse_root)
    return (vectors * np.maximum(values, least)) @ vectors.T


def slow_inflation(scores: Array, least: float = 1.0) -> Array:
    """The same of noise that outlasts batches by an unknown time, with Student's factor.

    What k batches show of it is in their n first cosine waves, which are independent,

        S = (2 / (n k)) sum_j c_j c_j^T,    c_j = sum_b u_b cos(pi j (b - 1/2) / k),  j = 1 ... n

    so that an estimate over its standard deviation by S follows Student's t of n degrees of
    freedom, n = 0.4 k^(2/3) (Lazarus, Lewis, Stock and Watson 2018, Journal of Business and
    Economic Statistics 36, 541-559); one alone would never say anything.

    Args:
        scores: (k, p) of batches in time order, such that white residuals have unit covariance.
        least: as of `inflation`, whatever so few waves are by chance.
    """
    k, p = scores.shape
    n = max(int(0.4 * k ** (2.0 / 3.0)), 2)
    waves = np.cos(np.pi * np.outer(np.arange(1, n + 1), (np.arange(k) + 0.5) / k)) @ scores
    student = stdtrit(n, 0.975) / Z95
    return inflation(np.eye(p), student**2 * 2.0 / (n * k) * waves.T @ waves, least)


def shrunk_inflation(inverse_root: Array, scores: Array) -> tuple[Array, Array]:
    """The same, as far as the scatter of so many batches can prove it.

    Eigenvalues lambda of a scatter estimated from few batches spread widely about their mean even
    where they are all alike (Marchenko and Pastur 1967): of white innovations 57 batches show 15
    unknowns scatters from 0.01 to 3, and to take all that exceeds 1 makes every interval 1.2 times
    too wide. So the scatter S is shrunk towards its mean mu, by the weight of least expected square
    error,

        (1 - w) S + w mu,    w = mu^2 (p + 1) / (nu d^2),    d^2 = mean (lambda - mu)^2

    (Ledoit and Wolf 2004, Journal of Multivariate Analysis 88, 365-411) with nu the batches that
    count by themselves. A direction beyond the edge of that spread, mu (1 + sqrt(g))^2 with
    g = p / nu, keeps at least the l that shows as lambda = l (1 + g mu / (l - mu)) (spiked model:
    Donoho, Gavish and Johnstone 2018, Annals of Statistics 46, 1742-1778). The mean, where it is
    below 1, is the least: innovations may be weaker where the parameters act than elsewhere. Below
    2 p batches the weight falls with their number.

    Args:
        inverse_root: as of `inflation`.
        scores: as of `meat`.

    Returns:
        (p, p) inflation, and (p,) share of each unknown's variance known from scatter alone.
    """
    k, p = scores.shape
    values, vectors = np.linalg.eigh(inverse_root @ meat(scores) @ inverse_root)
    values = np.maximum(values, 0.0)
    trust = min(1.0, k / (2.0 * p))
    mean = float(values.mean())
    floor = 1.0 - trust * (1.0 - min(max(mean, _LEAST_SCATTER), 1.0))
    nu = max(k / (1.0 + 2.0 * float((bartlett(k) ** 2).sum())), 1.0)
    apart = float(((values - mean) ** 2).mean())
    weight = trust * min(1.0, mean**2 * (p + 1.0) / (nu * apart)) if apart > 0.0 else trust
    shrunk = (1.0 - weight) * values + weight * mean
    if mean > 0.0:
        relative, g = values / mean, p / nu
        half = 0.5 * (relative + 1.0 - g)
        spike = mean * (half + np.sqrt(np.maximum(half**2 - relative, 0.0)))
        shrunk = np.where(relative > (1.0 + np.sqrt(g)) ** 2, np.maximum(shrunk, spike), shrunk)
    spread = (vectors * np.maximum(shrunk, floor)) @ vectors.T
    whole = np.einsum("ij,jk,ki->i", inverse_root, spread, inverse_root)
    known = floor * np.einsum("ij,ji->i", inverse_root, inverse_root)
    by_scatter = np.maximum(1.0 - known / np.maximum(whole, 1e-300), 1.0 - trust)
    return spread, by_scatter


_LEAST_SCATTER = 0.5
"""Of what the information says. On undisturbed flights of the emulator the mean is 0.5 to 1.7."""


def symmetric_roots(matrix: Array, ridge: float = 1e-12) -> tuple[Array, Array]:
    """Symmetric roots of (..., p, p) matrices, ridge added, and of their inverses."""
    values, vectors = np.linalg.eigh(matrix)
    roots = np.sqrt(np.maximum(values, 0.0) + max(ridge, 1e-300))[..., None, :]
    turned = np.swapaxes(vectors, -1, -2)
    return (vectors * roots) @ turned, (vectors / roots) @ turned


def student_factor(shares: Array, by_scatter: Array | float = 1.0) -> Array:
    """What makes 1.96 standard deviations a 95 % interval when batches are few.

    A variance estimated from the scatter of few batches is itself uncertain; the estimate over its
    standard deviation then follows Student's t, not the normal law. The degrees of freedom are
    Satterthwaite's for the sum over batches and neighbors that `meat` forms,

        nu = (sum w)^2 / (sum w^2 + 2 sum_l b_l^2 sum w w_l)

    with w the variance that each batch is expected to add (as in the small-sample theory of
    cluster-robust covariances by Bell and McCaffrey), w_l that of the l-th batch after it, and b
    Bartlett's weights. Where scatter determines only a share s of the variance and the rest is
    known, they are nu / s^2.

    Args:
        shares: (k, p) expected share of each batch in the variance of each unknown, any scale.
        by_scatter: (p,) share of the variance that scatter determines, see `shrunk_inflation`.

    Returns:
        (p,) factors on the standard deviations: quantile of t over quantile of the normal.
    """
    w = np.maximum(shares, 0.0)
    spread = (w * w).sum(axis=0)
    for lag, weight in enumerate(bartlett(len(w)), 1):
        spread = spread + 2.0 * weight**2 * (w[lag:] * w[:-lag]).sum(axis=0)
    total = w.sum(axis=0)
    freedom = np.where(spread > 0.0, total * total / np.where(spread > 0.0, spread, 1.0), 1.0)
    freedom = np.maximum(freedom, 1.0) / np.maximum(by_scatter, 1e-3) ** 2
    return stdtrit(freedom, 0.975) / Z95


def watched_factor(time: float) -> float:
    """Factor that makes 1.96 standard deviations a 95 % interval under continuous monitoring.

    An interval that holds at 95 % of instants is left at some instant by every third estimate:
    it drifts as the record grows. The normal mixture of Robbins (1970, Annals of Mathematical
    Statistics 41, 1397-1409) bounds the whole history of a mean of t seconds, in units of its own
    standard deviation, by

        sqrt((1 + 1 / t) (ln(1 + t) - 2 ln 0.05))

    with t in units of the flight after which something is claimed: 3.7 times at first, 3.0 to 3.2
    from the fourth such unit to the fiftieth, slowly more for ever.

    Args:
        time: flight time of the estimate, t.

    Returns:
        Factor on its standard deviation.
    """
    t = max(time, 1.0)
    return float(np.sqrt((1.0 + 1.0 / t) * (np.log1p(t) - 2.0 * np.log(0.05)))) / Z95
