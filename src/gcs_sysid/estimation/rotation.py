"""Fit of the rotational parameters to the moments of the forward form.

The cost  sum_rows (y - Q(theta) x)' W (y - Q(theta) x)  is an exact quadratic in Q, so it and
its derivatives follow from the moments alone. It is minimised by Gauss-Newton with
Levenberg-Marquardt damping; W is the inverse of the residual covariance, which the same moments
give (iterated to the maximum-likelihood point). See `gcs_sysid.model.rigid_body` for Q.

Moments come as a bank of hypotheses: the same rows with several leaks, and with the rotors'
signals taken at several delays. All are fitted at once, as stacked arrays. Between the delays of
the bank the moments are interpolated (they are smooth, band-limited functions of the delay), so
the delay is estimated to a small fraction of the bank's step.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation.uncertainty import sandwich, student_factor
from gcs_sysid.model import rigid_body as rb

N_X = rb.N_SIGNALS
WIDTH = N_X + 3
"""Width of a row [x, y]."""

DELAY_PRIOR_STD = 0.03
"""s; keeps the delay near zero while the flight does not tell it."""

_MAX_ITERATIONS = 40
_SCAN_ITERATIONS = 8
_WARM_ITERATIONS = 3
_CONVERGED = 1e-7
"""Steps smaller than this many standard deviations change nothing."""
_EPSILON = 1e-15
"""Rounding of sums of products."""
_PROBE = 1e-3
"""s; step of differences with respect to the delay."""


@dataclass(frozen=True)
class RotationFit:
    """Rotational parameters relative to k_T, with their uncertainty.

    Attributes:
        theta: (N_THETA,) estimate, see `rigid_body.THETA`.
        covariance: (N_THETA, N_THETA), corrected for coloured residuals, delay included, and
            widened so that 1.96 standard deviations are Student's 95 % interval.
        residual_covariance: (3, 3) of one row's residual.
        r_squared: (3,) share of each axis' angular acceleration that the model explains.
        rows: how many rows it rests on.
        converged: whether the minimiser was reached.
        delay: s, of the rotor stream behind the IMU stream.
        delay_std: s; zero where the delay was not estimated.
        leak: index of the leak that left the least uncertainty.
    """

    theta: Array
    covariance: Array
    residual_covariance: Array
    r_squared: Array
    rows: int
    converged: bool
    delay: float = 0.0
    delay_std: float = 0.0
    leak: int = 0

    @property
    def std(self) -> Array:
        """(N_THETA,) standard deviations."""
        std: Array = np.sqrt(np.diag(self.covariance))
        return std


def fit_rotation(
    batches: Array,
    counts: NDArray[np.int64],
    delays: Array,
    noise: Array,
    start: RotationFit | None = None,
) -> RotationFit | None:
    """Fit theta and the rotor delay to a bank of moments.

    Args:
        batches: (k, leaks, delays, WIDTH, WIDTH) moments of rows [x, y].
        counts: (k,) rows in each.
        delays: (delays,) s, the bank's rotor delays, equally spaced.
        noise: (leaks, WIDTH, WIDTH) what known noise of the inputs adds to the moments of a row.
        start: an earlier fit: a few steps from there, with its leak, follow a growing record at
            little cost. None: from the data alone, to the minimum.

    Returns:
        The fit, or None while the data cannot even start one (fewer rows than unknowns, or no
        response to roll and pitch torque).
    """
    rows = int(counts.sum())
    if rows < 3 * rb.N_THETA:
        return None
    if start is not None:
        only = slice(start.leak, start.leak + 1)
        batches, noise = batches[:, only], noise[only]
    bank = batches.sum(axis=0)
    middle = int(np.argmin(np.abs(delays)))
    first = [_starting_point(moments[middle]) for moments in bank]
    if any(theta is None for theta in first):
        return None
    theta = np.stack([t for t in first if t is not None])
    if start is None:
        theta, delay = _scan(bank, rows, delays, theta)
    else:
        # An earlier estimate from too little motion may lie in a valley of its own.
        both = np.stack([theta[0], start.theta])
        cost = _costs(np.repeat(bank[:1, middle], 2, axis=0), rows, both)
        theta = both[[int(np.argmin(cost))]]
        delay = np.array([start.delay])
    limit = _MAX_ITERATIONS if start is None else _WARM_ITERATIONS
    theta, delay, converged = _minimise(bank, rows, delays, theta, delay, limit)
    fits = [
        _finish(
            batches[:, i],
            rows,
            delays,
            noise[i],
            theta[i],
            float(delay[i]),
            bool(converged[i]),
            i,
        )
        for i in range(len(bank))
    ]
    best = min(fits, key=uncertainty)
    return best if start is None else replace(best, leak=start.leak)


def uncertainty(fit: RotationFit) -> float:
    """Sum of log standard deviations of what makes up the core parameters."""
    return float(np.sum(np.log(fit.std[: rb.DAMPING])))


def _scan(bank: Array, rows: int, delays: Array, theta: Array) -> tuple[Array, Array]:
    """Fit at every delay of the bank; the best one and its theta, for each leak."""
    leaks, nodes = bank.shape[:2]
    if nodes == 1:
        return theta, np.full(leaks, delays[0])
    single = bank.reshape(leaks * nodes, 1, WIDTH, WIDTH)
    at_nodes, _, _ = _minimise(
        single,
        rows,
        delays[:1],
        np.repeat(theta, nodes, axis=0),
        np.zeros(leaks * nodes),
        _SCAN_ITERATIONS,
    )
    cost = _costs(single[:, 0], rows, at_nodes).reshape(leaks, nodes)
    best = np.argmin(cost + (delays / DELAY_PRIOR_STD) ** 2 / rows, axis=1)
    return at_nodes.reshape(leaks, nodes, -1)[np.arange(leaks), best], delays[best]


def moments_at(bank: Array, delays: Array, delay: Array) -> Array:
    """Moments at any delay within the bank: Lagrange interpolation over its nodes.

    Args:
        bank: (K, delays, W, W) moments, or (K, batches, delays, W, W).
        delays: (delays,) s.
        delay: (K,) s, wanted.
    """
    if len(delays) == 1:
        single: Array = bank[..., 0, :, :]
        return single
    # A hair off the nodes: the barycentric form divides by the distance to them.
    difference = delay[:, None] - delays
    difference = np.where(np.abs(difference) < 1e-15, 1e-15, difference)
    apart = delays[:, None] - delays[None, :] + np.eye(len(delays))
    weights = 1.0 / (apart.prod(axis=1) * difference)
    weights /= weights.sum(axis=1, keepdims=True)
    flat = bank.reshape(*bank.shape[:-2], WIDTH * WIDTH)
    extra = (1,) * (flat.ndim - 3)
    between: Array = weights.reshape(len(delay), *extra, 1, len(delays)) @ flat
    return between.reshape(*bank.shape[:-3], WIDTH, WIDTH)


def _finish(
    batches: Array,
    rows: int,
    delays: Array,
    noise: Array,
    theta: Array,
    delay: float,
    converged: bool,
    leak: int,
) -> RotationFit:
    """Covariance, residuals and explained share at a minimum; batches (k, delays, W, W)."""
    at = np.array([delay])
    here = moments_at(batches[None], delays, at)[0]
    total = here.sum(axis=0)
    Q, G = rb.forward_jacobian(theta)
    residual = _residual_moments(total, Q) / rows
    W = _inverse_spd(residual)
    scores = _scores(here, Q, G, W)
    n = rb.N_THETA
    if len(delays) == 1:
        _, hessian = _normal_equations(total, Q, G, W)
    else:
        _, hessian = _with_delay(
            batches.sum(axis=0)[None], delays, at, total[None], Q[None], G[None], W[None]
        )
        hessian = hessian[0]
        cost = [
            _batch_costs(moments_at(batches[None], delays, at + probe)[0], Q, W)
            for probe in (-_PROBE, _PROBE)
        ]
        scores = np.column_stack([scores, (cost[0] - cost[1]) / (2.0 * _PROBE)])
    d = _scales(hessian)
    # A direction that the data do not see at all keeps a huge, finite variance.
    bread = np.linalg.inv(hessian / np.outer(d, d) + 1e-12 * np.eye(len(d)))
    shares = _variance_shares(here, G, W, (bread / np.outer(d, d))[:n, :n])
    if len(delays) > 1:
        bend = cost[0] - 2.0 * _batch_costs(here, Q, W) + cost[1]
        shares = np.column_stack([shares, bend])
    d_wide = d / student_factor(shares)
    covariance = sandwich(bread, scores / d) / np.outer(d_wide, d_wide)
    # Noise on the inputs makes least squares underrate them; what that does to the gradient is
    # known, and one Newton step takes it back (first-order correction for errors in variables).
    pull = np.zeros(len(d))
    pull[:n] = -_gradient(rows * noise, Q, G, W)
    step = bread @ (pull / d) / d
    if rb.is_physical(theta + step[:n]):
        theta = theta + step[:n]
        if len(delays) > 1:
            delay += float(step[n])
    power = np.diag(total)[N_X:] / rows
    return RotationFit(
        theta=theta,
        covariance=covariance[:n, :n],
        residual_covariance=residual,
        r_squared=1.0 - np.diag(residual) / np.maximum(power, 1e-300),
        rows=rows,
        converged=converged,
        delay=delay,
        delay_std=float(np.sqrt(covariance[n, n])) if len(delays) > 1 else 0.0,
        leak=leak,
    )


def _residual_moments(moments: Array, Q: Array) -> Array:
    """(..., 3, 3) residual moments of (..., W, W) moments under Q (..., 3, N_X)."""
    identity = np.broadcast_to(np.eye(3), (*Q.shape[:-1], 3))
    T = np.concatenate([-Q, identity], axis=-1)
    # Without noise only rounding is left of the large terms: floored at that, it stays definite.
    size = np.sqrt(np.maximum(np.diagonal(moments, axis1=-2, axis2=-1), 0.0))
    rounding = _EPSILON * (np.abs(T) @ size[..., None]) ** 2
    residual: Array = T @ moments @ np.swapaxes(T, -1, -2) + rounding * np.eye(3)
    return residual


def _costs(moments: Array, rows: int, theta: Array) -> Array:
    """(K,) log det of the residual covariance of each hypothesis."""
    Q = rb.forward_matrix(theta)
    cost: Array = np.linalg.slogdet(_residual_moments(moments, Q) / rows)[1]
    return cost


def _starting_point(total: Array) -> Array | None:
    """A rough theta from the response to torques: no guess by the user is needed."""
    Rxx, Rxy = total[:N_X, :N_X], total[:N_X, N_X:]
    scale = np.sqrt(np.diag(Rxx))
    scale[scale == 0.0] = 1.0
    # Columns in units of their own size; the ridge settles directions without excitation.
    A = Rxx / np.outer(scale, scale) + 1e-9 * np.eye(N_X)
    Q = (np.linalg.solve(A, Rxy / scale[:, None]) / scale[:, None]).T
    if not (Q[0, 0] > 0.0 and Q[1, 1] > 0.0):
        return None
    theta = np.zeros(rb.N_THETA)
    theta[0], theta[1] = 1.0 / Q[0, 0], 1.0 / Q[1, 1]
    # A flat body has Izz = Ixx + Iyy; a real multirotor comes close.
    theta[2] = 0.9 * (theta[0] + theta[1])
    theta[rb.MOMENT_RATIO] = max(Q[2, 3] * theta[2], 1e-4)
    theta[rb.CG_Y] = Q[0, 2] / Q[0, 0]
    theta[rb.CG_X] = -Q[1, 2] / Q[1, 1]
    return theta if rb.is_physical(theta) else None


def _minimise(
    bank: Array, rows: int, delays: Array, theta: Array, delay: Array, limit: int
) -> tuple[Array, Array, Mask]:
    """Levenberg-Marquardt on log det of the residual covariance (W concentrated out).

    Args:
        bank: (K, delays, W, W) hypotheses; with one delay alone, that is not fitted.
        rows: in each.
        delays: (delays,) s.
        theta: (K, N_THETA) starting points.
        delay: (K,) s, starting points.
        limit: most iterations.

    Returns:
        (K, N_THETA) minimisers, their (K,) delays, and (K,) whether each was reached.
    """
    with_delay = len(delays) > 1
    low, high = delays[0] + _PROBE, delays[-1] - _PROBE
    unknown = np.column_stack([theta, delay]) if with_delay else theta
    K, p = unknown.shape

    def evaluate(u: Array) -> tuple[Array, Array, Array, Array, Array]:
        moments = moments_at(bank, delays, u[:, -1]) if with_delay else bank[:, 0]
        Q, G = rb.forward_jacobian(u[:, : rb.N_THETA])
        S = _residual_moments(moments, Q) / rows
        cost = np.linalg.slogdet(S)[1]
        if with_delay:
            cost = cost + (u[:, -1] / DELAY_PRIOR_STD) ** 2 / rows
        return moments, Q, G, S, cost

    damping = np.full(K, 1e-4)
    converged = np.zeros(K, dtype=bool)
    state = evaluate(unknown)
    for _ in range(limit):
        moments, Q, G, S, cost = state
        W = _inverse_spd(S)
        if with_delay:
            gradient, hessian = _with_delay(bank, delays, unknown[:, -1], moments, Q, G, W)
        else:
            gradient, hessian = _normal_equations(moments, Q, G, W)
        d = _scales(hessian)
        H = hessian / (d[:, :, None] * d[:, None, :]) + damping[:, None, None] * np.eye(p)
        step = np.linalg.solve(H, (gradient / d)[..., None])[..., 0]
        # How much the cost can still fall, in units of the likelihood.
        converged |= np.einsum("kp,kp->k", step, gradient / d) < _CONVERGED**2
        candidate = unknown + step / d
        if with_delay:
            candidate[:, -1] = np.clip(candidate[:, -1], low, high)
        physical = rb.are_physical(candidate)
        candidate = np.where(physical[:, None], candidate, unknown)
        tried = evaluate(candidate)
        better = physical & (tried[-1] <= cost) & ~converged
        unknown = np.where(better[:, None], candidate, unknown)
        state = tuple(  # type: ignore[assignment]
            np.where(better.reshape(K, *(1,) * (new.ndim - 1)), new, old)
            for new, old in zip(tried, state, strict=True)
        )
        damping = np.where(better, np.maximum(damping * 0.1, 1e-12), damping * 10.0)
        # No step however small helps any more: rounding has the last word.
        converged |= damping > 1e6
        if converged.all():
            break
    return unknown[:, : rb.N_THETA], unknown[:, -1] if with_delay else delay, converged


def _with_delay(
    bank: Array, delays: Array, delay: Array, moments: Array, Q: Array, G: Array, W: Array
) -> tuple[Array, Array]:
    """Normal equations with the delay as one more unknown, its part by differences."""
    gradient, hessian = _normal_equations(moments, Q, G, W)
    early, late = (moments_at(bank, delays, delay + probe) for probe in (-_PROBE, _PROBE))
    cost_early, cost_here, cost_late = (
        0.5 * np.einsum("kij,kij->k", W, _residual_moments(m, Q)) for m in (early, moments, late)
    )
    information = 1.0 / DELAY_PRIOR_STD**2
    slope = (cost_late - cost_early) / (2.0 * _PROBE) + delay * information
    bend = (cost_late - 2.0 * cost_here + cost_early) / _PROBE**2
    cross = (_gradient(early, Q, G, W) - _gradient(late, Q, G, W)) / (2.0 * _PROBE)
    p = gradient.shape[-1]
    full = np.empty((*hessian.shape[:-2], p + 1, p + 1))
    full[..., :p, :p] = hessian
    full[..., p, :p] = full[..., :p, p] = cross
    full[..., p, p] = np.maximum(bend, 0.0) + information
    return np.concatenate([gradient, -slope[..., None]], axis=-1), full


def _gradient(moments: Array, Q: Array, G: Array, W: Array) -> Array:
    """(..., p) downhill gradient of half the cost."""
    Rxx, Ryx = moments[..., :N_X, :N_X], moments[..., N_X:, :N_X]
    WG = (W[..., None, :, :] @ G).reshape(*G.shape[:-2], 3 * N_X)
    right = (Ryx - Q @ Rxx).reshape(*Q.shape[:-2], 3 * N_X, 1)
    gradient: Array = (WG @ right)[..., 0]
    return gradient


def _normal_equations(moments: Array, Q: Array, G: Array, W: Array) -> tuple[Array, Array]:
    """Gradient (..., p) and Gauss-Newton matrix (..., p, p) of half the cost, downhill."""
    Rxx = moments[..., :N_X, :N_X]
    p = G.shape[-3]
    flat = (*G.shape[:-2], 3 * N_X)
    WG = (W[..., None, :, :] @ G).reshape(flat)
    GR = (G.reshape(*G.shape[:-3], p * 3, N_X) @ Rxx).reshape(flat)
    return _gradient(moments, Q, G, W), WG @ np.swapaxes(GR, -1, -2)


def _scores(batches: Array, Q: Array, G: Array, W: Array) -> Array:
    """(k, p) downhill gradient of half the cost, batch by batch."""
    Rxx, Ryx = batches[:, :N_X, :N_X], batches[:, N_X:, :N_X]
    WG = (W @ G).reshape(len(G), -1)
    scores: Array = (Ryx - Q @ Rxx).reshape(len(batches), -1) @ WG.T
    return scores


def _batch_costs(batches: Array, Q: Array, W: Array) -> Array:
    """(k,) half the cost, batch by batch."""
    costs: Array = 0.5 * np.einsum("ij,bij->b", W, _residual_moments(batches, Q))
    return costs


def _variance_shares(batches: Array, G: Array, W: Array, inverse: Array) -> Array:
    """(k, p) the diagonal of H^-1 H_b H^-1, H_b the information of batch b on theta."""
    Rxx = batches[:, :N_X, :N_X].reshape(len(batches), -1)
    D = np.tensordot(inverse, G, 1)
    shares: Array = Rxx @ (np.swapaxes(D, 1, 2) @ W @ D).reshape(len(D), -1).T
    return shares


def _scales(hessian: Array) -> Array:
    """(..., p) square roots of the diagonal, 1 where there is no information at all."""
    diagonal = np.diagonal(hessian, axis1=-2, axis2=-1)
    return np.sqrt(np.where(diagonal > 1e-100, diagonal, 1.0))


def _inverse_spd(S: Array) -> Array:
    """Inverses of covariances (..., 3, 3) that may be singular on data without noise."""
    trace = np.trace(S, axis1=-2, axis2=-1)
    floor = 1e-12 * np.maximum(trace / 3.0, 1e-300)
    inverse: Array = np.linalg.inv(S + floor[..., None, None] * np.eye(3))
    return inverse
