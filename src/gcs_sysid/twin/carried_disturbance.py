"""Unmodeled moments, known up to the start of a stretch and extrapolated from there.

Wind, a CG that the whiteners cannot distinguish from it, and unequal rotors leave a lasting angular
acceleration. The residual of one step of the model, averaged over the past with a memory m,

    d_k = (1 - a) sum_i a^i (w - w_model)_(k-i) / dt ,   a = exp(-dt / m),

is added to the model's at the start of a stretch and fades, d(t) = d exp(-t / tau): the forecast of
an Ornstein-Uhlenbeck moment. Memory and fading of each axis are those that predict best in a part
of the flight that is not judged; an axis without anything that lasts has none.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.model.parameters import AXES
from gcs_sysid.signals.recursions import lfilter

_MEMORIES = (0.03, 0.1, 0.3, 1.0)
"""s."""
_AHEAD = (0.3, 1.0)
"""s ahead at which they are compared."""
_LEAST = 0.3
"""Nats over these lengths, by which the power of the errors must fall: of noise alone nothing is
carried (20 draws of 12 s in the tests)."""


@dataclass(frozen=True)
class Carried:
    """How a disturbance is carried on, by axis.

    Attributes:
        memory: (3,) s, of the average before the start; 0: nothing is carried on.
        fading: (3,) s.
        rms: (3,) rad/s^2 of what is carried on.
    """

    memory: Array
    fading: Array
    rms: Array

    @property
    def any(self) -> bool:
        """Whether there is any."""
        return bool(self.memory.any())

    @property
    def says(self) -> str:
        """In words, what is carried on."""
        return ", ".join(
            f"{axis} {self.rms[i]:.2g} rad/s^2 rms, fading over {self.fading[i]:g} s"
            for i, axis in enumerate(AXES)
            if self.memory[i]
        )

    def at(self, left: Array, dt: float) -> Array:
        """(n, 3) rad/s^2 known at each sample of a gapless part.

        Args:
            left: (n, 3) sums of what one step leaves, as of `MeasuredFlight.one_step`.
            dt: s.
        """
        out = np.zeros_like(left)
        for axis in np.flatnonzero(self.memory):
            out[:, axis] = _averaged(left[:, axis], dt, float(self.memory[axis]))
        return out

    def forecast(self, now: Array, steps: int, dt: float) -> Array:
        """(k, steps, 3) rad/s^2 of every step after k instants, at which (k, 3) is known."""
        middle = dt * (np.arange(steps) + 0.5)
        fading = np.where(self.memory > 0.0, self.fading, 1.0)
        out: Array = now[:, None, :] * np.exp(-middle[:, None] / fading)
        return out


NOTHING_CARRIED = Carried(np.zeros(3), np.zeros(3), np.zeros(3))


def choose_carried(lefts: Sequence[Array], dt: float) -> Carried:
    """The memory and fading of each axis that predict best.

    Args:
        lefts: (n, 3) sums of what one step leaves, of every gapless part.
        dt: s.
    """
    memory, fading, rms = np.zeros(3), np.zeros(3), np.zeros(3)
    ahead = [round(seconds / dt) for seconds in _AHEAD]
    # Compared every 20 ms.
    stride, first = max(1, round(0.02 / dt)), round(max(_MEMORIES) / dt)
    there = [left for left in lefts if len(left) > first + ahead[-1] + stride]
    if not there:
        return NOTHING_CARRIED
    for axis in range(3):
        columns = [left[:, axis] for left in there]
        at = [np.arange(first, len(c) - ahead[-1], stride) for c in columns]
        rise = [
            np.concatenate([c[i + n] - c[i] for c, i in zip(columns, at, strict=True)])
            for n in ahead
        ]
        alone = sum(math.log(max(float((r**2).mean()), 1e-300)) for r in rise)
        best = alone - _LEAST
        for m in _MEMORIES:
            d = np.concatenate([_averaged(c, dt, m)[i] for c, i in zip(columns, at, strict=True)])
            for tau in (0.1, 0.3, 1.0, 3.0, 10.0):
                gains = [tau * (1.0 - math.exp(-n * dt / tau)) for n in ahead]
                score = sum(
                    math.log(max(float(((r - g * d) ** 2).mean()), 1e-300))
                    for r, g in zip(rise, gains, strict=True)
                )
                if score < best:
                    best, memory[axis], fading[axis] = score, m, tau
                    rms[axis] = math.sqrt(float((d**2).mean()))
    return Carried(memory, fading, rms)


def _averaged(left: Array, dt: float, memory: float) -> Array:
    """(n,) rad/s^2, leaky average of the past of (n,) sums."""
    a = math.exp(-dt / memory)
    steps = np.diff(left, prepend=left[:1])[:, None] / dt
    out, _ = lfilter([1.0 - a], [1.0, -a], steps)
    return np.asarray(out)[:, 0]
