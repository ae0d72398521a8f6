"""The course of the estimates: how they moved over the flight, in bounded memory."""

from collections.abc import Mapping

import numpy as np

from gcs_sysid.estimation.parameters import NOTHING, Value
from gcs_sysid.model.parameters import PARAMETERS
from gcs_sysid.session.snapshot import Course

MAX_POINTS = 4096


class CourseRecorder:
    """Keeps at most `MAX_POINTS` instants: when full, every second one goes."""

    def __init__(self) -> None:
        self._t = np.empty(MAX_POINTS)
        self._numbers = np.full((2, len(PARAMETERS), MAX_POINTS), np.nan)
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
            half = MAX_POINTS // 2
            self._t[:half] = self._t[::2].copy()
            self._numbers[:, :, :half] = self._numbers[:, :, ::2].copy()
            self._count = half
            self._every *= 2
        self._t[self._count] = t
        for i, name in enumerate(PARAMETERS):
            value = values.get(name, NOTHING)
            self._numbers[0, i, self._count] = np.nan if value.value is None else value.value
            self._numbers[1, i, self._count] = np.nan if value.std is None else value.std
        self._count += 1

    def clear(self) -> None:
        """Forget everything."""
        self._count = self._skipped = 0
        self._every = 1

    def course(self) -> Course:
        """A copy that does not change any more."""
        values, stds = self._numbers[:, :, : self._count].copy()
        return Course(
            self._t[: self._count].copy(),
            dict(zip(PARAMETERS, values, strict=True)),
            dict(zip(PARAMETERS, stds, strict=True)),
        )
