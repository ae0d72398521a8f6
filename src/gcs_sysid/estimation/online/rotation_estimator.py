"""The rotation of a record: from its whitened rows, those of the window, or the article's.

Where there are no whitened rows, or none yet, those of the window take their place.

A single step is mostly noise. How much of the motion a fit explains is therefore computed on the
rows of the symmetric window, which passes about 5 Hz: the same numbers as of fits to the window, on
which verdicts are based.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gcs_sysid.arrays import Array, by_parts
from gcs_sysid.estimation.checks.model_tests import (
    LEAST_RATE,
    PRODUCTS,
    RigidBodyTest,
    find_other_layout,
    judge_rigid_body,
)
from gcs_sysid.estimation.checks.validation import SHORTEST_VALIDATED, Validation, predict_held_out
from gcs_sysid.estimation.fit.disturbance import RULES, curve_doubt
from gcs_sysid.estimation.fit.inference import follow_rotation
from gcs_sysid.estimation.fit.lag_places import fit_lag_places
from gcs_sysid.estimation.fit.priors import Prior
from gcs_sysid.estimation.fit.problem import axis_power, residual_maker
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.whitened_fit import WhitenedFit, fit_whitened
from gcs_sysid.estimation.fit.whitener_choice import with_possible_noise
from gcs_sysid.estimation.noise.whitening import WhitenedMoments, joined
from gcs_sysid.estimation.online.fit import FitMoments, Instant
from gcs_sysid.estimation.online.thrust_estimator import BELIEVED, ThrustEstimator
from gcs_sysid.estimation.record.input_noise import SpeedNoise, is_sparse, with_sparse_readings
from gcs_sysid.estimation.record.record import FlightRecord
from gcs_sysid.estimation.record.whitened_record import WhitenedRecord
from gcs_sysid.estimation.record.window_record import WindowRecord
from gcs_sysid.estimation.rows.actuator_dynamics import ActuatorDynamics
from gcs_sysid.model import rigid_body as rb

_MIN_BATCHES = 10
"""Batches from which their scatter gives a standard deviation."""
_THRUST = rb.SIGNALS.index("thrust")
_LEAST_OWN = 0.02
"""Of an innovation's power, what is the gyro's at least: the rotors' noise is known to so much."""


@dataclass(frozen=True)
class LeftOut:
    """Shocks that a fit left out, to be left out by those that follow it.

    Attributes:
        moments: (3, width, width) as each axis' whitener made them.
        rows: in them.
    """

    moments: Array
    rows: int


class RotationEstimator:
    """Fits to the rotational moments of a record.

    Args:
        record: of the flight.
        thrust: of the same record.
        geometry: (3, rotors) of the airframe.
    """

    def __init__(self, record: FlightRecord, thrust: ThrustEstimator, geometry: Array) -> None:
        self.left_out: LeftOut | None = None
        """Shocks that the latest fit left out."""
        self._record, self._thrust, self._geometry = record, thrust, geometry

    @property
    def _white(self) -> WhitenedRecord | WindowRecord:
        return self._record.whitened

    @property
    def _basis(self) -> ActuatorDynamics:
        """Of the whitened rows' elements."""
        return self._white.basis

    @property
    def _data(self) -> WhitenedMoments:
        return self._white.moments(self._record.whitened_noise())

    def fit(
        self,
        start: RotationFit | None,
        prior: Prior | None,
        *,
        rigid: bool = True,
        rough: bool = False,
    ) -> RotationFit | None:
        """Fit what the record holds.

        Args:
            start: an earlier fit of it; None: from the data alone.
            prior: what else is known.
            rigid: whether the body has gyroscopic torque.
            rough: whether one place of the lag and rotors that are alike will do.

        Returns:
            The fit; None while the data cannot even start one.
        """
        record, basis = self._record, self._basis
        if record.article:
            return record.article.fit()
        data = self._data
        if basis.motors and not data.of_steps:
            data = with_possible_noise(data, basis, prior)
        if not rigid:
            data = replace(data, muted=tuple(basis.body_places(PRODUCTS)))
        hover = 0.0 if self._thrust.is_calm(prior) else self._hover
        known = prior, record.input_noise.doubt, record.choice, hover

        def fitted(first: RotationFit | None) -> WhitenedFit | None:
            near = first or start
            found = fit_whitened(data, basis, near, *known, others=not rough)
            doubtful = found is None or _is_doubtful(found.rotation)
            # Where the first place, all ways tried, ends no better, the start is not to blame.
            if doubtful and near and not (first and _is_doubtful(first)):
                fresh = fit_whitened(data, basis, None, *known)
                if found is None or (fresh is not None and fresh.cost < found.cost):
                    found = fresh
            return found

        if basis.bends:
            place = None if start is None else start.lag_place
            places = record.places() if place is None else record.places(place.of)
            some, independent = places[: 1 if rough else None], record.seconds / record.half_width
            found = fit_lag_places(fitted, basis, some, independent)
        else:
            found = fitted(None)
        if found is None:
            return None
        self.left_out = LeftOut(found.left_out, found.rows_left_out)
        return self._completed(self._with_motor_doubt(found.rotation))

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
        """The moments of now, with the whiteners of a fit.

        Args:
            fit: that is followed.
            left_out: shocks that it left out.
        """
        record, white = self._record, self._white
        assert left_out is not None
        pick = white.places(fit.whiteners)
        return Instant(
            white.total[pick] - left_out.moments,
            white.rows - left_out.rows,
            white.basis,
            record.whitened_noise(pick),
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
        """Whether the body is rigid, see `estimation.checks.model_tests`."""
        data = self._data
        pick = self._white.places(fit.whiteners)
        P = self._basis.map_at(fit.coordinates)
        rows = by_parts(lambda some: P @ some @ P.T, data.of_axes(pick))
        rows = rows - data.counts[:, None, None, None] * (P @ data.noise[pick] @ P.T)
        return judge_rigid_body(joined(rows, data.counts, data.grouped), fit.Q)

    def validate(self, prior: Prior | None, fit: RotationFit | None) -> Validation | None:
        """How well a part of the flight is predicted from the rest; None: too short, or not asked
        of the article's.

        Args:
            prior: what else is known.
            fit: to all of it.
        """
        if fit is None or self._record.article is not None:
            return None
        return predict_held_out(self._data, self._basis, self._record.choice, prior, fit)

    def other_layout(self) -> str | None:
        """What is wrong with the airframe's layout, if another explains the motion far better."""
        if self._record.article is not None:
            return None
        data = self._data
        if data.counts.sum() * self._white.time < SHORTEST_VALIDATED:
            return None
        window = self._record.rotation
        if rb.rms_rates(self._in_window, max(window.rows, 1))[:2].min() < LEAST_RATE:
            return None
        return find_other_layout(data, self._basis, self._geometry)

    def gyro_density(self, fit: RotationFit, theta: Array) -> Array:
        """(3, 3) two-sided density of gyro noise, rad^2/s, that leaves a fit's innovations.

        Noise of the rotors' inputs apart, as far as that is known.

        Args:
            fit: of this record.
            theta: (N_THETA,) what the rotors' noise acts with.
        """
        pick = self._white.places(fit.whiteners)
        own = np.diag(fit.residual_covariance)
        input_noise = self._record.whitened_noise(pick)
        TP = residual_maker(rb.forward_matrix(theta)) @ self._basis.map_at(fit.coordinates)
        rotors = axis_power(TP, input_noise)
        left = np.maximum(own - rotors, _LEAST_OWN * own)
        return np.diag(left * self._white.gyro_densities(fit.whiteners))

    @property
    def _in_window(self) -> Array:
        """(WIDTH, WIDTH) moments of the window's rows, at the middle of its coordinates."""
        basis = self._record.basis
        return basis.moments_at(self._record.rotation.total[0], basis.nodes[basis.middle])

    @property
    def _hover(self) -> float:
        """rad^2/s^2, thrust signal in hover: its rms."""
        rows = self._record.rotation.rows
        return math.sqrt(float(self._in_window[_THRUST, _THRUST]) / rows) if rows else 0.0

    def _with_motor_doubt(self, fit: RotationFit) -> RotationFit:
        """A fit to whitened rows of commands with what is not known of the motors."""
        record, commands = self._record, self._record.commands
        if commands is None or not fit.of_steps:
            return fit
        place = record.places(self._basis.lag_place.of)[0]
        off = commands.doubt + curve_doubt(fit, lambda: record.window_fit(place))
        mean = commands.mean_thrust
        if mean is not None and fit.disturbance.max() > RULES.detected:
            # Each rotor's mean thrust may be off by what asymmetry adds to it.
            share, _ = mean.rectified(fit.coordinates)
            for i, arms in ((rb.CG_X, self._geometry[0]), (rb.CG_Y, self._geometry[1])):
                off[i, i] += share**2 * float((arms**2).mean()) / len(arms)
        far = commands.distance_doubt(fit)
        return replace(fit.widened(off + far), lag_place=place, lag_doubt=off)

    def _completed(self, fit: RotationFit, instant: Instant | None = None) -> RotationFit:
        """A fit with what speeds miss that happens between readings; at an instant, or now."""
        noise = self._record.input_noise
        if not isinstance(noise, SpeedNoise) or not is_sparse(noise.interval):
            return fit
        found = self.moments(fit) if instant is None else instant.at(fit, self._record)
        return fit if found is None else with_sparse_readings(fit, noise, found.window)


def _is_doubtful(fit: RotationFit) -> bool:
    """Whether it may have started near a wrong solution."""
    return not fit.converged or float(fit.r_squared.min()) < BELIEVED
