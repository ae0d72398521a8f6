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

from gcs_sysid.arrays import Array
from gcs_sysid.estimation import basis as coordinate
from gcs_sysid.estimation.basis import RotorBasis
from gcs_sysid.estimation.priors import COORDINATES, N_UNKNOWNS, Prior
from gcs_sysid.estimation.search import (
    N_X,
    Point,
    Problem,
    first_guess,
    minimise,
    residual_maker,
    scales,
    scan,
    search,
)
from gcs_sysid.estimation.uncertainty import inflation, meat, student_factor, symmetric_roots
from gcs_sysid.model import rigid_body as rb

_WARM_ITERATIONS, _FOLLOW_ITERATIONS = 6, 2
_BLIND_STEP = 1.5
"""Standard deviations; a smaller step of a fit that follows is taken unseen."""
_HALVINGS = 20
"""A step that leads out of the physical inertias is shortened so often, then not taken."""


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
    problem = Problem(bank, rows, basis, prior)
    at = basis.nodes[basis.middle]
    first = [first_guess(m, rows, at, prior) for m in basis.moments_at(bank, at)]
    if any(guess is None for guess in first):
        return None
    unknowns = np.stack([guess for guess in first if guess is not None])
    if start is None:
        point, converged = search(problem, scan(problem, unknowns))
    else:
        # An earlier estimate from too little motion may lie in a valley of its own.
        earlier = np.tile(start.unknowns, (len(bank), 1))
        closer = problem.evaluate(earlier).cost < problem.evaluate(unknowns).cost
        unknowns = np.where(closer[:, None], earlier, unknowns)
        point, converged = minimise(problem, unknowns, _WARM_ITERATIONS)
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
    problem = Problem(total[None], rows, basis, prior)
    unknowns = start.footing.unknowns[None]
    scatter = start.footing.inflation, start.footing.widening
    outcome = _Outcome(problem, problem.evaluate(unknowns), 0, noise)
    if outcome.take_step(_BLIND_STEP):
        return outcome.fit(*scatter, start.converged, start.leak)
    point, converged = minimise(problem, unknowns, _FOLLOW_ITERATIONS)
    return _Outcome(problem, point, 0, noise).fit(*scatter, bool(converged[0]), start.leak)


def uncertainty(fit: RotationFit) -> float:
    """Sum of log standard deviations of what makes up the core parameters."""
    return float(np.sum(np.log(fit.std[: rb.DAMPING])))


class _Outcome:
    """What follows from the minimum of one hypothesis.

    Args:
        problem: that was solved.
        point: its solution.
        index: of the hypothesis.
        noise: (WIDTH, WIDTH) that known noise of the inputs adds to the moments of a row.
    """

    def __init__(self, problem: Problem, point: Point, index: int, noise: Array) -> None:
        self._problem = problem
        self._noise = noise
        self._unknowns: Array = point.unknowns[index]
        self._gradient: Array = point.gradient[index]
        self._hessian = point.hessian[index]
        self._residual = point.residual[index]
        self._index = index
        self._scale = scales(self._hessian)
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
