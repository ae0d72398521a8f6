"""The online estimator: samples in, relative estimates out, in bounded memory and time."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation import article, rotation, translation
from gcs_sysid.estimation.moments import Moments
from gcs_sysid.estimation.priors import Prior
from gcs_sysid.estimation.regression import LeakySum, RowMaker, Samples
from gcs_sysid.estimation.speed_noise import SpeedNoise
from gcs_sysid.estimation.translation import TranslationFit
from gcs_sysid.estimation.validation import Validation, validate
from gcs_sysid.filters.smoothers import DifferentiatorSmoother, Smoother, WindowSmoother

_SETTLE_GROWTH = 1.2
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
        delays: s, bank of rotor delays, equally spaced; one alone is taken as given.
        settle_interval: s, least time between full fits of a running course, which choose
            leak and delay; later they come when the record has grown by a fifth.
        batch_time: s, length of a batch of moments.
    """

    method: Literal["forward"] | article.Method = "forward"
    smoother: Literal["window", "td"] = "window"
    half_width: float = 0.1
    min_half_samples: int = 4
    bandwidth: float = 10.0
    leaks: tuple[float, ...] = (0.0, 0.3, 1.0)
    delays: tuple[float, ...] = tuple(0.01 * k - 0.015 for k in range(8))
    settle_interval: float = 2.0
    batch_time: float = 1.0


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
    """The second source of k_T / m, whichever `translation` is."""


@dataclass(frozen=True)
class _Followed:
    """Where a course of quick fits is: its latest, and flight time of its next full one."""

    fit: rotation.RotationFit
    settle: float


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
        if tuning.smoother == "td":
            smoother = DifferentiatorSmoother(dt, tuning.bandwidth)
        else:
            half = max(tuning.min_half_samples, round(tuning.half_width / dt))
            smoother = WindowSmoother(dt, half, tuning.delays)
        self._smoother = smoother
        self._speed_noise = SpeedNoise(geometry, dt)
        self._memories = tuning.leaks
        self._rows = RowMaker(geometry, smoother)
        self._row_time = smoother.step * dt
        per_batch = max(round(tuning.batch_time / self._row_time), 1)
        self._delays = smoother.delays
        self._leaks = [LeakySum(self._row_time, memory) for memory in tuning.leaks]
        bank = (len(tuning.leaks), len(self._delays))
        self._rotation = Moments((*bank, rotation.WIDTH, rotation.WIDTH), per_batch)
        self._settle_interval = tuning.settle_interval
        self._followed: dict[str, _Followed] = {}
        self._article = (
            None
            if tuning.method == "forward"
            else article.ArticleEstimator(geometry, dt, tuning.method)
        )
        self._momentum = Moments((3, translation.WIDTH, translation.WIDTH), per_batch)
        self._accelerometer = Moments((translation.WIDTH, translation.WIDTH), per_batch)

    def restart(self) -> None:
        """A gap: what comes next does not join on to what came before."""
        self._rows.restart()
        for leak in self._leaks:
            leak.restart()
        if self._article:
            self._article.restart()

    def update(self, samples: Samples) -> None:
        """Take a block of samples; the outcome does not depend on how they are grouped."""
        rows = self._rows.update(samples)
        self._speed_noise.update(samples.speeds)
        self._rotation.add(np.stack([leak.update(rows.rotation) for leak in self._leaks]))
        if self._article:
            self._article.update(samples)
        complete = np.isfinite(rows.momentum).all(axis=(1, 2))
        self._momentum.add(np.swapaxes(rows.momentum[complete], 0, 1))
        complete = np.isfinite(rows.accelerometer).all(axis=1)
        self._accelerometer.add(rows.accelerometer[complete])

    @property
    def seconds(self) -> float:
        """Flight time that the rotational estimate rests on."""
        return self._rotation.rows * self._row_time

    def fit(self, *, quick: bool = False, course: str = "") -> Fit:
        """The estimate from everything so far.

        Args:
            quick: go on from the last quick estimate, for the course of a running flight.
                Otherwise the outcome is a function of the data alone.
            course: name of the course of quick estimates to go on with. One that decides
                something must not depend on how often others look.
        """
        trans, accelerometer = self.fit_translation()
        validation = None
        noise = self._noise()
        if not quick and self._article is None:
            validation = validate(
                self._rotation.batches, self._rotation.counts, self._delays, noise, self.prior
            )
        return Fit(
            self._fit_rotation(course if quick else None, noise),
            trans,
            self.seconds,
            validation,
            accelerometer,
        )

    def fit_translation(
        self,
    ) -> tuple[TranslationFit | None, TranslationFit | None]:
        """Thrust and drag over mass from the better source, and from the accelerometer."""
        accelerometer = translation.fit_accelerometer(
            self._accelerometer.batches, self._accelerometer.counts, self.accelerometer_gain
        )
        momentum = None
        if self._momentum.rows * self._row_time > MIN_MOMENTUM_SECONDS:
            momentum = translation.fit_momentum(self._momentum.batches, self._momentum.counts)
        return momentum or accelerometer, accelerometer

    @property
    def speed_std(self) -> Array:
        """(rotors,) rad/s, noise of the rotor speeds."""
        return self._speed_noise.std

    def forget_last(self, seconds: float) -> None:
        """Leave out at least the last `seconds` of what was learnt (whole batches)."""
        rows = int(np.ceil(seconds / self._row_time))
        for moments in (self._rotation, self._momentum, self._accelerometer):
            moments.drop_last(rows)
        self._followed.clear()

    def _fit_rotation(self, course: str | None, noise: Array) -> rotation.RotationFit | None:
        if self._article:
            return self._article.fit()
        moments, delays = self._rotation, self._delays
        known = None if course is None else self._followed.get(course)
        if course is not None and known is not None and self.seconds < known.settle:
            latest = rotation.follow_rotation(
                moments.total[known.fit.leak],
                moments.rows,
                delays,
                noise[known.fit.leak],
                known.fit,
                self.prior,
            )
            self._followed[course] = _Followed(latest, known.settle)
            return latest
        fit = rotation.fit_rotation(
            moments.batches, moments.counts, delays, noise, prior=self.prior
        )
        if course is not None and fit is not None:
            settle = max(self.seconds + self._settle_interval, _SETTLE_GROWTH * self.seconds)
            self._followed[course] = _Followed(fit, settle)
        return fit

    def _noise(self) -> Array:
        return np.stack([self._speed_noise.moments(self._smoother, m) for m in self._memories])
