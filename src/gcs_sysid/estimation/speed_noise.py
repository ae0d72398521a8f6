"""Noise of the rotor speeds, and what it adds to the moments.

Noise on an input makes least squares underrate what that input does (errors in variables).
Where the noise is known, its part of the moments is known too and is taken out again.
"""

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.basis import WIDTH
from gcs_sysid.estimation.input_noise import THIRD_DIFFERENCE, InputNoise
from gcs_sysid.filters.smoothers import Smoother
from gcs_sysid.model import rigid_body

ROUNDING_STD = 2.0 * np.pi / 60.0 / np.sqrt(12.0)
"""rad/s, of a speed sent as a whole number of revolutions a minute."""
_FAST_ENOUGH = 0.012
"""s. Below this sample time a rotor hardly moves within four samples, so that what is left of
them after a parabola is taken out is noise; above, motion and noise cannot be told apart."""

_DH = rigid_body.SIGNALS.index("dH")


class SpeedNoise(InputNoise):
    """Follows level and noise of the rotor speeds.

    Args:
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
    """

    def __init__(self, geometry: Array, dt: float) -> None:
        self._dt = dt
        rotors = geometry.shape[1]
        super().__init__(rotors)
        self._samples = 0
        self._sums = np.zeros((2, rotors))  # of Omega and Omega^2
        self._differences = 0
        self._difference_squares = np.zeros(rotors)
        x, y, s = geometry
        self._mix = np.stack([-y, x, np.ones_like(x), s])  # roll, pitch, thrust, yaw

    def _add(self, speeds: Array) -> None:
        self._samples += len(speeds)
        self._sums += speeds.sum(axis=0), (speeds * speeds).sum(axis=0)
        joined = np.concatenate([self._last, speeds])
        self._last = joined[-3:]
        if len(joined) > 3:
            third = joined[3:] - joined[:-3] - 3.0 * (joined[2:-1] - joined[1:-2])
            self._differences += len(third)
            self._difference_squares += (third * third).sum(axis=0)

    @property
    def std(self) -> Array:
        """(rotors,) rad/s."""
        floor = np.full(self._sums.shape[1], ROUNDING_STD)
        if self._dt > _FAST_ENOUGH or self._differences < 100:
            return floor
        seen = np.sqrt(self._difference_squares / self._differences / THIRD_DIFFERENCE)
        std: Array = np.maximum(seen, floor)
        return std

    def moments(self, smoother: Smoother, memory: float) -> Array:
        """(WIDTH, WIDTH) what the noise adds to the moments of one row.

        Args:
            smoother: that made the rows.
            memory: s, of the leaky sum over the rows.
        """
        out = np.zeros((WIDTH, WIDTH))
        if self._samples == 0:
            return out
        average, derivative = smoother.noise_gains(memory)
        mean_square = self._sums[1] / self._samples
        mix, variance = self._mix, self.std**2
        out[:4, :4] = average * (mix * (4.0 * mean_square * variance)) @ mix.T
        out[_DH, _DH] = derivative * variance.sum()
        return out
