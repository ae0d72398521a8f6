"""What is known about the rotational parameters before a flight, or from before a change.

A prior is Gaussian and may cover some parameters, or combinations of them, and leave the rest
open. It is kept as information, the inverse of a covariance, so that nothing known is zero.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation.rows.actuator_dynamics import N_COORDINATES, Coordinate
from gcs_sysid.model import rigid_body as rb

N_UNKNOWNS = rb.N_THETA + N_COORDINATES
"""theta, then the coordinates: rotor delay, motor lag, thrust curve, and the lag's nuisances."""
COORDINATES = slice(rb.N_THETA, N_UNKNOWNS)


class Unknown(IntEnum):
    """Indices of the coordinates among the unknowns; theta's are those of `rigid_body`."""

    DELAY = rb.N_THETA + Coordinate.DELAY
    LAG = rb.N_THETA + Coordinate.LAG
    CURVE = rb.N_THETA + Coordinate.CURVE
    ASYMMETRY = rb.N_THETA + Coordinate.ASYMMETRY
    EXPONENT = rb.N_THETA + Coordinate.EXPONENT


COORDINATE_MEAN = np.array([0.0, 0.05, 0.5, 0.0, 0.0])
COORDINATE_STD = np.array([0.03, 0.05, 0.5, 0.4, 0.5])
"""s, s, 1, 1 and 1; keep delay, lag, curve, asymmetry and exponent of the lag at usual values while
the flight does not determine them. Simulators and motors on the bench have an asymmetry of 0 to
0.7."""


@dataclass(frozen=True)
class Prior:
    """Knowledge about theta (relative to k_T) and the basis' coordinates.

    Attributes:
        mean: (N_UNKNOWNS,) in theta's units, s, s and 1; any number where nothing is known.
        information: (N_UNKNOWNS, N_UNKNOWNS) inverse covariance, zeros where nothing is known.
    """

    mean: Array
    information: Array

    def pull(self, unknowns: Array) -> Array:
        """(..., N_UNKNOWNS) downhill gradient of half the cost at (..., N_UNKNOWNS) unknowns."""
        return (self.mean - unknowns) @ self.information

    def cost(self, unknowns: Array) -> Array:
        """(...) squared distance from the mean, in standard deviations."""
        return np.sum((self.mean - unknowns) * self.pull(unknowns), axis=-1)

    @property
    def thrust_curve(self) -> tuple[float, float]:
        """Mean and standard deviation; NaN and infinity where nothing is known."""
        known = np.flatnonzero(self.known)
        place = np.flatnonzero(known == Unknown.CURVE)
        if not len(place):
            return np.nan, np.inf
        d = np.sqrt(np.diag(self.information)[known])
        covariance = np.linalg.inv(self.information[np.ix_(known, known)] / np.outer(d, d))
        i = int(place[0])
        return float(self.mean[known[i]]), float(np.sqrt(covariance[i, i])) / float(d[i])

    @property
    def known(self) -> Mask:
        """(N_UNKNOWNS,) which unknowns it covers."""
        return np.diag(self.information) > 0.0
