"""The health of a vehicle while it flies: the hover of the last minutes, every few seconds."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from gcs_sysid.health.assessment import HoverRecords, beside_analysis
from gcs_sysid.health.health_file import condition_text, document_of
from gcs_sysid.health.vehicle_health import HealthOptions
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.results.result import Result
from gcs_sysid.signals.columns import RecordBlock, Track, by_key
from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.logs import Telemetry

_KEPT = 90.0
"""s of the vehicle's clock that are averaged: a baseline of 30 s and what is compared with it."""
_EVERY = 10.0
"""s of the vehicle's clock between looks: at 250 Hz each takes 0.2 s of a processor."""
_MOST_WAITING = 2000
"""Tracks that may wait to be joined, while not viewed."""
_NEW_FLIGHT = ("reboot", "reset", "vehicle")
"""Events after which what was flown before is another flight's."""


@dataclass(frozen=True)
class HoverNews:
    """Findings of a look at the hover.

    Attributes:
        document: a health file's content; its `verdict` is "refused" where nothing hovers.
        text: of a rotor that is named weak and was not before; else empty.
    """

    document: dict[str, Any]
    text: str


class HoverWatch:
    """Keeps the last minutes of records, and assesses the vehicle's health by their hover.

    Args:
        telemetry: the vehicle, and its parameters.
        source: what health names as its source.
    """

    def __init__(self, telemetry: Telemetry, source: str) -> None:
        self._telemetry = telemetry
        self._source = source
        self._kept: list[Track] = []
        self._fresh: list[Track] = []
        self._looked = -np.inf
        self._now = -np.inf
        self._named: int | None = None

    def add_records(self, block: RecordBlock) -> None:
        """The next records."""
        if any(event.kind in _NEW_FLIGHT for _, event in block.events):
            self._kept, self._fresh = [], []
            self._looked = self._now = -np.inf
            self._named = None
        for track in block.tracks:
            if track.stream is not Stream.PARAMETER and len(track.t):
                self._fresh.append(track)
                self._now = max(self._now, float(track.t[-1]))
        if len(self._fresh) > _MOST_WAITING:
            self._join()

    def look(
        self, airframe: Airframe, result: Callable[[], Result] | None = None
    ) -> HoverNews | None:
        """Findings of the hover now; None where it is not time for another look.

        Args:
            airframe: with the scale in force.
            result: the latest of the identification; called where it is time to look.
        """
        if self._now - self._looked < _EVERY:
            return None
        self._looked = self._now
        self._join()
        records = HoverRecords()
        records.begin(self._telemetry)
        records.add_records(RecordBlock(tuple(self._kept)))
        health = records.health(self._source, HealthOptions(airframe))
        if result is not None:
            latest = result()
            health = beside_analysis(health, latest)
        text = ""
        weakened = health.weakened
        if weakened is not None and weakened.condition.rotor != self._named:
            self._named = weakened.condition.rotor
            text = condition_text(weakened.condition)
        return HoverNews(document_of(health), text)

    def _join(self) -> None:
        joined = by_key([*self._kept, *by_key(self._fresh).values()])
        oldest = self._now - _KEPT
        self._kept = [track.part(track.t >= oldest) for track in joined.values()]
        self._fresh = []
