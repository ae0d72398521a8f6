"""Search for the minimum of the rotational cost, for several hypotheses side by side.

The cost is the log determinant of the residual covariance, whose inverse is the weight W: the
maximum-likelihood point of a Gaussian residual with unknown covariance. It follows from moments
alone; so do its derivatives (see `estimation.fit.rotation`).
"""

from copy import copy
from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation.fit.priors import COORDINATES, Prior
from gcs_sysid.estimation.rows.actuator_dynamics import PLAIN, WIDTH, ActuatorDynamics
from gcs_sysid.model import rigid_body as rb

N_X = rb.N_SIGNALS

COORDINATE_MEAN = np.array([0.0, 0.05, 0.5, 0.0, 0.0])
COORDINATE_STD = np.array([0.03, 0.05, 0.5, 0.4, 0.5])
"""s, s, 1, 1 and 1; keep delay, lag, curve, asymmetry and exponent of the lag at usual values while
the flight does not determine them. Simulators and motors on the bench have an asymmetry of 0 to
0.7."""

MAX_ITERATIONS = 40
_SCAN_ITERATIONS, _STARTS = 8, 4
_NODES_AT_ONCE = 16
"""Of a basis, whose moments are made in one step."""
_CONVERGED = 1e-6
"""Steps smaller than this many standard deviations change nothing."""
_UNSEEN = 1e-2
"""Smaller ones are taken without looking at the cost: what they gain is lost in its rounding."""
_DAMPING = 1e-4
_SHORTENED = 1.0
"""Damping that makes a step much shorter than it would be without."""
_NOISE_STEPS, _NOISE_LEFT = 100, 1e-10
"""Steps at most, and squared standard deviations to go at which they end. Each leaves of the way
that share by which noise adds to the moments: a third at most, but for curve and lag."""
_LONGER, _SHORTER = 2.0, 0.25
"""Times the share of a step that is taken, after one that came nearer, and one that did not."""
_ALIKE = 3e-13
"""Share of all residual power that every axis has at least: weights stay finite."""
_EPSILON = 4e-15
"""Rounding of sums of products, relative to the squares in them."""
_IDENTITY = np.eye(3)
_AXES, _DIAGONAL = np.arange(3), np.arange(WIDTH)


@dataclass(frozen=True)
class Point:
    """Where the search stands, for K hypotheses.

    Attributes:
        unknowns: (K, N_UNKNOWNS).
        cost: (K,) log det of the residual covariance, and the priors' part; all per row.
        gradient: (K, p) downhill, of half the likelihood's cost, W as it is there.
        hessian: (K, p, p) of the same, Gauss-Newton.
        residual: (K, 3, 3) covariance of one row's residual.
        Q: (K, 3, N_X).
        W: (K, 3, 3) inverse of `residual`.
        WG: (K, N_THETA, 3 N_X) derivatives of Q, weighted.
    """

    unknowns: Array
    cost: Array
    gradient: Array
    hessian: Array
    residual: Array
    Q: Array
    W: Array
    WG: Array

    def where(self, better: Mask, other: "Point") -> "Point":
        """The other point for the hypotheses where that is better."""
        if len(better) == 1:
            return other if better[0] else self
        return Point(
            *(
                np.where(better.reshape(-1, *(1,) * (new.ndim - 1)), new, old)
                for new, old in zip(vars(other).values(), vars(self).values(), strict=True)
            )
        )

    def part(self, which: Mask) -> "Point":
        """Some of the hypotheses."""
        return Point(*(values[which] for values in vars(self).values()))

    def filled(self, which: Mask, some: "Point") -> "Point":
        """With others for some of the hypotheses."""
        every = {name: values.copy() for name, values in vars(self).items()}
        for name, values in vars(some).items():
            every[name][which] = values
        return Point(**every)


class Problem:
    """Hypotheses that are fitted side by side.

    Args:
        bank: (K, width, width) moments of rows of elements.
        rows: in each; (K,) where they are not equally many.
        basis: of the elements; what it leaves free is fitted.
        prior: what else is known.
        noise: (K, width, width) in the moments of one row that is no part of what acted; gradient
            and curvature are those without it, cost and W those of the rows as they are.
    """

    def __init__(
        self,
        bank: Array,
        rows: Array | int,
        basis: ActuatorDynamics,
        prior: Prior | None,
        noise: Array | None = None,
    ) -> None:
        self.bank = bank
        self.rows: Array = np.full(len(bank), rows, dtype=float)
        """(K,) in each."""
        self.basis = basis
        self.prior = prior
        self._noise = None if noise is None else self.rows[:, None, None] * noise
        self.free_coordinates = rb.N_THETA + np.array(basis.free, dtype=int)
        """(f,) indices of those coordinates among the unknowns."""
        self.free = np.concatenate([np.arange(rb.N_THETA), self.free_coordinates])
        """(p,) indices of the unknowns that are fitted, coordinates last."""
        self.p = len(self.free)
        self._mean = COORDINATE_MEAN[list(basis.free)]
        self._information = COORDINATE_STD[list(basis.free)] ** -2.0

    def part(self, which: Mask) -> "Problem":
        """Some of the hypotheses."""
        noise = None if self._noise is None else self._noise[which]
        some = copy(self)
        some.bank, some.rows, some._noise = self.bank[which], self.rows[which], noise
        return some

    def prior_information(self) -> Array:
        """(p, p) of the prior, on what is fitted."""
        assert self.prior is not None
        information: Array = self.prior.information[np.ix_(self.free, self.free)]
        return information

    def prior_pull(self, unknowns: Array) -> Array:
        """(..., p) of the prior, on what is fitted."""
        assert self.prior is not None
        pull: Array = self.prior.pull(unknowns)[..., self.free]
        return pull

    def with_prior(self, gradient: Array, hessian: Array, unknowns: Array) -> tuple[Array, Array]:
        """(..., p) gradient and (..., p, p) curvature at unknowns, with what the prior adds."""
        if self.prior is None:
            return gradient, hessian
        return gradient + self.prior_pull(unknowns), hessian + self.prior_information()

    def weak_cost(self, unknowns: Array) -> Array:
        """(...) of leaving the ordinary, see COORDINATE_STD."""
        away = unknowns[..., self.free_coordinates] - self._mean
        cost: Array = (away * away) @ self._information
        return cost

    def maps(self, unknowns: Array) -> Array:
        """(K, 1 + f, WIDTH, width) what makes rows [x, y] here, and its derivatives."""
        return self.basis.maps(unknowns[:, COORDINATES])

    def moved(self, unknowns: Array, step: Array) -> Array:
        """(..., N_UNKNOWNS) after a (..., p) step, within the basis' range."""
        moved: Array = unknowns.copy()
        if len(self.basis.free) > 1:
            step = step * self._room(unknowns, step)[..., None]
        moved[..., self.free] += step
        moved[..., COORDINATES] = np.clip(moved[..., COORDINATES], self.basis.low, self.basis.high)
        return moved

    def _room(self, unknowns: Array, step: Array) -> Array:
        """(...) share of a step that does not lead out of the basis' range.

        Lag and delay do the same to slow signals: cut off singly, a step along both goes astray.
        """
        free = list(self.basis.free)
        low, high = self.basis.low[free], self.basis.high[free]
        at, way = unknowns[..., self.free_coordinates], step[..., -len(free) :]
        room = np.where(way > 0.0, high - at, at - low)
        share = 0.9 * room / np.maximum(np.abs(way), 1e-300)
        # At the edge itself a coordinate is just held.
        share = np.where(room > 1e-3 * (high - low), share, 1.0)
        smallest: Array = np.minimum(share.min(axis=-1), 1.0)
        return smallest

    def evaluate(self, unknowns: Array) -> Point:
        """Cost and its derivatives at (K, N_UNKNOWNS), or at (1, N_UNKNOWNS) for all."""
        K, n, f = len(self.bank), rb.N_THETA, len(self.basis.free)
        rows = self.rows[:, None, None]
        Q, G = rb.forward_jacobian(unknowns[:, :n])
        T = residual_maker(Q)
        if self.basis is PLAIN:
            P0, moments, TP = None, self.bank, T[:, None]
        else:
            P = self.maps(unknowns)
            P0 = np.swapaxes(P[:, 0], -1, -2)
            moments = P[:, 0] @ self.bank @ P0
            TP = T[:, None] @ P
        # Moments of residuals with rows; of their derivatives by the coordinates with rows.
        TPM = _times_each(TP, self.bank)
        cross = TPM if P0 is None else _times_each(TPM, P0)
        S = TPM[:, 0] @ np.swapaxes(TP[:, 0], -1, -2) / rows
        # Without noise only rounding is left of large terms; that keeps it definite.
        sizes = moments[:, _DIAGONAL, _DIAGONAL]
        own = S[:, _AXES, _AXES]
        S[:, _AXES, _AXES] = own + (
            (T * T @ sizes[..., None])[..., 0] * (_EPSILON / rows[..., 0])
            + (_ALIKE * own.sum(axis=1) + 1e-300)[:, None]
        )
        cost = np.linalg.slogdet(S)[1]
        W = np.linalg.inv(S)
        if self._noise is not None:
            noise = self._noise if P0 is None else P[:, 0] @ self._noise @ P0
            moments = moments - noise
            TPM = TPM - _times_each(TP, self._noise)
            cross = TPM if P0 is None else _times_each(TPM, P0)
        WG = (W[:, None] @ G).reshape(K, n, 3 * N_X)
        GR = (G.reshape(len(G), n * 3, N_X) @ moments[:, :N_X, :N_X]).reshape(K, n, 3 * N_X)
        hessian = np.empty((K, self.p, self.p))
        hessian[:, :n, :n] = WG @ np.swapaxes(GR, -1, -2)
        right = cross[..., :N_X].reshape(K, -1, 3 * N_X)
        downhill = WG @ np.swapaxes(right, -1, -2)
        gradient = np.empty((K, self.p))
        gradient[:, :n] = downhill[..., 0]
        if f:
            cost = cost + self.weak_cost(unknowns) / self.rows
            WT = W[:, None] @ TP
            slopes = (WT[:, :1] * TPM[:, 1:]).sum(axis=(2, 3))
            bends = WT[:, 1:].reshape(K, f, -1) @ np.swapaxes(TPM[:, 1:].reshape(K, f, -1), 1, 2)
            away = unknowns[:, self.free_coordinates] - self._mean
            gradient[:, n:] = -slopes - away * self._information
            hessian[:, n:, :n] = -np.swapaxes(downhill[..., 1:], 1, 2)
            hessian[:, :n, n:] = -downhill[..., 1:]
            hessian[:, n:, n:] = bends + np.diag(self._information)
        if self.prior is not None:
            cost = cost + self.prior.cost(unknowns) / self.rows
        if len(unknowns) < K:
            unknowns, Q = (np.broadcast_to(v, (K, *v.shape[1:])) for v in (unknowns, Q))
        return Point(unknowns, cost, gradient, hessian, S, Q, W, WG)


def scan(problem: Problem, unknowns: Array) -> Array:
    """Fit at every node of the basis; (starts, leaks, N_UNKNOWNS) the best ones of each leak."""
    basis, leaks = problem.basis, len(problem.bank)
    nodes = len(basis.nodes)
    if nodes == 1:
        return unknowns[None]
    every = np.repeat(unknowns, nodes, axis=0)
    every[:, COORDINATES] = np.tile(basis.nodes, (leaks, 1))
    P = basis.maps(basis.nodes)[:, 0]
    parts = []
    for start in range(0, nodes, _NODES_AT_ONCE):
        some = P[start : start + _NODES_AT_ONCE]
        parts.append(some @ problem.bank[:, None] @ np.swapaxes(some, 1, 2))
    there = np.concatenate(parts, axis=1).reshape(-1, WIDTH, WIDTH)
    rows = np.repeat(problem.rows, nodes)
    given = Problem(there, rows, PLAIN, problem.prior)
    point, _ = minimize(given, every, _SCAN_ITERATIONS)
    cost = point.cost + problem.weak_cost(every) / rows
    starts = 1 if len(basis.free) == 1 else _STARTS
    best = np.argsort(cost.reshape(leaks, nodes), axis=1)[:, :starts]
    # Rows as they are have no coordinates to move; those of the node are where each search goes on.
    found = point.unknowns.copy()
    found[:, COORDINATES] = every[:, COORDINATES]
    found = found.reshape(leaks, nodes, -1)
    chosen: Array = np.swapaxes(np.take_along_axis(found, best[..., None], axis=1), 0, 1)
    return chosen


def search(problem: Problem, starts: Array) -> tuple[Point, Mask]:
    """The best minimum that (starts, leaks, N_UNKNOWNS) lead to, for each leak."""
    s, leaks, _ = starts.shape
    if s == 1:
        return minimize(problem, starts[0], MAX_ITERATIONS)
    bank, rows = np.tile(problem.bank, (s, 1, 1)), np.tile(problem.rows, s)
    wide = Problem(bank, rows, problem.basis, problem.prior)
    point, converged = minimize(wide, starts.reshape(s * leaks, -1), MAX_ITERATIONS)
    best = np.argmin(point.cost.reshape(s, leaks), axis=0) * leaks + np.arange(leaks)
    return Point(*(values[best] for values in vars(point).values())), converged[best]


def minimize(problem: Problem, unknowns: Array, limit: int) -> tuple[Point, Mask]:
    """Levenberg-Marquardt on log det of the residual covariance (W concentrated out).

    Args:
        problem: K hypotheses.
        unknowns: (K, N_UNKNOWNS) starting points.
        limit: most iterations.

    Returns:
        The minimizers, and (K,) whether each was reached.
    """
    K = len(unknowns)
    point = problem.evaluate(unknowns)
    return _descend(problem, point, np.full(K, _DAMPING), np.full(K, np.inf), limit)


def _descend(
    problem: Problem, point: Point, damping: Array, gain: Array, limit: int
) -> tuple[Point, Mask]:
    """The steps of `minimize`, with (K,) damping and (K,) gain of the step before."""
    converged = np.zeros(len(damping), dtype=bool)
    eye = np.eye(problem.p)
    for taken in range(1, limit + 1):
        gradient, hessian = problem.with_prior(point.gradient, point.hessian, point.unknowns)
        d = scales(hessian)
        H = hessian / (d[:, :, None] * d[:, None, :]) + damping[:, None, None] * eye
        downhill = gradient / d
        step = np.linalg.solve(H, downhill[..., None])[..., 0]
        # How much the cost can still fall, in units of the likelihood.
        before, gain = gain, (step * downhill).sum(axis=1)
        # Steps that do not become shorter any more are rounding.
        small = (gain < _CONVERGED**2) | ((gain < _UNSEEN**2) & (gain > 0.5 * before))
        candidate = problem.moved(point.unknowns, step / d)
        physical = rb.are_physical(candidate)
        if not physical.all():
            candidate = np.where(physical[:, None], candidate, point.unknowns)
        tried = problem.evaluate(candidate)
        # A step promises little, too, where much damping has made it short: then the cost decides.
        unseen = (gain < _UNSEEN**2) & (damping <= _SHORTENED)
        better = physical & ((tried.cost <= point.cost) | unseen) & ~converged
        point = point.where(better, tried)
        damping = np.where(better, np.maximum(damping * 0.1, 1e-12), damping * 10.0)
        # No step however small helps any more: rounding has the last word.
        converged = converged | small | (damping > 1e6)
        if converged.all():
            break
        if 2 * np.count_nonzero(converged) >= len(converged):
            left = ~converged
            rest = _descend(
                problem.part(left), point.part(left), damping[left], gain[left], limit - taken
            )
            point, converged[left] = point.filled(left, rest[0]), rest[1]
            break
    return point, converged


def without_noise(problem: Problem, point: Point, noise: Array) -> tuple[Problem, Point, Array]:
    """The problem without noise of the commands, and where its gradient vanishes.

    Such noise is a good part of what slow commands show: unlike that of measured speeds, one step
    does not take it out, and it pulls delay, lag and curve as well.

    Args:
        problem: of rows as they are.
        point: its minimum, which noise has moved.
        noise: (K, width, width) in the moments of one row.

    Returns:
        The problem, its solution, and (K, p) what the noise adds to the gradient there.
    """
    corrected = Problem(problem.bank, problem.rows, problem.basis, problem.prior, noise)
    unknowns, d = point.unknowns, scales(point.hessian)
    # The curvature with noise is the larger: steps with it are short.
    hessian = point.hessian
    if problem.prior is not None:
        hessian = hessian + problem.prior_information()
    H = hessian / (d[:, :, None] * d[:, None, :]) + _DAMPING * np.eye(problem.p)

    def to_go(at: Point) -> tuple[Array, Array]:
        """Step to where the gradient vanishes, in units of d, and (K,) how far that is."""
        gradient, _ = corrected.with_prior(at.gradient, at.hessian, at.unknowns)
        step = np.linalg.solve(H, (gradient / d)[..., None])[..., 0]
        return step, (step * gradient / d).sum(axis=1)

    found = corrected.evaluate(unknowns)
    step, left = to_go(found)
    share = np.ones(len(unknowns))
    for _ in range(_NOISE_STEPS):
        if left.max() < _NOISE_LEFT:
            break
        moved = problem.moved(found.unknowns, share[:, None] * step / d)
        physical = rb.are_physical(moved)
        tried = corrected.evaluate(np.where(physical[:, None], moved, found.unknowns))
        further, less = to_go(tried)
        # There is no cost to fall: a step that leaves more to go was too long.
        nearer = less <= left
        found = found.where(nearer, tried)
        step, left = np.where(nearer[:, None], further, step), np.where(nearer, less, left)
        share = np.where(nearer, np.minimum(_LONGER * share, 1.0), _SHORTER * share)
    return corrected, found, problem.evaluate(found.unknowns).gradient - found.gradient


def residual_maker(Q: Array) -> Array:
    """(..., 3, WIDTH) what makes residuals y - Q x of rows [x, y]."""
    T = np.empty((*Q.shape[:-1], WIDTH))
    T[..., :N_X] = -Q
    T[..., N_X:] = _IDENTITY
    return T


def first_guess(total: Array, rows: int, at: Array, prior: Prior | None) -> Array | None:
    """(N_UNKNOWNS,) to start from: a rough fit, or the prior's mean where that fits better."""
    rough = _starting_point(total)
    if rough is not None:
        rough = np.concatenate([rough, at])
    if prior is None:
        return rough
    guess = np.where(prior.known, prior.mean, 0.0 if rough is None else rough)
    guess[COORDINATES] = at
    if not rb.is_physical(guess):
        return rough
    if rough is None:
        return guess
    problem = Problem(total[None], rows, PLAIN, prior)
    both = np.stack([rough, guess])
    costs = [float(problem.evaluate(u[None]).cost[0]) for u in both]
    chosen: Array = both[int(np.argmin(costs))]
    return chosen


def _starting_point(total: Array) -> Array | None:
    """A rough theta from the response to torques: no guess by the user is needed."""
    Rxx, Rxy = total[:N_X, :N_X], total[:N_X, N_X:]
    scale = np.sqrt(np.maximum(np.diag(Rxx), 0.0))
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


def scales(hessian: Array) -> Array:
    """(..., p) square roots of the diagonal, 1 where there is no information at all."""
    diagonal = np.diagonal(hessian, axis1=-2, axis2=-1)
    return np.sqrt(np.where(diagonal > 1e-100, diagonal, 1.0))


def _times_each(left: Array, right: Array) -> Array:
    """(K, f, 3, n) of (K or 1, f, 3, m) rows times (K or 1, m, n) matrices, in one product each."""
    product = left.reshape(len(left), -1, left.shape[-1]) @ right
    out: Array = product.reshape(len(product), *left.shape[1:-1], right.shape[-1])
    return out
