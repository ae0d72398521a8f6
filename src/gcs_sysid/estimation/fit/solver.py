"""Damped Newton steps, for several hypotheses side by side: the one minimizer of all fits.

Levenberg-Marquardt on the normal matrix scaled to a unit diagonal. What is minimized, in what
units, and which steps are allowed, is the problem's.
"""

from dataclasses import dataclass
from typing import Protocol, Self, TypeVar

import numpy as np

from gcs_sysid.arrays import Array, Mask

_DAMPING, _LEAST_DAMPING, _MOST_DAMPING, _EASED = 1e-4, 1e-12, 1e6, 0.1
_KEPT = 0.1
"""Share of the way to the edge of what is allowed that a step leaves."""
_BESIDE = 0.1
"""Standard deviations; smaller steps along that edge, which is curved, hardly gain what they
promise."""


@dataclass(frozen=True)
class Iterate:
    """Where the search stands, for K hypotheses.

    Attributes:
        unknowns: (K, u).
        gradient: (K, p) downhill, of half the cost.
        hessian: (K, p, p) of the same, Gauss-Newton.
        bend: (K, p, p) what residuals' second derivatives add to it, as far as these are known.
            Steps are by both; what is known of the unknowns is the first alone.
    """

    unknowns: Array
    gradient: Array
    hessian: Array
    bend: Array

    def where(self, better: Mask, other: Self) -> Self:
        """The other one for the hypotheses where that is better."""
        if len(better) == 1:
            return other if better[0] else self
        mine, others = vars(self), vars(other)
        return type(self)(
            **{
                name: np.where(better.reshape(-1, *(1,) * (old.ndim - 1)), others[name], old)
                for name, old in mine.items()
            }
        )

    def part(self, which: Array) -> Self:
        """Some of the hypotheses."""
        return type(self)(**{name: values[which] for name, values in vars(self).items()})

    def filled(self, which: Mask, some: Self) -> Self:
        """With others for some of the hypotheses."""
        every = {name: values.copy() for name, values in vars(self).items()}
        for name, values in vars(some).items():
            every[name][which] = values
        return type(self)(**every)


At = TypeVar("At", bound=Iterate)


@dataclass(frozen=True)
class Stopping:
    """When a step is taken, and when the last one was.

    Attributes:
        enough: standard deviations; smaller steps change nothing.
        unseen: standard deviations; smaller steps are taken without looking at what they gain,
            which is lost in its rounding, and end the search once they become no shorter.
        shortened: damping above which small steps are looked at nevertheless: it made them short.
        poor: share of the gain expected; a step that brings less was too long. 0: none is.
    """

    enough: float
    unseen: float
    shortened: float = np.inf
    poor: float = 0.0


class Minimized(Protocol[At]):
    """What is minimized, for K hypotheses."""

    @property
    def stopping(self) -> Stopping:
        """When the search ends."""
        ...

    def part(self, which: Array) -> Self:
        """Some of the hypotheses."""
        ...

    def evaluate(self, unknowns: Array) -> At:
        """At (K, u) unknowns."""
        ...

    def with_prior(self, at: At) -> tuple[Array, Array]:
        """(K, p) gradient and (K, p, p) curvature, with what is known beforehand."""
        ...

    def moved(self, unknowns: Array, step: Array) -> Array:
        """(K, u) unknowns after a (K, p) step."""
        ...

    def are_allowed(self, unknowns: Array) -> Mask:
        """(K,) whether unknowns mean anything."""
        ...

    def margin(self, unknowns: Array) -> tuple[Array, Array]:
        """(K,) how far from the edge of what is allowed, in any unit, and its (K, p) derivatives.

        Negative beyond it.
        """
        ...

    def reach(self, unknowns: Array) -> tuple[Array, Array]:
        """(K, p) least and greatest step of each unknown that does not leave its range."""
        ...

    def fall(self, before: At, after: At) -> Array:
        """(K,) by how much a step lowers what is minimized."""
        ...


def minimize(problem: Minimized[At], unknowns: Array, limit: int) -> tuple[At, Mask]:
    """The minimum that a start leads to.

    Args:
        problem: K hypotheses.
        unknowns: (K, u) starting points.
        limit: most iterations.

    Returns:
        The minimizers, and (K,) whether each was reached.
    """
    K = len(unknowns)
    damping, ease, gain = (np.full(K, value) for value in (_DAMPING, _EASED, np.inf))
    state = _Descent(damping, ease, gain, np.zeros(K, dtype=bool))
    return _descend(problem, problem.evaluate(unknowns), state, limit)


@dataclass(frozen=True)
class _Descent:
    """What the step before leaves, for K hypotheses.

    Attributes:
        damping: (K,) of the next step.
        ease: (K,) times which damping is after a good one: 1 after one that was rejected, so that
            the next is not too long again.
        gain: (K,) of the step before.
        beside: (K,) whether it went along the edge of what is allowed.
    """

    damping: Array
    ease: Array
    gain: Array
    beside: Mask

    def part(self, which: Mask) -> "_Descent":
        return _Descent(*(values[which] for values in vars(self).values()))


def _descend(problem: Minimized[At], point: At, state: _Descent, limit: int) -> tuple[At, Mask]:
    """The steps of `minimize`."""
    damping, ease, gain, beside = vars(state).values()
    converged, stopping = np.zeros(len(damping), dtype=bool), problem.stopping
    for taken in range(1, limit + 1):
        gradient, hessian = problem.with_prior(point)
        d = scales(hessian)
        step, downhill, H = _within(
            problem.reach(point.unknowns), gradient, hessian + point.bend, d, damping
        )
        candidate = problem.moved(point.unknowns, step / d)
        allowed = problem.are_allowed(candidate)
        # Long steps lead outside before a search is near; bent, they would end at the edge. From
        # there on it goes along it.
        outside = ~allowed & (beside | (damping >= 1.0))
        if outside.any():
            step = _along_edge(problem, point.unknowns, step, d, H, outside)
            candidate = problem.moved(point.unknowns, step / d)
            allowed = problem.are_allowed(candidate)
        # How much the cost can still fall, in units of the likelihood.
        # Beside an edge the way may go uphill first.
        before, gain = gain, np.abs((step * downhill).sum(axis=1))
        # Steps that do not become shorter any more are rounding.
        small = gain < np.where(outside, _BESIDE, stopping.enough) ** 2
        small |= (gain < stopping.unseen**2) & (gain > 0.5 * before)
        tried = point
        if allowed.any():
            tried = problem.evaluate(np.where(allowed[:, None], candidate, point.unknowns))
        fall = problem.fall(point, tried)
        unseen = (gain < stopping.unseen**2) & (damping <= stopping.shortened)
        better = allowed & ((fall >= 0.0) | unseen) & ~converged
        point = point.where(better, tried)
        beside = np.where(better, outside, beside)
        poor = (stopping.poor > 0.0) & ~small & (fall < stopping.poor * gain)
        factor = np.where(better, np.where(poor, 5.0, ease), 10.0)
        damping = np.maximum(factor * damping, _LEAST_DAMPING)
        ease = np.where(better, np.maximum(0.3 * ease, _EASED), 1.0)
        # Where no step however small helps any more, rounding has the last word.
        converged = converged | (small & (better | ~outside)) | (damping > _MOST_DAMPING)
        if converged.all():
            break
        if 2 * np.count_nonzero(converged) >= len(converged):
            left = ~converged
            state = _Descent(damping, ease, gain, beside).part(left)
            rest = _descend(problem.part(left), point.part(left), state, limit - taken)
            point, converged[left] = point.filled(left, rest[0]), rest[1]
            break
    return point, converged


def _within(
    reach: tuple[Array, Array], gradient: Array, hessian: Array, d: Array, damping: Array
) -> tuple[Array, Array, Array]:
    """As `_step`, where some unknowns have a range: those that would leave it go to its end.

    The others then go to the minimum beside that edge (active set: Bertsekas 1982, SIAM Journal on
    Control and Optimization 20, 221-246). Cut off there, they would make up for a move that is not
    made.
    """
    step, downhill, H = _step(hessian, gradient, d, damping)
    low, high = reach[0] * d, reach[1] * d
    held = np.zeros(step.shape, dtype=bool)
    while (beyond := ~held & ((step < low) | (step > high))).any():
        held |= beyond
        moved = np.where(held, np.clip(step, low, high), 0.0)
        left = np.where(held, moved, downhill - (H @ moved[..., None])[..., 0])
        either = held[:, :, None] | held[:, None, :]
        rest = np.where(either, np.eye(H.shape[1]), H)
        step = np.linalg.solve(rest, left[..., None])[..., 0]
    return step, downhill, H


def _along_edge(
    problem: Minimized[At], unknowns: Array, step: Array, d: Array, H: Array, outside: Mask
) -> Array:
    """(K, p) steps, those that lead outside bent along the edge of what is allowed.

    Of all steps that stay inside it is the one of least cost (active set: Nocedal and Wright 2006,
    Numerical Optimization, 16.5). Cut short, they would get nowhere once the edge is near.

    Args:
        problem: K hypotheses.
        unknowns: (K, u) where the steps start.
        step: (K, p) in units of d.
        d: (K, p) scales.
        H: (K, p, p) damped curvature in these units.
        outside: (K,) which steps lead outside.
    """
    margin, inward = problem.margin(unknowns)
    inward = inward / d
    way = np.linalg.solve(H, inward[..., None])[..., 0]
    away = (inward * way).sum(axis=1)
    for _ in range(4):  # edges are curved
        left, _slope = problem.margin(problem.moved(unknowns, step / d))
        short = np.where(outside, np.maximum(_KEPT * margin - left, 0.0), 0.0)
        if not short.any():
            break
        step = step + way * (short / away)[:, None]
    return step


def _step(hessian: Array, gradient: Array, d: Array, damping: Array) -> tuple[Array, Array, Array]:
    """(K, p) damped step, (K, p) gradient and (K, p, p) damped curvature, in units of d."""
    H = hessian / (d[:, :, None] * d[:, None, :])
    H = H + (damping + _lift(H))[:, None, None] * np.eye(d.shape[1])
    downhill = gradient / d
    return np.linalg.solve(H, downhill[..., None])[..., 0], downhill, H


def _lift(H: Array) -> Array:
    """(K,) what makes scaled curvatures positive definite, which less known noise need not be."""
    try:
        np.linalg.cholesky(H)
    except np.linalg.LinAlgError:
        least = np.linalg.eigvalsh(H)[:, 0]
        lift: Array = np.where(least > _LEAST_DAMPING, 0.0, _LEAST_DAMPING - 2.0 * least)
        return lift
    return np.zeros(len(H))


def scales(hessian: Array) -> Array:
    """(..., p) square roots of the diagonal, 1 where there is no information at all."""
    diagonal = np.diagonal(hessian, axis1=-2, axis2=-1)
    return np.sqrt(np.where(diagonal > 1e-100, diagonal, 1.0))
