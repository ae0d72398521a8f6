"""The program's way through a change in flight, or the plain way where it has none yet."""

from dataclasses import dataclass, field
from typing import Any

from benchmarks.accuracy.flights import part
from gcs_sysid.arrays import Array
from gcs_sysid.estimation.changes import ChangeDetector, ChangeTuning
from gcs_sysid.estimation.online import Fit, OnlineEstimator, Tuning
from gcs_sysid.estimation.regression import Samples


@dataclass
class _Closed:
    fit: Fit


@dataclass
class _Plain:
    """Estimator and detector; a detection ends the one and starts a new one without memory."""

    geometry: Array
    dt: float
    tuning: Tuning
    changes: ChangeTuning
    events: list[Any] = field(default_factory=list)
    segments: list[_Closed] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._detector = ChangeDetector(self.geometry, self.dt, self.changes)
        self._estimator = OnlineEstimator(self.geometry, self.dt, self.tuning)
        self._since, self._arm_at = 0.0, 3.0

    def update(self, t: Array, samples: Samples) -> bool:
        found = self._detector.update(samples)
        for change in found:
            self.events.append(change)
            self.segments.append(_Closed(self._estimator.fit()))
            self._estimator = OnlineEstimator(self.geometry, self.dt, self.tuning)
            self._since, self._arm_at = 0.0, 3.0
            after = round((self._detector.seconds - change.detected) / self.dt)
            samples = part(samples, slice(max(len(samples.gyro) - after, 0), None))
        self._estimator.update(samples)
        self._since += len(samples.gyro) * self.dt
        if self._since >= self._arm_at:
            self._arm_at = self._since + 1.0
            self._detector.arm(self._estimator.fit(quick=True))
        return bool(found)

    def fit(self, *, quick: bool = False) -> Fit:
        return self._estimator.fit(quick=quick)


def make(geometry: Array, dt: float) -> Any:
    """Follows a vehicle through its changes."""
    try:
        from gcs_sysid.estimation.tracking import Tracker
    except ImportError:
        return _Plain(geometry, dt, Tuning(), ChangeTuning())
    return Tracker(geometry, dt, Tuning(), ChangeTuning())
