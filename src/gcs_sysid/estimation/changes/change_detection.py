"""Alarms in flight: a sequential test on what a reference fit leaves unexplained.

Means over a quarter of a second of the four residuals of a reference (`change_reference`), less
their level in the flight so far, enter two-sided sums (CUSUM: E. S. Page, Continuous inspection
schemes, Biometrika 41, 1954). In gusts, a mass that changes at once shows sooner in thrust's jumps
from one twentieth of a second to the next but one. Both count in standard deviations of just such
values, so that gusts and colored noise raise the level, not the alarm rate. An alarm is not yet a
change: `change_hypotheses` classifies it.

The level is that of mean outputs and inputs: a better reference has another one at once.
"""

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.changes.change_reference import N_X, TOTAL, Reference

Channel = Literal["thrust", "roll", "pitch", "yaw"]
CHANNELS: tuple[Channel, ...] = get_args(Channel)


@dataclass(frozen=True)
class ChangeTuning:
    """Settings of the test; allowance, clip and threshold are in noise levels.

    Attributes:
        parts: of a frame, between which thrust may jump.
        part: s, length of each.
        warm_up: s of residuals before a channel is tested.
        memory: s over which mean and noise level are tracked.
        allowance: what a mean may deviate without being counted.
        clip: what it counts at most, so that one alone cannot alarm; and what thrust must jump from
            one part to the next but one.
        threshold: of the sum.
        least_share: floor of the noise level, as a share of the hover's thrust or of the
            torque that all of it would make at a rotor's arm.
    """

    parts: int = 5
    part: float = 0.05
    warm_up: float = 3.0
    memory: float = 5.0
    allowance: float = 3.0
    clip: float = 8.0
    threshold: float = 10.0
    least_share: float = 0.0025

    @property
    def frame(self) -> float:
        """s, length of the means."""
        return self.parts * self.part


class FrameTest:
    """Watches means of flight against a reference.

    Args:
        geometry: (3, rotors) of the airframe.
        tuning: settings.
    """

    def __init__(self, geometry: Array, tuning: ChangeTuning) -> None:
        self._tuning = tuning
        self._needed = max(round(tuning.warm_up / tuning.frame), 2)
        self.reference = Reference(geometry, np.full((4, N_X), np.nan))
        """In force."""
        # Of each channel, over frames in which nothing was suspected.
        self._y, self._x = np.zeros(4), np.zeros((4, N_X))
        self._variance, self._count = np.zeros(4), np.zeros(4)
        self._jump_variance = 0.0
        self._sums, self._began = np.zeros((4, 2)), np.zeros((4, 2))
        self._settles = False

    def clear(self) -> None:
        """A gap: forget what was suspected."""
        self._sums[:] = 0.0

    def arm(self, found: Reference) -> None:
        """Use a reference on the channels that it can watch; noise levels are kept."""
        before = self.reference
        # A channel that was watched already stays so, with the reference it had.
        matrix = np.where(found.watched[:, None], found.matrix, before.matrix)
        self._count[~before.watched] = 0.0
        self.reference = replace(found if found.watched.any() else before, matrix=matrix)

    def update(self, y: Array, x: Array, jumps: Array, t: float) -> tuple[Channel, float] | None:
        """Take a frame.

        Args:
            y: (4,) mean outputs; NaN where they are missing.
            x: (N_X,) mean inputs; NaN where most are missing.
            jumps: (parts,) of thrust's residual, by each part; NaN where they are not known.
            t: s, session time at which it begins.

        Returns:
            The channel farthest off of an alarm, and when it began.
        """
        if np.isnan(x).any():
            return None
        tuning, count = self._tuning, self._count
        matrix = self.reference.matrix
        new = count == 0.0
        self._y[new], self._x[new] = y[new], x
        off = (y - self._y) - np.sum(matrix * (x - self._x), axis=1)
        floor = tuning.least_share * self.reference.floors(1.0) * self._x[:, TOTAL]
        std = np.maximum(np.sqrt(self._variance), np.maximum(floor, 1e-12))
        beyond = np.abs(off) > tuning.allowance * std
        if self._settles:
            # After an alarm: go on from what residuals are now, with the scatter they had.
            self._settles = False
            self._y[beyond] += off[beyond]
            return None
        z = np.where(count < self._needed, np.nan, off / std)[:, None] * [1.0, -1.0]
        step = np.nan_to_num(np.minimum(z, tuning.clip) - tuning.allowance)
        self._began[self._sums == 0.0] = t
        self._sums = np.maximum(self._sums + step, 0.0)
        over = self._sums > tuning.threshold
        jumps = np.nan_to_num(jumps)
        usual = max(self._jump_variance**0.5, float(floor[0]), 1e-12)
        leap = int(np.argmax(np.abs(jumps)))
        leaps = count[0] >= self._needed and abs(jumps[leap]) > tuning.clip * usual
        if leaps or over.any():
            farthest = int(np.argmax(np.nan_to_num(np.abs(off) / std) * over.any(axis=1)))
            began = self._began[farthest][over[farthest]]
            self._sums[:], self._settles = 0.0, True
            if leaps:
                return "thrust", t + (leap - 1) * tuning.part
            return CHANNELS[farthest], float(began[0])
        # While a deviation builds up in a sum, levels are frozen: it alarms, or decays.
        learns = np.isfinite(off) & ~self._sums.any(axis=1)
        gain = np.where(learns, np.maximum(1.0 / (count + 1.0), tuning.frame / tuning.memory), 0.0)
        # What is far off counts less: in the warm-up, as later it is an alarm or in a sum.
        near = np.clip(off, -tuning.clip * std, tuning.clip * std)
        self._y += gain * np.nan_to_num(y - (off - near) - self._y)
        self._x += gain[:, None] * (x - self._x)
        self._variance += gain * np.nan_to_num(near * near - self._variance)
        jumps = np.clip(jumps, -tuning.clip * usual, tuning.clip * usual)
        self._jump_variance += gain[0] * (float(np.mean(jumps * jumps)) - self._jump_variance)
        self._count = count + learns
        return None
