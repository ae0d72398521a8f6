"""Fit of the rotational parameters to rows of the window, with several leaks as hypotheses.

Rows hold the rotors' signals in several forms, of which those at any delay, and with commands
at any motor lag and thrust curve, are linear maps (`estimation.rows.actuator_dynamics`); these
are unknowns of the fit too. What lags behind commands is a hypothesis beside them.

These rows have one damping for all three axes, and `axis_damping_doubt` is what one that differs by
axis does to the fit. Yaw alone determines the ratio of its damping to Izz, and roll and pitch their
damping. One damping for all of them ties Izz to Ixx and Iyy more closely than gyroscopic torque
does; but inflow and flapping damp roll and pitch, and hardly yaw; and with slow samples a torque
that seems late is taken for damping. Rows of one step have damping by axis among their unknowns
(`deviations`). In the window's, with phi its difference from the common one and D = dQ/dphi x,

    H = sum G' W G,  C = sum G' W D,  S = (H + L)^-1 C
    I = sum D' W D - C' S,   g = sum D' W r - S' (sum G' W r + L (mean - theta))
    P = (I / f + 1 / sigma^2)^-1,   phi = P g / f

with L the prior's information, and f the factor by which colored residuals widen the covariance of
theta. The fit leaves phi out, so it errs by -S phi, with the expected square S (P + phi phi') S'.
With commands sigma is the usual one; with speeds that of most evidence (`deviations`), and none
where evidence is against any.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit.deviations import (
    AXIS_DAMPING,
    OF_AXES,
    SIZES,
    DeviationChoice,
    evidence_for,
)
from gcs_sysid.estimation.fit.inference import Outcome
from gcs_sysid.estimation.fit.priors import N_UNKNOWNS, Prior
from gcs_sysid.estimation.fit.problem import N_X, JointProblem, residual_maker
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.search import MAX_ITERATIONS, first_guess, scan, search
from gcs_sysid.estimation.fit.solver import minimize, scales, vanish
from gcs_sysid.estimation.noise.uncertainty import inflation, meat, student_factor, symmetric_roots
from gcs_sysid.estimation.rows.actuator_dynamics import ActuatorDynamics, LagPlace
from gcs_sysid.model import rigid_body as rb

_ALIKE = 0.1
"""Of standard deviations, relative: in a minute of flight chance makes them differ by 0.07."""
_NEAR = 0.1
"""Squared standard deviations that a search may be from the minimum."""
_KNOWN_TO = 0.2
"""Of a moment of inertia: those known better show how much colored residuals widen intervals."""


def fit_rotation(
    batches: Array,
    counts: NDArray[np.int64],
    basis: ActuatorDynamics,
    noise: Array,
    start: RotationFit | None = None,
    prior: Prior | None = None,
    doubt: float = 0.0,
    hint: RotationFit | None = None,
    choice: DeviationChoice | None = None,
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
        choice: of deviations, of which those given are unknowns; None: all is exact.

    Returns:
        The fit, or None while the data cannot even start one (fewer rows than unknowns, or no
        response to roll and pitch torque).
    """
    rows = int(counts.sum())
    if rows < 3 * rb.N_THETA:
        return None
    bank = batches.sum(axis=0)
    of_speeds = None if basis.motors else noise
    problem = JointProblem(bank, rows, basis, prior)
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
        point, converged = minimize(problem, unknowns, 12)
    if choice is not None and choice.has_given:
        problem = JointProblem(bank, rows, basis, prior, deviations=choice.given)
        point, converged = minimize(problem, problem.extended(point.unknowns), MAX_ITERATIONS)
    deviations = problem.deviations
    stuck = np.zeros(len(bank), dtype=bool)
    if basis.motors:
        for _ in range(4):
            if converged.any():
                break
            # Curve and lag bend the valley: it takes many steps along.
            point, converged = minimize(problem, point.unknowns, MAX_ITERATIONS)
        # At the edge of the physical inertias, or of the range of the motors, is no minimum.
        stuck = Outcome(problem, point, of_speeds).left >= _NEAR
        converged &= ~stuck
    pull = None
    if basis.motors and noise.any():
        # Such noise is a good part of what slow commands show: unlike that of measured speeds, one
        # step does not take it out, and it pulls delay, lag and curve as well. Each step leaves of
        # the way that share by which noise adds to the moments: a third at most, but for curve and
        # lag.
        raw, problem = problem, JointProblem(bank, rows, basis, prior, noise, deviations)
        # The curvature with noise is the larger: steps with it are short.
        point = vanish(problem, point, raw.with_prior(point)[1])
        pull = raw.evaluate(point.unknowns).gradient - point.gradient
        batches = batches - counts[:, None, None, None] * noise
    outcome = Outcome(problem, point, of_speeds)
    if pull is not None:
        # Where the noise has shifted the minimum far, the way there may not be found.
        stuck = stuck | (outcome.left >= _NEAR)
        converged = converged & ~stuck
    inverse_roots = outcome.roots[1]
    scatter = []
    for i in range(len(bank)):
        own = batches[:, i : i + 1]
        spread_out = inflation(inverse_roots[i], meat(outcome.scores(i, own, counts)))
        scatter.append((spread_out, student_factor(outcome.shares(i, own))))
    spread, widening = (np.stack(parts) for parts in zip(*scatter, strict=True))
    if doubt:
        spread = spread + outcome.spread_of(doubt * (outcome.pull if pull is None else pull))
    fits = outcome.fits(spread, widening, converged, range(len(bank)), stuck)
    fits = [replace(fit, deviating=deviations) for fit in fits]
    if deviations.turns.any():
        for i, fit in enumerate(fits):
            # Where inertia scatters more than white noise would, so does what looks like a turn.
            colored = fit.data_std[: rb.CG_X] / outcome.white[i, : rb.CG_X]
            off = fit.imitated_turns(max(float(colored.max()), 1.0))
            fits[i] = fit.widened(off.T @ off)
    return most_certain([fit for fit, no in zip(fits, stuck, strict=True) if not no] or fits)


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


def fit_lag_places(
    batches: Array,
    counts: NDArray[np.int64],
    basis: ActuatorDynamics,
    noise: Array,
    places: Sequence[LagPlace],
    independent: float,
    start: RotationFit | None = None,
    prior: Prior | None = None,
    doubt: float = 0.0,
    hint: RotationFit | None = None,
    choice: DeviationChoice | None = None,
) -> RotationFit | None:
    """The fit with what lags behind the commands as a hypothesis; the others widen it.

    Estimates are those of the likeliest. By what those of the others differ from them, they may be
    off with these one's probability (Hoeting et al. (1999), Bayesian model averaging: a tutorial,
    Statistical Science 14, 382-417).

    Args:
        batches: as for `fit_rotation`, and so are all arguments not listed here.
        counts: rows in each batch.
        basis: of the elements; is left with the place that is taken.
        noise: of the inputs.
        places: hypotheses; the others start from the first one's fit.
        independent: how many rows there would be, did windows not overlap.
        start: an earlier fit.
        prior: what else is known.
        doubt: of the noise.
        hint: an earlier fit.
        choice: of deviations.
    """
    basis.lag_place = places[0]
    first = fit_rotation(batches, counts, basis, noise, start, prior, doubt, hint, choice)
    if first is None:
        return None
    leak = slice(first.leak, first.leak + 1)
    fits = [first]
    for basis.lag_place in places[1:]:
        fit = fit_rotation(
            batches[:, leak], counts, basis, noise[leak], first, prior, doubt, choice=choice
        )
        fits.append(first if fit is None else replace(fit, leak=first.leak))
    cost = np.array([np.linalg.slogdet(fit.residual_covariance)[1] for fit in fits])
    weight = np.exp(-0.5 * independent * (cost - cost.min()))
    best = int(np.argmin(cost))
    basis.lag_place = places[best]
    away = np.stack([fit.unknowns - fits[best].unknowns for fit in fits])
    doubted = (away * (weight / weight.sum())[:, None]).T @ away
    return replace(fits[best].widened(doubted), lag_place=places[best], lag_doubt=doubted)


def axis_damping_doubt(
    fit: RotationFit, rows: Array, prior: Prior | None = None, *, commands: bool
) -> Array:
    """(N_THETA, N_THETA) covariance of the error that one damping for three axes makes.

    Args:
        fit: of rows of the window.
        rows: (WIDTH, WIDTH) moments of rows [x, y] at its coordinates, without known noise.
        prior: of the fit.
        commands: whether they are the input: damping then always may differ, as in
            `DeviationChoice`; with speeds only as much as the flight shows.
    """
    theta = fit.theta
    W = np.linalg.inv(fit.residual_covariance)
    n = rb.N_THETA
    Q, G = fit.deviating.jacobian(theta, fit.deviations)
    D = np.linalg.inv(rb.inertia_matrix(theta)) @ OF_AXES
    inputs = rows[:N_X, :N_X]
    left = W @ (residual_maker(Q) @ rows)[:, :N_X]  # W r x'
    weighted = W @ G @ inputs
    H = np.einsum("kaz,laz->kl", weighted, G)
    H[range(n, len(H)), range(n, len(H))] += fit.deviating.information
    C = np.einsum("kaz,saz->ks", weighted, D)
    inverse = _inverse(H)
    pull = np.einsum("kax,ax->k", G, left)
    pull[n:] -= fit.deviating.information * fit.deviations
    S = inverse @ C
    if prior is not None:
        H[:n, :n] += prior.information[:n, :n]
        S = _inverse(H) @ C
        pull[:n] += prior.pull(fit.unknowns)[:n]
    own = np.einsum("saz,taz->st", W @ D @ inputs, D) - C.T @ S
    g = np.einsum("sax,ax->s", D, left) - S.T @ pull
    moments = np.abs(theta[rb.MOMENTS])
    white = np.sqrt(np.diag(inverse)[:n])
    known = np.zeros(rb.N_THETA, dtype=bool)
    known[rb.MOMENTS] = fit.data_std[rb.MOMENTS] < _KNOWN_TO * moments
    if not known.any():
        return np.zeros((rb.N_THETA, rb.N_THETA))
    f = max(float(((fit.data_std / white)[known] ** 2).max()), 1.0)
    # As usual, or as much as there is: an axis may be damped twice as much, or not at all.
    sigma = np.hypot(AXIS_DAMPING * moments, theta[rb.DAMPING])
    if not commands:
        sizes = [size * moments for size in SIZES["damping"]]
        evidence = [evidence_for(g / f, own / f, size) for size in sizes]
        if max(evidence) < 0.0:
            return np.zeros((rb.N_THETA, rb.N_THETA))
        sigma = sizes[int(np.argmax(evidence))]
    scaled = own / f * np.outer(sigma, sigma)
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    P = (vectors / (1.0 + np.maximum(values, 0.0))) @ vectors.T * np.outer(sigma, sigma)
    phi = P @ g / f
    S = S[:n]
    return S @ (P + np.outer(phi, phi)) @ S.T


def _inverse(information: Array) -> Array:
    d = scales(information)
    root = symmetric_roots(information / np.outer(d, d))[1]
    return root @ root / np.outer(d, d)
