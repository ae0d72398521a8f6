"""The rotation of a record: from its whitened rows, those of the window, or the article's."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.checks.model_tests import RigidBodyTest
from gcs_sysid.estimation.checks.validation import Validation
from gcs_sysid.estimation.fit.disturbance import RULES, curve_doubt
from gcs_sysid.estimation.fit.inference import follow_rotation
from gcs_sysid.estimation.fit.priors import Prior
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.online.fit import FitMoments, Instant
from gcs_sysid.estimation.online.thrust_estimator import ThrustEstimator
from gcs_sysid.estimation.online.whitened_estimator import LeftOut, WhitenedEstimator
from gcs_sysid.estimation.record.input_noise import (
    SpeedNoise,
    is_sparse,
    with_sparse_readings,
)
from gcs_sysid.estimation.record.record import FlightRecord
from gcs_sysid.model.rigid_body import CG_X, CG_Y

_MIN_BATCHES = 10
"""Batches from which their scatter gives a standard deviation."""


class RotationEstimator:
    """Fits to the rotational moments of a record.

    Args:
        record: of the flight.
        whitening: fits to its rows.
        thrust: of the same record.
        geometry: (3, rotors) of the airframe.
    """

    def __init__(
        self,
        record: FlightRecord,
        whitening: WhitenedEstimator,
        thrust: ThrustEstimator,
        geometry: Array,
    ) -> None:
        self.left_out: LeftOut | None = None
        """Shocks that the latest fit left out."""
        self._record, self._whitening, self._thrust = record, whitening, thrust
        self._arms = geometry[:2]

    def fit(
        self, start: RotationFit | None, prior: Prior | None, **how: bool
    ) -> RotationFit | None:
        """Fit what the record holds.

        Args:
            start: an earlier fit of it; None: from the data alone.
            prior: what else is known.
            how: `rigid` and `rough`, as of `WhitenedEstimator.fit`.

        Returns:
            The fit; None while the data cannot even start one.
        """
        if self._record.article:
            return self._record.article.fit()
        found = self._whitening.fit(start, prior, calm=self._thrust.is_calm(prior), **how)
        if found is None:
            return None
        fit, self.left_out = found
        return self._completed(self._with_motor_doubt(fit))

    def follow(
        self, instants: Sequence[Instant], start: RotationFit, prior: Prior | None
    ) -> list[RotationFit]:
        """Quick fits at some instants, from an earlier one."""
        place = start.lag_place
        self._record.use_place(place)
        fits = follow_rotation(
            np.stack([i.moments for i in instants]),
            np.array([i.rows for i in instants]),
            instants[0].basis,
            np.stack([i.noise for i in instants]),
            start,
            prior,
        )
        if place is not None:
            commands = self._record.commands
            far = [0.0 if commands is None else commands.distance_doubt(fit) for fit in fits]
            # Of where it is, not of where it was: the next one has a distance of its own.
            doubt = start.lag_doubt
            fits = [
                replace(fit.widened(doubt + off), lag_place=place, lag_doubt=doubt)
                for fit, off in zip(fits, far, strict=True)
            ]
        return [self._completed(fit, instant) for fit, instant in zip(fits, instants, strict=True)]

    def instant(self, fit: RotationFit, left_out: LeftOut | None) -> Instant:
        """The moments of now.

        Args:
            fit: that is followed.
            left_out: shocks that it left out.
        """
        record = self._record
        assert left_out is not None
        return Instant(
            *self._whitening.followed(fit, left_out),
            record.rotation.total[0].copy(),
            record.rotation.rows,
            record.momentum.total.copy(),
            record.momentum.rows,
            record.seconds,
            record.mean_thrust,
        )

    def moments(self, fit: RotationFit | None) -> FitMoments | None:
        """What the latest fit rests on; None of none, and of the article's."""
        if fit is None or self._record.article is not None:
            return None
        return self.instant(fit, self.left_out).at(fit, self._record)

    @property
    def can_test_rigid_body(self) -> bool:
        """Whether there are batches enough for `test_rigid_body`."""
        record = self._record
        return record.article is None and len(record.rotation.batches) >= _MIN_BATCHES

    def test_rigid_body(self, fit: RotationFit) -> RigidBodyTest:
        """Whether the body is rigid, by a fit."""
        return self._whitening.test_rigid_body(fit)

    def validate(self, prior: Prior | None, fit: RotationFit | None) -> Validation | None:
        """How well a part of the flight is predicted from the rest; None: too short, or not asked
        of the article's.

        Args:
            prior: what else is known.
            fit: to all of it.
        """
        if fit is None or self._record.article is not None:
            return None
        return self._whitening.validate(prior, fit)

    def other_layout(self) -> str | None:
        """What is wrong with the airframe's layout, if another explains the motion far better."""
        return None if self._record.article is not None else self._whitening.other_layout()

    def gyro_density(self, fit: RotationFit, theta: Array) -> Array:
        """See `OnlineEstimator.gyro_density`."""
        return self._whitening.gyro_density(fit, theta)

    def _with_motor_doubt(self, fit: RotationFit) -> RotationFit:
        """A fit to whitened rows of commands with what is not known of the motors."""
        record, commands = self._record, self._record.commands
        if commands is None or not fit.of_steps:
            return fit
        off = commands.doubt + curve_doubt(fit)
        mean = commands.mean_thrust
        if mean is not None and fit.disturbance.max() > RULES.detected:
            # Each rotor's mean thrust may be off by what asymmetry adds to it.
            share, _ = mean.rectified(fit.coordinates)
            for i, arms in ((CG_X, self._arms[0]), (CG_Y, self._arms[1])):
                off[i, i] += share**2 * float((arms**2).mean()) / len(arms)
        place = record.places(self._whitening.basis.lag_place.of)[0]
        far = commands.distance_doubt(fit)
        return replace(fit.widened(off + far), lag_place=place, lag_doubt=off)

    def _completed(self, fit: RotationFit, instant: Instant | None = None) -> RotationFit:
        """A fit with what speeds miss that happens between readings; at an instant, or now."""
        noise = self._record.input_noise
        if not isinstance(noise, SpeedNoise) or not is_sparse(noise.interval):
            return fit
        found = self.moments(fit) if instant is None else instant.at(fit, self._record)
        return fit if found is None else with_sparse_readings(fit, noise, found.window)
