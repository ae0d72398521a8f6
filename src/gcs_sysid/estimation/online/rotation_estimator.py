"""The rotation of a record: from its whitened rows, from those of the window, or the article's.

Whitened rows decide as soon as there are any. Without them, as while a flight on commands begins,
rows of the symmetric window do.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.checks.model_tests import PRODUCTS, RigidBodyTest, judge_rigid_body
from gcs_sysid.estimation.checks.validation import Validation, validate
from gcs_sysid.estimation.fit.disturbance import RULES, curve_doubt
from gcs_sysid.estimation.fit.inference import follow_rotation
from gcs_sysid.estimation.fit.priors import Prior
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.window_fit import axis_damping_doubt, fit_lag_places, fit_rotation
from gcs_sysid.estimation.online.fit import FitMoments, Instant
from gcs_sysid.estimation.online.thrust_estimator import ThrustEstimator
from gcs_sysid.estimation.online.whitened_estimator import LEAST_OWN, LeftOut, WhitenedEstimator
from gcs_sysid.estimation.record.input_noise import (
    SpeedNoise,
    is_sparse,
    with_sparse_readings,
)
from gcs_sysid.estimation.record.record import FlightRecord
from gcs_sysid.model import rigid_body
from gcs_sysid.model.rigid_body import CG_X, CG_Y

_MIN_BATCHES = 10
"""Batches from which their scatter gives a standard deviation."""


class RotationEstimator:
    """Fits to the rotational moments of a record.

    Args:
        record: of the flight.
        whitening: of its whitened rows, where there are any.
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
        """Shocks that the latest fit to whitened rows left out."""
        self._record, self._basis = record, record.basis
        self._whitening, self._thrust = whitening, thrust
        self._arms, self._choice = geometry[:2], record.choice

    @property
    def whitened(self) -> WhitenedEstimator | None:
        """None where there are no whitened rows, or none yet."""
        return None if self._record.whitened is None else self._whitening

    def fit(self, start: RotationFit | None, prior: Prior | None) -> RotationFit | None:
        """Fit what the record holds.

        Args:
            start: an earlier fit of it; None: from the data alone.
            prior: what else is known.

        Returns:
            The fit; None while the data cannot even start one.
        """
        fit = self._fitted(start, prior)
        return None if fit is None else self._completed(fit, prior)

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
            doubts = [
                start.lag_doubt + (0.0 if commands is None else commands.distance_doubt(fit))
                for fit in fits
            ]
            fits = [
                replace(fit.widened(doubt), lag_place=place, lag_doubt=doubt)
                for fit, doubt in zip(fits, doubts, strict=True)
            ]
        return [
            self._completed(fit, prior, instant)
            for fit, instant in zip(fits, instants, strict=True)
        ]

    def instant(self, fit: RotationFit, left_out: LeftOut | None) -> Instant:
        """The moments of now.

        Args:
            fit: that is followed.
            left_out: shocks in whitened rows; None where there are none of these.
        """
        record, leak = self._record, fit.leak
        window = record.rotation.total[leak].copy()
        followed = window, record.rotation.rows, record.basis, record.noise(leak)
        if self.whitened is not None:
            assert left_out is not None
            followed = self.whitened.followed(fit, left_out)
        return Instant(
            *followed,
            window,
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

    def without_products(self, prior: Prior | None) -> RotationFit | None:
        """The fit of a body without gyroscopic torque."""
        fit = self._fitted_without_products(prior)
        return None if fit is None else self._completed(fit, prior)

    @property
    def can_test_rigid_body(self) -> bool:
        """Whether there are batches enough for `test_rigid_body`."""
        record = self._record
        return record.article is None and len(record.rotation.batches) >= _MIN_BATCHES

    def test_rigid_body(self, fit: RotationFit) -> RigidBodyTest:
        """Whether the body is rigid, by a fit."""
        if self.whitened is not None:
            return self.whitened.test_rigid_body(fit)
        P = self._basis.map_at(fit.coordinates)
        return judge_rigid_body(self._record.rotation.batches[:, fit.leak], P, fit.Q)

    def validate(self, prior: Prior | None) -> Validation | None:
        """How well a part of the flight is predicted from the rest; None: too short, or not asked
        of the article's.
        """
        record = self._record
        if record.article is not None:
            return None
        if self.whitened is not None:
            return self.whitened.validate(prior)
        moments = record.rotation
        return validate(
            moments.batches,
            moments.counts,
            self._basis,
            self._noise(),
            record.noise_gains(),
            prior,
            self._choice,
        )

    def other_layout(self, fit: RotationFit | None) -> str | None:
        """What is wrong with the airframe's layout, if another explains the motion far better."""
        return None if self.whitened is None else self.whitened.other_layout(fit)

    def gyro_density(self, fit: RotationFit, theta: Array) -> Array:
        """See `OnlineEstimator.gyro_density`."""
        if self.whitened is not None and fit.whiteners:
            return self.whitened.gyro_density(fit, theta)
        record, n = self._record, rigid_body.N_SIGNALS
        Q = rigid_body.forward_matrix(theta)
        own = np.diag(fit.residual_covariance)
        noise = self._basis.noise_at(record.noise(fit.leak), fit.coordinates)
        rotors = np.diag(Q @ noise[:n, :n] @ Q.T)
        left = np.maximum(own - rotors, LEAST_OWN * own)
        return np.diag(left) * (record.dt / record.noise_gains()[fit.leak])

    def _fitted(self, start: RotationFit | None, prior: Prior | None) -> RotationFit | None:
        record = self._record
        if record.article:
            return record.article.fit()
        if self.whitened is not None:
            return self._fitted_to_whitened(self.whitened, start, prior)
        if self._basis.bends:
            return self._fit_lag_places(start, prior)
        data = record.rotation.batches, record.rotation.counts, self._basis, self._noise()
        if start is not None:
            fit = fit_rotation(*data, start, prior, record.noise_doubt, choice=self._choice)
            if fit is not None and fit.converged:
                return fit
        return fit_rotation(*data, prior=prior, doubt=record.noise_doubt, choice=self._choice)

    def _fitted_to_whitened(
        self, whitened: WhitenedEstimator, start: RotationFit | None, prior: Prior | None
    ) -> RotationFit | None:
        found = whitened.fit(start, prior, calm=self._thrust.is_calm(prior))
        if found is None:
            return None
        fit, self.left_out = found
        return self._with_motor_doubt(fit)

    def _with_motor_doubt(self, fit: RotationFit) -> RotationFit:
        """A fit to whitened rows; of commands, with what is not known of the motors."""
        record, commands = self._record, self._record.commands
        if commands is None:
            return fit
        off = commands.doubt + curve_doubt(fit) + commands.distance_doubt(fit)
        mean = commands.mean_thrust
        if mean is not None and fit.disturbance.max() > RULES.detected:
            # Each rotor's mean thrust may be off by what asymmetry adds to it.
            share, _ = mean.rectified(fit.coordinates)
            for i, arms in ((CG_X, self._arms[0]), (CG_Y, self._arms[1])):
                off[i, i] += share**2 * float((arms**2).mean()) / len(arms)
        place = record.places(self._whitening.basis.lag_place.of)[0]
        return replace(fit.widened(off), lag_place=place, lag_doubt=off)

    def _fit_lag_places(self, start: RotationFit | None, prior: Prior | None) -> RotationFit | None:
        """Of commands, with what lags as a hypothesis."""
        record = self._record
        known = None if start is None else start.lag_place
        places = record.places() if known is None else record.places(known.of)
        moments = record.rotation
        data = moments.batches, moments.counts, self._basis, self._noise()
        independent = record.seconds / record.half_width
        others = prior, record.noise_doubt
        if start is not None:
            fit = fit_lag_places(*data, places, independent, start, *others, choice=self._choice)
            if fit is not None and fit.converged:
                return fit
        return fit_lag_places(*data, places, independent, None, *others, start, self._choice)

    def _fitted_without_products(self, prior: Prior | None) -> RotationFit | None:
        if self.whitened is not None:
            found = self.whitened.fit(prior=prior, rigid=False)
            return None if found is None else self._with_motor_doubt(found[0])
        moments: Array = self._record.rotation.batches.copy()
        places = self._basis.body_places(PRODUCTS)
        moments[..., places, :] = 0.0
        moments[..., :, places] = 0.0
        fit = fit_rotation(
            moments,
            self._record.rotation.counts,
            self._basis,
            self._noise(),
            prior=prior,
            doubt=self._record.noise_doubt,
        )
        if fit is None or not self._basis.bends:
            return fit
        return replace(fit, lag_place=self._basis.lag_place)

    def _completed(
        self, fit: RotationFit, prior: Prior | None, instant: Instant | None = None
    ) -> RotationFit:
        """A fit with what its rows leave out; at an instant, or now.

        Speeds miss what happens between readings. The window has one damping for three axes.
        """
        if self._record.article is not None:
            return fit
        noise = self._record.input_noise
        sparse = isinstance(noise, SpeedNoise) and is_sparse(noise.interval)
        if fit.whiteners and not sparse:
            return fit
        found = self.moments(fit) if instant is None else instant.at(fit, self._record)
        if found is None:
            return fit
        if isinstance(noise, SpeedNoise):
            fit = with_sparse_readings(fit, noise, found.window)
        if not fit.whiteners:
            commands = self._basis.motors
            fit = fit.widened(axis_damping_doubt(fit, found.rows[0], prior, commands=commands))
        return fit

    def _noise(self) -> Array:
        return np.stack([self._record.noise(i) for i in range(len(self._record.memories))])
