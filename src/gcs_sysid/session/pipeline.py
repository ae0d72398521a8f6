"""Frames in, estimates out: the telemetry intake and the chain, tied together.

Live sessions and log analyses are two ways to drive this one class, which is why they end with
the same numbers.
"""

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

from gcs_sysid.estimation.anchors import Anchor
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.session.chain import Chain, ChainOptions
from gcs_sysid.session.result import Result
from gcs_sysid.telemetry.frames import Frame
from gcs_sysid.telemetry.intake import Intake, IntakeEvent
from gcs_sysid.telemetry.logs import Log, Telemetry

_MAX_EVENTS = 1000
_RECORDS_AT_ONCE = 4096
_SENSIBLE = (946_684_800.0, 4_102_444_800.0)
"""Unix times of the years 2000 and 2100: a record cannot be from outside."""


class Pipeline:
    """From the frames of a link or log to results.

    Args:
        airframe: with a scale anchor.
        source: what the result names as its source.
        wanted: system and perhaps component to listen to; None: the first autopilot heard.
        options: of the chain.
        anchor: sets the scale instead of the airframe's.
    """

    def __init__(
        self,
        airframe: Airframe,
        source: str,
        wanted: tuple[int, int | None] | None = None,
        options: ChainOptions | None = None,
        anchor: Anchor | None = None,
    ) -> None:
        self.source = source
        self.intake = Intake(wanted)
        self._telemetry: Telemetry = self.intake
        self._wanted = wanted
        self.chain = Chain(airframe, options, anchor)
        self._events: deque[dict[str, Any]] = deque(maxlen=_MAX_EVENTS)
        self._recorded: datetime | None = None

    def take(self, frames: Iterable[Frame]) -> bool:
        """Take frames in the order received. Returns whether the estimate was renewed."""
        renewed = False
        for frame in frames:
            record = self.intake.frame(frame)
            for event in self.intake.take_events():
                self._take_event(event)
            if record is not None and self.chain.feed(record):
                renewed = True
        return renewed

    def take_log(self, log: Log, progress: Callable[[float], None] | None = None) -> None:
        """Take a whole recording, instead of frames.

        Args:
            log: not yet read, opened for the vehicle wanted.
            progress: called with the share of the log done, 0 to 1, now and then.
        """
        self._telemetry = log
        for number, record in enumerate(log.records()):
            for event in log.take_events():
                self._take_event(event)
            self.chain.feed(record)
            if progress and number % _RECORDS_AT_ONCE == 0:
                progress(log.share_read)
        for event in log.take_events():
            self._take_event(event)
        if log.recorded is not None and _SENSIBLE[0] <= log.recorded < _SENSIBLE[1]:
            self._recorded = datetime.fromtimestamp(log.recorded, UTC)
        if progress:
            progress(1.0)

    def _take_event(self, event: IntakeEvent) -> None:
        if event.kind == "reset":
            self.chain.reset()
        else:
            self.chain.note(event.text)
        vehicle = self._telemetry.vehicle
        if event.kind == "vehicle" and vehicle is not None:
            self.chain.chooser.autopilot = vehicle.key
        if event.kind != "vehicle":
            self._events.append({"t": self.chain.t, "kind": event.kind, "text": event.text})

    def result(self) -> Result:
        """The latest estimate."""
        return self._complete(self.chain.result())

    def finish(self) -> Result:
        """The final estimate, from all that was taken."""
        return self._complete(self.chain.finish())

    def _complete(self, result: Result) -> Result:
        vehicle = self._telemetry.vehicle
        reasons = result.reasons
        if vehicle is None:
            others = ", ".join(map(str, self._telemetry.systems))
            heard = f"; heard: {others}" if others else ""
            which = " the wanted" if self._wanted else " any"
            reasons = (f"no heartbeat of{which} autopilot was heard{heard}",)
        telemetry = {**self._telemetry.as_dict(), **result.telemetry}
        if self._recorded is not None:
            telemetry["recorded"] = f"{self._recorded:%Y-%m-%d %H:%M} UTC"
        return replace(
            result,
            source=self.source,
            reasons=reasons,
            vehicle=vehicle.as_dict() if vehicle else {},
            events=tuple(sorted([*self._events, *result.events], key=lambda event: event["t"])),
            telemetry=telemetry,
        )
