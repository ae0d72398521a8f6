"""Fit of the rotational parameters to whitened rows: a whitener for each axis, shocks left out.

Theta, delay (and with commands lag and curve) follow from the three axes together, each with rows
that its own whitener made (`whitener_choice`).

A collision or a bump in the air is no stationary noise of any kind: batches of a quarter of a
second whose innovations are far stronger than the median, and more than the rotors explain of their
motion, are left out (`shocks_in`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from gcs_sysid.arrays import Array, Mask, by_parts
from gcs_sysid.estimation.fit.deviations import NO_DEVIATIONS, DeviationChoice
from gcs_sysid.estimation.fit.disturbance import RULES
from gcs_sysid.estimation.fit.inference import Outcome
from gcs_sysid.estimation.fit.priors import COORDINATES, N_UNKNOWNS, Prior, Unknown
from gcs_sysid.estimation.fit.problem import (
    NOISE_SHARE,
    Evaluation,
    Problem,
    axis_power,
    own_power,
    residual_maker,
    times_moments,
)
from gcs_sysid.estimation.fit.rotation import RotationFit, along
from gcs_sysid.estimation.fit.solver import minimize, scales
from gcs_sysid.estimation.fit.whitener_choice import TRY, AxisFit, BankProblem
from gcs_sysid.estimation.noise.uncertainty import inflation, meat, shrunk_inflation, student_factor
from gcs_sysid.estimation.noise.whitening import MOST_WEIGHT, WhitenedMoments, find_whiteners
from gcs_sysid.estimation.rows.actuator_dynamics import ActuatorDynamics
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.significance import FALSE_ALARM_RATE

SHOCK = 6.0
"""Times the median power of innovations, from which a batch is left out."""
_OWN = 0.5
"""Share of a batch's motion that the fit does not explain, up to which it is no shock."""
_ONE = (0, 0, 0)
"""Whiteners of the axes where there is but one."""
_MOST_SHOCKS = 0.25
"""Share of the rows; what happens more often is no shock. Batches get longer as they get older."""
_JUDGED_ALIKE = 12
"""Times that batches are judged by the whiteners found before, 5 s each: a bump shows with any of
them."""
_JUDGES = 3
"""Iterations of a fit that judges, from the one before: the strongest are 6 times the median."""
_CALM, _ALIKE = 2.5, (0.5, 1.5)
"""Times their median, up to which innovations under the fit before hold no shock, and times what it
left, between which that median shows that the fit still holds: another one would move neither to
where shocks begin. Most of a flight is so, and need not be fitted in order to be judged."""
_JUDGED = 3
"""Rounds of judging batches, each by the fit without those found before."""
_CHOSEN = 3
"""Times that deviations from the model are chosen again."""
_AS_CERTAIN = 0.1
"""Of standard deviations, relative: in a minute of flight chance makes them differ by 0.07."""
_STRETCHES, _STEPS = 3, 10
"""A minute has about as many kinds of maneuver; iterations without one of them."""


def innovation_maker(Q: Array, basis: ActuatorDynamics, coordinates: Array) -> Array:
    """(3, width) what makes innovations of rows of elements, at a fit's Q and coordinates."""
    return residual_maker(Q) @ basis.map_at(coordinates)


def find_shocks(TP: Array, variance: Array, batches: Array, counts: NDArray[np.int64]) -> Mask:
    """(k,) which batches' innovations are far stronger than the median.

    Args:
        TP: (3, width) what makes innovations of rows of elements, by a fit.
        variance: (3,) of them.
        batches: (k, 1 or 3, width, width) with its whiteners.
        counts: (k,) rows in each.
    """
    relative = _relative(TP, variance, batches, counts)
    motion = (own_power(batches) / counts[:, None] / variance).mean(axis=1)
    # What rotors explain for the most part, they did: most of a flight may be far calmer.
    shocks: Mask = relative > np.maximum(SHOCK * np.median(relative), _OWN * motion)
    few = counts[shocks].sum() <= _MOST_SHOCKS * counts.sum()
    return shocks if few else np.zeros(len(counts), dtype=bool)


def _relative(TP: Array, variance: Array, batches: Array, counts: NDArray[np.int64]) -> Array:
    """(k,) power of innovations over their variance, mean of the axes."""
    power = by_parts(lambda some: axis_power(TP, some), batches)
    return (power / counts[:, None] / variance).mean(axis=1)


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

    def innovation_maker(self, basis: ActuatorDynamics) -> Array:
        """(3, width) what makes its innovations of rows of elements."""
        Q = rb.forward_matrix(self.unknowns[: rb.N_THETA])
        return innovation_maker(Q, basis, self.unknowns[COORDINATES])

    def is_calm(self, data: WhitenedMoments, basis: ActuatorDynamics) -> bool:
        """Whether it shows, without another fit, that no batch holds a shock."""
        relative = _relative(
            self.innovation_maker(basis), self.variance, data.of_axes(self.pick), data.counts
        )
        middle = float(np.median(relative))
        return _ALIKE[0] < middle < _ALIKE[1] and bool(relative.max() <= _CALM * middle)


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
    none = np.zeros(len(data.counts), dtype=bool)
    before = start if start is not None and start.age < _JUDGED_ALIKE else None
    if before is not None and quick and before.is_calm(data, basis):
        return none, replace(before, age=before.age + 1)
    bank = BankProblem(data, basis)
    age, limit = 0, TRY
    if before is not None:
        pick, unknowns, age, limit = before.pick, before.unknowns[None], before.age + 1, _JUDGES
    else:
        trial = bank.scanned() if start is None else bank.tried(start.unknowns)
        if trial is None:
            return none, None
        pick = trial.pick
        unknowns = trial.unknowns[list(pick)[:1]]
    point, _ = minimize(bank.axes(pick), unknowns, limit)
    found = ShockReference(point.unknowns[0], pick, point.variance[0], age)
    TP = found.innovation_maker(basis)
    return find_shocks(TP, found.variance, data.of_axes(pick), data.counts), found


@dataclass(frozen=True)
class WhitenedFit:
    """A fit, and what it left out.

    Attributes:
        rotation: the fit.
        left_out: (1 or 3, width, width) moments of batches with shocks, as each axis' whitener made
            them.
        rows_left_out: in them.
        cost: nats a row, summed over the axes; the less, the better.
        bound: (N_THETA,) standard deviations, were innovations white and the model whole.
    """

    rotation: RotationFit
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
    others: bool = True,
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
        others: whether deviations are chosen beside those given.

    Returns:
        The fit, or None while the data cannot even start one.
    """
    given = choice.given if choice is not None and choice.has_given else NO_DEVIATIONS
    deviations = given if start is None else start.deviating
    wanted = np.ones(len(data.counts), dtype=bool) if only is None else only
    bank = BankProblem(data, basis, prior, wanted, deviations)
    if bank.is_short:
        return None
    solved, chosen = _solved(bank, start, wanted), choice if others else None
    settled = [_settled(*one, wanted, chosen) for one in solved]
    if not settled:
        return None
    finishing = _Finishing(data, wanted, choice, doubt, hover, only is None, scatter)
    return most_certain([finishing.finished(*one) for one in settled])


def _solved(
    bank: BankProblem, start: RotationFit | None, wanted: Mask
) -> list[tuple[BankProblem, AxisFit]]:
    """Where the search ends: each axis with its whitener, or all with one leak after the other.

    Rows of the window share samples: what a leak leaves of them is not which is best.
    """
    data, unknowns = bank.data, None
    if start is not None:
        assert start.warm_start is not None
        unknowns = start.warm_start.unknowns
        pick = tuple(i for i in find_whiteners(start.whiteners, data.whiteners) if i is not None)
        if len(pick) == len(_ONE):
            if not data.of_steps:
                bank, pick = bank.under(pick[0]), _ONE
            # A crash among the batches would lead the search away from what it starts from.
            TP = innovation_maker(start.Q, bank.basis, start.coordinates)
            variance = np.diag(start.residual_covariance)
            shocks = find_shocks(TP, variance, bank.data.of_axes(pick), data.counts)
            bank = replace(bank, kept=wanted & ~shocks)
            return [(bank, bank.solve(pick, unknowns[None]))]
    trial = bank.scanned() if unknowns is None else bank.tried(unknowns)
    if trial is None:
        return []
    if data.of_steps:
        return [(bank, bank.solve_from(trial))]
    under = [(bank.under(i), trial.unknowns[[i]]) for i in range(len(data.whiteners))]
    return [(one, one.solve(_ONE, starts)) for one, starts in under]


def most_certain(fits: Sequence[WhitenedFit]) -> WhitenedFit:
    """The first that is nearly as certain as any, so the one with the shortest memory.

    How certain each is, is itself estimated from scatter, with error. The least of several such
    numbers is too small, and long memories, which sum up slow errors, gain most by chance.
    """
    # Of its own size: the response to torque goes with the inverse of inertia, whose absolute error
    # vanishes with it where slow errors drive a moment to nothing.
    uncertain = [
        float((_logs(each.std) - _logs(rb.counterparts(each.theta, 1.0)))[: rb.DAMPING].mean())
        for each in (fit.rotation for fit in fits)
    ]
    return fits[int(np.argmax(np.array(uncertain) <= min(uncertain) + _AS_CERTAIN))]


def _logs(values: Array) -> Array:
    """Of sizes; of nothing, as the std of what is muted, that of next to nothing."""
    return np.log(np.maximum(np.abs(values), 1e-300))


def _settled(
    bank: BankProblem, solved: AxisFit, wanted: Mask, choice: DeviationChoice | None
) -> tuple[BankProblem, AxisFit]:
    """The fit from where the search ended: without shocks, with deviations."""
    data, kept = bank.data, wanted if bank.kept is None else bank.kept
    batches = data.of_axes(solved.pick)
    for _ in range(_JUDGED):
        TP, variance = _innovation_maker(solved), solved.point.variance[0]
        shocks = find_shocks(TP, variance, batches, data.counts)
        if (kept == (wanted & ~shocks)).all():
            break
        # The fit without the worst of them sees the rest.
        kept = wanted & ~shocks
        bank = replace(bank, kept=kept)
        solved = bank.solve(solved.trial.pick, solved.point.unknowns)
        batches = data.of_axes(solved.pick)
    power = axis_power(_innovation_maker(solved), batches) / data.counts[:, None]
    # Without noise rounding alone is left, of either sign.
    power = np.maximum(power, np.finfo(float).eps * solved.point.variance[0])
    # Over the median: geometric mean of the axes.
    relative = np.exp(np.log(power / np.median(power, axis=0)).mean(axis=1))
    if data.is_whole or _gain(relative[kept]) > MOST_WEIGHT:
        bank = replace(bank, data=data.weighed(relative))
        solved = bank.solve(solved.trial.pick, solved.point.unknowns)
    for _ in range(_CHOSEN if choice is not None else 0):
        assert choice is not None
        batches = bank.data.of_axes(solved.pick)
        chosen = bank.choose_deviations(solved, choice, None if bank.basis.motors else batches)
        if chosen.like(bank.deviations):
            break
        # Whiteners too: what the model lacked looked like a disturbance.
        unknowns = solved.point.unknowns[0]
        phi = chosen.doing(unknowns[N_UNKNOWNS:], bank.deviations)
        bank = replace(bank, deviations=chosen)
        solved = bank.solve(solved.trial.pick, np.append(unknowns[:N_UNKNOWNS], phi)[None])
    return bank, solved


def _gain(power: Array) -> float:
    """Times the variance that an estimate has if batches of such innovations count alike."""
    return float(power.mean() * (1.0 / power).mean())


@dataclass(frozen=True)
class _Finishing:
    """What a fit is completed with, wherever its search ended: arguments of `fit_whitened`.

    Attributes:
        wanted: (k,) batches that were to be fitted.
        of_all: whether these are all.
    """

    data: WhitenedMoments
    wanted: Mask
    choice: DeviationChoice | None
    doubt: float
    hover: float
    of_all: bool
    scatter: bool

    def finished(self, bank: BankProblem, solved: AxisFit) -> WhitenedFit:
        """The fit with its intervals, of the batches kept with their whiteners."""
        kept = self.wanted if bank.kept is None else bank.kept
        outcome = Outcome(solved.problem, solved.point)
        p = solved.problem.p
        # With the standard deviations that white innovations of the whole model would have.
        bound = outcome.fits(np.eye(p)[None], np.ones((1, p)), [solved.converged])[0]
        fit = bound
        if self.scatter:
            fit = self._with_scatter(bank, solved, outcome)
            if self.data.judges:
                r_squared = _explained(solved, self.data.total(kept), self.data.judges)
                fit = replace(fit, r_squared=r_squared)
        fit = replace(
            fit,
            whiteners=tuple(bank.data.whiteners[i] for i in solved.pick),
            of_steps=self.data.of_steps,
            disturbance=solved.trial.detected,
            deviating=bank.deviations,
        )
        # As they came, not as they are weighed.
        came = self.data if self.data.of_steps else bank.data
        without = self.wanted & ~kept
        return WhitenedFit(
            fit,
            came.of_axes(solved.pick)[without].sum(axis=0),
            int(came.counts[without].sum()),
            solved.cost,
            bound.std,
        )

    def _with_scatter(self, bank: BankProblem, solved: AxisFit, outcome: Outcome) -> RotationFit:
        """The fit with standard deviations from the scatter of its batches, and what that hides."""
        data, basis, problem, point = bank.data, bank.basis, solved.problem, solved.point
        noise, batches = NOISE_SHARE * bank.noise(solved.pick), data.of_axes(solved.pick)
        scores, inverse_root = bank.scores(outcome, batches), outcome.roots[1][0]
        spread, by_scatter = shrunk_inflation(inverse_root, scores)
        disturbed = solved.trial.detected.max() > RULES.detected
        if disturbed or bank.deviations.shown:
            # What disturbs is hardly stationary, and who deviates in one way may do so in others:
            # there all scatter counts, proved or not.
            spread, by_scatter = inflation(inverse_root, meat(scores)), np.ones(len(spread))
        spread = spread[None]
        counts = data.counts[:, None]
        shares = outcome.shares(0, batches) - counts * outcome.shares(0, noise[None])
        widening = student_factor(bank.joined(shares), by_scatter)[None]
        if data.is_whole:
            # Whiteness of innovations is based on all rows, not on the scatter of few batches.
            widening = np.ones_like(widening)
        if self.doubt:
            raw = Problem(problem.moments, bank.rows, basis, bank.prior, deviations=bank.deviations)
            pull = raw.evaluate(point.unknowns).gradient - point.gradient
            spread = spread + outcome.spread_of(self.doubt * pull)
        # First from scatter alone.
        fit = outcome.fits(spread, widening, [solved.converged])[0]
        fit, ways = replace(fit, deviating=bank.deviations), []
        for error in solved.trial.systematic(fit, self.hover):
            way = np.zeros(problem.p)
            way[: rb.N_THETA] = error / widening[0, : rb.N_THETA]
            ways.append(way)
        shaken = 1.0 if disturbed or not data.of_steps else 0.0
        ways += list(fit.imitated_turns(shaken)[:, problem.free] / widening[0])
        if disturbed and basis.motors and self.of_all:
            rows = data.counts if bank.kept is None else bank.kept * data.counts
            ways.append(curve_scatter(problem, fit, batches, rows, noise) / widening[0])
        if self.choice is not None and not basis.motors and Unknown.DELAY in problem.free:
            excess = float(np.trace(spread[0])) / problem.p
            way, delays = unlike_delays(problem, point, self.choice.older, excess)
            fit = replace(fit, ages=self.choice.of_rotors(delays))
            ways.append(way / widening[0])
        for way in ways:
            spread = spread + outcome.spread_of(way[None] @ point.hessian[0])
        if not ways:
            return fit
        return replace(outcome.fits(spread, widening, [solved.converged])[0], ages=fit.ages)


def curve_scatter(
    problem: Problem, fit: RotationFit, batches: Array, counts: NDArray[np.int64], noise: Array
) -> Array:
    """(p,) what all that is fitted errs by with the curve, beyond the fit's own interval.

    Curve, lag and T_max are found from what thrust does to second order. So do vertical speed under
    inflow and commands that the stream does not show, in some maneuvers more than in others: in one
    flight of an outside simulator the curve was right, 0.56, until yaw was flown, and 0.40 from
    then on, with an interval of 0.06. Batches of a second, which maneuvers have alike, do not show
    that; fits without one third of the flight each do (delete-a-group jackknife: Kott 2001, Journal
    of Official Statistics 17, 521-526).

    Args:
        problem: that was solved.
        fit: its solution.
        batches: (k, 1 or 3, width, width) moments, in time order, with its whiteners.
        counts: (k,) rows in each; 0: it is left out.
        noise: (1 or 3, width, width) to be taken out of each row.
    """
    nothing = np.zeros(problem.p)
    if Unknown.CURVE not in problem.free or len(counts) < _STRETCHES:
        return nothing
    own = fit.extended_covariance[np.ix_(problem.free, problem.free)]
    at = int(np.flatnonzero(problem.free == Unknown.CURVE)[0])
    if not own[at, at] > 0.0:
        return nothing
    ends = np.cumsum(counts)
    stretch = np.minimum((ends - 1) * _STRETCHES // ends[-1], _STRETCHES - 1)
    weights = np.stack([(counts > 0) & (stretch != i) for i in range(_STRETCHES)])
    rows = weights @ counts
    others = Problem(
        np.tensordot(weights.astype(float), batches, 1) - rows[:, None, None, None] * noise,
        rows,
        problem.basis,
        problem.prior,
        deviations=problem.deviations,
    )
    unknowns = np.concatenate([fit.unknowns, fit.deviations])
    point, _ = minimize(others, np.tile(unknowns, (_STRETCHES, 1)), _STEPS)
    curves = point.unknowns[:, Unknown.CURVE]
    variance = (_STRETCHES - 1) * float(curves.var()) - own[at, at]
    return along(own, at, float(np.sqrt(max(variance, 0.0))))


def unlike_delays(
    problem: Problem, point: Evaluation, older: Array, excess: float
) -> tuple[Array, Array]:
    """(p,) what all that is fitted errs by where some rotors' readings are older than others', and
    (k,) s by which they are, beyond chance.

    By how much is found in one step, as a delay of all is. What stands out of chance is an error.

    Args:
        problem: that was solved, of measured speeds.
        point: its solution.
        older: (k, 4, 4) see `DeviationChoice.older`.
        excess: variance over that of white innovations.
    """
    P = problem.maps(point.unknowns)[0]
    moments = problem.informed(problem.moments, problem.exact)
    T, W = residual_maker(point.Q[0]), np.diag(point.W[0])
    at = 1 + problem.basis.free.index(Unknown.DELAY - rb.N_THETA)
    late = T[:, :4] @ older @ P[at, :4]  # (k, 3, width)
    weighted = W[:, None] * times_moments(late[None], moments)[0]
    downhill = -(weighted * (T @ P[0])).sum(axis=(1, 2))
    columns = weighted @ P[0, : rb.N_SIGNALS].T / W[:, None]
    by_theta = -np.tensordot(point.WG[0], columns, ((1, 2), (1, 2)))
    by_coordinate = np.tensordot(T @ P[1:], weighted, ((1, 2), (1, 2)))
    cross = np.concatenate([by_theta, by_coordinate])  # (p, k)
    d = scales(point.hessian)[0]
    own = np.linalg.pinv(point.hessian[0] / np.outer(d, d), rcond=1e-12, hermitian=True)
    answer = own @ (cross / d[:, None]) / d[:, None]
    information = np.tensordot(late, weighted, ((1, 2), (1, 2))) - cross.T @ answer
    values, vectors = np.linalg.eigh(information)
    seen = values > 1e-6 * values[-1]  # not where rotors share an arm
    along_seen = vectors[:, seen].T @ downhill
    likelier = float((along_seen**2 / values[seen]).sum())
    chance = excess * float(chdtri(int(seen.sum()), FALSE_ALARM_RATE))
    delays = vectors[:, seen] @ (along_seen / values[seen])
    delays *= 1.0 - chance / likelier if likelier > chance else 0.0
    return -answer @ delays, delays


def _innovation_maker(solved: AxisFit) -> Array:
    """(3, width) what makes innovations of rows of elements."""
    at = solved.point.unknowns[0, COORDINATES]
    return innovation_maker(solved.point.Q[0], solved.problem.basis, at)


def _explained(solved: AxisFit, total: Array, judges: tuple[int, ...]) -> Array:
    """(3,) share of each axis' acceleration that a fit explains, rows whitened by others.

    Args:
        solved: the fit.
        total: (bank, width, width) moments.
        judges: whitener of each axis.
    """
    point = solved.point
    moments = solved.problem.basis.moments_at(total[list(judges)], point.unknowns[0, COORDINATES])
    left = axis_power(residual_maker(point.Q[0]), moments)
    return 1.0 - left / np.maximum(own_power(moments), 1e-300)
