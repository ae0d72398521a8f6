"""How an unmodeled moment biases an estimate, and how it is detected.

The whiteners of a bank weigh the same data differently (`whitening`). The power of their
innovations shows whether there is a disturbance, and which whitener leaves nothing of it that a
loop has answered.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit.priors import COORDINATE_STD, Unknown
from gcs_sysid.estimation.fit.rotation import RotationFit, along
from gcs_sysid.estimation.noise.whitening import Whitener
from gcs_sysid.model import rigid_body as rb


@dataclass(frozen=True)
class DisturbanceRules:
    """From where a disturbance counts, and what it costs by commands."""

    detected: float = 1.0
    """Nats a second. Undisturbed flights of every simulator tried have 0.0 to 0.4, disturbed ones
    4 to 350, real ones 9 to 82."""
    curve: float = 0.03
    """Of the thrust curve, which air that moves with the vehicle bends: on four disturbed flights
    of an outside simulator curves of 0.4 were off by 0.003 to 0.058."""


RULES = DisturbanceRules()
AXES = np.arange(3)


@dataclass(frozen=True)
class BankTrial:
    """The fit to the data under every whitener.

    Attributes:
        whiteners: of the bank.
        time: s, T of a row.
        unknowns: (bank, N_UNKNOWNS + m), all with the same coordinates.
        variance: (bank, 3) power of the innovations, as of `BankProblem`.
        answered: (bank, 3) power of what a loop answers in them, by one and the same vehicle:
            without the known noise of rotor speeds; by commands all of it.
    """

    whiteners: Sequence[Whitener]
    time: float
    unknowns: Array
    variance: Array
    answered: Array

    @cached_property
    def pick(self) -> tuple[int, ...]:
        """Whitener of each axis: of least innovation power.

        Where a moment from outside is answered by the loop, what has to be white is that moment and
        the gyro's noise. What sensors of rotors add is in no loop, and known. Where it decides the
        whitener, which then leaves some of the moment, which biases, another is taken: that of a
        disturbance that leaves least of what is answered. Not of yaw: its noise is not measured but
        inferred from that of the other axes (`input_noise`).
        """
        pick = self.variance.argmin(axis=0)
        calm = np.array([not whitener.disturbed for whitener in self.whiteners])
        none = calm[:, None] | np.isinf(self.variance)
        answering = np.where(none, np.inf, self.answered).argmin(axis=0)
        gain = self._gain(self.answered[pick, AXES], self.answered[answering, AXES])
        shaken = self.detected > RULES.detected  # none where no whitener is of a disturbance
        shaken[2] = False
        return tuple(np.where(shaken & (gain > RULES.detected), answering, pick).tolist())

    def _gain(self, before: Array, after: Array) -> Array:
        """Nats a second, of innovations' powers."""
        return np.asarray(-0.5 * np.log(after / before) / self.time)

    @cached_property
    def detected(self) -> Array:
        """(3,) nats a second by which some whitener of a disturbance explains an axis better; NaN
        where there is none.

        g = ln(sigma of the best without disturbance / sigma of the best of all) / T
        """
        calm = [i for i, whitener in enumerate(self.whiteners) if not whitener.disturbed]
        if len(calm) == len(self.whiteners):
            return np.full(3, np.nan)
        best, best_calm = self.variance.min(axis=0), self.variance[calm].min(axis=0)
        return self._gain(best_calm, best)

    def systematic(self, fit: RotationFit, hover: float) -> Array:
        """(k, N_THETA) errors that scatter does not show, each of a cause of its own.

        Args:
            fit: with the whiteners of least innovation power.
            hover: rad^2/s^2 (1 with commands), thrust signal in hover; 0 where the air is known to
                be calm: what disturbs is then zero in the mean.
        """
        some = np.flatnonzero(self.detected[:2] > RULES.detected)
        errors = [self._trim(fit, int(axis), hover) for axis in some]
        found = np.reshape(errors, (-1, rb.N_THETA))
        return found[found.any(axis=1)]

    def _trim(self, fit: RotationFit, axis: int, hover: float) -> Array:
        """(N_THETA,) offset of the CG that the moment would hold if it were constant."""
        whitener = self.whiteners[self.pick[axis]]
        error = np.zeros(rb.N_THETA)
        if whitener.disturbed and hover > 0.0:
            r = whitener.gyro_share * float(fit.residual_covariance[axis, axis])
            moment = fit.theta[axis] * np.sqrt(whitener.strength * r)
            error[rb.CG_Y if axis == 0 else rb.CG_X] = moment / hover
        return error


def curve_doubt(fit: RotationFit, window: Callable[[], RotationFit | None]) -> Array:
    """(N_UNKNOWNS, N_UNKNOWNS) of a fit by commands, for what a disturbance does to the curve.

    Slow motion may see another curve, as in the wash of a quad that is flown hard; it is not less
    certain than before the flight. Were the curve another, all unknowns would go with it.

    Args:
        fit: to rows of one step.
        window: fits the symmetric window of the same flight.
    """
    if not fit.disturbance[:2].max() > RULES.detected:
        return np.zeros_like(fit.full_covariance)
    slow = window()
    bent = 0.0 if slow is None else abs(float((fit.unknowns - slow.unknowns)[Unknown.CURVE]))
    bent = min(bent, float(COORDINATE_STD[Unknown.CURVE - rb.N_THETA]))
    off = along(fit.full_covariance, Unknown.CURVE, math.hypot(RULES.curve, bent))
    return np.outer(off, off)
