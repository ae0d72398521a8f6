"""What is minimized: the power that Q(theta) leaves in rows, from their moments alone.

Rows [x, y] hold y = w' and signals x, and w' = Q(theta) x for a rigid body. At coordinates eta of
the actuators they are P(eta) z of rows z of elements, so that with T = [-Q, 1] residuals T P z have
the covariance

    S = T P M P' T' / n ,    M the sum of z z'

an exact quadratic in Q that follows from moments, as do its derivatives. Each axis has rows that
its own whitener made. The weight W = diag(1 / sigma_a^2) is the inverse of what is left, iterated
to the maximum-likelihood point.

Known noise N of the rotors' inputs is part of the residual; but it is no part of what turned the
vehicle, and least squares would underrate the inputs for it (errors in variables). Gradient and
curvature are therefore those of M - n N, for which the truth is the stationary point; the curvature
keeps a little of it (NOISE_SHARE).
"""

from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation.fit.deviations import NO_DEVIATIONS, Deviations
from gcs_sysid.estimation.fit.priors import (
    COORDINATE_MEAN,
    COORDINATE_STD,
    COORDINATES,
    N_UNKNOWNS,
    Prior,
)
from gcs_sysid.estimation.fit.solver import Iterate, Stopping
from gcs_sysid.estimation.rows.actuator_dynamics import PLAIN, WIDTH, ActuatorDynamics
from gcs_sysid.model import rigid_body as rb

N_X = rb.N_SIGNALS
NOISE_SHARE = 0.97
"""Share of the inputs' known noise that is no information. How strong it is, is known to one or two
percent, and where inputs are hardly more than noise, information must not become negative."""
LEAST_POWER = 0.05
"""Share of an innovation's power that no correction leaves it without."""
_EPSILON = 4e-15
"""Rounding of sums of products, relative to the squares in them."""
_IDENTITY = np.eye(3)
_DIAGONAL = np.arange(WIDTH)


@dataclass(frozen=True)
class Evaluation(Iterate):
    """A problem at some unknowns, for K hypotheses.

    Attributes:
        cost: (K,) log det of the residual covariance, with what coordinates, deviations and prior
            add; all per row.
        power: (K, 3) of the residuals of all rows, without the inputs' known noise; may be
            negative.
        weak: (K,) what coordinates, deviations and prior add to twice the cost of all rows.
        residual: (K, 3, 3) covariance of one row's residual.
        W: (K, 3, 3) its inverse.
        Q: (K, 3, N_X).
        WG: (K, N_THETA + m, 3, N_X) derivatives of Q by theta and m deviations, weighted.
    """

    cost: Array
    power: Array
    weak: Array
    residual: Array
    W: Array
    Q: Array
    WG: Array

    @property
    def variance(self) -> Array:
        """(K, 3) power of one row's residual."""
        return np.diagonal(self.residual, axis1=1, axis2=2)


class Problem:
    """Hypotheses that are fitted side by side, each axis weighed by its innovations' power.

    Args:
        moments: (K, 1, width, width) of rows of elements, the same for all axes, or (K, 3, ...) as
            each axis has them; (K, width, width) for short.
        rows: in each; (K,) where they are not equally many.
        basis: of the elements; what it leaves free is fitted.
        prior: what else is known.
        noise: as `moments`, of one row: known noise of the inputs in it; None: there is none.
        deviations: m of them, fitted too: unknowns after the coordinates.
    """

    stopping = Stopping(enough=1e-4, unseen=3e-4, poor=0.25)
    """Between two delays there is less noise than on a straight line: steps may overshoot."""

    def __init__(
        self,
        moments: Array,
        rows: Array | int,
        basis: ActuatorDynamics,
        prior: Prior | None,
        noise: Array | None = None,
        deviations: Deviations = NO_DEVIATIONS,
    ) -> None:
        self.moments = moments if moments.ndim == 4 else moments[:, None]
        self.rows: Array = np.full(len(moments), rows, dtype=float)
        """(K,) in each."""
        self.basis, self.prior, self.deviations = basis, prior, deviations
        m = len(deviations.std)
        self.linear = rb.N_THETA + m
        """Theta and deviations, which come first among what is fitted."""
        self.free_coordinates = rb.N_THETA + np.array(basis.free, dtype=int)
        """(f,) indices of those coordinates among the unknowns."""
        self.free = np.concatenate(
            [np.arange(rb.N_THETA), N_UNKNOWNS + np.arange(m), self.free_coordinates]
        )
        """(p,) indices of the unknowns that are fitted, coordinates last."""
        self.p = len(self.free)
        self._mean = COORDINATE_MEAN[list(basis.free)]
        self._information = COORDINATE_STD[list(basis.free)] ** -2.0
        self.noise, self.silent = noise, noise is None or not noise.any()
        self.exact = self.moments
        """As `moments`, without the known noise."""
        if noise is not None and not self.silent:
            noise = noise if noise.ndim == 4 else noise[:, None]
            self.exact = self.moments - self.rows[:, None, None, None] * noise

    def part(self, which: Array) -> Self:
        """Some of the hypotheses."""
        some = copy(self)
        for name in ("moments", "rows", "exact"):
            setattr(some, name, getattr(self, name)[which])
        if not self.silent and len(self._usual) > 1:
            some._usual = self._usual[which]
        return some

    # ---- unknowns ----------------------------------------------------------------------------

    @property
    def prior_information(self) -> Array:
        """(p, p) of the prior, on what is fitted."""
        information = np.zeros((self.p, self.p))
        if self.prior is not None:
            known = self.free < N_UNKNOWNS
            places = self.free[known]
            information[np.ix_(known, known)] = self.prior.information[np.ix_(places, places)]
        return information

    def prior_pull(self, unknowns: Array) -> Array:
        """(..., p) of the prior, on what is fitted."""
        pull = np.zeros((*unknowns.shape[:-1], self.p))
        if self.prior is not None:
            known = self.free < N_UNKNOWNS
            pull[..., known] = self.prior.pull(unknowns[..., :N_UNKNOWNS])[..., self.free[known]]
        return pull

    def with_prior(self, at: Evaluation) -> tuple[Array, Array]:
        """(K, p) gradient and (K, p, p) curvature, with what the prior adds."""
        if self.prior is None:
            return at.gradient, at.hessian
        return at.gradient + self.prior_pull(at.unknowns), at.hessian + self.prior_information

    def weak_cost(self, unknowns: Array) -> Array:
        """(...) of leaving the ordinary, see COORDINATE_STD."""
        away = unknowns[..., self.free_coordinates] - self._mean
        return (away * away) @ self._information

    def extended(self, unknowns: Array) -> Array:
        """(..., N_UNKNOWNS + m) of (..., N_UNKNOWNS or more): deviations, if missing, zero."""
        shape = (*unknowns.shape[:-1], N_UNKNOWNS + len(self.deviations.std))
        if unknowns.shape[-1] == shape[-1]:
            return unknowns
        out = np.zeros(shape)
        out[..., :N_UNKNOWNS] = unknowns[..., :N_UNKNOWNS]
        return out

    def moved(self, unknowns: Array, step: Array) -> Array:
        """(..., N_UNKNOWNS + m) after a (..., p) step, within the basis' range."""
        moved: Array = unknowns.copy()
        moved[..., self.free] += step
        moved[..., COORDINATES] = np.clip(moved[..., COORDINATES], self.basis.low, self.basis.high)
        return moved

    def reach(self, unknowns: Array) -> tuple[Array, Array]:
        """(K, p) steps to the ends of the basis' range."""
        at, free = unknowns[:, self.free_coordinates], list(self.basis.free)
        low, high = np.full((2, len(unknowns), self.p), np.inf)
        low[:, self.linear :] = at - self.basis.low[free]
        high[:, self.linear :] = self.basis.high[free] - at
        return -low, high

    def are_allowed(self, unknowns: Array) -> Mask:
        """(...) whether a rigid body can have such inertia."""
        return rb.are_physical(unknowns)

    def margin(self, unknowns: Array) -> tuple[Array, Array]:
        """(K,) least principal second moment of the mass, and its (K, p) derivatives."""
        least, by_elements = rb.least_second_moment(unknowns)
        slope = np.zeros((len(unknowns), self.p))
        slope[:, rb.ELEMENTS] = by_elements
        return least, slope

    def maps(self, unknowns: Array) -> Array:
        """(K, 1 + f, WIDTH, width) what makes rows [x, y] here, and its derivatives."""
        return self.basis.maps(unknowns[:, COORDINATES])

    def informed(self, moments: Array, exact: Array) -> Array:
        """What follows linearly from moments, without what of the known noise is no information.

        Args:
            moments: what follows from them.
            exact: the same without the known noise.
        """
        return moments if self.silent else (1.0 - NOISE_SHARE) * moments + NOISE_SHARE * exact

    # ---- cost --------------------------------------------------------------------------------

    def evaluate(self, unknowns: Array) -> Evaluation:
        """Cost and its derivatives at (K, N_UNKNOWNS + m), or at (1, N_UNKNOWNS + m) for all."""
        K, n, f = len(self.moments), self.linear, len(self.basis.free)
        unknowns = np.broadcast_to(unknowns, (K, unknowns.shape[1]))
        moments, exact = self.moments, self.exact
        if self.basis is not PLAIN:
            P = self.maps(unknowns)
            first, turned = P[:, :1], np.swapaxes(P[:, :1], -1, -2)
            mapped = first @ exact
            exact = mapped @ turned
            moments = exact if self.silent else first @ moments @ turned
        phi = unknowns[:, N_UNKNOWNS:]
        Q, G = self.deviations.jacobian(unknowns, phi)
        T = residual_maker(Q)
        residual, W, power = self._weigh(T, moments, exact)
        # By axis: (K, 3, n, N_X).
        WG, by_axis = (np.swapaxes(each, 1, 2) for each in (W[:, None] @ G, G))
        hessian, gradient = np.empty((K, self.p, self.p)), np.empty((K, self.p))
        bend = np.zeros_like(hessian)
        signals = self.informed(moments, exact)[..., :N_X, :N_X]
        hessian[:, :n, :n] = (WG @ signals @ np.swapaxes(by_axis, -1, -2)).sum(axis=1)
        downhill = WG @ (exact[..., :N_X, :] @ T[..., None])
        gradient[:, :n] = downhill.sum(axis=1)[..., 0]
        weak = np.zeros(K)
        if phi.shape[1]:
            information = self.deviations.information
            weak = weak + (phi * phi) @ information
            places = np.arange(rb.N_THETA, n)
            gradient[:, places] -= phi * information
            hessian[:, places, places] += information
        if f:
            # Of residuals, by coordinate: (K, f, 3, width), and with all columns.
            TP = T[:, None] @ P[:, 1:]
            changed = times_moments(TP, self.exact)
            TPM = changed
            if not self.silent:
                TPM = self.informed(times_moments(TP, self.moments), changed)
            slopes = ((W[:, None] @ changed) * (T @ P[:, 0])[:, None]).sum(axis=(2, 3))
            weighted = (W[:, None] @ TPM).reshape(K, f, -1)
            bends = weighted @ np.swapaxes(TP.reshape(K, f, -1), 1, 2)
            columns = TPM @ np.swapaxes(P[:, :1, :N_X], -1, -2)  # (K, f, 3, N_X)
            cross = (WG @ np.moveaxis(columns, 1, -1)).sum(axis=1)  # (K, n, f)
            away = unknowns[:, self.free_coordinates] - self._mean
            gradient[:, n:] = -slopes - away * self._information
            hessian[:, :n, n:] = -cross
            hessian[:, n:, :n] = -np.swapaxes(cross, 1, 2)
            hessian[:, n:, n:] = bends + np.diag(self._information)
            left = W[:, None] @ times_moments(T[:, None], mapped)
            turned = left @ np.swapaxes(P[:, 1:, :N_X], -1, -2)  # (K, f, 3, N_X)
            both = -(G.reshape(K, n, -1) @ np.swapaxes(turned.reshape(K, f, -1), 1, 2))
            bend[:, :n, n:], bend[:, n:, :n] = both, np.swapaxes(both, 1, 2)
            of_maps = np.swapaxes(T, 1, 2) @ left[:, 0]
            bend[:, n:, n:] = self.basis.curvature(unknowns[:, COORDINATES], P, of_maps)
            weak = weak + self.weak_cost(unknowns)
        if self.prior is not None:
            weak = weak + self.prior.cost(unknowns[:, :N_UNKNOWNS])
        cost = np.linalg.slogdet(residual)[1] + weak / self.rows
        WG = np.swapaxes(WG, 1, 2)
        return Evaluation(unknowns, gradient, hessian, bend, cost, power, weak, residual, W, Q, WG)

    @cached_property
    def _usual(self) -> Array:
        """(K, 3 or 1, WIDTH, WIDTH) known noise at coordinates that are always the same."""
        assert self.noise is not None
        if self.basis is PLAIN:
            return self.noise
        at = self.basis.nodes[self.basis.middle]
        return self.basis.moments_at(self.noise, at)

    def _weigh(self, T: Array, moments: Array, exact: Array) -> tuple[Array, Array, Array]:
        """Residual covariance, its inverse, and power, as of `Evaluation`.

        Args:
            T: (K, 3, WIDTH) what makes residuals.
            moments: (K, 1 or 3, WIDTH, WIDTH) of rows [x, y].
            exact: the same without the inputs' known noise.
        """
        rows = self.rows[:, None]
        own = axis_power(T, exact)
        all_ = own if self.silent else axis_power(T, moments)
        # Signals between two of the basis' delays are means of both, and have less noise: a weight
        # that followed that would make every delay look for the middle between two.
        usual = own / rows if self.silent else own / rows + axis_power(T, self._usual)
        sizes = moments[..., _DIAGONAL, _DIAGONAL]
        least = LEAST_POWER * all_ + _EPSILON * (T * T * sizes).sum(axis=-1)
        variance = np.maximum(usual, least / rows) + 1e-300
        return variance[..., None] * _IDENTITY, _IDENTITY / variance[..., None], own

    def fall(self, before: Evaluation, after: Evaluation) -> Array:
        """(K,) by how much a step lowers the power over the innovations' variance as it was before.

        At the point that this leads to in the end the gradient without the known noise vanishes.
        """
        was, now = ((at.power / before.variance).sum(axis=1) + at.weak for at in (before, after))
        return was - now


def residual_maker(Q: Array) -> Array:
    """(..., 3, WIDTH) what makes residuals y - Q x of rows [x, y]."""
    T = np.empty((*Q.shape[:-1], WIDTH))
    T[..., :N_X] = -Q
    T[..., N_X:] = _IDENTITY
    return T


def times_moments(left: Array, moments: Array) -> Array:
    """(K, f, 3, m) of (K or 1, f, 3, n) such rows times (K, 1 or 3, n, m) moments of each axis."""
    if moments.shape[1] == 1:
        # In one product each.
        product = left.reshape(len(left), -1, left.shape[-1]) @ moments[:, 0]
        out: Array = product.reshape(len(product), *left.shape[1:-1], -1)
        return out
    out = np.swapaxes(np.swapaxes(left, 1, 2) @ moments, 1, 2)
    return out


def own_power(moments: Array) -> Array:
    """(..., 3) of y itself, of (..., 1 or 3, n, n) moments of rows that end with it."""
    axes = np.arange(3)
    out: Array = moments[..., axes if moments.shape[-3] > 1 else 0, axes - 3, axes - 3]
    return out


def axis_power(T: Array, moments: Array) -> Array:
    """(..., 3) T_a M_a T_a' of (..., 3, n) rows and (..., 1 or 3, n, n) moments."""
    if moments.shape[-3] == 1:
        power: Array = ((T @ moments[..., 0, :, :]) * T).sum(axis=-1)
    else:
        power = ((T[..., None, :] @ moments)[..., 0, :] * T).sum(axis=-1)
    return power
