"""The prediction-error estimate of a whole flight, from the samples kept.

Rows of one step are filtered by the whitener of each axis' likeliest noise (`likeliest_noise`), all
columns alike, and theta is what leaves the innovations of least power (Ljung, System
Identification, ch. 7): maximum likelihood, and unbiased under feedback. What is fitted, weighed,
left out and uncertain is as of the online estimator's whitened rows (`fit.whitened_fit`). Noise
follows from what a fit leaves, and the fit from the noise, until both stay.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation.checks.validation import Validation, predict_held_out
from gcs_sysid.estimation.fit.deviations import DeviationChoice
from gcs_sysid.estimation.fit.priors import Prior
from gcs_sysid.estimation.fit.problem import axis_power, residual_maker
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.whitened_fit import SHOCK, WhitenedFit, fit_whitened
from gcs_sysid.estimation.noise.whitening import WhitenedMoments, Whitener, bank_for
from gcs_sysid.estimation.offline.kept_rows import CommandRows, SpeedRows
from gcs_sysid.estimation.offline.likeliest_noise import Likeliest, innovations, likeliest
from gcs_sysid.estimation.online.fit import FitMoments
from gcs_sysid.estimation.record.command_record import RIVAL, STAYED, TRUSTED
from gcs_sysid.estimation.rows.motor_linearization import LocalDynamics
from gcs_sysid.model import rigid_body as rb

_BATCH, _MOST_BATCHES = 0.25, 256
"""s, in which shocks are found; and how many of them are kept apart."""
_LOOKS = 8
"""Most times that noise and motors are looked for again."""
_SETTLED = 0.1
"""Standard deviations that another look moves theta by at most."""
_THRUST = rb.SIGNALS.index("thrust")
_COMPARED = frozenset(
    ("leak 0.3 s", "leak 1 s", "moment to 4 Hz", "moment to 11 Hz", "moment to 23 Hz")
)
"""Of the bank, what the likeliest are compared with."""


@dataclass(frozen=True)
class Whitened:
    """A flight's rows under whiteners.

    Attributes:
        data: moments.
        basis: of the rows.
        runs: (n, width) the rows themselves, of every run without a gap.
        time: s of a row.
    """

    data: WhitenedMoments
    basis: LocalDynamics
    runs: Sequence[Array]
    time: float

    @cached_property
    def total(self) -> Array:
        """(bank, width, width) of all rows, shocks included."""
        (moments,) = self.data.parts
        every: Array = moments.sum(axis=0)
        return every

    def power(self, fit: RotationFit, moments: Array) -> Array:
        """(3,) that each axis of a fit leaves of (3, width, width) moments."""
        TP = residual_maker(fit.Q) @ self.basis.map_at(fit.coordinates)
        return axis_power(TP, moments)

    def believed(self, fit: RotationFit) -> "Whitened":
        """The same without the known noise of the inputs where there is less than it alone leaves.

        Speeds from a simulator are not rounded. Taken out all the same, noise of that size made
        moments of inertia up to 12 standard deviations too small.
        """
        own = list(self.data.likeliest)
        left = self.power(fit, self.total[own]) / self.data.counts.sum()
        if (self.power(fit, self.data.noise[own]) <= left).all():
            return self
        return replace(self, data=replace(self.data, noise=np.zeros_like(self.data.noise)))

    @property
    def thrust(self) -> float:
        """rad^2/s^2, rms of the thrust signal."""
        power = sum(float((run[:, _THRUST] ** 2).sum()) for run in self.runs)
        return math.sqrt(power / sum(len(run) for run in self.runs))


@dataclass(frozen=True)
class PredictionErrorFit:
    """What the estimator found.

    Attributes:
        fit: the estimate.
        whitened: what it was fitted to.
    """

    fit: WhitenedFit
    whitened: Whitened

    def validate(self, prior: Prior | None, choice: DeviationChoice) -> Validation | None:
        """How well fits to four fifths of the flight predict the last, see `RotationEstimator`."""
        made = self.whitened
        return predict_held_out(made.data, made.basis, choice, prior, self.fit.rotation)

    @property
    def cost(self) -> float:
        """Nats of all rows, shocks included: what is left out differs from one to another."""
        data, fit = self.whitened.data, self.fit.rotation
        places = data.places(fit.whiteners)
        rows = int(data.counts.sum())
        power = self.whitened.power(fit, self.whitened.total[places]) / rows
        return 0.5 * rows * float(np.log(power).sum())

    def moments(self, online: FitMoments | None) -> FitMoments | None:
        """What the fit rests on, at its coordinates; with the window of the online estimate."""
        if online is None:
            return None
        data, fit = self.whitened.data, self.fit.rotation
        places = data.places(fit.whiteners)
        total = self.whitened.total[places] - self.fit.left_out
        rows = data.counts.sum() - self.fit.rows_left_out
        without = self.whitened.basis.moments_at(total - rows * data.noise[places], fit.coordinates)
        return online._replace(rows=without)


def estimate(
    rows: SpeedRows | CommandRows,
    start: RotationFit,
    doubt: float = 0.0,
    prior: Prior | None = None,
    choice: DeviationChoice | None = None,
    *,
    calm: bool = True,
    rival: float = math.inf,
    progress: Callable[[float], None] | None = None,
) -> PredictionErrorFit | None:
    """Fit a flight.

    Args:
        rows: of it.
        start: the online estimate.
        doubt: one standard deviation of the inputs' known noise, relative.
        prior: what else is known.
        choice: of deviations from the model.
        calm: whether it is known that no steady wind blows.
        rival: nats of rows by which something else lags; from what is far less likely than that
            the estimate is the first whose motors stayed.
        progress: called with the share that is done.

    Returns:
        The estimate; None where the flight is too short for one, or the search does not end.
    """
    judges = start.whiteners if start.of_steps else (bank_for(rows.time)[1],) * 3
    rotation, found, basis = start, None, rows.basis(start.coordinates)
    runs, noise = rows.made(basis), None
    if not runs:
        return None

    def fitted(made: Whitened) -> WhitenedFit | None:
        before = rotation if rotation.warm_start else None
        thrust = 0.0 if calm else made.thrust
        return fit_whitened(made.data, basis, before, prior, doubt, choice, thrust)

    for look in range(_LOOKS):
        if progress is not None:
            progress(look / _LOOKS)
        off = np.abs(rotation.coordinates - basis.at)
        stayed = bool((off <= STAYED * basis.moved).all())
        if look and not stayed:
            far = TRUSTED * basis.moved
            basis = rows.basis(np.clip(rotation.coordinates, basis.at - far, basis.at + far))
            runs, noise = rows.made(basis), None
            if not runs:
                return None
        noise = _likeliest(runs, basis, rotation, rows.time, judges, noise)
        made = _whitened(rows, runs, basis, noise).believed(rotation)
        fit = fitted(made)
        if fit is None:
            break
        moved = np.abs(fit.rotation.theta - rotation.theta)
        # One that does not converge on these rows may on those about where it went.
        rotation = fit.rotation
        is_near = (np.abs(rotation.coordinates - basis.at) <= TRUSTED * basis.moved).all()
        found = PredictionErrorFit(fit, made) if rotation.converged and is_near else None
        if look and stayed and found:
            if found.cost > rival + RIVAL:
                return found
            if (moved <= _SETTLED * rotation.std).all():
                break
    if progress is not None:
        progress(1.0)
    if found is None:
        return None
    made = _compared(found.whitened, rows, judges)
    fit = fitted(made)
    return found if fit is None else PredictionErrorFit(fit, made)


def _likeliest(
    runs: Sequence[Array],
    basis: LocalDynamics,
    fit: RotationFit,
    T: float,
    judges: Sequence[Whitener],
    before: Sequence[Likeliest] | None,
) -> list[Likeliest]:
    """Of each axis, as it shows in what a fit leaves."""
    residuals = residuals_of(runs, basis, fit)
    sound = sound_rows(residuals, T, fit.whiteners or judges)
    return [
        likeliest([T * r[:, i] for r in residuals], sound, T, before[i].numbers if before else ())
        for i in range(3)
    ]


def residuals_of(runs: Sequence[Array], basis: LocalDynamics, fit: RotationFit) -> list[Array]:
    """(n, 3) rad/s^2 that a fit leaves of every run."""
    TP = residual_maker(fit.Q) @ basis.map_at(fit.coordinates)
    return [run @ TP.T for run in runs]


def sound_rows(residuals: Sequence[Array], T: float, whiteners: Sequence[Whitener]) -> list[Mask]:
    """Of each run (n,) which rows belong to no shock."""
    size = max(round(_BATCH / T), 1)
    powers = []
    for run in residuals:
        white = np.stack([innovations(run[:, i], whiteners[i]) for i in range(3)], axis=1)
        starts = np.arange(0, len(run), size)
        counts = np.diff([*starts, len(run)])[:, None]
        powers.append(np.add.reduceat(white * white, starts, axis=0) / counts)
    usual = np.median(np.concatenate(powers), axis=0)
    return [
        np.repeat((power / usual).mean(axis=1) <= SHOCK, size)[: len(run)]
        for power, run in zip(powers, residuals, strict=True)
    ]


def _whitened(
    rows: SpeedRows | CommandRows,
    runs: Sequence[Array],
    basis: LocalDynamics,
    noise: Sequence[Likeliest],
) -> Whitened:
    """Moments of all rows under the likeliest whiteners, those without a disturbance first."""
    calm = [
        replace(each.calm, name=f"calm {name}") for each, name in zip(noise, "xyz", strict=True)
    ]
    own = [
        replace(each.best, name=f"likeliest {name}") if each.best.disturbed else each_calm
        for each, each_calm, name in zip(noise, calm, "xyz", strict=True)
    ]
    whiteners = (*calm, *(whitener for whitener in own if whitener.disturbed))
    total = sum(len(run) for run in runs)
    size = max(round(_BATCH / rows.time), -(-total // _MOST_BATCHES), 1)
    counts = np.concatenate([np.diff([*range(0, len(run), size), len(run)]) for run in runs])
    data = WhitenedMoments(
        (_moments(runs, whiteners, size),),
        counts,
        rows.noise(basis, whiteners),
        whiteners,
        rows.time,
        size,
        likeliest=tuple(whiteners.index(whitener) for whitener in own),
    )
    return Whitened(data, basis, runs, rows.time)


def _compared(
    made: Whitened, rows: SpeedRows | CommandRows, judges: Sequence[Whitener]
) -> Whitened:
    """The same beside whiteners of the bank, and those that judged the online estimate."""
    data, T = made.data, made.time
    known = [whitener for whitener in bank_for(T) if whitener.name in _COMPARED]
    others = tuple({whitener.name: whitener for whitener in (*known, *judges)}.values())
    (part,), names = data.parts, [whitener.name for whitener in others]
    # None where it has been found that there is none.
    noise = rows.noise(made.basis, others) * data.noise.any()
    first = len(data.whiteners)
    every = replace(
        data,
        parts=(np.concatenate([part, _moments(made.runs, others, data.grouped)], axis=1),),
        noise=np.concatenate([data.noise, noise]),
        whiteners=(*data.whiteners, *others),
        judges=tuple(first + names.index(whitener.name) for whitener in judges),
    )
    return replace(made, data=every)


def _moments(runs: Sequence[Array], whiteners: Sequence[Whitener], size: int) -> Array:
    """(k, bank, width, width) of every so many rows, whitened."""
    width = runs[0].shape[1]
    out = np.empty((sum(-(-len(run) // size) for run in runs), len(whiteners), width, width))
    for place, whitener in enumerate(whiteners):
        first = 0
        for run in runs:
            white = innovations(run, whitener)
            whole = len(white) // size
            blocks = white[: whole * size].reshape(whole, size, width)
            out[first : first + whole, place] = np.swapaxes(blocks, 1, 2) @ blocks
            first += whole
            rest = white[whole * size :]
            if len(rest):
                out[first, place] = rest.T @ rest
                first += 1
    return out
