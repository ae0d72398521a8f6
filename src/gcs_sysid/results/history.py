"""The history of the estimates: how they moved over the flight, in bounded memory."""

from collections.abc import Mapping

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.status import NOTHING, Value
from gcs_sysid.model.parameters import PARAMETERS
from gcs_sysid.results.snapshot import History

MAX_POINTS = 4096


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

    def append(self, t: float, values: Mapping[str, Value]) -> None:
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

    def clear(self) -> None:
        """Forget everything."""
        self._t, self._numbers = _room()
        self._count = self._skipped = 0
        self._every = 1

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
