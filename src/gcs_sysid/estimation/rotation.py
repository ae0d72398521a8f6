"""Fit of the rotational parameters to the moments of the forward form.

The cost  sum_rows (y - Q(theta) x)' W (y - Q(theta) x)  is an exact quadratic in Q, so it and
its derivatives follow from the moments alone. It is minimised by Gauss-Newton with
Levenberg-Marquardt damping; W is the inverse of the residual covariance, which the same moments
give (iterated to the maximum-likelihood point). See `gcs_sysid.model.rigid_body` for Q.

Moments come as a bank of hypotheses: the same rows with several leaks, and with the rotors'
signals taken at every node of a grid over what is not known of them (`estimation.grid`): delay,
and with commands motor lag and thrust curve. All are fitted at once, as stacked arrays. Between
the nodes the moments are interpolated, so these are estimated to a small fraction of the grid's
step.

Rows are correlated, so that the cost overstates what it knows. A prior joins the search as it
is, but in the outcome it is weighed against the information that the scatter of the batch
scores leaves: the curvature-adjusted composite likelihood of Chandler and Bate (2007),
Biometrika 94, 167-183.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation import grid as shapes
from gcs_sysid.estimation.grid import Grid
from gcs_sysid.estimation.priors import COORDINATES, N_UNKNOWNS, Prior
from gcs_sysid.estimation.uncertainty import inflation, meat, student_factor, symmetric_roots
from gcs_sysid.model import rigid_body as rb

N_X = rb.N_SIGNALS
WIDTH = N_X + 3
"""Width of a row [x, y]."""

COORDINATE_MEAN = np.array([0.0, 0.05, 0.5])
COORDINATE_STD = np.array([0.03, 0.05, 0.5])
"""s, s and 1; keep delay, lag and curve in the ordinary while the flight does not tell them."""

_MAX_ITERATIONS = 40
_SCAN_ITERATIONS = 8
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
_ONE_NODE = Grid((0.0,))
_AXES, _DIAGONAL = np.arange(3), np.arange(WIDTH)
_OUTPUTS = np.arange(N_X, WIDTH)


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
        coordinates: (3,) rotor delay (s), motor lag (s), thrust curve, see `estimation.grid`.
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
        return float(self.coordinates[shapes.DELAY])

    @property
    def delay_std(self) -> float:
        """s; zero where the delay was not estimated."""
        return float(self.coordinates_std[shapes.DELAY])


def fit_rotation(
    batches: Array,
    counts: NDArray[np.int64],
    grid: Grid,
    noise: Array,
    start: RotationFit | None = None,
    prior: Prior | None = None,
) -> RotationFit | None:
    """Fit theta and the grid's coordinates to a bank of moments.

    Args:
        batches: (k, leaks, nodes, WIDTH, WIDTH) moments of rows [x, y].
        counts: (k,) rows in each.
        grid: of the nodes.
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
    problem = _Problem(bank.reshape(*bank.shape[:2], -1), rows, grid, prior)
    middle = grid.middle
    first = [_first_guess(m, rows, grid.nodes[middle], prior) for m in bank[:, middle]]
    if any(guess is None for guess in first):
        return None
    unknowns = np.stack([guess for guess in first if guess is not None])
    if start is None:
        unknowns = _scan(problem, unknowns)
    else:
        # An earlier estimate from too little motion may lie in a valley of its own.
        earlier = np.tile(start.unknowns, (len(bank), 1))
        closer = problem.evaluate(earlier).cost < problem.evaluate(unknowns).cost
        unknowns = np.where(closer[:, None], earlier, unknowns)
    limit = _MAX_ITERATIONS if start is None else _WARM_ITERATIONS
    point, converged = _minimise(problem, unknowns, limit)
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
    grid: Grid,
    noise: Array,
    start: RotationFit,
    prior: Prior | None = None,
) -> RotationFit:
    """Follow a growing record from an earlier fit: a step or two with its leak.

    How far the score scatters is taken over from the earlier fit, as it hardly changes.

    Args:
        total: (nodes, WIDTH, WIDTH) moments of all rows, with the leak of `start`.
        rows: in them.
        grid: of the nodes.
        noise: (WIDTH, WIDTH) as of `fit_rotation`.
        start: a fit of the same record when it was shorter.
        prior: what else is known.
    """
    assert start.footing is not None
    problem = _Problem(total.reshape(1, grid.size, -1), rows, grid, prior)
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
        bank: (K, nodes, W * W) moments.
        rows: in each.
        grid: of the nodes; what it leaves free is fitted.
        prior: what else is known.
    """

    def __init__(self, bank: Array, rows: int, grid: Grid, prior: Prior | None) -> None:
        self.bank = bank
        self.rows = rows
        self.grid = grid
        self.prior = prior
        coordinates = rb.N_THETA + np.array(grid.free, dtype=int)
        self.free = np.concatenate([np.arange(rb.N_THETA), coordinates])
        """(p,) indices of the unknowns that are fitted."""
        self.p = len(self.free)
        self._pairs = [(grid.free.index(i), grid.free.index(j)) for i, j in grid.pairs]
        self._mean = COORDINATE_MEAN[list(grid.free)]
        self._information = COORDINATE_STD[list(grid.free)] ** -2.0

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

    def weights(self, unknowns: Array) -> Array:
        """(K, d, nodes): what makes moments, and their derivatives, of those at the nodes."""
        return self.grid.weights(unknowns[:, COORDINATES])

    def moved(self, unknowns: Array, step: Array) -> Array:
        """(..., N_UNKNOWNS) after a (..., p) step, within the grid."""
        moved: Array = unknowns.copy()
        moved[..., self.free] += step
        moved[..., COORDINATES] = np.clip(moved[..., COORDINATES], self.grid.low, self.grid.high)
        return moved

    def evaluate(self, unknowns: Array) -> _Point:
        """Cost and its derivatives at (K, N_UNKNOWNS)."""
        K, n, f = len(unknowns), rb.N_THETA, len(self.grid.free)
        moments = (self.weights(unknowns) @ self.bank).reshape(K, -1, WIDTH, WIDTH)
        Q, G = rb.forward_jacobian(unknowns[:, :n])
        T = residual_maker(Q)
        # Moments of residuals with rows: here, and derivatives by the grid's coordinates.
        cross = T[:, None] @ moments
        Tt = np.swapaxes(T, -1, -2)
        residual = cross @ Tt[:, None]
        S = residual[:, 0] / self.rows
        # Without noise only rounding is left of large terms; that keeps it definite.
        sizes = moments[:, 0, _DIAGONAL, _DIAGONAL]
        own = S[:, _AXES, _AXES]
        S[:, _AXES, _AXES] = own + (
            (T * T @ sizes[..., None])[..., 0] * (_EPSILON / self.rows)
            + (_ALIKE * own.sum(axis=1) + 1e-300)[:, None]
        )
        cost = np.linalg.slogdet(S)[1]
        W = np.linalg.inv(S)
        WG = (W[:, None] @ G).reshape(K, n, 3 * N_X)
        GR = (G.reshape(K, n * 3, N_X) @ moments[:, 0, :N_X, :N_X]).reshape(K, n, 3 * N_X)
        hessian = np.empty((K, self.p, self.p))
        hessian[:, :n, :n] = WG @ np.swapaxes(GR, -1, -2)
        right = cross[:, : 1 + f, :, :N_X].reshape(K, -1, 3 * N_X)
        downhill = WG @ np.swapaxes(right, -1, -2)
        gradient = np.empty((K, self.p))
        gradient[:, :n] = downhill[..., 0]
        if f:
            cost = cost + self.weak_cost(unknowns) / self.rows
            curves = 0.5 * (residual[:, 1:].reshape(K, -1, 9) @ W.reshape(K, 9, 1))[..., 0]
            away = unknowns[:, self.free[n:]] - self._mean
            gradient[:, n:] = -curves[:, :f] - away * self._information
            hessian[:, n:, :n] = -np.swapaxes(downhill[..., 1:], 1, 2)
            hessian[:, :n, n:] = -downhill[..., 1:]
            for k, (i, j) in enumerate(self._pairs):
                curve = curves[:, f + k]
                if i == j:
                    curve = np.maximum(curve, 0.0) + self._information[i]
                hessian[:, n + i, n + j] = hessian[:, n + j, n + i] = curve
        if self.prior is not None:
            cost = cost + self.prior.cost(unknowns) / self.rows
        return _Point(unknowns, cost, gradient, hessian, S, Q, W, WG)


def _scan(problem: _Problem, unknowns: Array) -> Array:
    """Fit at every node of the grid; the best one with its theta, for each leak."""
    leaks, nodes = problem.bank.shape[:2]
    if nodes == 1:
        return unknowns
    every = np.repeat(unknowns, nodes, axis=0)
    every[:, COORDINATES] = np.tile(problem.grid.nodes, (leaks, 1))
    given = _Problem(
        problem.bank.reshape(leaks * nodes, 1, -1), problem.rows, _ONE_NODE, problem.prior
    )
    point, _ = _minimise(given, every, _SCAN_ITERATIONS)
    weak = problem.weak_cost(every) / problem.rows
    best = np.argmin((point.cost + weak).reshape(leaks, nodes), axis=1)
    chosen: Array = point.unknowns.reshape(leaks, nodes, -1)[np.arange(leaks), best]
    return chosen


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
            batches: (k, nodes, W, W) of this hypothesis.
            counts: (k,) rows in each.
        """
        k = len(batches)
        f = len(self._problem.grid.free)
        weights = self._problem.weights(self._unknowns[None])[0, : 1 + f]
        moments = (weights @ batches.reshape(k, -1, WIDTH * WIDTH)).reshape(k, -1, WIDTH, WIDTH)
        T = residual_maker(self._Q)
        cross = T @ moments
        scores = cross[:, 0, :, :N_X].reshape(k, -1) @ self._WG.T
        if f:
            slopes = cross[:, 1:].reshape(k, f, -1) @ (self._W @ T).reshape(-1)
            scores = np.column_stack([scores, -0.5 * slopes])
        # Away from the likelihood's own minimum all batches pull one way; that is no scatter.
        scores -= np.outer(counts / counts.sum(), scores.sum(axis=0))
        scaled: Array = scores / self._scale
        return scaled

    def shares(self, batches: Array) -> Array:
        """(k, p) what each batch is expected to add to the variance of each unknown.

        The diagonal of H^-1 H_b H^-1, H_b the information of a batch; any scale.

        Args:
            batches: (k, nodes, W, W) of this hypothesis.
        """
        k, n, inverse_root = len(batches), rb.N_THETA, self.roots[1]
        weights = self._problem.weights(self._unknowns[None])[0]
        moments = (weights @ batches.reshape(k, -1, WIDTH * WIDTH)).reshape(k, -1, WIDTH, WIDTH)
        inverse = (inverse_root @ inverse_root) / (self._scale[:, None] * self._scale)
        weighted = (inverse[:n, :n] @ self._WG.reshape(n, -1)).reshape(n, 3, N_X)
        moved = np.linalg.inv(self._W) @ weighted
        shares: Array = moments[:, 0, :N_X, :N_X].reshape(k, -1) @ (
            (np.swapaxes(moved, 1, 2) @ weighted).reshape(n, -1).T
        )
        grid = self._problem.grid
        if grid.free:
            T = residual_maker(self._Q)
            own = [1 + len(grid.free) + grid.pairs.index((i, i)) for i in grid.free]
            bends = (T @ moments[:, own]).reshape(k, len(own), -1) @ (self._W @ T).reshape(-1)
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
            coordinates, grid = self._unknowns[COORDINATES], problem.grid
            inside = (coordinates > grid.low) & (coordinates < grid.high)
            pull[n:] *= inside[list(grid.free)]
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
        nodes = self._problem.bank[self._index]
        # The gyro is not moved with the rotors' delay: any node tells.
        powers: Array = nodes[0].reshape(WIDTH, WIDTH)[_OUTPUTS, _OUTPUTS] / self._problem.rows
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
    problem = _Problem(total.reshape(1, 1, -1), rows, _ONE_NODE, prior)
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
