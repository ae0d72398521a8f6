"""Fit of the rotational parameters to the moments of the forward form.

The cost  sum_rows (y - Q(theta) x)' W (y - Q(theta) x)  is an exact quadratic in Q, so it and
its derivatives follow from the moments alone. It is minimised by Gauss-Newton with
Levenberg-Marquardt damping; W is the inverse of the residual covariance, which the same moments
give (iterated to the maximum-likelihood point). See `gcs_sysid.model.rigid_body` for Q.

Rows hold the rotors' signals in several forms, of which those at any delay, and with commands
at any motor lag and thrust curve, are linear maps (`estimation.basis`); these are unknowns of the
fit too. Moments come with several leaks as hypotheses, fitted at once as stacked arrays.

Rows are correlated, so that the cost overstates what it knows. A prior joins the search as it
is, but in the outcome it is weighed against the information that the scatter of the batch
scores leaves: the curvature-adjusted composite likelihood of Chandler and Bate (2007),
Biometrika 94, 167-183.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation import basis as coordinate
from gcs_sysid.estimation.basis import PLAIN, WIDTH, RotorBasis
from gcs_sysid.estimation.priors import COORDINATES, N_UNKNOWNS, Prior
from gcs_sysid.estimation.uncertainty import inflation, meat, student_factor, symmetric_roots
from gcs_sysid.model import rigid_body as rb

N_X = rb.N_SIGNALS

COORDINATE_MEAN = np.array([0.0, 0.05, 0.5])
COORDINATE_STD = np.array([0.03, 0.05, 0.5])
"""s, s and 1; keep delay, lag and curve in the ordinary while the flight does not tell them."""

_MAX_ITERATIONS = 40
_SCAN_ITERATIONS, _STARTS = 8, 4
_WARM_ITERATIONS, _FOLLOW_ITERATIONS = 6, 2
_CONVERGED = 1e-7
"""Steps smaller than this many standard deviations change nothing."""
_BLIND_STEP = 1.5
"""Standard deviations; a smaller step of a fit that follows is taken unseen."""
_DAMPING = 1e-4
_ALIKE = 3e-13
"""Share of all residual power that every axis has at least: weights stay finite."""
_EPSILON = 4e-15
"""Rounding of sums of products, relative to the squares in them."""
_HALVINGS = 20
"""A step that leads out of the physical inertias is shortened so often, then not taken."""
_IDENTITY = np.eye(3)
_AXES, _DIAGONAL = np.arange(3), np.arange(WIDTH)


@dataclass(frozen=True)
class Footing:
    """From where a later fit of the same, longer record goes on.

    Attributes:
        unknowns: (N_UNKNOWNS,) at the minimum of the cost.
        inflation: (p, p) of the covariance, see `uncertainty.inflation`.
        widening: (p,) of the standard deviations, see `uncertainty.student_factor`.
    """

    unknowns: Array
    inflation: Array
    widening: Array


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
        coordinates: (3,) rotor delay (s), motor lag (s), thrust curve, see `estimation.basis`.
        leak: index of the leak that left the least uncertainty.
        data_std: (N_THETA,) standard deviations without the prior: huge where the flight alone
            does not tell a parameter.
        full_covariance: (N_UNKNOWNS, N_UNKNOWNS) of theta and the coordinates; zeros where one
            was not estimated.
        footing: what `follow_rotation` starts from.
    """

    theta: Array
    covariance: Array
    residual_covariance: Array
    r_squared: Array
    rows: int
    converged: bool
    coordinates: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    leak: int = 0
    data_std: Array = field(default_factory=lambda: np.empty(0))
    full_covariance: Array = field(default_factory=lambda: np.empty((0, 0)))
    footing: Footing | None = None

    def __post_init__(self) -> None:
        if not self.data_std.size:
            object.__setattr__(self, "data_std", self.std)
        if not self.full_covariance.size:
            full = np.zeros((N_UNKNOWNS, N_UNKNOWNS))
            full[: rb.N_THETA, : rb.N_THETA] = self.covariance
            object.__setattr__(self, "full_covariance", full)

    @property
    def std(self) -> Array:
        """(N_THETA,) standard deviations."""
        std: Array = np.sqrt(np.diag(self.covariance))
        return std

    @property
    def unknowns(self) -> Array:
        """(N_UNKNOWNS,) theta and the coordinates."""
        return np.concatenate([self.theta, self.coordinates])

    @property
    def coordinates_std(self) -> Array:
        """(3,) standard deviations; zero where one was not estimated."""
        std: Array = np.sqrt(np.diag(self.full_covariance))[COORDINATES]
        return std

    @property
    def delay(self) -> float:
        """s, of the rotor stream behind the IMU stream."""
        return float(self.coordinates[coordinate.DELAY])

    @property
    def delay_std(self) -> float:
        """s; zero where the delay was not estimated."""
        return float(self.coordinates_std[coordinate.DELAY])


def fit_rotation(
    batches: Array,
    counts: NDArray[np.int64],
    basis: RotorBasis,
    noise: Array,
    start: RotationFit | None = None,
    prior: Prior | None = None,
) -> RotationFit | None:
    """Fit theta and the basis' coordinates to moments.

    Args:
        batches: (k, leaks, width, width) moments of rows of elements.
        counts: (k,) rows in each.
        basis: of the elements.
        noise: (leaks, WIDTH, WIDTH) what known noise of the inputs adds to the moments of a row.
        start: an earlier fit: a few steps from there, at every leak, at little cost. None: from
            the data alone, to the minimum.
        prior: what else is known.

    Returns:
        The fit, or None while the data cannot even start one (fewer rows than unknowns, or no
        response to roll and pitch torque).
    """
    rows = int(counts.sum())
    if rows < 3 * rb.N_THETA:
        return None
    bank = batches.sum(axis=0)
    problem = _Problem(bank, rows, basis, prior)
    at = basis.nodes[basis.middle]
    first = [_first_guess(m, rows, at, prior) for m in basis.moments_at(bank, at)]
    if any(guess is None for guess in first):
        return None
    unknowns = np.stack([guess for guess in first if guess is not None])
    if start is None:
        point, converged = _search(problem, _scan(problem, unknowns))
    else:
        # An earlier estimate from too little motion may lie in a valley of its own.
        earlier = np.tile(start.unknowns, (len(bank), 1))
        closer = problem.evaluate(earlier).cost < problem.evaluate(unknowns).cost
        unknowns = np.where(closer[:, None], earlier, unknowns)
        point, converged = _minimise(problem, unknowns, _WARM_ITERATIONS)
    fits = []
    for i in range(len(bank)):
        outcome = _Outcome(problem, point, i, noise[i])
        spread = inflation(outcome.roots[1], meat(outcome.scores(batches[:, i], counts)))
        widening = student_factor(outcome.shares(batches[:, i]))
        fits.append(outcome.fit(spread, widening, bool(converged[i]), i))
    return min(fits, key=uncertainty)


def follow_rotation(
    total: Array,
    rows: int,
    basis: RotorBasis,
    noise: Array,
    start: RotationFit,
    prior: Prior | None = None,
) -> RotationFit:
    """Follow a growing record from an earlier fit: a step or two with its leak.

    How far the score scatters is taken over from the earlier fit, as it hardly changes.

    Args:
        total: (width, width) moments of all rows, with the leak of `start`.
        rows: in them.
        basis: of the elements.
        noise: (WIDTH, WIDTH) as of `fit_rotation`.
        start: a fit of the same record when it was shorter.
        prior: what else is known.
    """
    assert start.footing is not None
    problem = _Problem(total[None], rows, basis, prior)
    unknowns = start.footing.unknowns[None]
    scatter = start.footing.inflation, start.footing.widening
    outcome = _Outcome(problem, problem.evaluate(unknowns), 0, noise)
    if outcome.take_step(_BLIND_STEP):
        return outcome.fit(*scatter, start.converged, start.leak)
    point, converged = _minimise(problem, unknowns, _FOLLOW_ITERATIONS)
    return _Outcome(problem, point, 0, noise).fit(*scatter, bool(converged[0]), start.leak)


def uncertainty(fit: RotationFit) -> float:
    """Sum of log standard deviations of what makes up the core parameters."""
    return float(np.sum(np.log(fit.std[: rb.DAMPING])))


@dataclass(frozen=True)
class _Point:
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

    def where(self, better: Mask, other: "_Point") -> "_Point":
        """The other point for the hypotheses where that is better."""
        if len(better) == 1:
            return other if better[0] else self
        return _Point(
            *(
                np.where(better.reshape(-1, *(1,) * (new.ndim - 1)), new, old)
                for new, old in zip(vars(other).values(), vars(self).values(), strict=True)
            )
        )


class _Problem:
    """Hypotheses that are fitted side by side.

    Args:
        bank: (K, width, width) moments of rows of elements.
        rows: in each.
        basis: of the elements; what it leaves free is fitted.
        prior: what else is known.
    """

    def __init__(self, bank: Array, rows: int, basis: RotorBasis, prior: Prior | None) -> None:
        self.bank = bank
        self.rows = rows
        self.basis = basis
        self.prior = prior
        coordinates = rb.N_THETA + np.array(basis.free, dtype=int)
        self.free = np.concatenate([np.arange(rb.N_THETA), coordinates])
        """(p,) indices of the unknowns that are fitted."""
        self.p = len(self.free)
        self._mean = COORDINATE_MEAN[list(basis.free)]
        self._information = COORDINATE_STD[list(basis.free)] ** -2.0

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

    def weak_cost(self, unknowns: Array) -> Array:
        """(...) of leaving the ordinary, see COORDINATE_STD."""
        away = unknowns[..., self.free[rb.N_THETA :]] - self._mean
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
        at, way = unknowns[..., self.free[rb.N_THETA :]], step[..., rb.N_THETA :]
        room = np.where(way > 0.0, high - at, at - low)
        share = 0.9 * room / np.maximum(np.abs(way), 1e-300)
        # At the edge itself a coordinate is just held.
        share = np.where(room > 1e-3 * (high - low), share, 1.0)
        smallest: Array = np.minimum(share.min(axis=-1), 1.0)
        return smallest

    def evaluate(self, unknowns: Array) -> _Point:
        """Cost and its derivatives at (K, N_UNKNOWNS)."""
        K, n, f = len(unknowns), rb.N_THETA, len(self.basis.free)
        P = self.maps(unknowns)
        P0 = np.swapaxes(P[:, 0], -1, -2)
        moments = P[:, 0] @ self.bank @ P0
        Q, G = rb.forward_jacobian(unknowns[:, :n])
        T = residual_maker(Q)
        # Moments of residuals with rows; of their derivatives by the coordinates with rows.
        TP = T[:, None] @ P
        TPM = TP @ self.bank[:, None]
        cross = TPM @ P0[:, None]
        S = TPM[:, 0] @ np.swapaxes(TP[:, 0], -1, -2) / self.rows
        # Without noise only rounding is left of large terms; that keeps it definite.
        sizes = moments[:, _DIAGONAL, _DIAGONAL]
        own = S[:, _AXES, _AXES]
        S[:, _AXES, _AXES] = own + (
            (T * T @ sizes[..., None])[..., 0] * (_EPSILON / self.rows)
            + (_ALIKE * own.sum(axis=1) + 1e-300)[:, None]
        )
        cost = np.linalg.slogdet(S)[1]
        W = np.linalg.inv(S)
        WG = (W[:, None] @ G).reshape(K, n, 3 * N_X)
        GR = (G.reshape(K, n * 3, N_X) @ moments[:, :N_X, :N_X]).reshape(K, n, 3 * N_X)
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
            away = unknowns[:, self.free[n:]] - self._mean
            gradient[:, n:] = -slopes - away * self._information
            hessian[:, n:, :n] = -np.swapaxes(downhill[..., 1:], 1, 2)
            hessian[:, :n, n:] = -downhill[..., 1:]
            hessian[:, n:, n:] = bends + np.diag(self._information)
        if self.prior is not None:
            cost = cost + self.prior.cost(unknowns) / self.rows
        return _Point(unknowns, cost, gradient, hessian, S, Q, W, WG)


def _scan(problem: _Problem, unknowns: Array) -> Array:
    """Fit at every node of the basis; (starts, leaks, N_UNKNOWNS) the best ones of each leak."""
    basis, leaks = problem.basis, len(problem.bank)
    nodes = len(basis.nodes)
    if nodes == 1:
        return unknowns[None]
    every = np.repeat(unknowns, nodes, axis=0)
    every[:, COORDINATES] = np.tile(basis.nodes, (leaks, 1))
    P = basis.maps(basis.nodes)[:, 0]
    there = (P @ problem.bank[:, None] @ np.swapaxes(P, 1, 2)).reshape(-1, WIDTH, WIDTH)
    given = _Problem(there, problem.rows, PLAIN, problem.prior)
    point, _ = _minimise(given, every, _SCAN_ITERATIONS)
    cost = point.cost + problem.weak_cost(every) / problem.rows
    starts = 1 if len(basis.free) == 1 else _STARTS
    best = np.argsort(cost.reshape(leaks, nodes), axis=1)[:, :starts]
    found = point.unknowns.reshape(leaks, nodes, -1)
    chosen: Array = np.swapaxes(np.take_along_axis(found, best[..., None], axis=1), 0, 1)
    return chosen


def _search(problem: _Problem, starts: Array) -> tuple[_Point, Mask]:
    """The best minimum that (starts, leaks, N_UNKNOWNS) lead to, for each leak."""
    s, leaks, _ = starts.shape
    if s == 1:
        return _minimise(problem, starts[0], _MAX_ITERATIONS)
    wide = _Problem(np.tile(problem.bank, (s, 1, 1)), problem.rows, problem.basis, problem.prior)
    point, converged = _minimise(wide, starts.reshape(s * leaks, -1), _MAX_ITERATIONS)
    best = np.argmin(point.cost.reshape(s, leaks), axis=0) * leaks + np.arange(leaks)
    return _Point(*(values[best] for values in vars(point).values())), converged[best]


def _minimise(problem: _Problem, unknowns: Array, limit: int) -> tuple[_Point, Mask]:
    """Levenberg-Marquardt on log det of the residual covariance (W concentrated out).

    Args:
        problem: K hypotheses.
        unknowns: (K, N_UNKNOWNS) starting points.
        limit: most iterations.

    Returns:
        The minimisers, and (K,) whether each was reached.
    """
    K, p = len(unknowns), problem.p
    damping = np.full(K, _DAMPING)
    converged = np.zeros(K, dtype=bool)
    eye = np.eye(p)
    point = problem.evaluate(unknowns)
    for _ in range(limit):
        gradient, hessian = point.gradient, point.hessian
        if problem.prior is not None:
            gradient = gradient + problem.prior_pull(point.unknowns)
            hessian = hessian + problem.prior_information()
        d = _scales(hessian)
        H = hessian / (d[:, :, None] * d[:, None, :]) + damping[:, None, None] * eye
        downhill = gradient / d
        step = np.linalg.solve(H, downhill[..., None])[..., 0]
        # How much the cost can still fall, in units of the likelihood.
        small = (step * downhill).sum(axis=1) < _CONVERGED**2
        candidate = problem.moved(point.unknowns, step / d)
        physical = rb.are_physical(candidate)
        if not physical.all():
            candidate = np.where(physical[:, None], candidate, point.unknowns)
        tried = problem.evaluate(candidate)
        better = physical & (tried.cost <= point.cost) & ~converged
        point = point.where(better, tried)
        damping = np.where(better, np.maximum(damping * 0.1, 1e-12), damping * 10.0)
        # No step however small helps any more: rounding has the last word.
        converged = converged | small | (damping > 1e6)
        if converged.all():
            break
    return point, converged


class _Outcome:
    """What follows from the minimum of one hypothesis.

    Args:
        problem: that was solved.
        point: its solution.
        index: of the hypothesis.
        noise: (WIDTH, WIDTH) that known noise of the inputs adds to the moments of a row.
    """

    def __init__(self, problem: _Problem, point: _Point, index: int, noise: Array) -> None:
        self._problem = problem
        self._noise = noise
        self._unknowns: Array = point.unknowns[index]
        self._gradient: Array = point.gradient[index]
        self._hessian = point.hessian[index]
        self._residual = point.residual[index]
        self._index = index
        self._scale = _scales(self._hessian)
        self._Q, self._W, self._WG = point.Q[index], point.W[index], point.WG[index]
        # A direction that the data do not see at all keeps a huge, finite variance.
        self.roots = symmetric_roots(self._hessian / (self._scale[:, None] * self._scale))
        """(p, p) root of the scaled information, and its inverse."""

    def scores(self, batches: Array, counts: NDArray[np.int64]) -> Array:
        """(k, p) scaled downhill gradient of half the cost, batch by batch.

        Args:
            batches: (k, width, width) of this hypothesis.
            counts: (k,) rows in each.
        """
        k, f = len(batches), len(self._problem.basis.free)
        P = self._problem.maps(self._unknowns[None])[0]
        TP = residual_maker(self._Q) @ P
        TPM = TP[:1] @ batches[:, None]
        scores = (TPM[:, 0] @ P[0].T)[..., :N_X].reshape(k, -1) @ self._WG.T
        if f:
            slopes = TPM.reshape(k, -1) @ (self._W @ TP[1:]).reshape(f, -1).T
            scores = np.column_stack([scores, -slopes])
        # Away from the likelihood's own minimum all batches pull one way; that is no scatter.
        scores -= np.outer(counts / counts.sum(), scores.sum(axis=0))
        scaled: Array = scores / self._scale
        return scaled

    def shares(self, batches: Array) -> Array:
        """(k, p) what each batch is expected to add to the variance of each unknown.

        The diagonal of H^-1 H_b H^-1, H_b the information of a batch; any scale.

        Args:
            batches: (k, width, width) of this hypothesis.
        """
        k, n, inverse_root = len(batches), rb.N_THETA, self.roots[1]
        basis = self._problem.basis
        P = self._problem.maps(self._unknowns[None])[0]
        moments = P[0] @ batches @ P[0].T
        inverse = (inverse_root @ inverse_root) / (self._scale[:, None] * self._scale)
        weighted = (inverse[:n, :n] @ self._WG.reshape(n, -1)).reshape(n, 3, N_X)
        moved = np.linalg.inv(self._W) @ weighted
        shares: Array = moments[:, :N_X, :N_X].reshape(k, -1) @ (
            (np.swapaxes(moved, 1, 2) @ weighted).reshape(n, -1).T
        )
        if basis.free:
            TP = residual_maker(self._Q) @ P[1:]
            bends = ((self._W @ TP) * (TP @ batches[:, None])).sum(axis=(2, 3))
            shares = np.column_stack([shares, bends])
        return shares

    def take_step(self, largest: float) -> bool:
        """Go on by a Gauss-Newton step, unless that is longer than so many deviations."""
        problem, d = self._problem, self._scale
        root, inverse_root = self.roots
        downhill = self._gradient / d
        if problem.prior is None:
            step = inverse_root @ (inverse_root @ downhill)
        else:
            downhill = downhill + problem.prior_pull(self._unknowns) / d
            step = np.linalg.solve(
                root @ root + problem.prior_information() / (d[:, None] * d), downhill
            )
        if step @ downhill > largest**2:
            return False
        moved = self._moved(step / d)
        self._gradient = self._gradient - self._hessian @ (moved - self._unknowns)[problem.free]
        self._unknowns = moved
        return True

    def fit(self, spread: Array, widening: Array, converged: bool, leak: int) -> RotationFit:
        """The estimate.

        Args:
            spread: (p, p) inflation of the covariance.
            widening: (p,) factors on the standard deviations.
            converged: whether the minimum was reached.
            leak: index of the leak.
        """
        problem, d, p, n = self._problem, self._scale, self._problem.p, rb.N_THETA
        root, inverse_root = self.roots
        prior = problem.prior
        # Noise on the inputs makes least squares underrate them; what that does to the gradient
        # is known, and one Newton step takes it back (first-order correction for errors in
        # variables).
        pull = np.zeros(p)
        noise = problem.rows * self._noise
        pull[:n] = self._WG @ (self._Q @ noise[:N_X, :N_X] - noise[N_X:, :N_X]).reshape(-1)
        wider = widening[:, None] * inverse_root
        data_covariance = wider @ spread @ wider.T
        covariance = data_covariance
        if prior is None:
            step = inverse_root @ (inverse_root @ (pull / d))
        else:
            pull += self._gradient
            coordinates, basis = self._unknowns[COORDINATES], problem.basis
            inside = (coordinates > basis.low) & (coordinates < basis.high)
            pull[n:] *= inside[list(basis.free)]
            held = (root / widening[:, None]) @ np.linalg.inv(spread)
            covariance = np.linalg.inv(
                held @ (root / widening)
                + problem.prior_information() / (d[:, None] * d)
                + 1e-15 * np.eye(p)
            )
            step = covariance @ (
                held @ (inverse_root @ (pull / (d * widening)))
                + problem.prior_pull(self._unknowns) / d
            )
        unknowns = self._moved(step / d)
        covariance = covariance / (d[:, None] * d)
        full = np.zeros((N_UNKNOWNS, N_UNKNOWNS))
        full[np.ix_(problem.free, problem.free)] = covariance
        power = self._powers()
        return RotationFit(
            theta=unknowns[:n],
            covariance=full[:n, :n],
            residual_covariance=self._residual,
            r_squared=1.0 - np.diag(self._residual) / np.maximum(power, 1e-300),
            rows=problem.rows,
            converged=converged,
            coordinates=unknowns[COORDINATES],
            leak=leak,
            data_std=(np.sqrt(np.diag(data_covariance)) / d)[:n],
            full_covariance=full,
            footing=Footing(self._unknowns, spread, widening),
        )

    def _powers(self) -> Array:
        """(3,) mean squares of the angular accelerations."""
        powers: Array = np.diag(self._problem.bank[self._index])[-3:] / self._problem.rows
        return powers

    def _moved(self, step: Array) -> Array:
        """The unknowns after a step, shortened until the inertia is physical."""
        for _ in range(_HALVINGS):
            unknowns = self._problem.moved(self._unknowns, step)
            if rb.is_physical(unknowns):
                return unknowns
            step = 0.5 * step
        start: Array = self._unknowns
        return start


def residual_maker(Q: Array) -> Array:
    """(..., 3, WIDTH) what makes residuals y - Q x of rows [x, y]."""
    T = np.empty((*Q.shape[:-1], WIDTH))
    T[..., :N_X] = -Q
    T[..., N_X:] = _IDENTITY
    return T


def _first_guess(total: Array, rows: int, at: Array, prior: Prior | None) -> Array | None:
    """(N_UNKNOWNS,) to start from: a rough fit, or what the prior says where it fits better."""
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
    problem = _Problem(total[None], rows, PLAIN, prior)
    both = np.stack([rough, guess])
    costs = [float(problem.evaluate(u[None]).cost[0]) for u in both]
    chosen: Array = both[int(np.argmin(costs))]
    return chosen


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


def _scales(hessian: Array) -> Array:
    """(..., p) square roots of the diagonal, 1 where there is no information at all."""
    diagonal = np.diagonal(hessian, axis1=-2, axis2=-1)
    return np.sqrt(np.where(diagonal > 1e-100, diagonal, 1.0))
