"""Whiteners of a bank, tried on all axes at once; each axis takes that of least innovation power.

Where the search starts from nothing it looks at every node of the rotors' dynamics, so that delay
is found by the power of the innovations, within its bounds. As a free column it would be found
where torque predicts the motion best, which under feedback is the inverse of the controller.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation.fit.deviations import NO_DEVIATIONS, DeviationChoice, Deviations
from gcs_sysid.estimation.fit.disturbance import AXES, BankTrial
from gcs_sysid.estimation.fit.inference import Outcome
from gcs_sysid.estimation.fit.priors import COORDINATES, N_UNKNOWNS, Prior
from gcs_sysid.estimation.fit.problem import (
    LEAST_POWER,
    NOISE_SHARE,
    Evaluation,
    Problem,
    axis_power,
    own_power,
    residual_maker,
)
from gcs_sysid.estimation.fit.search import first_guess
from gcs_sysid.estimation.fit.solver import minimize, scales
from gcs_sysid.estimation.noise.uncertainty import meat
from gcs_sysid.estimation.noise.whitening import WhitenedMoments, joined
from gcs_sysid.estimation.rows.actuator_dynamics import PLAIN, WIDTH, ActuatorDynamics
from gcs_sysid.model import rigid_body as rb

_SCAN, TRY, _AGAIN, _FIT = 5, 8, 4, 60
"""Iterations: at a node; with a whitener, from there and from a fit; with those of the axes."""
_SCANNED = 64
"""Pairs of whitener and node that are looked at, about."""


@dataclass(frozen=True)
class AxisFit:
    """The fit with a whitener for each axis.

    Attributes:
        problem: that was solved.
        point: its solution.
        converged: whether that was reached.
        pick: whitener of each axis.
        trial: of all whiteners, there.
    """

    problem: Problem
    point: Evaluation
    converged: bool
    pick: tuple[int, ...]
    trial: BankTrial

    @property
    def cost(self) -> float:
        """Nats a row, summed over the axes."""
        power = self.trial.variance[list(self.pick), AXES]
        weak = self.point.weak[0] / self.problem.rows[0]
        return 0.5 * float(np.log(power).sum() + weak)


@dataclass(frozen=True)
class BankProblem:
    """Moments under every whitener of a bank, to be fitted.

    Attributes:
        data: the moments.
        basis: of the elements.
        prior: what else is known.
        kept: (k,) batches to fit; None: all.
        deviations: from the model, fitted too.
    """

    data: WhitenedMoments
    basis: ActuatorDynamics
    prior: Prior | None = None
    kept: Mask | None = None
    deviations: Deviations = NO_DEVIATIONS

    @cached_property
    def total(self) -> Array:
        """(bank, width, width) sum over the batches kept."""
        kept = np.ones(len(self.data.counts), dtype=bool) if self.kept is None else self.kept
        return self.data.total(kept)

    @cached_property
    def rows(self) -> int:
        """In them."""
        counts = self.data.counts
        return int(counts.sum() if self.kept is None else counts[self.kept].sum())

    @property
    def is_short(self) -> bool:
        """Whether there are too few rows for as many unknowns."""
        return self.rows < 3 * rb.N_THETA

    def under(self, i: int) -> "BankProblem":
        """The same with one of the whiteners alone."""
        return replace(self, data=self.data.under([i]))

    def axes(self, pick: tuple[int, ...], deviations: Deviations | None = None) -> Problem:
        """The problem with one whitener for each axis; with these deviations, or others."""
        moments, noise = self.total[self._places(pick)][None], self.noise(pick)[None]
        if deviations is None:
            deviations = self.deviations
        return Problem(moments, self.rows, self.basis, self.prior, noise, deviations)

    def noise(self, pick: tuple[int, ...]) -> Array:
        """(3, width, width) known in one row; (1, ...) where there is but one whitener."""
        return self.data.noise[self._places(pick)]

    def _places(self, pick: tuple[int, ...]) -> list[int]:
        return list(pick if len(self.data.whiteners) > 1 else pick[:1])

    def joined(self, values: Array) -> Array:
        """(g, ...) sums of (k, ...) values of the batches, of those kept that count as one."""
        kept = slice(None) if self.kept is None else self.kept
        return joined(values[kept], self.data.counts[kept], self.data.grouped)

    def scores(self, outcome: Outcome, batches: Array) -> Array:
        """(g, p) how the score of (k, 3, width, width) batches scatters."""
        counts, scores = self.joined(self.data.counts), self.joined(outcome.scores(0, batches))
        # Away from the likelihood's own minimum all rows pull one way, and the noise that is known
        # does; that is no scatter.
        return scores - np.outer(counts / counts.sum(), scores.sum(axis=0))

    def solve(self, pick: tuple[int, ...], starts: Array) -> AxisFit:
        """Fit with a whitener for each axis, or with others, should these be better there.

        Args:
            pick: whitener of each axis.
            starts: (n, N_UNKNOWNS or more), of which the likeliest is taken.
        """
        for again in (True, False):
            problem = self.axes(pick)
            unknowns = problem.extended(starts)
            if len(unknowns) > 1:
                costs = [float(problem.evaluate(u[None]).cost[0]) for u in unknowns]
                unknowns = unknowns[[int(np.argmin(costs))]]
            point, converged = minimize(problem, unknowns, _FIT)
            trial = self.tried(point.unknowns[0])
            fit = AxisFit(problem, point, bool(converged[0]), pick, trial)
            if not again or trial.pick == pick:
                break
            pick, starts = trial.pick, point.unknowns
        return fit

    def solve_from(self, trial: BankTrial) -> AxisFit:
        """Fit with the whiteners of a trial.

        From what the first axis or the others found, whichever is nearer to all of it.
        """
        return self.solve(trial.pick, np.unique(trial.unknowns[list(trial.pick)], axis=0))

    def fitted(self) -> AxisFit | None:
        """The fit under every whitener, from the data alone; None: nothing to start from."""
        trial = self.scanned()
        return None if trial is None else self.solve_from(trial)

    def tried(self, unknowns: Array, limit: int = _AGAIN) -> BankTrial:
        """Every whitener on all axes, coordinates as in (N_UNKNOWNS,) or (bank, N_UNKNOWNS)."""
        fitted = unknowns if unknowns.ndim == 1 else None
        unknowns = np.broadcast_to(unknowns, (len(self.total), unknowns.shape[-1]))
        at = unknowns[0, COORDINATES]
        moments, noise = (
            self.basis.moments_at(m, at)[:, None] for m in (self.total, self.data.noise)
        )
        problem = Problem(moments, self.rows, PLAIN, self.prior, noise, self.deviations)
        point, converged = minimize(problem, problem.extended(unknowns), limit)
        known = np.median(point.unknowns, axis=0) if fitted is None else problem.extended(fitted)
        T = self._residual_maker(known)
        answered = axis_power(T, problem.exact)
        if fitted is not None:
            # Where a whitener leaves hardly more than noise an estimate may run away, downhill.
            least = np.where(converged[:, None], -np.inf, answered)
            point = replace(point, power=np.maximum(point.power, least))
        alike = self._alike(point, noise, T)
        # An axis' noise is its own.
        for axis, own in enumerate(self.data.likeliest):
            alike[[i for i in self.data.likeliest if i != own], axis] = np.inf
        found = point.unknowns.copy()
        answered = np.maximum(answered / self.rows, LEAST_POWER * point.variance)
        if self.basis.motors:
            found[:, COORDINATES] = at  # plain rows have none
            answered = alike  # what is known to be missing of commands, a loop made
        return BankTrial(self.data.whiteners, self.data.time, found, alike, answered)

    def scanned(self) -> BankTrial | None:
        """From the data alone: every node with every whitener, then all of these at the best one.

        None while the data cannot even start a fit.
        """
        basis, nodes, rows = self.basis, self.basis.nodes, self.rows
        if self.is_short:
            return None
        every = max(len(self.total) * len(nodes) // _SCANNED, 1)
        some, some_noise = self.total[::every], self.data.noise[::every]
        middle = nodes[basis.middle]
        at_middle = basis.moments_at(some - NOISE_SHARE * rows * some_noise, middle)
        guesses = [first_guess(moments, rows, middle, self.prior) for moments in at_middle]
        found = [guess for guess in guesses if guess is not None]
        if not found:
            return None
        guess = np.stack([found[len(found) // 2] if g is None else g for g in guesses])
        P = basis.maps(nodes)[:, 0]
        turned = np.swapaxes(P, 1, 2)
        moments, noise = (
            (P @ m[:, None] @ turned).reshape(-1, 1, WIDTH, WIDTH) for m in (some, some_noise)
        )
        starts = np.repeat(guess, len(nodes), axis=0)
        starts[:, COORDINATES] = np.tile(nodes, (len(some), 1))
        problem = Problem(moments, rows, PLAIN, self.prior, noise)
        point, _ = minimize(problem, starts, _SCAN)
        axes = self.axes((0, 0, 0))
        known = axes.extended(np.median(point.unknowns, axis=0))
        alike = self._alike(point, noise, self._residual_maker(known))
        power = np.log(alike).reshape(len(some), len(nodes), len(AXES))
        weak = axes.weak_cost(starts)
        cost = power.min(axis=0).sum(axis=1) + weak[: len(nodes)] / rows
        best = int(np.argmin(cost))
        starts = point.unknowns.reshape(len(some), len(nodes), -1)[:, best].copy()
        if basis.motors:
            starts[:, COORDINATES] = nodes[best]  # plain rows have none
        return self.tried(np.repeat(starts, every, axis=0)[: len(self.total)], TRY)

    def _residual_maker(self, known: Array) -> Array:
        """(3, WIDTH) of a vehicle of (N_UNKNOWNS + m,) unknowns."""
        return residual_maker(self.deviations.forward(known, known[N_UNKNOWNS:]))

    def _alike(self, point: Evaluation, noise: Array, T: Array) -> Array:
        """(K, 3) power of innovations as it would be if all had the same share of known noise.

        Input noise biases the minimum of the power towards a vehicle with less response. An
        estimate that errs that way by chance would look better than the truth. The power compared
        is therefore that without the known noise, which is stationary at the truth, plus that noise
        with one and the same response.

        Args:
            point: K solutions.
            noise: (K, 1, WIDTH, WIDTH) in one row.
            T: (3, WIDTH) what makes that vehicle's residuals.
        """
        of_noise = axis_power(T, noise)
        return np.maximum(point.power / self.rows + of_noise, LEAST_POWER * point.variance)

    def choose_deviations(
        self,
        fit: AxisFit,
        choice: DeviationChoice,
        batches: Array | None,
    ) -> Deviations:
        """The deviations for which there is evidence, from one look at all of them.

        A likelihood of colored innovations counts their rows for more than they are. So it is
        divided by the scatter of the scores, of the model with all deviations (Burnham and Anderson
        2002, Model Selection and Multimodel Inference, section 2.5); by its median over the
        unknowns, as a few of them scatter by chance. By commands, where errors of the motors
        scatter too and vehicles usually deviate, all that helps is taken.

        Args:
            fit: without them, or with some.
            choice: of them.
            batches: (k, 3, width, width) with its whiteners; None: with commands.
        """
        point = fit.point
        every = choice.every(point.unknowns[0])
        n, m = rb.N_THETA, len(every.std)
        free = self.axes(fit.pick, replace(every, std=np.full(m, np.inf)))
        unknowns = free.extended(point.unknowns[:, :N_UNKNOWNS])
        phi = every.doing(point.unknowns[0, N_UNKNOWNS:], self.deviations)
        unknowns[:, N_UNKNOWNS:] = phi
        gradient, hessian = (part[0] for part in free.with_prior(free.evaluate(unknowns)))
        of = np.arange(n, n + m)
        others = np.setdiff1d(np.arange(free.p), of)
        d = scales(hessian[None])[0][others]
        cross = hessian[np.ix_(others, of)] / d[:, None]
        inverse = np.linalg.pinv(
            hessian[np.ix_(others, others)] / np.outer(d, d), rcond=1e-12, hermitian=True
        )
        information = hessian[np.ix_(of, of)] - cross.T @ inverse @ cross
        score = gradient[of] - cross.T @ inverse @ (gradient[others] / d)
        scatter = 1.0
        if batches is not None:
            largest = replace(every, std=choice.largest(point.unknowns[0]))
            bounded = self.axes(fit.pick, largest)
            outcome = Outcome(bounded, minimize(bounded, unknowns, _AGAIN)[0])
            root = outcome.roots[1][0]
            spread = root @ meat(self.scores(outcome, batches)) @ root
            scatter = max(float(np.median(np.diag(spread))), 1.0)
        score += information @ phi
        return choice.choose(every, point.unknowns[0], score / scatter, information / scatter)


def with_possible_noise(
    data: WhitenedMoments, basis: ActuatorDynamics, prior: Prior | None
) -> WhitenedMoments:
    """The same with no more known noise than what is left without any.

    Noise that aliases into slow commands is inferred from how they move, as a loop's would be;
    where what moves them is the pilot, that is many times all that a fit leaves.
    """
    bank = BankProblem(replace(data, noise=np.zeros_like(data.noise)), basis, prior)
    trial = bank.scanned()
    if trial is None:
        return data
    unknowns = trial.unknowns
    noise = basis.moments_at(data.noise, unknowns[0, COORDINATES])[:, None]
    added = axis_power(residual_maker(NO_DEVIATIONS.forward(unknowns, unknowns[:, :0])), noise)
    share = np.min(np.divide(trial.variance, added, out=np.ones_like(added), where=added > 0.0))
    return replace(data, noise=min(float(share), 1.0) * data.noise)


def explained_by(data: WhitenedMoments, basis: ActuatorDynamics) -> Array | None:
    """(3,) shares of the whitened acceleration that a fit explains; None: there is none."""
    problem = BankProblem(data, basis)
    # Beside the edge of what is physical a quick search may lead nowhere yet.
    fit = problem.fitted()
    if fit is None:
        return None
    trial = fit.trial
    places = list(trial.pick)
    power = own_power(problem.total[places]) / problem.rows
    return 1.0 - trial.variance[places, AXES] / np.maximum(power, 1e-300)
