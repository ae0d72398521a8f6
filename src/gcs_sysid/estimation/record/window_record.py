"""Rows of the symmetric window in the form of whitened ones: leaks are their whiteners.

Slow samples, and a gyro behind a low-pass, show next to nothing of what happens within a step. The
window differentiates the gyro's noise, a leak integrates it again; where noise of the rotors'
inputs dominates, no leak is better.
"""

from collections.abc import Sequence

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.noise.whitening import (
    NONE,
    WhitenedMoments,
    Whitener,
    find_whiteners,
    leak,
)
from gcs_sysid.estimation.rows.actuator_dynamics import ActuatorDynamics
from gcs_sysid.estimation.rows.regression import NormalEquations


class WindowRecord:
    """Moments of rows of the window under every leak.

    Args:
        basis: of the elements.
        sums: (leaks, width, width) moments of the rows.
        memories: s, of the leaks; 0: none.
        dt: s between samples.
        time: s between rows.
        grouped: rows of a batch.
        gains: (leaks,) variance of a row's derivative over that of white noise of the gyro.
    """

    def __init__(
        self,
        basis: ActuatorDynamics,
        sums: NormalEquations,
        memories: Sequence[float],
        dt: float,
        time: float,
        grouped: int,
        gains: Array,
    ) -> None:
        self.basis, self.time, self._dt = basis, time, dt
        self.whiteners = tuple(leak(time, memory) if memory else NONE for memory in memories)
        self._sums, self._grouped, self._gains = sums, grouped, gains

    @property
    def total(self) -> Array:
        """(leaks, width, width) sum over all rows; not to be written to."""
        return self._sums.total

    @property
    def rows(self) -> int:
        """In them."""
        return self._sums.rows

    def moments(self, noise: Array) -> WhitenedMoments:
        """All that is kept, for a fit; views of it."""
        return WhitenedMoments(
            (self._sums.batches,),
            self._sums.counts,
            noise,
            self.whiteners,
            self.time,
            self._grouped,
            self._gains,
            judges=(0, 0, 0),
        )

    def places(self, whiteners: Sequence[Whitener]) -> list[int]:
        """Where whiteners are in the bank."""
        return [i or 0 for i in find_whiteners(whiteners, self.whiteners)]

    def gyro_densities(self, whiteners: Sequence[Whitener]) -> Array:
        """(3,) density of the gyro's noise over the power that it leaves in a row."""
        densities: Array = self._dt / self._gains[self.places(whiteners)]
        return densities
