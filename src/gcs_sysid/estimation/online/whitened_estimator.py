"""The rotation of a record from its whitened rows; how it is judged from those of the window.

Where there are no whitened rows, or none yet, those of the window take their place.

A single step is mostly noise. How much of the motion a fit explains is therefore computed on the
rows of the symmetric window, which passes about 5 Hz: the same numbers as of fits to the window, on
which verdicts are based.
"""

import math
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
from gcs_sysid.estimation.fit.lag_places import fit_lag_places
from gcs_sysid.estimation.fit.priors import Prior
from gcs_sysid.estimation.fit.problem import axis_power, residual_maker
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.translation import TranslationFit
from gcs_sysid.estimation.fit.whitened_fit import WhitenedFit, fit_whitened
from gcs_sysid.estimation.fit.whitener_choice import with_possible_noise
from gcs_sysid.estimation.noise.whitening import WhitenedMoments, joined
from gcs_sysid.estimation.record.record import FlightRecord
from gcs_sysid.estimation.record.whitened_record import WhitenedRecord
from gcs_sysid.estimation.record.window_record import WindowRecord
from gcs_sysid.estimation.rows.actuator_dynamics import ActuatorDynamics
from gcs_sysid.model import rigid_body as rb

_BELIEVED = 0.5
"""Share of the motion explained, from which deviations are those of rotors."""
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


class WhitenedEstimator:
    """Fits to the whitened rows of a record.

    Args:
        record: that has such rows.
        geometry: (3, rotors) of the airframe.
    """

    def __init__(self, record: FlightRecord, geometry: Array) -> None:
        self._choice = record.choice
        self._geometry = geometry
        self._record = record

    @property
    def _white(self) -> WhitenedRecord | WindowRecord:
        return self._record.whitened

    @property
    def basis(self) -> ActuatorDynamics:
        """Of the whitened rows' elements."""
        return self._white.basis

    def fit(
        self,
        start: RotationFit | None = None,
        prior: Prior | None = None,
        *,
        rigid: bool = True,
        calm: bool = False,
        rough: bool = False,
    ) -> tuple[RotationFit, LeftOut] | None:
        """Fit what the record holds.

        Args:
            start: an earlier fit of it; None: from the data alone.
            prior: on the unknowns.
            rigid: whether the body has gyroscopic torque.
            calm: whether no steady wind blows.
            rough: whether one place of the lag and rotors that are alike will do.

        Returns:
            The fit and the shocks that it left out; None while the data cannot even start one.
        """
        data = self._data
        if self.basis.motors and not data.of_steps:
            data = with_possible_noise(data, self.basis, prior)
        if not rigid:
            data = replace(data, muted=tuple(self.basis.body_places(PRODUCTS)))
        known = prior, self._record.noise_doubt, self._choice, 0.0 if calm else self._hover

        def fitted(first: RotationFit | None) -> WhitenedFit | None:
            near = first or start
            found = fit_whitened(data, self.basis, near, *known, others=not rough)
            doubtful = found is None or _is_doubtful(found.rotation)
            # Where the first place, all ways tried, ends no better, the start is not to blame.
            if doubtful and near and not (first and _is_doubtful(first)):
                fresh = fit_whitened(data, self.basis, None, *known)
                if found is None or (fresh is not None and fresh.cost < found.cost):
                    found = fresh
            return found

        if self.basis.bends:
            record, place = self._record, None if start is None else start.lag_place
            places = record.places() if place is None else record.places(place.of)
            some, independent = places[: 1 if rough else None], record.seconds / record.half_width
            found = fit_lag_places(fitted, self.basis, some, independent)
        else:
            found = fitted(None)
        if found is None:
            return None
        return found.rotation, LeftOut(found.left_out, found.rows_left_out)

    def followed(
        self, fit: RotationFit, left_out: LeftOut
    ) -> tuple[Array, int, ActuatorDynamics, Array]:
        """The moments of now, with the whiteners of a fit: as of `Instant`, without its shocks."""
        pick, white = self._white.places(fit.whiteners), self._white
        return (
            white.total[pick] - left_out.moments,
            white.rows - left_out.rows,
            self.basis,
            self._record.whitened_noise(pick),
        )

    def validate(self, prior: Prior | None, fit: RotationFit) -> Validation | None:
        """Fit a part, predict the rest; whiteness of innovations."""
        return predict_held_out(self._data, self.basis, self._choice, prior, fit)

    def other_layout(self) -> str | None:
        """What is wrong with the given layout, if another one explains the motion far better."""
        data = self._data
        if data.counts.sum() * self._white.time < SHORTEST_VALIDATED:
            return None
        if self._rates[:2].min() < LEAST_RATE:
            return None
        return find_other_layout(data, self.basis, self._geometry)

    def judged_thrust(self, thrust: TranslationFit, fit: RotationFit) -> TranslationFit:
        """Thrust over mass of the mean rotor, where rotors differ.

        The whole vehicle's thrust weighs those most that carry most of it:
        sum k_i O_i = k (1 + sum e_i share_i) sum O_i.
        """
        if not fit.deviating.thrusts.any() or fit.r_squared.min() < _BELIEVED:
            return thrust
        effect = fit.deviating.thrusts @ self._choice.shares(fit.unknowns)
        factor = 1.0 / (1.0 + float(fit.deviations @ effect))
        # Rounding of what hardly is in the data may leave less than nothing.
        spread = float(max(effect @ fit.deviations_covariance @ effect, 0.0)) ** 0.5
        kappa = factor * thrust.kappa
        return replace(
            thrust, kappa=kappa, kappa_std=math.hypot(factor * thrust.kappa_std, spread * kappa)
        )

    def test_rigid_body(self, fit: RotationFit) -> RigidBodyTest:
        """Whether the body is rigid, see `estimation.checks.model_tests`."""
        data = self._data
        pick = self._white.places(fit.whiteners)
        P = self.basis.map_at(fit.coordinates)
        rows = by_parts(lambda some: P @ some @ P.T, data.of_axes(pick))
        rows = rows - data.counts[:, None, None, None] * (P @ data.noise[pick] @ P.T)
        return judge_rigid_body(joined(rows, data.counts, data.grouped), fit.Q)

    def gyro_density(self, fit: RotationFit, theta: Array) -> Array:
        """(3, 3) two-sided density of gyro noise, rad^2/s, that leaves a fit's innovations.

        Args:
            fit: of this record.
            theta: (N_THETA,) what the rotors' noise acts with.
        """
        pick = self._white.places(fit.whiteners)
        own = np.diag(fit.residual_covariance)
        input_noise = self._record.whitened_noise(pick)
        TP = residual_maker(rb.forward_matrix(theta)) @ self.basis.map_at(fit.coordinates)
        rotors = axis_power(TP, input_noise)
        left = np.maximum(own - rotors, _LEAST_OWN * own)
        return np.diag(left * self._white.gyro_densities(fit.whiteners))

    @property
    def _data(self) -> WhitenedMoments:
        return self._white.moments(self._record.whitened_noise())

    @property
    def _hover(self) -> float:
        """rad^2/s^2, thrust signal in hover: its rms."""
        window = self._record.rotation
        thrust = self._record.basis.moments_at(
            window.total[0], self._record.basis.nodes[self._record.basis.middle]
        )[_THRUST, _THRUST]
        return math.sqrt(float(thrust) / window.rows) if window.rows else 0.0

    @property
    def _rates(self) -> Array:
        """(3,) rms of body rates, rad/s, slower than some 5 Hz."""
        window, basis = self._record.rotation, self._record.basis
        sums = basis.moments_at(window.total[0], basis.nodes[basis.middle])
        return rb.rms_rates(sums, max(window.rows, 1))


def _is_doubtful(fit: RotationFit) -> bool:
    """Whether it may have started near a wrong solution."""
    return not fit.converged or float(fit.r_squared.min()) < _BELIEVED
