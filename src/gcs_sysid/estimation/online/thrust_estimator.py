"""Thrust and drag over mass of a record: from the momentum balance, or the accelerometer."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit import translation
from gcs_sysid.estimation.fit.disturbance import RULES
from gcs_sysid.estimation.fit.priors import COORDINATE_STD, Prior
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.translation import TranslationFit
from gcs_sysid.estimation.online.fit import Instant
from gcs_sysid.estimation.record.record import FlightRecord
from gcs_sysid.estimation.rows.actuator_dynamics import Coordinate
from gcs_sysid.model import rigid_body

MIN_MOMENTUM_SECONDS = 5.0
"""Flight time from which momentum balance beats the accelerometer's bias."""
BELIEVED = 0.5
"""Share of the motion explained, from which deviations are those of rotors."""
_CURVE_STEP = 0.05
"""Of the thrust curve, for the derivative of thrust over mass."""


class ThrustEstimator:
    """Fits to the translational moments of a record.

    Args:
        record: of the flight.
        place: m, standard deviation of each coordinate of the accelerometer's place.
    """

    def __init__(self, record: FlightRecord, place: float = 0.0) -> None:
        self._gain: translation.AccelerometerGain | None = None
        self._before: translation.MomentumStart | None = None
        self._record, self._basis = record, record.basis
        self._place = place

    def know_sensors(
        self, momentum: TranslationFit | None, accelerometer: TranslationFit | None
    ) -> None:
        """How the accelerometer reads against gravity, and velocity errs, in an earlier segment."""
        self._gain = translation.accelerometer_gain(momentum, accelerometer)
        self._before = None if momentum is None else momentum.warm_start

    def fit(
        self, at: RotationFit | None, prior: Prior | None
    ) -> tuple[TranslationFit | None, TranslationFit | None]:
        """Thrust and drag over mass from the better source, and from the accelerometer.

        Args:
            at: gives the coordinates of the basis; None: its middle.
            prior: what else is known.
        """
        where = self.coordinates(at, prior)
        momentum = self.by_momentum(where)
        accelerometer = self.by_accelerometer(where)
        return self.with_slope(momentum or accelerometer, at, prior), accelerometer

    def quick(
        self, at: RotationFit | None, prior: Prior | None
    ) -> tuple[TranslationFit | None, TranslationFit | None]:
        """Of the momentum balance, without `with_slope`, and of the better source, with it.

        Args:
            at: as of `fit`.
            prior: likewise.
        """
        where = self.coordinates(at, prior)
        momentum = self.by_momentum(where)
        return momentum, self.with_slope(momentum or self.by_accelerometer(where), at, prior)

    def by_momentum(self, where: Array) -> TranslationFit | None:
        """Of the momentum balance, at (3,) coordinates; None while it is too early."""
        record, weights = self._record, self._basis.thrust_weights(where)
        if record.momentum.rows * record.row_time <= MIN_MOMENTUM_SECONDS:
            return None
        batches, total = (
            _mixed(weights, m) for m in (record.momentum.batches, record.momentum.total)
        )
        return translation.fit_momentum(batches, record.momentum.counts, total, self._before)

    def by_accelerometer(self, where: Array) -> TranslationFit | None:
        """Of the accelerometer's z axis, at (3,) coordinates."""
        moments = self._record.accelerometer
        mixed = _mixed(self._basis.thrust_weights(where), moments.batches)
        return translation.fit_accelerometer(mixed, moments.counts, self._gain, self._place)

    def follow(
        self, instants: Sequence[Instant], at: Sequence[RotationFit], start: TranslationFit
    ) -> list[TranslationFit]:
        """Quick fits of the momentum balance at some instants, from an earlier one."""
        weights = [self._basis.thrust_weights(fit.coordinates) for fit in at]
        pairs = zip(weights, instants, strict=True)
        return translation.follow_momentum(
            np.stack([_mixed(w, i.momentum) for w, i in pairs]),
            np.array([i.momentum_rows for i in instants]),
            start,
        )

    def is_calm(self, prior: Prior | None) -> bool:
        """Whether it is known that no steady wind blows; without velocity nothing is."""
        momentum = self.by_momentum(self.coordinates(None, prior))
        return momentum is not None and momentum.wind < translation.CALM

    def coordinates(self, fit: RotationFit | None, prior: Prior | None) -> Array:
        """(3,) of a fit, or the basis' middle with the thrust curve that is known beforehand."""
        self._record.use_place(None if fit is None else fit.lag_place)
        where: Array = self._basis.nodes[self._basis.middle] if fit is None else fit.coordinates
        if fit is None and prior is not None and Coordinate.CURVE in self._basis.free:
            curve, _ = prior.thrust_curve
            where = where.copy()
            if np.isfinite(curve):
                where[Coordinate.CURVE] = np.clip(
                    curve, self._basis.low[Coordinate.CURVE], self._basis.high[Coordinate.CURVE]
                )
        return where

    def with_slope(
        self,
        fit: TranslationFit | None,
        at: RotationFit | None,
        prior: Prior | None,
        instant: Instant | None = None,
    ) -> TranslationFit | None:
        """The fit with how kappa changes with the thrust curve, where that is unknown.

        It is gravity over the mean share of thrust.

        Args:
            fit: of thrust over mass.
            at: what is known of the rotation.
            prior: what else is known.
            instant: that the fit is of; None: now.
        """
        if fit is None or (at is None and Coordinate.CURVE not in self._basis.free):
            return fit
        if at is not None:
            fit = self._of_mean_rotor(fit, at)
            mean = instant.mean_thrust if instant is not None else self._record.mean_thrust
            if mean is not None:
                # Thrust of the rows that kappa is of has one time constant.
                share, slope = mean.rectified(at.coordinates)
                motors = slice(rigid_body.N_THETA, rigid_body.N_THETA + len(slope))
                variance = float(slope @ at.full_covariance[motors, motors] @ slope)
                if at.disturbance.max() > RULES.detected:
                    # Asymmetry is then what disturbs, too.
                    variance += share * share
                spread = float(np.hypot(fit.kappa_std, fit.kappa * variance**0.5)) / (1.0 + share)
                fit = replace(fit, kappa=fit.kappa / (1.0 + share), kappa_std=spread)
        if Coordinate.CURVE not in self._basis.free:
            return fit
        where = self.coordinates(at, prior)
        total = self._record.momentum.total if instant is None else instant.momentum
        if fit.source == "accelerometer":
            total = self._record.accelerometer.total
        step = _CURVE_STEP * np.eye(len(where))[Coordinate.CURVE]
        less, more = (
            float(mixed[..., -2, 0].ravel()[-1])  # of the vertical axis
            for c in (where - step, where + step)
            for mixed in (_mixed(self._basis.thrust_weights(c), total),)
        )
        change = -fit.kappa * (more - less) / (0.5 * (more + less)) / (2.0 * step[Coordinate.CURVE])
        if at is None:
            # Of the curve nothing is known yet but what was known, or what it ordinarily is.
            known = np.inf if prior is None else prior.thrust_curve[1]
            curve_std = min(known, float(COORDINATE_STD[Coordinate.CURVE]))
            return replace(fit, kappa_std=float(np.hypot(fit.kappa_std, change * curve_std)))
        return replace(fit, curve_slope=float(change))

    def _of_mean_rotor(self, thrust: TranslationFit, fit: RotationFit) -> TranslationFit:
        """Thrust over mass of the mean rotor, where rotors differ.

        The whole vehicle's thrust weighs those most that carry most of it:
        sum k_i O_i = k (1 + sum e_i share_i) sum O_i.
        """
        if not fit.deviating.thrusts.any() or fit.r_squared.min() < BELIEVED:
            return thrust
        effect = fit.deviating.thrusts @ self._record.choice.shares(fit.unknowns)
        factor = 1.0 / (1.0 + float(fit.deviations @ effect))
        # Rounding of what hardly is in the data may leave less than nothing.
        spread = float(max(effect @ fit.deviations_covariance @ effect, 0.0)) ** 0.5
        kappa = factor * thrust.kappa
        spread = float(np.hypot(factor * thrust.kappa_std, spread * kappa))
        return replace(thrust, kappa=kappa, kappa_std=spread)


def _mixed(weights: Array, moments: Array) -> Array:
    """(..., width, width) of rows whose thrusts are mixed by their (thrusts,) weights."""
    if len(weights) == 1:
        return moments
    others = moments.shape[-1] - len(weights)
    mixer = np.zeros((1 + others, moments.shape[-1]))
    mixer[0, :-others] = weights
    mixer[1:, -others:] = np.eye(others)
    return mixer @ moments @ mixer.T
