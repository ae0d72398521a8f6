"""From points near the minima of a problem to estimates with their covariance.

Rows are correlated, so that the cost overstates what it knows. A prior joins the search as it is,
but in the outcome it is weighed against the information that the scatter of the batch scores
leaves: the curvature-adjusted composite likelihood of Chandler and Bate (2007), Biometrika 94,
167-183.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from gcs_sysid.arrays import Array, Mask, by_parts
from gcs_sysid.estimation.fit.priors import COORDINATE_STD, COORDINATES, N_UNKNOWNS, Prior, Unknown
from gcs_sysid.estimation.fit.problem import N_X, Evaluation, Problem, own_power, residual_maker
from gcs_sysid.estimation.fit.rotation import RotationFit, RotationStart, along, standard_deviations
from gcs_sysid.estimation.fit.solver import minimize, scales
from gcs_sysid.estimation.noise.uncertainty import symmetric_roots
from gcs_sysid.estimation.rows.actuator_dynamics import ActuatorDynamics
from gcs_sysid.model import rigid_body as rb

_FOLLOWED = 3
"""Iterations of a fit that follows, where it is not near."""
_ABSURD = -0.5
"""Share of an axis' acceleration explained: less indicates a false minimum."""


def follow_rotation(
    totals: Array,
    rows: Array,
    basis: ActuatorDynamics,
    noise: Array,
    start: RotationFit,
    prior: Prior | None = None,
) -> list[RotationFit]:
    """Follow a growing record from an earlier fit: a step or two with its whiteners.

    How far the score scatters is taken over from the earlier fit, as it hardly changes.

    Args:
        totals: (K, 3, width, width) moments of all rows at K instants, as each axis' whitener of
            `start` has them.
        rows: (K,) in them.
        basis: of the elements.
        noise: (K, 3, width, width) of the inputs in one row.
        start: a fit of the same record when it was shorter.
        prior: what else is known.

    Returns:
        K fits, each of which depends on `start` and its own instant alone.
    """
    before = start.warm_start
    assert before is not None
    unknowns = np.tile(before.unknowns, (len(rows), 1))
    problem = Problem(totals, rows, basis, prior, noise, start.deviating)
    outcome = Outcome(problem, problem.evaluate(unknowns))
    # A step of less than 3 standard deviations is taken unseen.
    near = outcome.take_step(3.0)
    scatter = before.inflation, before.widening
    fits = outcome.fits(*scatter, [start.converged] * len(rows))
    if not near.all():
        far = ~near
        point, converged = minimize(problem.part(far), unknowns[far], _FOLLOWED)
        better = Outcome(problem.part(far), point).fits(*scatter, converged)
        for i, fit in zip(np.flatnonzero(far), better, strict=True):
            fits[i] = fit
    return [
        replace(
            fit,
            whiteners=start.whiteners,
            of_steps=start.of_steps,
            disturbance=start.disturbance,
            deviating=start.deviating,
            ages=start.ages,
        )
        for fit in fits
    ]


class Outcome:
    """What follows from points near the minima of K hypotheses.

    Args:
        problem: that was solved.
        point: its solution.
    """

    def __init__(self, problem: Problem, point: Evaluation) -> None:
        self._problem, self._point = problem, point
        self._unknowns: Array = point.unknowns
        self._gradient: Array = point.gradient
        self._scale = scales(point.hessian)
        self._scales = self._scale[:, :, None] * self._scale[:, None, :]
        # A direction that the data do not see at all keeps a huge, finite variance.
        self.roots = symmetric_roots(point.hessian / self._scales)
        """(K, p, p) roots of the scaled information, and of its inverse."""

    def spread_of(self, pull: Array) -> Array:
        """(K, p, p) what a (K, p) gradient that is uncertain by itself adds to the inflation."""
        moved = _times(self.roots[1], pull / self._scale)
        return moved[:, :, None] * moved[:, None, :]

    def scores(self, i: int, batches: Array) -> Array:
        """(k, p) scaled downhill gradient of half the cost, batch by batch.

        Args:
            i: of the hypothesis.
            batches: (k, 1 or 3, width, width) of this hypothesis.
        """
        f, point = len(self._problem.basis.free), self._point
        P = self._problem.maps(self._unknowns[i : i + 1])[0]
        TP = residual_maker(point.Q[i]) @ P
        WG = point.WG[i].reshape(self._problem.linear, -1)
        slopes = (point.W[i] @ TP[1:]).reshape(f, TP.shape[-2] * TP.shape[-1])

        def some(batches: Array) -> Array:
            k = len(batches)
            TPM = TP[0] @ batches[:, 0] if batches.shape[1] == 1 else _each_axis(TP[0], batches)
            of_theta = (TPM @ P[0, :N_X].T).reshape(k, -1) @ WG.T
            return np.column_stack([of_theta, -TPM.reshape(k, -1) @ slopes.T])

        return by_parts(some, batches) / self._scale[i]

    def shares(self, i: int, batches: Array) -> Array:
        """(k, p) what each batch is expected to add to the variance of each unknown.

        The diagonal of H^-1 H_b H^-1, H_b the information of a batch; any scale.

        Args:
            i: of the hypothesis.
            batches: (k, 1 or 3, width, width) of this hypothesis.
        """
        n, inverse_root, point = self._problem.linear, self.roots[1][i], self._point
        W = point.W[i]
        P = self._problem.maps(self._unknowns[i : i + 1])[0]
        inverse = (inverse_root @ inverse_root) / self._scales[i]
        weighted = (inverse[:n, :n] @ point.WG[i].reshape(n, -1)).reshape(n, 3, N_X)
        moved = point.residual[i] @ weighted
        # Of each axis the outer product of what a parameter does to its Q.
        powers = moved[..., None] * weighted[..., None, :]
        if batches.shape[1] == 1:
            powers = powers.sum(axis=1)
        powers = powers.reshape(n, -1).T
        X, TP = P[0, :N_X], residual_maker(point.Q[i]) @ P[1:]

        def some(batches: Array) -> Array:
            of_theta: Array = (X @ batches @ X.T).reshape(len(batches), -1) @ powers
            bends = [((W @ row) * _each_axis(row, batches)).sum(axis=(1, 2)) for row in TP]
            return np.column_stack([of_theta, *bends])

        return by_parts(some, batches)

    def take_step(self, largest: float) -> Mask:
        """Go on by a Gauss-Newton step where that is no longer than so many deviations.

        Returns:
            (K,) where it was taken.
        """
        problem, d = self._problem, self._scale
        root, inverse_root = self.roots
        downhill = self._gradient / d
        if problem.prior is None:
            step = _times(inverse_root, _times(inverse_root, downhill))
        else:
            downhill = downhill + problem.prior_pull(self._unknowns) / d
            information = root @ root + problem.prior_information / self._scales
            step = np.linalg.solve(information, downhill[..., None])[..., 0]
        near: Mask = (step * downhill).sum(axis=1) <= largest**2
        moved = self._moved(np.where(near[:, None], step / d, 0.0))
        way = (moved - self._unknowns)[:, problem.free]
        self._gradient = self._gradient - _times(self._point.hessian, way)
        self._unknowns = moved
        return near

    def fits(
        self,
        spread: Array,
        widening: Array,
        converged: Iterable[bool],
    ) -> list[RotationFit]:
        """The K estimates.

        Args:
            spread: (K, p, p) or (p, p) inflation of the covariance.
            widening: (K, p) or (p,) factors on the standard deviations.
            converged: whether each minimum was reached.
        """
        problem, point, d, n = self._problem, self._point, self._scale, rb.N_THETA
        K, p = d.shape
        spread, widening = np.broadcast_to(spread, (K, p, p)), np.broadcast_to(widening, (K, p))
        root, inverse_root = self.roots
        prior = problem.prior
        wider = widening[:, :, None] * inverse_root
        added, data_covariance = self._with_sizes(wider @ symmetric_roots(spread, 0.0)[0])
        places = slice(n, problem.linear)
        covariance, phi = data_covariance, self._unknowns[:, N_UNKNOWNS:] * d[:, places]
        if prior is None:
            step = -_times(covariance[:, :, places], added * phi)
        else:
            pull = self._gradient.copy()
            coordinates, basis = self._unknowns[:, COORDINATES], problem.basis
            inside = (coordinates > basis.low) & (coordinates < basis.high)
            pull[:, problem.linear :] *= inside[:, list(basis.free)]
            # Of a fit astray some directions may scatter beyond all digits: they are the prior's.
            held = (root / widening[:, :, None]) @ np.linalg.pinv(spread, hermitian=True)
            information = held @ (root / widening[:, None, :]) + 1e-15 * np.eye(p)
            information[:, range(n, problem.linear), range(n, problem.linear)] += added
            covariance = np.linalg.inv(information + problem.prior_information / self._scales)
            from_data = _times(held, _times(inverse_root, pull / (d * widening)))
            from_data[:, places] -= added * phi
            step = _times(covariance, from_data + problem.prior_pull(self._unknowns) / d)
        unknowns = self._moved(step / d)
        every = np.zeros((K, unknowns.shape[1], unknowns.shape[1]))
        every[:, problem.free[:, None], problem.free] = covariance / self._scales
        full = every[:, :N_UNKNOWNS, :N_UNKNOWNS]
        if problem.basis.curve_doubt and Unknown.CURVE in problem.free:
            for own in full:
                with_curve = along(own, Unknown.CURVE, problem.basis.curve_doubt)
                own += np.outer(with_curve, with_curve)
        r_squared = self._explained()
        if problem.basis.motors and Unknown.CURVE in problem.free:
            # A fit that explains an axis worse than nothing is in a false minimum.
            for i in np.flatnonzero(r_squared.min(axis=1) < _ABSURD):
                own = full[i]
                # There curve and lag are what they ordinarily are.
                for place in (Unknown.CURVE, Unknown.LAG):
                    off = along(own, place, COORDINATE_STD[place - rb.N_THETA])
                    own += np.outer(off, off)
        data_std = standard_deviations(np.diagonal(data_covariance, axis1=1, axis2=2)) / d
        # The likelihood's information adds up with the prior's L to C^-1: dx / dm = C L.
        by_prior = every[:, problem.free[:, None], problem.free] @ problem.prior_information
        return [
            RotationFit(
                theta=unknowns[i, :n],
                covariance=full[i, :n, :n],
                residual_covariance=point.residual[i],
                r_squared=r_squared[i],
                rows=int(problem.rows[i]),
                converged=bool(done),
                coordinates=unknowns[i, COORDINATES],
                data_std=data_std[i, :n],
                by_prior=by_prior[i, :n, :n],
                full_covariance=full[i],
                warm_start=RotationStart(self._unknowns[i], spread[i], widening[i]),
                deviations=unknowns[i, N_UNKNOWNS:],
                extended_covariance=every[i],
            )
            for i, done in enumerate(converged)
        ]

    def _with_sizes(self, factor: Array) -> tuple[Array, Array]:
        """What known sizes of deviations are worth beside data that scatter more than white.

        They are information too; but they are no data, and scatter does not make them larger.

        Args:
            factor: (K, p, p) F of the scaled covariance C = F F' by scatter, which widens their
                information with the data's.

        Returns:
            (K, m) scaled information S to be added, and (K, p, p) the covariance with it,
            (C^-1 + S)^-1 = F (1 + F' S F)^-1 F'.
        """
        places, deviations = slice(rb.N_THETA, self._problem.linear), self._problem.deviations
        own = factor[:, places]
        white, scattered = (self.roots[1][:, places] ** 2).sum(axis=2), (own**2).sum(axis=2)
        known = deviations.information * deviations.sized / self._scale[:, places] ** 2
        added = known * np.maximum(1.0 - white / scattered, 0.0)
        values, vectors = np.linalg.eigh(np.swapaxes(own, 1, 2) @ (added[:, :, None] * own))
        known_too = factor @ (vectors / np.sqrt(1.0 + np.maximum(values, 0.0))[:, None, :])
        return added, known_too @ np.swapaxes(known_too, 1, 2)

    def _explained(self) -> Array:
        """(K, 3) share of each axis' angular acceleration that the model explains."""
        problem = self._problem
        all_ = own_power(problem.moments) / problem.rows[:, None]
        return 1.0 - self._point.variance / np.maximum(all_, 1e-300)

    def _moved(self, step: Array) -> Array:
        """(K, N_UNKNOWNS) after a (K, p) step, shortened until the inertia is physical.

        Nor does it leave the basis' range: lag and delay do the same to slow signals, and cut off
        singly a step along both goes astray. At the end itself a coordinate is just held.
        """
        low, high = self._problem.reach(self._unknowns)
        room = np.where(step > 0.0, high, -low)
        share = np.where(room > 0.0, 0.9 * room / np.maximum(np.abs(step), 1e-300), np.inf)
        step = np.where(room > 0.0, np.minimum(share.min(axis=1, keepdims=True), 1.0) * step, 0.0)
        # After so many halvings a step out of the physical inertias is not taken.
        for _ in range(20):
            unknowns = self._problem.moved(self._unknowns, step)
            physical = self._problem.are_allowed(unknowns)
            if physical.all():
                return unknowns
            step = np.where(physical[:, None], step, 0.5 * step)
        return np.where(self._problem.are_allowed(unknowns)[:, None], unknowns, self._unknowns)


def _times(matrices: Array, vectors: Array) -> Array:
    """(K, a) products of (K, a, b) and (K, b)."""
    return (matrices @ vectors[..., None])[..., 0]


def _each_axis(rows: Array, batches: Array) -> Array:
    """(k, 3, width) of (3, width) rows times (k, 1 or 3, width, width) batches of each axis."""
    return (rows[:, None] @ batches)[:, :, 0]
