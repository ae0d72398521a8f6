"""Rows of one step: the change of a signal, and the average of what made it change.

Over a step T the change of a rate is the integral of its derivative. From samples dt apart, for a
step of one sample,

    g_k - g_(k-1) = integral of g' dt
    integral of x dt ~ T (x_(k-1) + x_k) / 2                                     trapezoid
                     ~ T (-x_(k-2) + 13 x_(k-1) + 13 x_k - x_(k+1)) / 24         cubic

The cubic through four samples is the default, as the trapezoid makes (omega T)^2 / 12 too little of
a signal. Where a step holds h samples, each gyro value is the
mean over h of them, and the change of the mean over one step to the mean over the next is that of
the derivative under a triangle of half width T = h dt. Nothing is smoothed beyond the step, so that
rows keep their order in time, and what filters them afterwards may be causal.
"""

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.signals.smoothers import Smoothed

_CUBIC = np.array([-1.0, 13.0, 13.0, -1.0]) / 24.0
_SHORTEST = 0.002
"""s, of a step: faster samples add nothing on rigid-body motion."""
_SPACING = 0.009
"""s between the delays at which the rotors' signals are taken, about."""
_EARLIEST, _LATEST = 0.018, 0.05
"""s, by which the rotors' stamps may be early, and late."""


def step_for(dt: float) -> "OneStep":
    """The step for samples that are `dt` s apart."""
    samples = max(1, round(_SHORTEST / dt))
    time = samples * dt
    spacing = max(1, round(_SPACING / time))
    early = max(round(_EARLIEST / (spacing * time)), 1)
    late = max(round(_LATEST / (spacing * time)), 1)
    shifts = tuple(spacing * i for i in range(-early, late + 1))
    return OneStep(dt, shifts, samples)


class OneStep:
    """Averages and derivatives over one step, block by block, as of a smoother.

    Args:
        dt: s between samples.
        shifts: whole steps by which the first signals may be stamped late, rising.
        samples: h, of a step.
        mean: whether a value is the mean over a step; else it is that of one sample, whose noise
            nothing within the step can have answered.
    """

    def __init__(
        self,
        dt: float,
        shifts: tuple[int, ...] = (0,),
        samples: int = 1,
        *,
        mean: bool = True,
    ) -> None:
        h = self.step = samples
        self.time = h * dt
        """s of a step, T."""
        self.delays = np.array(shifts) * self.time
        box = np.ones(h) / h
        value = box if mean else np.ones(1)
        self._average = np.convolve(np.convolve(box, value), _CUBIC)
        change = np.convolve(value, np.concatenate([[-1.0], np.zeros(h - 1), [1.0]])) / self.time
        self._derivative = np.pad(change, (len(self._average) - len(change)) // 2)
        self._shifts = tuple(shift - shifts[0] for shift in shifts)
        # Rows of the signals themselves come first when all delays are positive.
        self._own = max(-shifts[0], 0)
        self._first = max(shifts[0], 0)
        self._reach = max(self._own, self._first + self._shifts[-1])
        self._pending: Array | None = None
        self._made: tuple[Array, Array] | None = None

    @property
    def late_taps(self) -> Array:
        """(delays, length) response of the late signals' averages to a single sample."""
        return self._responses(self._average)

    @property
    def late_slopes(self) -> Array:
        """(delays, length) the same of their derivatives, 1/s."""
        return self._responses(self._derivative)

    def _responses(self, taps: Array) -> Array:
        # What is taken from a later row has answered to the same sample earlier.
        last = self._shifts[-1]
        out = np.zeros((len(self._shifts), len(taps) + self.step * last))
        for response, shift in zip(out, self._shifts, strict=True):
            start = self.step * (last - shift)
            response[start : start + len(taps)] = taps[::-1]
        return out

    def restart(self) -> None:
        """What comes next does not join on to what came before."""
        self._pending = self._made = None

    def count_after(self, samples: int) -> int:
        """How many rows so many more samples will complete."""
        known = 0 if self._pending is None else len(self._pending)
        made = 0 if self._made is None else len(self._made[0])
        return max(made + self._makes(known + samples) - self._reach, 0)

    def _makes(self, samples: int) -> int:
        return max((samples - len(self._average)) // self.step + 1, 0)

    def update(self, signals: Array, late: int) -> Smoothed:
        """(n, m) samples to rows; the first `late` signals are taken at every delay too."""
        if self._pending is not None:
            signals = np.concatenate([self._pending, signals])
        n = self._makes(len(signals))
        self._pending = signals[n * self.step :]
        average, derivative = (
            self._filtered(signals, taps, n) for taps in (self._average, self._derivative)
        )
        if self._made is not None:
            average = np.concatenate([self._made[0], average])
            derivative = np.concatenate([self._made[1], derivative])
        count = max(len(average) - self._reach, 0)
        self._made = average[count:], derivative[count:]
        own = slice(self._own, self._own + count)
        moved = [slice(self._first + s, self._first + s + count) for s in self._shifts]
        return Smoothed(
            average[own],
            derivative[own],
            np.stack([average[m, :late] for m in moved]),
            np.stack([derivative[m, :late] for m in moved]),
        )

    def _filtered(self, signals: Array, taps: Array, n: int) -> Array:
        """(n, m) sums with weights, every step."""
        out = np.zeros((n, signals.shape[1]))
        for place, weight in enumerate(taps):
            if weight:
                out += weight * signals[place : place + (n - 1) * self.step + 1 : self.step][:n]
        return out
