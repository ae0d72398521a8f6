"""Rows of commands about motors that were found, and how likely these are."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit.priors import COORDINATE_STD, Unknown
from gcs_sysid.estimation.fit.problem import axis_power, residual_maker
from gcs_sysid.estimation.fit.rotation import RotationFit, along
from gcs_sysid.estimation.fit.whitened_fit import WhitenedFit
from gcs_sysid.estimation.noise.whitening import Whitener
from gcs_sysid.estimation.record.whitened_record import WhitenedRecord
from gcs_sysid.estimation.rows.motor_linearization import LocalDynamics, MotorRows
from gcs_sysid.model import rigid_body as rb

TRUSTED = 4.0
"""Steps of the linearization that a round goes at most: farther off the rows are not what motors
there make. A curve of 0.85 went to 0.23 in one round, to where its residual only seemed less."""
_NEAR = 1.1
"""Times the least innovation power of an axis, up to which a whitener may be the likeliest with
another place of the lag. Where places compete, their residuals are alike."""
_NO_RIVAL, _CLOSE = 0.2, 2.0
"""Nats a row by which a place of the lag must be less likely, and steps of the linearization within
which its motors must be, for its rows not to be made again: on recorded flights that brought at
most half as much."""


_RIVAL = 20.0
"""Nats by which a place of the lag must be less likely to count no more: its weight is 2e-9."""


@dataclass(frozen=True)
class TunedRows:
    """Rows about one set of motors.

    Attributes:
        basis: the motors.
        maker: of the rows.
        white: their moments.
        fit: to these, when they were made.
        away: (N_UNKNOWNS,) remaining error where the motors moved away.
        samples: that they were made of at once.
    """

    basis: LocalDynamics
    maker: MotorRows
    white: WhitenedRecord
    fit: WhitenedFit
    away: Array
    samples: int

    @property
    def trusted(self) -> bool:
        """Whether the motors found are those that the rows are made about, nearly."""
        return self.is_within(TRUSTED)

    def is_within(self, steps: float) -> bool:
        """Whether the motors found are so many steps of the linearization away, at most."""
        return self._is_near(self.fit.rotation, steps)

    def distance_doubt(self, fit: RotationFit) -> Array:
        """(N_UNKNOWNS, N_UNKNOWNS) covariance of what a later fit to the rows may be off by.

        The motors may be found, from more flight, far from those that the rows are made about. Then
        curve and lag are what they ordinarily are, and all unknowns go with them, until rows are
        made again.
        """
        doubt = np.zeros_like(fit.full_covariance)
        if self._is_near(fit, TRUSTED):
            return doubt
        for place in (Unknown.CURVE, Unknown.LAG):
            off = along(fit.full_covariance, place, COORDINATE_STD[place - rb.N_THETA])
            doubt += np.outer(off, off)
        return doubt

    def _is_near(self, fit: RotationFit, steps: float) -> bool:
        off = np.abs(fit.coordinates - self.basis.at)
        return bool((off <= steps * self.basis.moved).all())

    def restart(self) -> None:
        """A gap: what comes next does not join on to what came before."""
        self.maker.restart()
        self.white.restart()

    @property
    def rank(self) -> tuple[bool, float]:
        """The less, the more it is to be believed."""
        return not self.trusted, self.cost

    @property
    def cost(self) -> float:
        """Nats of all samples, shocks included: what is left out differs from one to another.

        So does the number of rows, as slower motors take longer until their past is forgotten.
        """
        rows = self.samples / self.maker.samples_a_row
        return 0.5 * rows * float(np.log(self._power.min(axis=0) / self.white.rows).sum())

    @property
    def near(self) -> list[Whitener]:
        """Whiteners of which some axis' innovations are nearly as weak as of the likeliest."""
        power, whiteners = self._power, self.white.whiteners
        near = (power < _NEAR * power.min(axis=0)).any(axis=1)
        # A disturbance shows by what whiteners without one leave.
        calm = [i for i, whitener in enumerate(whiteners) if not whitener.disturbed]
        near[np.array(calm)[power[calm].argmin(axis=0)]] = True
        return [whiteners[i] for i in np.flatnonzero(near)]

    @property
    def _power(self) -> Array:
        """(bank, 3) of the innovations of all rows, times their number."""
        fit = self.fit.rotation
        TP = residual_maker(fit.Q) @ self.basis.map_at(fit.coordinates)
        return axis_power(TP, self.white.total[:, None])


@dataclass(frozen=True)
class FirstPlace:
    """The place of the lag that others are compared with.

    Attributes:
        whiteners: that are enough for it.
        cost: nats.
    """

    whiteners: Sequence[Whitener]
    cost: float

    def is_enough(self, other: TunedRows, *, tried: bool) -> bool:
        """Whether rows about the motors found would not change which is likelier, nor how far.

        Args:
            other: place of the lag, on its way.
            tried: whether its rows have been made again as often as those of one that is no rival.
        """
        worse = other.cost - self.cost
        if tried:
            return worse > _RIVAL
        return other.is_within(_CLOSE) and worse > _NO_RIVAL * other.white.rows
