"""Who carries the vehicle: a sequential test between its rotors and the ground.

In the air the specific force is thrust over mass, so that from one window to the next

    d log |f| = a d log u + v,

with u what thrust grows with (squared speeds, or commands) and a near 1: motor lag takes from it,
the thrust curve of commands adds. On the ground |f| is 1 g whatever the rotors do: a = 0. The test
adds up the log-likelihood ratio of the two (Wald 1945), with a the most likely within bounds, and v
as large as the better of the two leaves it.

It needs no report, no height and no known vehicle, and says nothing while thrust is constant. What
turns fast or reads far from 1 g stands on nothing, whatever thrust does.
"""

import math
from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array, Mask


@dataclass(frozen=True)
class GroundRules:
    """Settings of the test.

    Attributes:
        window: s, long against most motors' lags.
        slopes: of thrust that carries.
        memory: s over which the residuals' power is averaged.
        least_noise: of log |f|: what an accelerometer leaves of a mean over a window.
        step: nats that one window may add: a shock is one like others.
        one_g: m/s^2, between which the mean force of what stands lies.
        turns: rad/s, mean rate from which nothing stands.
    """

    window: float = 0.2
    slopes: tuple[float, float] = (0.5, 1.25)
    memory: float = 3.0
    least_noise: float = 0.003
    step: float = 2.0
    one_g: tuple[float, float] = (6.5, 13.5)
    turns: float = 1.0


RULES = GroundRules()
_ODDS = math.log(1000.0)
"""Nats from which it stands; until half of them are lost again."""
_MOST = np.array([0.3, 0.2])
"""Of the changes of log |f| and log u that count: a shock is one window like others."""


class GroundTest:
    """Takes samples block by block; how they are grouped does not matter."""

    def __init__(self) -> None:
        self._number = -1
        self._sums = np.zeros((2, 4))
        self._before = np.full(3, np.nan)
        self._nats = 0.0
        self._power = np.array([1e-4, 1e-4])
        self._stands = False

    def update(self, t: Array, force: Array, rates: Array, thrust: Array) -> Mask:
        """Take a block.

        Args:
            t: (n,) s.
            force: (n,) m/s^2, norm of the specific force; NaN: not measured.
            rates: (n,) rad/s, norm of the body rates.
            thrust: (n, 2) as of `FlightDetector.update`.

        Returns:
            (n,) whether the ground carries it, by the windows before each sample.
        """
        values = np.column_stack([force, rates, thrust])
        numbers = np.floor(t / RULES.window).astype(np.int64)
        starts = np.flatnonzero(np.diff(numbers, prepend=numbers[0] - 1))
        known = np.isfinite(values)
        sums = np.add.reduceat(np.where(known, values, 0.0), starts, axis=0)
        counts = np.add.reduceat(known, starts, axis=0)
        out = np.empty(len(t), bool)
        for k, start in enumerate(starts):
            if numbers[start] != self._number:
                self._close()
                self._number = int(numbers[start])
            self._sums += np.stack([sums[k], counts[k]])
            out[start : starts[k + 1] if k + 1 < len(starts) else None] = self._stands
        return out

    def _close(self) -> None:
        """Judge the window that has ended against the one before it."""
        total, count = self._sums
        mean = np.divide(total, count, out=np.full(4, np.nan), where=count > 0)
        self._sums = np.zeros((2, 4))
        shown = mean[[0, 2, 3]]  # force, squared speeds, commands
        logs = np.log(shown, out=np.full(3, np.nan), where=shown > 0.0)
        y, *changes = logs - self._before
        self._before = logs
        x = changes[0] if math.isfinite(changes[0]) else changes[1]
        if not (math.isfinite(x) and math.isfinite(y)):
            return
        y, x = np.clip([y, x], -_MOST, _MOST)
        slope = min(max(y / x, RULES.slopes[0]), RULES.slopes[1]) if x else 0.0
        squares = np.array([y * y, (y - slope * x) ** 2])
        keep = math.exp(-RULES.window / RULES.memory)
        self._power = keep * self._power + (1.0 - keep) * squares
        # Twice: differences of means that follow each other are correlated by -1/2.
        variance = 2.0 * max(float(self._power.min()), RULES.least_noise**2)
        gain = float(squares[0] - squares[1]) / (2.0 * variance)
        self._nats += min(max(gain, -RULES.step), RULES.step)
        if not (RULES.one_g[0] < mean[0] < RULES.one_g[1]) or mean[1] > RULES.turns:
            self._nats = max(self._nats, 0.0)
        self._nats = min(max(self._nats, -_ODDS), _ODDS)
        self._stands = self._nats < -0.5 * _ODDS if self._stands else self._nats <= -_ODDS
