"""Fit of the rotational parameters to whitened rows: a whitener for each axis, shocks left out.

Every whitener of a bank is tried on all axes at once; each axis then takes the one of least
innovation power, and theta, delay (and with commands lag and curve) follow from the three together
(`estimation.fit.axis_problem`). Where the search starts from nothing it looks at every node of the
rotors' dynamics, so that delay is found by the power of the innovations, within its bounds. As a
free column it would be found where torque predicts the motion best, which under feedback is the
inverse of the controller.

A collision or a bump in the air is no stationary noise of any kind: batches of a quarter of a
second whose innovations are far stronger than the median are left out.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.arrays import Array, Mask, by_parts
from gcs_sysid.estimation.fit.axis_problem import NOISE_SHARE, AxisPoint, AxisProblem, minimize_axes
from gcs_sysid.estimation.fit.curve_scatter import curve_scatter
from gcs_sysid.estimation.fit.deviations import NO_DEVIATIONS, DeviationChoice, Deviations
from gcs_sysid.estimation.fit.disturbance import RULES, BankTrial
from gcs_sysid.estimation.fit.priors import COORDINATES, N_UNKNOWNS, Prior
from gcs_sysid.estimation.fit.rotation import BLIND_STEP, RotationFit
from gcs_sysid.estimation.fit.search import first_guess, residual_maker, scales
from gcs_sysid.estimation.fit.whitened_outcome import WhitenedOutcome
from gcs_sysid.estimation.noise.uncertainty import inflation, meat, shrunk_inflation, student_factor
from gcs_sysid.estimation.noise.whitened_moments import WhitenedMoments, grouped
from gcs_sysid.estimation.rows.actuator_dynamics import PLAIN, WIDTH, ActuatorDynamics
from gcs_sysid.model import rigid_body as rb

SHOCK = 6.0
"""Times the median power of innovations, from which a batch is left out."""
_JUDGED = 3
"""Rounds of judging them, each by the fit without those found before."""
_JUDGED_ALIKE = 12
"""Times that batches are judged by the whiteners found before, 5 s each: a bump shows with any of
them."""
_JUDGES = 3
"""Iterations of a fit that judges, from the one before: the strongest are 6 times the median."""
_CALM, _ALIKE = 2.5, (0.5, 1.5)
"""Times their median, up to which innovations under the fit before hold no shock, and times what it
left, between which that median shows that the fit still holds: another one would move neither to
where shocks begin. Most of a flight is so, and need not be fitted in order to be judged."""
_MOST_SHOCKS = 0.25
"""Share of the batches; what happens more often is no shock."""
_SCAN, _TRY, _AGAIN, _FIT, _FOLLOW = 5, 8, 4, 30, 3
"""Iterations: at a node; with a whitener, from there and from a fit; with those of the axes; of a
fit that follows."""
_CHOSEN = 3
"""Times that deviations from the model are chosen again."""
_SCANNED = 64
"""Pairs of whitener and node that are looked at, about."""
_REACH = 2
"""Neighbors of a batch with correlated scores: innovations have little memory."""
_LEAST = 0.05
"""Share of an innovation's power that no correction leaves it without."""
_AXES = 3


@dataclass(frozen=True)
class WhitenedFit:
    """A fit, and what it left out.

    Attributes:
        rotation: the fit.
        shocks: (k,) which batches were left out.
        left_out: (3, width, width) moments of these, as each axis' whitener made them.
        rows_left_out: in them.
        cost: nats a row, summed over the axes; the less, the better.
        bound: (N_THETA,) standard deviations, were innovations white and the model whole.
    """

    rotation: RotationFit
    shocks: Mask
    left_out: Array
    rows_left_out: int
    cost: float
    bound: Array


def fit_whitened(
    data: WhitenedMoments,
    basis: ActuatorDynamics,
    start: RotationFit | None = None,
    prior: Prior | None = None,
    doubt: float = 0.0,
    choice: DeviationChoice | None = None,
    hover: float = 0.0,
    only: Mask | None = None,
    *,
    scatter: bool = True,
) -> WhitenedFit | None:
    """Fit theta and the basis' coordinates to whitened moments.

    Args:
        data: moments.
        basis: of the elements.
        start: an earlier fit of the same record; None: from the data alone.
        prior: what else is known.
        doubt: one standard deviation of the inputs' known noise, relative.
        choice: of deviations from the model; None: there are none.
        hover: rad^2/s^2, thrust signal in hover; 0: not known.
        only: (k,) batches to fit; None: all.
        scatter: whether standard deviations count how far batches scatter; else, at three quarters
            of the cost, they are the bound.

    Returns:
        The fit, or None while the data cannot even start one.
    """
    deviations = NO_DEVIATIONS if start is None else start.deviating
    wanted = np.ones(len(data.counts), dtype=bool) if only is None else only
    kept = wanted
    given, all_rows = data, int(data.counts[kept].sum())
    rows = all_rows
    if rows < 3 * rb.N_THETA:
        return None
    everything = total = data.total(kept)
    if start is None:
        trial = _scanned(total, rows, data, basis, prior)
    else:
        assert start.warm_start is not None
        unknowns = start.warm_start.unknowns
        trial = _tried(total, rows, data, basis, prior, unknowns, deviations=deviations)
    if trial is None:
        return None
    solved = _solved(total, rows, data, basis, prior, trial, deviations)
    batches = data.of_axes(solved.pick)
    for _ in range(_JUDGED):
        shocks = _shocks(solved.point, batches, data.counts, basis)
        if (kept == (wanted & ~shocks)).all():
            break
        # The fit without the worst of them sees the rest.
        kept = wanted & ~shocks
        total, rows = data.total(kept), int(data.counts[kept].sum())
        solved = _solved(total, rows, data, basis, prior, solved.trial, deviations)
        batches = data.of_axes(solved.pick)
    if data.own:
        data = data.weighed(_relative_power(solved.point, batches, data.counts, basis))
        total, rows = data.total(kept), int(data.counts[kept].sum())
        solved = _solved(total, rows, data, basis, prior, solved.trial, deviations)
        batches = data.of_axes(solved.pick)
    for _ in range(_CHOSEN if choice is not None else 0):
        assert choice is not None
        chosen = _chosen(solved, rows, basis, prior, choice)
        if chosen.like(deviations):
            break
        # Whiteners too: what the model lacked looked like a disturbance.
        deviations = chosen
        unknowns = solved.point.unknowns[0, :N_UNKNOWNS]
        trial = _tried(total, rows, data, basis, prior, unknowns, deviations=deviations)
        solved = _solved(total, rows, data, basis, prior, trial, deviations)
        batches = data.of_axes(solved.pick)
    pick = list(solved.pick)
    if not scatter:
        bare = replace(
            _bound(solved, WhitenedOutcome(solved.problem, solved.point)),
            whiteners=tuple(data.whiteners[i] for i in pick),
            disturbance=solved.trial.detected,
        )
        left_out = everything[pick] - total[pick], all_rows - rows
        return WhitenedFit(bare, ~kept, *left_out, solved.cost, bare.std)
    noise = data.noise[pick]
    batches, counts = grouped(batches[kept], data.counts[kept], data.grouped)
    batches -= NOISE_SHARE * counts[:, None, None, None] * noise
    outcome = WhitenedOutcome(solved.problem, solved.point)
    scores = outcome.scores(0, batches, counts)
    inverse_root = outcome.roots[1][0]
    spread, by_scatter = shrunk_inflation(inverse_root, scores, _REACH)
    disturbed = solved.trial.detected.max() > RULES.detected
    if disturbed or deviations.shown or data.own:
        # What disturbs is hardly stationary, and who deviates in one way may do so in others: there
        # all scatter counts, proved or not.
        spread, by_scatter = inflation(inverse_root, meat(scores, _REACH)), np.ones(len(spread))
    spread = spread[None]
    widening = student_factor(outcome.shares(0, batches), _REACH, by_scatter)[None]
    if data.own:
        # Whiteness of innovations is based on all rows, not on the scatter of few batches.
        widening = np.ones_like(widening)
    if doubt:
        silent = np.zeros_like(noise)[None]
        raw = AxisProblem(solved.problem.bank, rows, basis, prior, silent, deviations)
        pull = raw.evaluate(solved.point.unknowns).gradient - solved.point.gradient
        spread = spread + outcome.spread_of(doubt * pull)
    # First from scatter, which also gives the contrasts' standard deviations.
    improved = outcome.fits(spread, widening, [solved.converged], [0])[0]
    if data.judges:
        improved = replace(
            improved, r_squared=_explained(solved, given.total(kept), data.judges, basis)
        )
    r_squared = improved.r_squared
    errors = solved.trial.systematic(improved, hover)
    for error in errors:
        way = np.zeros(solved.problem.p)
        way[: rb.N_THETA] = error / widening[0, : rb.N_THETA]
        spread = spread + outcome.spread_of(way[None] @ solved.point.hessian[0])
    scatters = disturbed and basis.motors and only is None
    if scatters:
        along = curve_scatter(solved.problem, improved, batches, counts) / widening[0]
        spread = spread + outcome.spread_of(along[None] @ solved.point.hessian[0])
    if len(errors) or scatters:
        improved = outcome.fits(spread, widening, [solved.converged], [0])[0]
    fit = replace(
        improved,
        r_squared=r_squared,
        whiteners=tuple(data.whiteners[i] for i in pick),
        disturbance=solved.trial.detected,
        deviating=deviations,
    )
    if data.own:
        total, rows = given.total(kept), int(given.counts[kept].sum())
    left_out = everything[pick] - total[pick], all_rows - rows
    return WhitenedFit(fit, ~kept, *left_out, solved.cost, _bound(solved, outcome).std)


def least_power(data: WhitenedMoments, basis: ActuatorDynamics, unknowns: Array) -> tuple[int, ...]:
    """Whitener of least innovation power, of each axis, near (N_UNKNOWNS,) of a fit."""
    total, rows = data.total(np.ones(len(data.counts), dtype=bool)), int(data.counts.sum())
    return _tried(total, rows, data, basis, None, unknowns).pick


def follow_whitened(
    totals: Array,
    rows: Array,
    basis: ActuatorDynamics,
    noise: Array,
    start: RotationFit,
    prior: Prior | None = None,
) -> list[RotationFit]:
    """Follow a growing record from an earlier fit, with its whiteners.

    Args:
        totals: (K, 3, width, width) moments of all rows at K instants, as each axis has them.
        rows: (K,) in them.
        basis: of the elements.
        noise: (K, 3, width, width) of the inputs in one row.
        start: a fit of the same record when it was shorter.
        prior: what else is known.

    Returns:
        K fits, each of which depends on `start` and its own instant alone.
    """
    assert start.warm_start is not None
    scatter = start.warm_start.inflation, start.warm_start.widening
    unknowns = np.tile(start.warm_start.unknowns, (len(rows), 1))
    deviations = start.deviating
    problem = AxisProblem(totals, rows, basis, prior, noise, deviations)
    outcome = WhitenedOutcome(problem, problem.evaluate(unknowns))
    near = outcome.take_step(BLIND_STEP)
    fits = outcome.fits(*scatter, [start.converged] * len(rows), [0] * len(rows))
    if not near.all():
        far = ~near
        alone = AxisProblem(totals[far], rows[far], basis, prior, noise[far], deviations)
        point, converged = minimize_axes(alone, unknowns[far], _FOLLOW)
        better = WhitenedOutcome(alone, point).fits(*scatter, converged, [0] * len(converged))
        for i, fit in zip(np.flatnonzero(far), better, strict=True):
            fits[i] = fit
    taken = {name: getattr(start, name) for name in ("whiteners", "disturbance", "deviating")}
    return [replace(fit, **taken) for fit in fits]


def explained_by(data: WhitenedMoments, basis: ActuatorDynamics) -> Array | None:
    """(3,) shares of the whitened acceleration that a quick fit explains; None: there is none."""
    kept = np.ones(len(data.counts), dtype=bool)
    total, rows = data.total(kept), int(data.counts.sum())
    trial = _scanned(total, rows, data, basis, None)
    if trial is None:
        return None
    axes = np.arange(_AXES)
    power = total[list(trial.pick), axes - _AXES, axes - _AXES] / rows
    share: Array = 1.0 - trial.variance[list(trial.pick), axes] / np.maximum(power, 1e-300)
    return share


@dataclass(frozen=True)
class ShockReference:
    """Where the fit starts by which the next batches are judged.

    Attributes:
        unknowns: (N_UNKNOWNS,) fitted to those before.
        pick: whitener of each axis.
        variance: (3,) power of the innovations of that fit.
        age: how many times others were judged by these whiteners.
    """

    unknowns: Array
    pick: tuple[int, ...]
    variance: Array
    age: int = 0


def shocks_in(
    data: WhitenedMoments,
    basis: ActuatorDynamics,
    start: ShockReference | None,
    *,
    quick: bool = False,
) -> tuple[Mask, ShockReference | None]:
    """(k,) which batches are to be left out, by a fit to these batches alone, where one is needed.

    Args:
        data: the batches.
        basis: of the elements.
        start: what the batches before were judged by; None: these are the first.
        quick: whether that fit will do where it shows that nothing is near a shock.

    Returns:
        The mask, and what the next ones are judged by.
    """
    kept = np.ones(len(data.counts), dtype=bool)
    before = start if start is not None and start.age < _JUDGED_ALIKE else None
    if before is not None and quick and _is_calm(before, data, basis):
        return ~kept, replace(before, age=before.age + 1)
    total, rows = data.total(kept), int(data.counts.sum())
    age, limit = 0, _TRY
    if before is not None:
        pick, unknowns, age, limit = before.pick, before.unknowns[None], before.age + 1, _JUDGES
    else:
        if start is None:
            trial = _scanned(total, rows, data, basis, None)
        else:
            trial = _tried(total, rows, data, basis, None, start.unknowns)
        if trial is None:
            return ~kept, None
        pick = trial.pick
        unknowns = trial.unknowns[list(pick)[:1]]
    places = list(pick)
    problem = AxisProblem(total[places][None], rows, basis, None, data.noise[places][None])
    point, _ = minimize_axes(problem, unknowns, limit)
    shocks = _shocks(point, data.of_axes(pick), data.counts, basis)
    return shocks, ShockReference(point.unknowns[0], pick, point.variance[0], age)


def _is_calm(before: ShockReference, data: WhitenedMoments, basis: ActuatorDynamics) -> bool:
    """Whether the fit before shows, without another, that no batch holds a shock."""
    TP = residual_maker(rb.forward_matrix(before.unknowns[: rb.N_THETA])) @ basis.map_at(
        before.unknowns[COORDINATES]
    )
    relative = _relative(TP, before.variance, data.of_axes(before.pick), data.counts)
    middle = float(np.median(relative))
    return _ALIKE[0] < middle < _ALIKE[1] and bool(relative.max() <= _CALM * middle)


@dataclass(frozen=True)
class _Solved:
    """The fit with a whitener for each axis."""

    problem: AxisProblem
    point: AxisPoint
    converged: bool
    pick: tuple[int, ...]
    trial: BankTrial

    @property
    def cost(self) -> float:
        """Nats a row, summed over the axes."""
        power = self.trial.variance[list(self.pick), np.arange(_AXES)]
        weak = self.point.weak[0] / self.problem.rows[0]
        return 0.5 * float(np.log(power).sum() + weak)


def _bound(solved: _Solved, outcome: WhitenedOutcome) -> RotationFit:
    """The fit with the standard deviations that white innovations of the whole model would have."""
    p = solved.problem.p
    return outcome.fits(np.eye(p)[None], np.ones((1, p)), [solved.converged], [0])[0]


def _solved(
    total: Array,
    rows: int,
    data: WhitenedMoments,
    basis: ActuatorDynamics,
    prior: Prior | None,
    trial: BankTrial,
    deviations: Deviations,
) -> _Solved:
    """Fit with the whiteners of a trial; and once more, should others be better there."""
    pick = trial.pick
    unknowns = trial.unknowns[list(pick)]
    for again in (True, False):
        bank, noise = total[list(pick)][None], data.noise[list(pick)][None]
        problem = AxisProblem(bank, rows, basis, prior, noise, deviations)
        # From what the first axis or the others found, whichever is nearer to all of it.
        starts = [problem.evaluate(u[None]) for u in np.unique(unknowns, axis=0)]
        cost = [float(np.log(p.variance).sum() + p.weak[0] / rows) for p in starts]
        point, converged = minimize_axes(problem, starts[int(np.argmin(cost))].unknowns, _FIT)
        found = point.unknowns[0]
        trial = _tried(total, rows, data, basis, prior, found, deviations=deviations)
        solved = _Solved(problem, point, bool(converged[0]), pick, trial)
        if not again or trial.pick == pick:
            break
        pick, unknowns = trial.pick, point.unknowns
    return solved


def _tried(
    total: Array,
    rows: int,
    data: WhitenedMoments,
    basis: ActuatorDynamics,
    prior: Prior | None,
    unknowns: Array,
    limit: int = _AGAIN,
    deviations: Deviations = NO_DEVIATIONS,
) -> BankTrial:
    """Every whitener on all axes, coordinates as in (N_UNKNOWNS,) or (bank, N_UNKNOWNS)."""
    fitted = unknowns if unknowns.ndim == 1 else None
    unknowns = np.broadcast_to(unknowns, (len(total), unknowns.shape[-1]))
    at = unknowns[0, COORDINATES]
    moments, noise = (basis.moments_at(m, at)[:, None] for m in (total, data.noise))
    problem = AxisProblem(moments, rows, PLAIN, prior, noise, deviations)
    point, _ = minimize_axes(problem, problem.extended(unknowns), limit)
    known = np.median(point.unknowns, axis=0) if fitted is None else problem.extended(fitted)
    alike = _alike(point, rows, noise[:, 0], known, deviations)
    for axis, own in enumerate(data.own):
        # An axis' noise is its own.
        alike[[i for i in data.own if i != own], axis] = np.inf
    tried = point.unknowns.copy()
    if basis.motors:
        tried[:, COORDINATES] = at  # plain rows have none
    return BankTrial(data.whiteners, data.time, tried, alike, point.hessian)


def _chosen(
    solved: _Solved,
    rows: int,
    basis: ActuatorDynamics,
    prior: Prior | None,
    choice: DeviationChoice,
) -> Deviations:
    """The deviations for which there is evidence, from one look at all of them."""
    before, point = solved.problem, solved.point
    every = choice.every(point.unknowns[0])
    competing = choice.with_turns(every, point.unknowns[0])
    n, m = rb.N_THETA, len(competing.std)
    noise = (before.bank - before.without) / (NOISE_SHARE * rows)
    problem = AxisProblem(before.bank, rows, basis, prior, noise, competing)
    unknowns = problem.extended(point.unknowns[:, :N_UNKNOWNS])
    # The fit in terms of all deviations: the same torque.
    flat = every.torques.reshape(len(every.std), -1)
    torque = before.deviations.torque(point.unknowns[:, N_UNKNOWNS:]).reshape(-1)
    phi = np.zeros(m)
    phi[: len(flat)] = np.linalg.lstsq(flat.T, torque, rcond=None)[0]
    unknowns[:, N_UNKNOWNS:] = phi
    at = problem.evaluate(unknowns)
    gradient, hessian = (part[0] for part in problem.with_prior(at.gradient, at.hessian, unknowns))
    of = np.arange(n, n + m)
    others = np.setdiff1d(np.arange(problem.p), of)
    d = scales(hessian[None])[0][others]
    cross = hessian[np.ix_(others, of)] / d[:, None]
    inverse = np.linalg.pinv(
        hessian[np.ix_(others, others)] / np.outer(d, d), rcond=1e-12, hermitian=True
    )
    information = hessian[np.ix_(of, of)] - cross.T @ inverse @ cross
    score = gradient[of] - cross.T @ inverse @ (gradient[others] / d)
    return choice.choose(every, point.unknowns[0], score + information @ phi, information)


def _alike(
    point: AxisPoint,
    rows: int,
    noise: Array,
    known: Array,
    deviations: Deviations = NO_DEVIATIONS,
) -> Array:
    """(K, 3) power of the innovations as it would be if all had the same share of known noise.

    Input noise biases the minimum of the power towards a vehicle with less response. An estimate
    that errs that way by chance would look better than the truth. The power compared is therefore
    that without the known noise, which is stationary at the truth, plus that noise with one and the
    same response.

    Args:
        point: K solutions.
        rows: that they are of.
        noise: (K, WIDTH, WIDTH) in one row.
        known: (N_UNKNOWNS + m,) of that vehicle.
        deviations: m of them.
    """
    torque = deviations.torque(known[N_UNKNOWNS:])
    T = residual_maker(rb.forward_matrix(known[: rb.N_THETA], torque))
    of_noise = ((T @ noise) * T).sum(axis=-1)
    alike: Array = np.maximum(
        point.motion_power / rows + NOISE_SHARE * of_noise, _LEAST * point.variance
    )
    return alike


def _scanned(
    total: Array,
    rows: int,
    data: WhitenedMoments,
    basis: ActuatorDynamics,
    prior: Prior | None,
) -> BankTrial | None:
    """From the data alone: every node with every whitener, then all whiteners at the best one."""
    nodes = basis.nodes
    every = max(len(total) * len(nodes) // _SCANNED, 1)
    some, some_noise = total[::every], data.noise[::every]
    middle = nodes[basis.middle]
    at_middle = basis.moments_at(some - NOISE_SHARE * rows * some_noise, middle)
    guesses = [first_guess(moments, rows, middle, prior) for moments in at_middle]
    known = [guess for guess in guesses if guess is not None]
    if not known:
        return None
    guess = np.stack([known[len(known) // 2] if g is None else g for g in guesses])
    P = basis.maps(nodes)[:, 0]
    turned = np.swapaxes(P, 1, 2)
    moments, noise = (
        (P @ m[:, None] @ turned).reshape(-1, 1, WIDTH, WIDTH) for m in (some, some_noise)
    )
    starts = np.repeat(guess, len(nodes), axis=0)
    starts[:, COORDINATES] = np.tile(nodes, (len(some), 1))
    problem = AxisProblem(moments, rows, PLAIN, prior, noise)
    point, _ = minimize_axes(problem, starts, _SCAN)
    known_vehicle = np.median(point.unknowns, axis=0)
    alike = _alike(point, rows, noise[:, 0], known_vehicle)
    power = np.log(alike).reshape(len(some), len(nodes), _AXES)
    weak = AxisProblem(total[:1, None], rows, basis, prior, data.noise[:1, None]).weak_cost(starts)
    cost = power.min(axis=0).sum(axis=1) + weak[: len(nodes)] / rows
    best = int(np.argmin(cost))
    found = point.unknowns.reshape(len(some), len(nodes), -1)[:, best].copy()
    if basis.motors:
        found[:, COORDINATES] = nodes[best]  # plain rows have none
    unknowns = np.repeat(found, every, axis=0)[: len(total)]
    return _tried(total, rows, data, basis, prior, unknowns, _TRY)


def _explained(
    solved: _Solved, total: Array, judges: tuple[int, ...], basis: ActuatorDynamics
) -> Array:
    """(3,) share of each axis' acceleration that a fit explains, rows whitened by others.

    Args:
        solved: the fit.
        total: (bank, width, width) moments.
        judges: whitener of each axis.
        basis: of the elements.
    """
    point, axes = solved.point, np.arange(_AXES)
    P = basis.map_at(point.unknowns[0, COORDINATES])
    moments = P @ total[list(judges)] @ P.T
    T = residual_maker(point.Q[0])
    left = (T[:, None] @ moments)[:, 0] * T
    share: Array = 1.0 - left.sum(axis=-1) / np.maximum(
        moments[axes, axes - _AXES, axes - _AXES], 1e-300
    )
    return share


def _relative_power(
    point: AxisPoint, batches: Array, counts: NDArray[np.int64], basis: ActuatorDynamics
) -> Array:
    """(k,) of the innovations in each batch, over the median: geometric mean of the axes."""
    TP = residual_maker(point.Q[0]) @ basis.map_at(point.unknowns[0, COORDINATES])
    power = ((TP[:, None] @ batches)[:, :, 0] * TP).sum(axis=-1) / counts[:, None]
    relative: Array = np.exp(np.log(power / np.median(power, axis=0)).mean(axis=1))
    return relative


def _shocks(
    point: AxisPoint, batches: Array, counts: NDArray[np.int64], basis: ActuatorDynamics
) -> Mask:
    """(k,) whose innovations are far stronger than the median."""
    TP = residual_maker(point.Q[0]) @ basis.map_at(point.unknowns[0, COORDINATES])
    return _far_stronger(TP, point.variance[0], batches, counts)


def find_shocks(TP: Array, fit: RotationFit, batches: Array, counts: NDArray[np.int64]) -> Mask:
    """(k,) which batches hold shocks, by a fit.

    Args:
        TP: (3, width) what makes its innovations of rows of elements.
        fit: that judges.
        batches: (k, 3, width, width) with its whiteners.
        counts: (k,) rows in each.
    """
    return _far_stronger(TP, np.diag(fit.residual_covariance), batches, counts)


def _relative(TP: Array, variance: Array, batches: Array, counts: NDArray[np.int64]) -> Array:
    """(k,) power of innovations over their variance, mean of the axes."""

    def power(some: Array) -> Array:
        squares: Array = ((TP[:, None] @ some)[:, :, 0] * TP).sum(axis=-1)
        return squares

    relative: Array = (by_parts(power, batches) / counts[:, None] / variance).mean(axis=1)
    return relative


def _far_stronger(TP: Array, variance: Array, batches: Array, counts: NDArray[np.int64]) -> Mask:
    relative = _relative(TP, variance, batches, counts)
    shocks: Mask = relative > SHOCK * np.median(relative)
    return shocks if shocks.mean() <= _MOST_SHOCKS else np.zeros(len(counts), dtype=bool)
