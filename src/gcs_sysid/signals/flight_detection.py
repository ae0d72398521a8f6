"""When the vehicle flies: what the autopilot says, else what armed rotors and height say."""

import numpy as np

from gcs_sysid.arrays import Array, Mask

TAKE_OFF = 1.0
"""s after leaving the ground that do not count yet: ground effect, and feet that slip."""
_HEIGHT = 0.3
"""m above where it stood, from which a vehicle that does not tell is believed to fly."""


class FlightDetector:
    """Marks flight on the grid, block by block; how samples are grouped does not matter."""

    def __init__(self) -> None:
        self._stood_at = -np.inf
        self._ground = np.nan

    def update(self, t: Array, in_air: Array, armed: Array, speeds: Array, position: Array) -> Mask:
        """Take a block.

        Args:
            t: (n,) s, session times.
            in_air: (n,) 1 where the autopilot says that it flies, 0 where not, NaN: not told.
            armed: (n,) the same for arming.
            speeds: (n, rotors) speeds or commands, zero where a rotor stands; NaN: not told.
            position: (n, 3) north, east, down in m; NaN: not told.

        Returns:
            (n,) whether it flies.
        """
        turn = (speeds > 0.0).all(axis=1)
        # Whoever says disarmed of a vehicle that says it flies, with all rotors turning, is not it.
        disarmed = (armed < 0.5) & ~(turn & (in_air > 0.5))
        stands = disarmed | (speeds == 0.0).all(axis=1)
        ground = _held(np.where(stands, position[:, 2], np.nan), self._ground)
        self._ground = float(ground[-1])
        # Where height or ground is not known, turning rotors must do.
        low = ground - position[:, 2] < _HEIGHT
        guess = turn & ~low
        aloft = np.where(np.isfinite(in_air), in_air > 0.5, guess) & ~stands
        stood_at = np.maximum.accumulate(np.append(self._stood_at, np.where(aloft, -np.inf, t)))
        self._stood_at = float(stood_at[-1])
        flies: Mask = aloft & (t - stood_at[1:] >= TAKE_OFF)
        return flies


def _held(values: Array, before: float) -> Array:
    """Each value, or where it is NaN the last one before it."""
    known = np.append(before, values)
    index = np.maximum.accumulate(np.where(np.isfinite(known), np.arange(len(known)), 0))
    held: Array = known[index][1:]
    return held
