"""Fit of the rotational parameters to the moments of the forward form.

The cost  sum_rows (y - Q(theta) x)' W (y - Q(theta) x)  is an exact quadratic in Q, so it and
its derivatives follow from the moments alone. It is minimized by Gauss-Newton with
Levenberg-Marquardt damping; W is the inverse of the residual covariance, which the same moments
give (iterated to the maximum-likelihood point). See `gcs_sysid.model.rigid_body` for Q.

Rows hold the rotors' signals in several forms, of which those at any delay, and with commands
at any motor lag and thrust curve, are linear maps (`estimation.rows.actuator_dynamics`); these
are unknowns of the fit too. Moments come with several leaks as hypotheses, fitted at once as
stacked arrays.

Rows are correlated, so that the cost overstates what it knows. A prior joins the search as it
is, but in the outcome it is weighed against the information that the scatter of the batch
scores leaves: the curvature-adjusted composite likelihood of Chandler and Bate (2007),
Biometrika 94, 167-183.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.arrays import Array, Mask, by_parts
from gcs_sysid.estimation.fit.deviations import NO_DEVIATIONS, Deviations
from gcs_sysid.estimation.fit.priors import COORDINATES, N_UNKNOWNS, Prior, Unknown
from gcs_sysid.estimation.fit.search import (
    COORDINATE_STD,
    MAX_ITERATIONS,
    N_X,
    Point,
    Problem,
    first_guess,
    minimize,
    residual_maker,
    scales,
    scan,
    search,
    without_noise,
)
from gcs_sysid.estimation.noise.uncertainty import inflation, meat, student_factor, symmetric_roots
from gcs_sysid.estimation.noise.whitening import Whitener
from gcs_sysid.estimation.rows.actuator_dynamics import ActuatorDynamics, Coordinate, LagPlace
from gcs_sysid.model import rigid_body as rb

_WARM_ITERATIONS, _FOLLOW_ITERATIONS = 12, 2
BLIND_STEP = 3.0
"""Standard deviations; a smaller step of a fit that follows is taken unseen."""
_ALIKE = 0.1
"""Of standard deviations, relative: in a minute of flight chance makes them differ by 0.07."""
_NEAR, _ROUNDS = 0.1, 4
"""Squared standard deviations that a search may be from the minimum; how often it continues."""
_ABSURD = -0.5
"""Share of an axis' acceleration explained: less indicates a false minimum."""
_HALVINGS = 20
"""A step that leads out of the physical inertias is shortened so often, then not taken."""


@dataclass(frozen=True)
class RotationStart:
    """Warm start for a later fit of the same, longer record.

    Attributes:
        unknowns: (N_UNKNOWNS,) at the minimum of the cost.
        inflation: (p, p) of the covariance, see `uncertainty.inflation`.
        widening: (p,) of the standard deviations, see `uncertainty.student_factor`.
        stuck: whether the search ended elsewhere than near a minimum.
    """

    unknowns: Array
    inflation: Array
    widening: Array
    stuck: bool = False


@dataclass(frozen=True)
class RotationFit:
    """Rotational parameters relative to k_T, with their uncertainty.

    Attributes:
        theta: (N_THETA,) estimate, see `rigid_body.THETA`.
        covariance: (N_THETA, N_THETA), corrected for colored residuals, delay included, and
            widened so that 1.96 standard deviations are Student's 95 % interval.
        residual_covariance: (3, 3) of one row's residual.
        r_squared: (3,) share of each axis' angular acceleration that the model explains.
        rows: number of rows fitted.
        converged: whether the minimizer was reached.
        coordinates: (N_COORDINATES,) rotor delay (s), motor lag (s), thrust curve, and nuisances of
            the lag, see `estimation.rows.actuator_dynamics`.
        leak: index of the leak that was taken, see `most_certain`.
        whiteners: of each axis, where rows were whitened; else empty.
        disturbance: (3,) nats a second by which an unmodeled moment explains an axis better than
            sensor noise alone, see `whitened_fit.Trial.detected`; NaN where rows were not whitened.
        data_std: (N_THETA,) standard deviations without the prior: huge where the flight alone does
            not determine a parameter.
        full_covariance: (N_UNKNOWNS, N_UNKNOWNS) of theta and the coordinates; zeros where one
            was not estimated.
        warm start: what `follow_rotation` starts from.
        deviations: (m,) values of those that were fitted, see `estimation.fit.deviations`.
        extended_covariance: (N_UNKNOWNS + m, N_UNKNOWNS + m) with theirs.
        deviating: which these are.
        lag_place: what was taken to lag, of commands; None where nothing does.
        lag_doubt: (N_UNKNOWNS, N_UNKNOWNS) part of the covariance that stems from not knowing that;
            empty where there is none.
    """

    theta: Array
    covariance: Array
    residual_covariance: Array
    r_squared: Array
    rows: int
    converged: bool
    coordinates: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0, 0.0, 0.0]))
    leak: int = 0
    data_std: Array = field(default_factory=lambda: np.empty(0))
    full_covariance: Array = field(default_factory=lambda: np.empty((0, 0)))
    warm_start: RotationStart | None = None
    whiteners: tuple[Whitener, ...] = ()
    disturbance: Array = field(default_factory=lambda: np.full(3, np.nan))
    deviations: Array = field(default_factory=lambda: np.zeros(0))
    extended_covariance: Array = field(default_factory=lambda: np.empty((0, 0)))
    deviating: Deviations = NO_DEVIATIONS
    lag_place: LagPlace | None = None
    lag_doubt: Array = field(default_factory=lambda: np.empty((0, 0)))

    def __post_init__(self) -> None:
        if not self.data_std.size:
            object.__setattr__(self, "data_std", self.std)
        if not self.full_covariance.size:
            full = np.zeros((N_UNKNOWNS, N_UNKNOWNS))
            full[: rb.N_THETA, : rb.N_THETA] = self.covariance
            object.__setattr__(self, "full_covariance", full)
        if not self.extended_covariance.size:
            object.__setattr__(self, "extended_covariance", self.full_covariance)

    @property
    def Q(self) -> Array:
        """(3, N_SIGNALS) of w' = Q x, deviations included."""
        return rb.forward_matrix(self.theta, self.deviating.torque(self.deviations))

    @property
    def std(self) -> Array:
        """(N_THETA,) standard deviations."""
        return _deviations(np.diag(self.covariance))

    @property
    def deviations_covariance(self) -> Array:
        """(m, m) of the deviations."""
        return self.extended_covariance[N_UNKNOWNS:, N_UNKNOWNS:]

    @property
    def open_covariance(self) -> Array:
        """(N_THETA, N_THETA) what of theta's covariance would vanish were the deviations known."""
        across = self.extended_covariance[: rb.N_THETA, N_UNKNOWNS:]
        if not across.shape[1]:
            return np.zeros((rb.N_THETA, rb.N_THETA))
        own = self.deviations_covariance
        d = np.sqrt(np.diag(own))
        inverse = np.linalg.pinv(own / np.outer(d, d), hermitian=True)
        explained: Array = (across / d) @ inverse @ (across / d).T
        return explained

    @property
    def unknowns(self) -> Array:
        """(N_UNKNOWNS,) theta and the coordinates."""
        return np.concatenate([self.theta, self.coordinates])

    @property
    def coordinates_std(self) -> Array:
        """(N_COORDINATES,) standard deviations; zero where one was not estimated."""
        std: Array = np.sqrt(np.diag(self.full_covariance))[COORDINATES]
        return std

    @property
    def delay(self) -> float:
        """s, of the rotor stream behind the IMU stream."""
        return float(self.coordinates[Coordinate.DELAY])

    @property
    def delay_std(self) -> float:
        """s; zero where the delay was not estimated."""
        return float(self.coordinates_std[Coordinate.DELAY])


def fit_rotation(
    batches: Array,
    counts: NDArray[np.int64],
    basis: ActuatorDynamics,
    noise: Array,
    start: RotationFit | None = None,
    prior: Prior | None = None,
    doubt: float = 0.0,
    hint: RotationFit | None = None,
) -> RotationFit | None:
    """Fit theta and the basis' coordinates to moments.

    Args:
        batches: (k, leaks, width, width) moments of rows of elements.
        counts: (k,) rows in each.
        basis: of the elements.
        noise: what known noise of the inputs adds to the moments of a row, with each leak, in the
            form of `ActuatorDynamics.noise_at`.
        start: an earlier fit: a few steps from there, at every leak, at little cost. None: from
            the data alone, to the minimum.
        prior: what else is known.
        doubt: one standard deviation of the noise, relative.
        hint: an earlier fit, from which a search from the data alone starts too.

    Returns:
        The fit, or None while the data cannot even start one (fewer rows than unknowns, or no
        response to roll and pitch torque).
    """
    rows = int(counts.sum())
    if rows < 3 * rb.N_THETA:
        return None
    bank = batches.sum(axis=0)
    problem = Problem(bank, rows, basis, prior)
    at = basis.nodes[basis.middle]
    first = [first_guess(m, rows, at, prior) for m in basis.moments_at(bank, at)]
    if any(guess is None for guess in first):
        return None
    unknowns = np.stack([guess for guess in first if guess is not None])
    if start is None:
        starts = scan(problem, unknowns)
        if hint is not None:
            known = np.broadcast_to(hint.unknowns, (1, len(bank), N_UNKNOWNS))
            starts = np.concatenate([starts, known])
        point, converged = search(problem, starts)
    else:
        # An earlier estimate from too little motion may lie in a valley of its own.
        earlier = np.tile(start.unknowns, (len(bank), 1))
        closer = problem.evaluate(earlier).cost < problem.evaluate(unknowns).cost
        unknowns = np.where(closer[:, None], earlier, unknowns)
        point, converged = minimize(problem, unknowns, _WARM_ITERATIONS)
    stuck = np.zeros(len(bank), dtype=bool)
    if basis.motors:
        for round_ in range(_ROUNDS + 1):
            # A search that steps out of the physical inertias only is at no minimum.
            stuck = Outcome(problem, point, noise).left >= _NEAR
            converged &= ~stuck
            if converged.any() or round_ == _ROUNDS:
                break
            # Curve and lag bend the valley: it takes many steps along.
            point, converged = minimize(problem, point.unknowns, MAX_ITERATIONS)
    pull = None
    if basis.motors and noise.any():
        problem, point, pull = without_noise(problem, point, noise)
        batches = batches - counts[:, None, None, None] * noise
    outcome = Outcome(problem, point, noise)
    if pull is not None:
        # Where the noise has shifted the minimum far, the way there may not be found.
        stuck = stuck | (outcome.left >= _NEAR)
        converged = converged & ~stuck
    inverse_roots = outcome.roots[1]
    scatter = []
    for i in range(len(bank)):
        spread_out = inflation(inverse_roots[i], meat(outcome.scores(i, batches[:, i], counts)))
        scatter.append((spread_out, student_factor(outcome.shares(i, batches[:, i]))))
    spread, widening = (np.stack(parts) for parts in zip(*scatter, strict=True))
    if doubt:
        spread = spread + outcome.spread_of(doubt * (outcome.pull if pull is None else pull))
    fits = outcome.fits(spread, widening, converged, range(len(bank)), stuck)
    return most_certain([fit for fit, no in zip(fits, stuck, strict=True) if not no] or fits)


def follow_rotation(
    totals: Array,
    rows: Array,
    basis: ActuatorDynamics,
    noise: Array,
    start: RotationFit,
    prior: Prior | None = None,
) -> list[RotationFit]:
    """Follow a growing record from an earlier fit: a step or two with its leak.

    How far the score scatters is taken over from the earlier fit, as it hardly changes.

    Args:
        totals: (K, width, width) moments of all rows at K instants, with the leak of `start`.
        rows: (K,) in them.
        basis: of the elements.
        noise: (K, ...) as of `fit_rotation`.
        start: a fit of the same record when it was shorter.
        prior: what else is known.

    Returns:
        K fits, each of which depends on `start` and its own instant alone.
    """
    assert start.warm_start is not None
    noisy = basis.motors and bool(noise.any())
    problem = Problem(totals, rows, basis, prior, noise if noisy else None)
    unknowns = start.warm_start.unknowns[None]
    scatter = start.warm_start.inflation, start.warm_start.widening
    outcome = Outcome(problem, problem.evaluate(unknowns), noise)
    near = outcome.take_step(BLIND_STEP)
    stuck = np.full(len(rows), start.warm_start.stuck)
    leaks = [start.leak] * len(rows)
    fits = outcome.fits(*scatter, [start.converged] * len(rows), leaks, stuck)
    if not near.all():
        far = ~near
        alone = Problem(totals[far], rows[far], basis, prior)
        starts = np.repeat(unknowns, len(alone.rows), axis=0)
        point, converged = minimize(alone, starts, _FOLLOW_ITERATIONS)
        if noisy:
            alone, point, _ = without_noise(alone, point, noise[far])
        leaks = leaks[: len(converged)]
        better = Outcome(alone, point, noise[far]).fits(*scatter, converged, leaks, stuck[far])
        for i, fit in zip(np.flatnonzero(far), better, strict=True):
            fits[i] = fit
    return fits


def most_certain(fits: Sequence[RotationFit]) -> RotationFit:
    """The first that is nearly as certain as any, so the one with the shortest memory.

    How certain each is, is itself estimated from scatter, with error. The least of several such
    numbers is too small, and long memories, which sum up slow errors, gain most by chance.
    """
    uncertain = np.array([uncertainty(fit) for fit in fits])
    return fits[int(np.argmax(uncertain <= uncertain.min() + _ALIKE))]


def uncertainty(fit: RotationFit) -> float:
    """Mean log standard deviation of what makes up the core parameters."""
    return float(np.mean(np.log(fit.std[: rb.DAMPING])))


class Outcome:
    """What follows from points near the minima of K hypotheses.

    Args:
        problem: that was solved.
        point: its solution.
        noise: (K, ...) as of `fit_rotation`; that of commands is taken out of the problem already.
    """

    def __init__(self, problem: Problem, point: Point, noise: Array) -> None:
        self._problem = problem
        self._linear = problem.p - len(problem.free_coordinates)
        self._noise = noise
        self._point = point
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
        spread: Array = moved[:, :, None] * moved[:, None, :]
        return spread

    @property
    def left(self) -> Array:
        """(K,) twice by how much the likelihood could still rise: standard deviations, squared."""
        problem, point = self._problem, self._point
        gradient, hessian = problem.with_prior(point.gradient, point.hessian, point.unknowns)
        inverse_roots = symmetric_roots(hessian / self._scales)[1]
        left: Array = (_times(inverse_roots, gradient / self._scale) ** 2).sum(axis=1)
        return left

    @property
    def pull(self) -> Array:
        """(K, p) gradient that undoes what noise of measured speeds does, to first order.

        It makes least squares underrate its inputs (errors in variables).
        """
        problem, point = self._problem, self._point
        pull = np.zeros_like(self._scale)
        if not problem.basis.motors:
            noise = problem.rows[:, None, None] * self._noise
            excess = point.Q @ noise[:, :N_X, :N_X] - noise[:, N_X:, :N_X]
            pull[:, : rb.N_THETA] = _times(point.WG, excess.reshape(len(pull), -1))
        return pull

    def scores(self, i: int, batches: Array, counts: NDArray[np.int64]) -> Array:
        """(k, p) scaled downhill gradient of half the cost, batch by batch.

        Args:
            i: of the hypothesis.
            batches: (k, width, width) of this hypothesis.
            counts: (k,) rows in each.
        """
        f, point = len(self._problem.basis.free), self._point
        P = self._problem.maps(self._unknowns[i : i + 1])[0]
        TP = residual_maker(point.Q[i]) @ P

        def some(batches: Array) -> Array:
            TPM, k = TP[0] @ batches, len(batches)
            of_theta: Array = (TPM @ P[0].T)[..., :N_X].reshape(k, -1) @ point.WG[i].T
            if not f:
                return of_theta
            slopes = TPM.reshape(k, -1) @ (point.W[i] @ TP[1:]).reshape(f, -1).T
            return np.column_stack([of_theta, -slopes])

        scores = by_parts(some, batches)
        # Away from the likelihood's own minimum all batches pull one way; that is no scatter.
        scores -= np.outer(counts / counts.sum(), scores.sum(axis=0))
        scaled: Array = scores / self._scale[i]
        return scaled

    def shares(self, i: int, batches: Array) -> Array:
        """(k, p) what each batch is expected to add to the variance of each unknown.

        The diagonal of H^-1 H_b H^-1, H_b the information of a batch; any scale.

        Args:
            i: of the hypothesis.
            batches: (k, width, width) of this hypothesis.
        """
        n, inverse_root, point = rb.N_THETA, self.roots[1][i], self._point
        W = point.W[i]
        P = self._problem.maps(self._unknowns[i : i + 1])[0]
        inverse = (inverse_root @ inverse_root) / self._scales[i]
        weighted = (inverse[:n, :n] @ point.WG[i].reshape(n, -1)).reshape(n, 3, N_X)
        moved = np.linalg.inv(W) @ weighted
        powers = (np.swapaxes(moved, 1, 2) @ weighted).reshape(n, -1).T
        X, TP = P[0, :N_X], residual_maker(point.Q[i]) @ P[1:]

        def some(batches: Array) -> Array:
            of_theta: Array = (X @ batches @ X.T).reshape(len(batches), -1) @ powers
            if not len(TP):
                return of_theta
            bends = ((W @ TP) * (TP @ batches[:, None])).sum(axis=(2, 3))
            return np.column_stack([of_theta, bends])

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
            information = root @ root + problem.prior_information() / self._scales
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
        leaks: Iterable[int],
        stuck: Mask | None = None,
    ) -> list[RotationFit]:
        """The K estimates.

        Args:
            spread: (K, p, p) or (p, p) inflation of the covariance.
            widening: (K, p) or (p,) factors on the standard deviations.
            converged: whether each minimum was reached.
            leaks: index of each one's leak.
            stuck: (K,) whether each search ended elsewhere than near a minimum; None: none did.
        """
        problem, point, d, n = self._problem, self._point, self._scale, rb.N_THETA
        K, p = d.shape
        spread, widening = np.broadcast_to(spread, (K, p, p)), np.broadcast_to(widening, (K, p))
        root, inverse_root = self.roots
        prior = problem.prior
        pull = self.pull
        wider = widening[:, :, None] * inverse_root
        data_covariance = wider @ spread @ np.swapaxes(wider, 1, 2)
        covariance = data_covariance
        if prior is None:
            step = _times(inverse_root, _times(inverse_root, pull / d))
        else:
            pull += self._gradient
            coordinates, basis = self._unknowns[:, COORDINATES], problem.basis
            inside = (coordinates > basis.low) & (coordinates < basis.high)
            pull[:, self._linear :] *= inside[:, list(basis.free)]
            held = (root / widening[:, :, None]) @ np.linalg.inv(spread)
            covariance = np.linalg.inv(
                held @ (root / widening[:, None, :])
                + problem.prior_information() / self._scales
                + 1e-15 * np.eye(p)
            )
            from_data = _times(held, _times(inverse_root, pull / (d * widening)))
            step = _times(covariance, from_data + problem.prior_pull(self._unknowns) / d)
        unknowns = self._moved(step / d)
        every = np.zeros((K, unknowns.shape[1], unknowns.shape[1]))
        every[:, problem.free[:, None], problem.free] = covariance / self._scales
        full = every[:, :N_UNKNOWNS, :N_UNKNOWNS]
        if problem.basis.curve_doubt and Unknown.CURVE in problem.free:
            # Were the curve another, all unknowns would go with it.
            along = (
                full[:, :, Unknown.CURVE]
                / full[:, Unknown.CURVE, Unknown.CURVE, None]
                * problem.basis.curve_doubt
            )
            full += along[:, :, None] * along[:, None, :]
        r_squared = self._explained()
        stuck = np.zeros(K, dtype=bool) if stuck is None else stuck
        if problem.basis.motors and Unknown.CURVE in problem.free:
            # A fit that explains an axis worse than nothing is in a false minimum.
            astray = stuck | (r_squared.min(axis=1) < _ABSURD)
            for i in np.flatnonzero(astray).tolist():
                # There curve and lag are what they ordinarily are.
                for place, std in (
                    (Unknown.CURVE, COORDINATE_STD[Coordinate.CURVE]),
                    (Unknown.LAG, COORDINATE_STD[Coordinate.LAG]),
                ):
                    if full[i, place, place] > 0.0:
                        along = full[i, :, place] / full[i, place, place] * std
                        full[i] += np.outer(along, along)
        data_std = _deviations(np.diagonal(data_covariance, axis1=1, axis2=2)) / d
        return [
            RotationFit(
                theta=unknowns[i, :n],
                covariance=full[i, :n, :n],
                residual_covariance=point.residual[i],
                r_squared=r_squared[i],
                rows=int(problem.rows[i]),
                converged=bool(done),
                coordinates=unknowns[i, COORDINATES],
                leak=leak,
                data_std=data_std[i, :n],
                full_covariance=full[i],
                warm_start=RotationStart(self._unknowns[i], spread[i], widening[i], bool(stuck[i])),
                deviations=unknowns[i, N_UNKNOWNS:],
                extended_covariance=every[i],
            )
            for i, (done, leak) in enumerate(zip(converged, leaks, strict=True))
        ]

    def _explained(self) -> Array:
        """(K, 3) share of each axis' angular acceleration that the model explains."""
        problem = self._problem
        own, all_ = (np.diagonal(m, axis1=1, axis2=2) for m in (self._point.residual, problem.bank))
        share: Array = 1.0 - own / np.maximum(all_[:, -3:] / problem.rows[:, None], 1e-300)
        return share

    def _moved(self, step: Array) -> Array:
        """(K, N_UNKNOWNS) after a (K, p) step, shortened until the inertia is physical."""
        for _ in range(_HALVINGS):
            unknowns = self._problem.moved(self._unknowns, step)
            physical = rb.are_physical(unknowns)
            if physical.all():
                return unknowns
            step = np.where(physical[:, None], step, 0.5 * step)
        physical = rb.are_physical(unknowns)
        return np.where(physical[:, None], unknowns, self._unknowns)


def _deviations(variances: Array) -> Array:
    """Square roots; without limit where less noise than there is left negative information."""
    root: Array = np.sqrt(np.where(variances >= 0.0, variances, np.inf))
    return root


def _times(matrices: Array, vectors: Array) -> Array:
    """(K, a) products of (K, a, b) and (K, b)."""
    products: Array = (matrices @ vectors[..., None])[..., 0]
    return products
