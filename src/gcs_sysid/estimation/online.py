"""The online estimator: samples in, relative estimates out, in bounded memory and time."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation import article, rotation, translation
from gcs_sysid.estimation.moments import Moments
from gcs_sysid.estimation.regression import LeakySum, RowMaker, Samples
from gcs_sysid.filters.smoothers import DifferentiatorSmoother, Smoother, WindowSmoother
from gcs_sysid.model import rigid_body

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
        batch_time: s, length of a batch of moments.
    """

    method: Literal["forward"] | article.Method = "forward"
    smoother: Literal["window", "td"] = "window"
    half_width: float = 0.1
    min_half_samples: int = 4
    bandwidth: float = 10.0
    leaks: tuple[float, ...] = (0.0, 0.1, 0.3)
    batch_time: float = 1.0


@dataclass(frozen=True)
class Fit:
    """What the estimator knows at one instant, relative to k_T."""

    rotation: rotation.RotationFit | None
    translation: translation.TranslationFit | None
    seconds: float
    """Flight time that it rests on."""


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
            smoother = WindowSmoother(dt, half)
        self._rows = RowMaker(geometry, smoother)
        self._row_time = smoother.step * dt
        per_batch = max(round(tuning.batch_time / self._row_time), 1)
        self._leaks = [LeakySum(rotation.WIDTH, self._row_time, memory) for memory in tuning.leaks]
        self._rotation = Moments((len(tuning.leaks), rotation.WIDTH, rotation.WIDTH), per_batch)
        self._article = (
            None
            if tuning.method == "forward"
            else article.ArticleEstimator(geometry, dt, tuning.method)
        )
        self._latest: list[Array | None] = [None] * len(tuning.leaks)
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
        return Fit(self._fit_rotation(quick), trans, self.seconds)

    def _fit_rotation(self, quick: bool) -> rotation.RotationFit | None:
        """The fit with the leak that leaves the least uncertainty."""
        if self._article:
            return self._article.fit()
        fits = [
            rotation.fit_rotation(
                self._rotation.batches[:, i],
                self._rotation.counts,
                start=self._latest[i] if quick else None,
            )
            for i in range(len(self._leaks))
        ]
        if quick:
            self._latest = [None if fit is None else fit.theta for fit in fits]
        there = [fit for fit in fits if fit is not None]
        return min(there, key=_uncertainty, default=None)


def _uncertainty(fit: rotation.RotationFit) -> float:
    """Sum of log standard deviations of what makes up the core parameters."""
    return float(np.sum(np.log(fit.std[: rigid_body.DAMPING])))
