"""The rotational cost where each axis has moments of its own.

Rows whitened with one filter are not white on every axis: each axis a has moments M_a of the rows
that its own whitener made. With T = [-Q(theta), 1] the innovations' power and the cost are

    sigma_a^2 = T_a M_a T_a' / n ,    cost = sum over a of n ln sigma_a^2

so that the weight is diagonal. Known noise N_a of the rotors' inputs is part of the innovations,
and stays in sigma_a; but it is no part of what turned the vehicle, and least squares would
underrate the inputs for it (errors in variables). Gradient and curvature are therefore those of
M_a - n N_a, for which the truth is the stationary point.
"""

from dataclasses import dataclass, fields

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation.fit.deviations import NO_DEVIATIONS, Deviations
from gcs_sysid.estimation.fit.priors import N_UNKNOWNS, Prior
from gcs_sysid.estimation.fit.search import N_X, Problem, residual_maker, scales
from gcs_sysid.estimation.rows.actuator_dynamics import PLAIN, WIDTH, ActuatorDynamics
from gcs_sysid.model import rigid_body as rb

NOISE_SHARE = 0.97
"""Share of the inputs' known noise that is taken out. How strong it is, is known to one or two
percent, and where inputs are hardly more than noise, information must not become negative."""
_LEAST = 0.05
"""Share of an innovation's power that no correction leaves it without."""
_AXES = 3
_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-4, 1e-12, 1e6
_CONVERGED = 3e-4
"""Steps smaller than this many standard deviations change nothing."""
_POOR = 0.25
"""Of the gain expected; a step that brings less is too long."""
_EPSILON = 4e-15
"""Rounding of sums of products, relative to the squares in them."""
_DIAGONAL = np.arange(WIDTH)


@dataclass(frozen=True)
class AxisPoint:
    """State of the search, for K hypotheses.

    Attributes:
        unknowns: (K, N_UNKNOWNS).
        variance: (K, 3) power of the innovations.
        motion_power: (K, 3) of the same, times n, without the inputs' known noise; may be negative.
        weak: (K,) what coordinates and prior add to twice the cost.
        gradient: (K, p) downhill, of half the cost, at the weights of this point.
        hessian: (K, p, p) of the same, Gauss-Newton.
        Q: (K, 3, N_X).
        WG: (K, N_THETA + m, 3, N_X) derivatives of Q by theta and the deviations, over the
            innovations' power.
    """

    unknowns: Array
    variance: Array
    motion_power: Array
    weak: Array
    gradient: Array
    hessian: Array
    Q: Array
    WG: Array

    @property
    def residual(self) -> Array:
        """(K, 3, 3) covariance of one row's innovations, of each axis by itself."""
        covariance: Array = self.variance[:, :, None] * np.eye(_AXES)
        return covariance

    def where(self, better: Mask, other: "AxisPoint") -> "AxisPoint":
        """The other point for the hypotheses where that is better."""
        pairs = ((getattr(other, f.name), getattr(self, f.name)) for f in fields(self))
        return AxisPoint(
            *(np.where(better.reshape(-1, *(1,) * (new.ndim - 1)), new, old) for new, old in pairs)
        )

    def chosen(self, which: Array) -> "AxisPoint":
        """Some of the hypotheses."""
        return AxisPoint(*(getattr(self, f.name)[which] for f in fields(self)))


class AxisProblem(Problem):
    """Hypotheses that are fitted side by side.

    Args:
        moments: (K, 3, width, width) of rows of elements, as each axis has them whitened; or
            (K, 1, ...) where all axes have the same.
        rows: in each; (K,) where they are not equally many.
        basis: of the elements; what it leaves free is fitted.
        prior: what else is known.
        noise: as `moments`, of one row: known noise of the inputs in it.
        deviations: m of them, fitted too: unknowns after the coordinates.
    """

    def __init__(
        self,
        moments: Array,
        rows: Array | int,
        basis: ActuatorDynamics,
        prior: Prior | None,
        noise: Array,
        deviations: Deviations = NO_DEVIATIONS,
    ) -> None:
        super().__init__(moments, rows, basis, prior)
        self.deviations = deviations
        m = len(deviations.std)
        self.linear = rb.N_THETA + m
        """Theta and deviations, which come first among what is fitted."""
        self.free = np.concatenate(
            [self.free[: rb.N_THETA], N_UNKNOWNS + np.arange(m), self.free_coordinates]
        )
        self.p = len(self.free)
        self._silent = not noise.any()
        self.without = moments
        """As `moments`, without the known noise."""
        if not self._silent:
            self.without = moments - (NOISE_SHARE * self.rows)[:, None, None, None] * noise
        self._noise_of_all = self.rows[:, None, None, None] * noise
        usual = noise if basis is PLAIN else basis.moments_at(noise, basis.nodes[basis.middle])
        self._usual = NOISE_SHARE * usual
        """(K, 3 or 1, WIDTH, WIDTH) known noise at coordinates that are always the same."""

    def prior_information(self) -> Array:
        """(p, p) of the prior, on what is fitted."""
        assert self.prior is not None
        information = np.zeros((self.p, self.p))
        known = self.free < N_UNKNOWNS
        places = self.free[known]
        information[np.ix_(known, known)] = self.prior.information[np.ix_(places, places)]
        return information

    def prior_pull(self, unknowns: Array) -> Array:
        """(..., p) of the prior, on what is fitted."""
        assert self.prior is not None
        known = self.free < N_UNKNOWNS
        pull = np.zeros((*unknowns.shape[:-1], self.p))
        pull[..., known] = self.prior.pull(unknowns[..., :N_UNKNOWNS])[..., self.free[known]]
        return pull

    def extended(self, unknowns: Array) -> Array:
        """(..., N_UNKNOWNS + m) of (..., N_UNKNOWNS or more): deviations, if missing, zero."""
        shape = (*unknowns.shape[:-1], N_UNKNOWNS + len(self.deviations.std))
        if unknowns.shape[-1] == shape[-1]:
            return unknowns
        out = np.zeros(shape)
        out[..., :N_UNKNOWNS] = unknowns[..., :N_UNKNOWNS]
        return out

    def evaluate(self, unknowns: Array) -> AxisPoint:  # type: ignore[override]
        """Cost and its derivatives at (K, N_UNKNOWNS + m), or at (1, N_UNKNOWNS + m) for all."""
        K, n, f = len(self.bank), self.linear, len(self.basis.free)
        unknowns = np.broadcast_to(unknowns, (K, unknowns.shape[1]))
        phi = unknowns[:, N_UNKNOWNS:]
        rows = self.rows[:, None]
        moments, corrected = self.bank, self.without
        if self.basis is not PLAIN:
            P = self.maps(unknowns)
            first, turned = P[:, :1], np.swapaxes(P[:, :1], -1, -2)
            moments = first @ moments @ turned
            corrected = moments if self._silent else first @ corrected @ turned
        Q, G = self._model(unknowns[:, : rb.N_THETA], phi)
        T = residual_maker(Q)
        sizes = moments[..., _DIAGONAL, _DIAGONAL]
        own = _power(T, corrected)
        all_ = own if self._silent else _power(T, moments)
        # Signals between two of the basis' delays are means of both, and have less noise: a weight
        # that followed that would make every delay look for the middle between two.
        usual = own / rows if self._silent else own / rows + _power(T, self._usual)
        least = _LEAST * all_ + _EPSILON * (T * T * sizes).sum(axis=-1)
        variance = np.maximum(usual, least / rows) + 1e-300
        W = 1.0 / variance
        G = np.swapaxes(G, 1, 2)  # (K, 3, n, N_X)
        WG = W[:, :, None, None] * G
        hessian, gradient = np.empty((K, self.p, self.p)), np.empty((K, self.p))
        hessian[:, :n, :n] = (WG @ corrected[..., :N_X, :N_X] @ np.swapaxes(G, -1, -2)).sum(axis=1)
        downhill = WG @ (corrected[..., :N_X, :] @ T[..., None])
        gradient[:, :n] = downhill.sum(axis=1)[..., 0]
        weak = np.zeros(K)
        if phi.shape[1]:
            information = self.deviations.information
            weak = weak + (phi * phi) @ information
            places = np.arange(rb.N_THETA, n)
            gradient[:, places] -= phi * information
            hessian[:, places, places] += information
        if f:
            # Of residuals, by coordinate and axis: (K, f, 3, width), and with all columns.
            TP = T[:, None] @ P[:, 1:]
            TPM = _per_axis(TP, self.without)
            left = T @ P[:, 0]
            corrected_TPM = TPM
            if not self._silent:
                # What a delay does to the noise itself is no information: all of it is taken out.
                corrected_TPM = TPM - (1.0 - NOISE_SHARE) * _per_axis(TP, self._noise_of_all)
            slopes = (W[:, None, :, None] * corrected_TPM * left[:, None]).sum(axis=(2, 3))
            bends = (W[:, None, :, None] * TPM).reshape(K, f, -1) @ np.swapaxes(
                TP.reshape(K, f, -1), 1, 2
            )
            columns = TPM @ np.swapaxes(P[:, :1, :N_X], -1, -2)  # (K, f, 3, N_X)
            cross = (WG @ np.moveaxis(columns, 1, -1)).sum(axis=1)  # (K, n, f)
            away = unknowns[:, self.free_coordinates] - self._mean
            gradient[:, n:] = -slopes - away * self._information
            hessian[:, :n, n:] = -cross
            hessian[:, n:, :n] = -np.swapaxes(cross, 1, 2)
            hessian[:, n:, n:] = bends + np.diag(self._information)
            weak = weak + self.weak_cost(unknowns)
        if self.prior is not None:
            weak = weak + self.prior.cost(unknowns[:, :N_UNKNOWNS])
        return AxisPoint(
            unknowns, variance, own, weak, gradient, hessian, Q,
            np.swapaxes(WG, 1, 2),
        )  # fmt: skip

    def _model(self, theta: Array, phi: Array) -> tuple[Array, Array]:
        """Q and its derivatives by theta and phi, (K, N_THETA + m, 3, N_X)."""
        if not phi.shape[1]:
            return rb.forward_jacobian(theta)
        Q, G = rb.forward_jacobian(theta, self.deviations.torque(phi))
        J_inv = np.linalg.inv(rb.inertia_matrix(theta))
        return Q, np.concatenate([G, J_inv[:, None] @ self.deviations.torques], axis=1)


def minimize_axes(problem: AxisProblem, unknowns: Array, limit: int) -> tuple[AxisPoint, Mask]:
    """Gauss-Newton with Levenberg-Marquardt damping; each step at the weights of its start.

    What falls is sum_a T_a (M_a - n N_a) T_a' / sigma_a^2 with sigma_a as it was before the step:
    at the point that this leads to in the end the gradient without the known noise vanishes.

    Args:
        problem: K hypotheses.
        unknowns: (K, N_UNKNOWNS) starting points.
        limit: most iterations.

    Returns:
        The solutions, and (K,) whether each was reached.
    """
    K, p = len(problem.bank), problem.p
    damping = np.full(K, _DAMPING)
    converged = np.zeros(K, dtype=bool)
    eye = np.eye(p)
    point = problem.evaluate(unknowns)
    for _ in range(limit):
        gradient, hessian = problem.with_prior(point.gradient, point.hessian, point.unknowns)
        d = scales(hessian)
        H = hessian / (d[:, :, None] * d[:, None, :])
        H = H + (damping + _lift(H))[:, None, None] * eye
        downhill = gradient / d
        step = np.linalg.solve(H, downhill[..., None])[..., 0]
        gain = (step * downhill).sum(axis=1)
        candidate = problem.moved(point.unknowns, step / d)
        physical = rb.are_physical(candidate)
        candidate = np.where(physical[:, None], candidate, point.unknowns)
        tried = problem.evaluate(candidate)
        before, after = (
            (at.motion_power / point.variance).sum(axis=1) + at.weak for at in (point, tried)
        )
        small = gain < _CONVERGED**2
        better = physical & ((after <= before) | small) & ~converged
        point = point.where(better, tried)
        # Between two delays there is less noise than on a straight line: steps may overshoot.
        poor = ~small & (before - after < _POOR * gain)
        change = np.where(better, np.where(poor, 5.0, 0.1), 10.0)
        damping = np.maximum(change * damping, _LEAST_DAMPING)
        converged = converged | small | (damping > _MOST_DAMPING)
        if converged.all():
            break
    return point, converged


def _lift(H: Array) -> Array:
    """(K,) what makes scaled curvatures positive definite, which less known noise need not be."""
    try:
        np.linalg.cholesky(H)
    except np.linalg.LinAlgError:
        least = np.linalg.eigvalsh(H)[:, 0]
        lift: Array = np.where(least > _LEAST_DAMPING, 0.0, _LEAST_DAMPING - 2.0 * least)
        return lift
    return np.zeros(len(H))


def _power(T: Array, moments: Array) -> Array:
    """(K, 3) T_a M_a T_a' of (K, 3, WIDTH) and (K, 3 or 1, WIDTH, WIDTH)."""
    if moments.shape[1] == 1:
        power: Array = ((T @ moments[:, 0]) * T).sum(axis=-1)
    else:
        power = ((T[..., None, :] @ moments)[..., 0, :] * T).sum(axis=-1)
    return power


def _per_axis(left: Array, moments: Array) -> Array:
    """(K, f, 3, width) of such rows times (K, 3 or 1, width, width) moments."""
    product: Array = np.swapaxes(np.swapaxes(left, 1, 2) @ moments, 1, 2)
    return product
