"""The online estimator: samples in, relative estimates out, in bounded memory and time."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation import article, rotation, translation
from gcs_sysid.estimation.basis import CURVE, RotorBasis
from gcs_sysid.estimation.coupling import PRODUCTS, Coupling, gyroscopic_coupling
from gcs_sysid.estimation.moments import Moments
from gcs_sysid.estimation.priors import Prior
from gcs_sysid.estimation.regression import LeakySums, RowMaker, Samples
from gcs_sysid.estimation.rotors import RotorInput, RotorPath
from gcs_sysid.estimation.speed_noise import SpeedNoise
from gcs_sysid.estimation.translation import TranslationFit
from gcs_sysid.estimation.validation import Validation, validate
from gcs_sysid.filters.smoothers import DifferentiatorSmoother, Smoother, WindowSmoother

_SETTLE_GROWTH = 1.5
_MIN_BATCHES = 10
"""From which their scatter tells how sure a number is."""
_PIECE_TIME = 0.1
"""s of samples that are taken at once."""
MIN_MOMENTUM_SECONDS = 5.0
"""Flight time from which momentum balance beats the accelerometer's bias."""


@dataclass(frozen=True)
class Tuning:
    """Settings of the online estimator.

    Attributes:
        method: "forward", or one of the article's variants, for study (`estimation.article`).
        smoother: "window" (symmetric, the default) or "td" (linear tracking differentiator).
        half_width: s, half of the window, at high sample rates.
        min_half_samples: the window's half never has fewer samples than this.
        bandwidth: rad/s, R of the differentiator.
        leaks: s, memories of the leaky sums carried side by side; 0 for none.
        delays: s, nodes of rotor delay; one alone is taken as given.
        rotor_input: what the samples hold of the rotors.
        lags: s, nodes of motor lag, for commands; the first is none.
        curves: least and greatest thrust curve, for commands; one value is taken as given.
        gyro_cutoff: Hz, low-pass of the autopilot on its gyro; None: there is none.
        settle_interval: s, least time between full fits of a running course, which choose
            leak and delay; later they come when the record has grown by half.
        batch_time: s, length of a batch of moments.
    """

    method: Literal["forward"] | article.Method = "forward"
    smoother: Literal["window", "td"] = "window"
    half_width: float = 0.1
    min_half_samples: int = 4
    bandwidth: float = 10.0
    leaks: tuple[float, ...] = (0.0, 0.3, 1.0)
    delays: tuple[float, ...] = tuple(0.01 * k - 0.015 for k in range(8))
    rotor_input: RotorInput = "speed"
    lags: tuple[float, ...] = (0.0,)
    curves: tuple[float, ...] = (1.0,)
    gyro_cutoff: float | None = None
    settle_interval: float = 2.0
    batch_time: float = 1.0


COMMANDS = Tuning(
    # Commands answer to the gyro's noise: a longer window lets less of that back in.
    half_width=0.2,
    rotor_input="command",
    leaks=(0.0, 0.3),
    delays=(-0.015, -0.00375, 0.0075, 0.01875, 0.03),
    lags=(0.0, 0.015, 0.035, 0.06, 0.09, 0.13),
    curves=(-0.2, 1.2),
)
"""Tuning for commands as the rotors' input."""
_BATCHES, _FEWER_BATCHES = 512, 256
"""Rows of commands are wide, and their batches large: fewer are kept apart."""


@dataclass(frozen=True)
class Fit:
    """What the estimator knows at one instant, relative to k_T."""

    rotation: rotation.RotationFit | None
    translation: TranslationFit | None
    seconds: float
    """Flight time that it rests on."""
    validation: Validation | None = None
    """Only of full fits."""
    accelerometer: TranslationFit | None = None
    """The second source of k_T / m, whichever `translation` is; of full fits, for certain."""
    coupling: Coupling | None = None
    """Whether it moves like a rigid body; None while that cannot be told."""


@dataclass(frozen=True)
class _Followed:
    """Where a course of quick fits is: its latest, and flight time of its next full one."""

    fit: rotation.RotationFit
    settle: float


@dataclass(frozen=True)
class _FollowedThrust:
    """The same of thrust and drag: the latest full fit, and how many batches it rests on."""

    fit: TranslationFit
    batches: int


class OnlineEstimator:
    """Recursive estimator on samples of one uniform step.

    Args:
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
        tuning: settings.
    """

    def __init__(self, geometry: Array, dt: float, tuning: Tuning) -> None:
        self.dt = dt
        self.prior: Prior | None = None
        """What else is known about the rotation; may be set at any time."""
        self.accelerometer_gain: translation.Gain | None = None
        """How the accelerometer reads against gravity, from an earlier segment."""
        smoother: Smoother
        half_width = tuning.half_width
        if tuning.smoother == "td":
            smoother = DifferentiatorSmoother(dt, tuning.bandwidth)
        else:
            half = max(tuning.min_half_samples, round(tuning.half_width / dt))
            half_width = half * dt
            smoother = WindowSmoother(dt, half, tuning.delays)
        self._smoother = smoother
        self._speed_noise = SpeedNoise(geometry, dt, commands=tuning.rotor_input == "command")
        self._memories = tuning.leaks
        # Samples are taken in pieces of one size, however they come: whole rows, at little cost.
        piece = smoother.step * max(round(_PIECE_TIME / (smoother.step * dt)), 1)
        self._held = _Held(piece, geometry.shape[1])
        commands = tuning.rotor_input == "command"
        self._basis = basis = RotorBasis(
            smoother.delays,
            tuning.lags,
            tuning.curves,
            commands=commands,
            half_width=half_width,
        )
        path = RotorPath(geometry, dt, basis, tuning.gyro_cutoff)
        self._rows = RowMaker(path, basis, smoother)
        self._row_time = smoother.step * dt
        per_batch = max(round(tuning.batch_time / self._row_time), 1)
        self._leaks = LeakySums(self._row_time, tuning.leaks)
        kept = _FEWER_BATCHES if commands else _BATCHES
        bank = (len(tuning.leaks), basis.width, basis.width)
        self._rotation = Moments(bank, per_batch, kept)
        self._settle_interval = tuning.settle_interval
        self._followed: dict[str, _Followed] = {}
        self._thrust: dict[str, _FollowedThrust] = {}
        self._coupling: Coupling | None = None
        self._coupling_at = 0.0
        self._article = (
            None
            if tuning.method == "forward"
            else article.ArticleEstimator(geometry, dt, tuning.method)
        )
        width = len(basis.lags) * basis.sets + 3
        self._momentum = Moments((3, width, width), per_batch, kept)
        self._accelerometer = Moments((width, width), per_batch, kept)

    def restart(self) -> None:
        """A gap: what comes next does not join on to what came before."""
        self._flush()
        self._rows.restart()
        self._speed_noise.restart()
        self._leaks.restart()
        if self._article:
            self._article.restart()

    def update(self, samples: Samples) -> None:
        """Take a block of samples; the outcome does not depend on how they are grouped."""
        for piece in self._held.add(samples):
            self._take(piece)

    def _flush(self) -> None:
        """Take what is held back for want of a whole piece."""
        rest = self._held.rest()
        if rest is not None:
            self._take(rest)

    def _take(self, samples: Samples) -> None:
        rows = self._rows.update(samples)
        self._speed_noise.update(samples.speeds)
        if self._article:
            self._article.update(samples)
        if rows.rotation.shape[1] == 0:
            return
        self._rotation.add(self._leaks.update(rows.rotation)[:, 0])
        self._momentum.add(_complete(rows.momentum))
        self._accelerometer.add(_complete(rows.accelerometer))

    @property
    def seconds(self) -> float:
        """Flight time that the rotational estimate rests on."""
        return self._rotation.rows * self._row_time

    def fit(self, *, quick: bool = False, course: str = "") -> Fit:
        """The estimate from everything so far.

        Args:
            quick: go on from the last quick estimate, for the course of a running flight; of
                the latest samples, up to 0.1 s may be left out. Otherwise the outcome is a
                function of the data alone.
            course: name of the course of quick estimates to go on with. One that decides
                something must not depend on how often others look.
        """
        if not quick:
            self._flush()
        name = course if quick else None
        rot = self._fit_rotation(name)
        at = None if rot is None else rot.coordinates
        trans, accelerometer = self.fit_translation(name, at)
        if trans is not None and at is not None and CURVE in self._basis.free:
            trans = replace(trans, curve_slope=self._curve_slope(trans, at))
        validation = None
        if not quick and self._article is None:
            validation = validate(
                self._rotation.batches,
                self._rotation.counts,
                self._basis,
                self._noise(),
                np.array([self._smoother.noise_gains(m)[1] for m in self._memories]),
                self.prior,
            )
        coupling = self._coupling_of(rot, quick=quick)
        if coupling is not None and coupling.contradicted and not quick:
            # What rotors turn against remains to be told: inertia in roll and pitch.
            rot = rotation.fit_rotation(
                self._without_products(),
                self._rotation.counts,
                self._basis,
                self._noise(),
                prior=self.prior,
            )
        return Fit(rot, trans, self.seconds, validation, accelerometer, coupling)

    def _coupling_of(self, fit: rotation.RotationFit | None, *, quick: bool) -> Coupling | None:
        """Whether the body is rigid; between settled fits what the latest said."""
        if fit is None or self._article is not None or len(self._rotation.batches) < _MIN_BATCHES:
            return None
        if quick and self.seconds < self._coupling_at:
            return self._coupling
        self._coupling_at = _SETTLE_GROWTH * self.seconds
        batches = self._rotation.batches[:, fit.leak]
        at_fit = self._basis.moments_at(batches, fit.coordinates)
        self._coupling = gyroscopic_coupling(at_fit, fit.theta)
        return self._coupling

    def _without_products(self) -> Array:
        """The moments as if products of rates were zero: of a body without gyroscopic torque."""
        moments: Array = self._rotation.batches.copy()
        places = self._basis.body_places(PRODUCTS)
        moments[..., places, :] = 0.0
        moments[..., :, places] = 0.0
        return moments

    def fit_translation(
        self, course: str | None = None, at: Array | None = None
    ) -> tuple[TranslationFit | None, TranslationFit | None]:
        """Thrust and drag over mass from the better source, and from the accelerometer.

        Args:
            course: to go on with, of the better source alone; None: both, from the data alone.
            at: (3,) coordinates of the basis; None: its middle.
        """
        where = self._basis.nodes[self._basis.middle] if at is None else at
        weights = self._basis.thrust_weights(where)
        momentum = None
        if self._momentum.rows * self._row_time > MIN_MOMENTUM_SECONDS:
            momentum = self._fit_momentum(course, weights)
            if course is not None:
                return momentum, None
        accelerometer = translation.fit_accelerometer(
            _mixed(weights, self._accelerometer.batches),
            self._accelerometer.counts,
            self.accelerometer_gain,
        )
        return momentum or accelerometer, accelerometer

    def _curve_slope(self, fit: TranslationFit, at: Array) -> float:
        """Change of kappa with the thrust curve: it is gravity over the mean share of thrust."""
        moments = self._momentum if fit.source == "momentum" else self._accelerometer
        step = 0.05 * np.eye(3)[CURVE]
        less, more = (
            float(mixed[..., 2, 0].ravel()[-1])  # of the vertical axis
            for c in (at - step, at + step)
            for mixed in (_mixed(self._basis.thrust_weights(c), moments.total),)
        )
        change: float = -fit.kappa * (more - less) / (0.5 * (more + less)) / (2.0 * step[CURVE])
        return change

    def _fit_momentum(self, course: str | None, weights: Array) -> TranslationFit | None:
        moments = self._momentum
        total = _mixed(weights, moments.total)
        known = None if course is None else self._thrust.get(course)
        if known is not None and known.batches == len(moments.batches):
            return translation.follow_momentum(total, moments.rows, known.fit)
        fit = translation.fit_momentum(_mixed(weights, moments.batches), moments.counts, total)
        if course is not None and fit is not None:
            self._thrust[course] = _FollowedThrust(fit, len(moments.batches))
        return fit

    @property
    def speed_std(self) -> Array:
        """(rotors,) rad/s, noise of the rotor speeds (or of commands, 1)."""
        return self._speed_noise.std

    def forget_last(self, seconds: float) -> None:
        """Leave out at least the last `seconds` of what was learnt (whole batches)."""
        self._flush()
        rows = int(np.ceil(seconds / self._row_time))
        for moments in (self._rotation, self._momentum, self._accelerometer):
            moments.drop_last(rows)
        self._followed.clear()
        self._thrust.clear()

    def _fit_rotation(self, course: str | None) -> rotation.RotationFit | None:
        if self._article:
            return self._article.fit()
        moments, basis = self._rotation, self._basis
        known = None if course is None else self._followed.get(course)
        if course is not None and known is not None and self.seconds < known.settle:
            latest = rotation.follow_rotation(
                moments.total[known.fit.leak],
                moments.rows,
                basis,
                self._noise_of(known.fit.leak),
                known.fit,
                self.prior,
            )
            self._followed[course] = _Followed(latest, known.settle)
            return latest
        fit = rotation.fit_rotation(
            moments.batches, moments.counts, basis, self._noise(), prior=self.prior
        )
        if course is not None and fit is not None:
            settle = max(self.seconds + self._settle_interval, _SETTLE_GROWTH * self.seconds)
            self._followed[course] = _Followed(fit, settle)
        return fit

    def _noise(self) -> Array:
        return np.stack([self._noise_of(leak) for leak in range(len(self._memories))])

    def _noise_of(self, leak: int) -> Array:
        return self._speed_noise.moments(self._smoother, self._memories[leak])


class _Held:
    """Samples held back until there are enough for a piece.

    Args:
        size: samples of a piece.
        rotors: how many there are.
    """

    def __init__(self, size: int, rotors: int) -> None:
        edges = np.cumsum([0, 3, 3, rotors, 4, 3, 3])
        self._buffer = np.empty((size, edges[-1]))
        self._columns = [slice(a, b) for a, b in pairwise(edges)]
        self._count = 0

    def add(self, samples: Samples) -> Iterator[Samples]:
        """The pieces that these samples complete; each is valid until the next."""
        signals = (
            samples.gyro,
            samples.rates,
            samples.speeds,
            samples.attitude,
            samples.force,
            samples.velocity,
        )
        done, n, size = 0, len(samples.gyro), len(self._buffer)
        while done < n:
            take = min(n - done, size - self._count)
            to = slice(self._count, self._count + take)
            for signal, columns in zip(signals, self._columns, strict=True):
                self._buffer[to, columns] = signal[done : done + take]
            done += take
            self._count += take
            if self._count == size:
                self._count = 0
                yield self._samples(size)

    def rest(self) -> Samples | None:
        """What is held, if anything."""
        count, self._count = self._count, 0
        return self._samples(count) if count else None

    def _samples(self, count: int) -> Samples:
        return Samples(*(self._buffer[:count, columns] for columns in self._columns))


def _complete(rows: Array) -> Array:
    """Of rows (..., n, width) those in which nothing is missing, in any part."""
    if np.isfinite(rows.sum()):
        return rows
    there = np.isfinite(rows).all(axis=-1)
    whole: Array = rows[..., there.reshape(-1, rows.shape[-2]).all(axis=0), :]
    return whole


def _mixed(weights: Array, moments: Array) -> Array:
    """(..., WIDTH, WIDTH) of rows whose thrusts are mixed by their (thrusts,) weights."""
    if len(weights) == 1:
        return moments
    mixer = np.zeros((translation.WIDTH, moments.shape[-1]))
    mixer[0, :-3] = weights
    mixer[1:, -3:] = np.eye(3)
    mixed: Array = mixer @ moments @ mixer.T
    return mixed
