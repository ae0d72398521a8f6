"""The online estimator: samples in, relative estimates out, in bounded memory and time."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation import article, rotation, translation
from gcs_sysid.estimation.moments import Moments
from gcs_sysid.estimation.regression import LeakySum, RowMaker, Samples
from gcs_sysid.estimation.speed_noise import SpeedNoise
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
        leaks: s, memories of the leaky sums carried side by side; 0 for none. Well below
            `batch_time`, else scores of neighbouring batches say too little of their own scatter.
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
    leaks: tuple[float, ...] = (0.0, 0.3)
    delays: tuple[float, ...] = tuple(0.01 * k - 0.015 for k in range(8))
    settle_interval: float = 2.0
    batch_time: float = 1.0


@dataclass(frozen=True)
class Fit:
    """What the estimator knows at one instant, relative to k_T."""

    rotation: rotation.RotationFit | None
    translation: translation.TranslationFit | None
    seconds: float
    """Flight time that it rests on."""
    validation: Validation | None = None
    """Only of full fits."""


class OnlineEstimator:
    """Recursive estimator on samples of one uniform step.

    Args:
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
        tuning: settings.
    """

    def __init__(self, geometry: Array, dt: float, tuning: Tuning) -> None:
        self.dt = dt
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
        self._latest: rotation.RotationFit | None = None
        self._settle_next = -np.inf
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

    def fit(self, *, quick: bool = False) -> Fit:
        """The estimate from everything so far.

        Args:
            quick: go on from the last quick estimate, for the course of a running flight.
                Otherwise the outcome is a function of the data alone.
        """
        trans = None
        if self._momentum.rows * self._row_time > MIN_MOMENTUM_SECONDS:
            trans = translation.fit_momentum(self._momentum.batches, self._momentum.counts)
        if trans is None:
            trans = translation.fit_accelerometer(
                self._accelerometer.batches, self._accelerometer.counts
            )
        validation = None
        if not quick and self._article is None:
            validation = validate(
                self._rotation.batches,
                self._rotation.counts,
                self._delays,
                self._noise(),
                np.array([self._smoother.noise_gains(m)[1] for m in self._memories]),
            )
        return Fit(self._fit_rotation(quick), trans, self.seconds, validation)

    def _fit_rotation(self, quick: bool) -> rotation.RotationFit | None:
        if self._article:
            return self._article.fit()
        start = None
        if quick and self.seconds < self._settle_next:
            start = self._latest
        fit = rotation.fit_rotation(
            self._rotation.batches, self._rotation.counts, self._delays, self._noise(), start
        )
        if quick:
            self._latest = fit
            if start is None:
                self._settle_next = max(
                    self.seconds + self._settle_interval, _SETTLE_GROWTH * self.seconds
                )
        return fit

    def _noise(self) -> Array:
        return np.stack([self._speed_noise.moments(self._smoother, m) for m in self._memories])
