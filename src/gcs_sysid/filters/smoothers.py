"""What the regression puts on every signal: averages of one side, derivatives of the other.

A smoother takes blocks of samples and gives rows; both kinds of row come from one linear filter,
so their lag is the same. Samples may be missing (NaN): rows that they would touch are NaN.
"""

from typing import Protocol

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.filters.differentiator import LinearDifferentiator
from gcs_sysid.filters.windows import cosine_window


class Smoother(Protocol):
    """A filter pair that works block by block."""

    step: int
    """Samples between rows."""

    def restart(self) -> None:
        """What comes next does not join on to what came before."""
        ...

    def update(self, signals: Array) -> tuple[Array, Array]:
        """(n, m) samples to averages and derivatives, each (rows, m)."""
        ...


class WindowSmoother:
    """The symmetric window: zero phase, finite memory. The default.

    Args:
        dt: s between samples.
        half: samples on either side of the centre.
    """

    def __init__(self, dt: float, half: int) -> None:
        self._window = cosine_window(half, dt)
        # Four rows in half a window lose next to nothing.
        self.step = max(1, half // 4)
        self._pending: Array | None = None

    def restart(self) -> None:
        """What comes next does not join on to what came before."""
        self._pending = None

    def update(self, signals: Array) -> tuple[Array, Array]:
        """(n, m) samples to averages and derivatives, each (rows, m)."""
        if self._pending is not None:
            signals = np.concatenate([self._pending, signals])
        count = max((len(signals) - self._window.length) // self.step + 1, 0)
        self._pending = signals[count * self.step :]
        if count == 0:
            return signals[:0], signals[:0]
        return (
            self._window.apply(signals, self.step),
            self._window.apply(signals, self.step, derivative=True),
        )


class DifferentiatorSmoother:
    """The linear tracking differentiator: z1 averages, z2 differentiates.

    Args:
        dt: s between samples.
        bandwidth: R, rad/s.
    """

    def __init__(self, dt: float, bandwidth: float) -> None:
        self._filter = LinearDifferentiator(dt, bandwidth)
        self.step = max(1, round(0.25 / (bandwidth * dt)))
        self._next_row = 0
        self._held: Array | None = None
        self._unsettled: Array = np.zeros(0)

    def restart(self) -> None:
        """What comes next does not join on to what came before."""
        self._filter.restart()
        self._held = None

    def update(self, signals: Array) -> tuple[Array, Array]:
        """(n, m) samples to averages and derivatives, each (rows, m)."""
        if len(signals) == 0:
            return signals, signals
        if self._held is None:
            self._held = np.zeros(signals.shape[1])
            self._unsettled = np.full(signals.shape[1], self._filter.settling)
        # A missing sample is held over, and spoils the memory until that has settled again.
        index = np.arange(len(signals))[:, None]
        missing = np.isnan(signals)
        last_there = np.maximum.accumulate(np.where(missing, -1, index))
        filled = np.where(
            last_there >= 0, np.take_along_axis(signals, np.maximum(last_there, 0), 0), self._held
        )
        self._held = filled[-1]
        last_missing = np.maximum.accumulate(np.where(missing, index, -1))
        wait = np.where(
            last_missing >= 0,
            self._filter.settling - (index - last_missing),
            self._unsettled - (index + 1),
        )
        self._unsettled = np.maximum(wait[-1], 0)
        z1, z2 = self._filter.update(filled)
        rows = slice(self._next_row, None, self.step)
        self._next_row = (self._next_row - len(signals)) % self.step
        settled = wait <= 0
        return np.where(settled, z1, np.nan)[rows], np.where(settled, z2, np.nan)[rows]
