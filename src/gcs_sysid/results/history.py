"""How estimates moved over a flight, kept in bounded memory, and as plots show it.

Beside them angular acceleration, as measured and as predicted.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.arrays import Array
from gcs_sysid.judgement.status import NOTHING
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import PARAMETERS
from gcs_sysid.significance import Z95

MAX_POINTS = 4096


@dataclass(frozen=True)
class History:
    """How the estimates moved over time: one row an instant.

    Attributes:
        t: (n,) seconds since the start of the session, vehicle clock.
        value: name -> (n,) values, NaN where there was none.
        std: name -> (n,) standard deviations.
    """

    t: NDArray[np.float64]
    value: dict[str, NDArray[np.float64]]
    std: dict[str, NDArray[np.float64]]


@dataclass(frozen=True)
class Acceleration:
    """Angular acceleration of the last seconds, as measured and as predicted.

    Attributes:
        t: (n,) seconds since the start of the session, vehicle clock.
        measured: (n, 3) about roll, pitch and yaw, rad/s^2.
        predicted: (n, 3) the same, each row by the estimate there was before it.
    """

    t: NDArray[np.float64]
    measured: NDArray[np.float64]
    predicted: NDArray[np.float64]

    @property
    def r_squared(self) -> NDArray[np.float64]:
        """(3,) share of the measured power that was predicted; NaN where nothing moved."""
        power = np.sum(self.measured**2, axis=0)
        error = np.sum((self.measured - self.predicted) ** 2, axis=0)
        share = 1.0 - np.divide(error, power, out=np.full(3, np.nan), where=power > 0.0)
        return np.asarray(share, dtype=np.float64)


class HistoryRecorder:
    """Keeps at most `MAX_POINTS` instants: when full, every second one goes.

    What is given out are views, not copies: an instant is written once, and in the place of one
    that was given out never.
    """

    def __init__(self) -> None:
        self._t, self._numbers = _room()
        self._count = 0
        self._every = 1
        self._skipped = 0

    def append(self, t: float, values: Mapping[str, Estimate]) -> None:
        """Add an instant."""
        self._skipped += 1
        if self._skipped < self._every:
            return
        self._skipped = 0
        if self._count == MAX_POINTS:
            times, numbers = self._t, self._numbers
            self._t, self._numbers = _room()
            self._count = MAX_POINTS // 2
            self._t[: self._count] = times[::2]
            self._numbers[:, :, : self._count] = numbers[:, :, ::2]
            self._every *= 2
        self._t[self._count] = t
        for i, name in enumerate(PARAMETERS):
            value = values.get(name, NOTHING)
            self._numbers[0, i, self._count] = np.nan if value.value is None else value.value
            self._numbers[1, i, self._count] = np.nan if value.std is None else value.std
        self._count += 1

    def history(self) -> History:
        """The instants so far; what is given out does not change any more."""
        t, numbers = self._t[: self._count], self._numbers[:, :, : self._count]
        t.flags.writeable = numbers.flags.writeable = False
        values, stds = numbers
        return History(
            t,
            dict(zip(PARAMETERS, values, strict=True)),
            dict(zip(PARAMETERS, stds, strict=True)),
        )


def _room() -> tuple[Array, Array]:
    """(m,) times and (2, parameters, m) values and standard deviations, none of them known."""
    return np.empty(MAX_POINTS), np.full((2, len(PARAMETERS), MAX_POINTS), np.nan)


def known_history(history: History, name: str) -> tuple[Array, Array, Array]:
    """(n,) times, values and halves of 95 % intervals where there is an estimate.

    Halves are NaN where there is no interval.
    """
    value = history.value.get(name, np.empty(0))
    std = history.std.get(name, np.full(value.shape, np.nan))
    known = np.isfinite(value)
    half = Z95 * std[known]
    half[~np.isfinite(half)] = np.nan
    return history.t[: len(value)][known], value[known], half


def settled_range(
    t: Array,
    values: tuple[Array, Array],
    band: tuple[Array, Array],
    also: Iterable[float] = (),
) -> tuple[float, float]:
    """The range worth looking at: all of the later half, what must be seen besides, and a margin.

    The start of a history is far off and its band is wider than the picture; letting it set the
    scale would flatten what matters.

    Args:
        t: (n,) s, rising.
        values: (n,) least and (n,) greatest value at each.
        band: (n,) ends of the 95 % intervals; NaN where there is none.
        also: values that must be seen.
    """
    late = t >= t[0] + 0.5 * (t[-1] - t[0])
    low, high = float(np.min(values[0][late])), float(np.max(values[1][late]))
    edges = np.concatenate([band[0][late], band[1][late]])
    edges = edges[np.isfinite(edges)]
    if edges.size:
        # A band far wider than the value (nothing known yet) must not hide the value's history.
        reach = 3.0 * max(abs(low), abs(high), high - low)
        low = min(low, max(float(edges.min()), low - reach))
        high = max(high, min(float(edges.max()), high + reach))
    low, high = min([low, *also]), max([high, *also])
    return with_margin(low, high)


def with_margin(low: float, high: float) -> tuple[float, float]:
    """A range with some room around it; an empty one too."""
    margin = 0.08 * (high - low) or 0.1 * abs(high) or 1.0
    return low - margin, high + margin
