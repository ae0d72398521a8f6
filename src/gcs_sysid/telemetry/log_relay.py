"""A log that another process reads: its blocks, each with the figures of that moment."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from gcs_sysid.signals.columns import IntakeEvent, RecordBlock
from gcs_sysid.signals.records import Record
from gcs_sysid.telemetry.clock import ClockDrift
from gcs_sysid.telemetry.logs import Log, one_by_one, open_log
from gcs_sysid.telemetry.object_pipe import ObjectSender
from gcs_sysid.telemetry.vehicles import MavlinkSystem


@dataclass(eq=False)
class LogFigures:
    """All that a `Log` says of itself, at one moment of its reading."""

    kind: str
    recorded: float | None
    vehicle: MavlinkSystem | None
    systems: list[MavlinkSystem]
    parameters: dict[str, float]
    drift: ClockDrift
    drift_ppm: float | None
    problems: tuple[str, ...]
    share_read: float
    telemetry: dict[str, Any]

    @classmethod
    def of(cls, log: Log) -> "LogFigures":
        """Those of now."""
        return cls(
            log.kind,
            log.recorded,
            log.vehicle,
            log.systems,
            log.parameters,
            log.drift,
            log.drift_ppm,
            log.problems,
            log.share_read,
            log.as_dict(),
        )


@dataclass(frozen=True)
class RelayedPart:
    """What the reading process says: figures, and the block just read, if any."""

    figures: LogFigures
    block: RecordBlock | None = None
    last: bool = False


def relayed(log: Log, sender: ObjectSender) -> Iterator[RecordBlock]:
    """The blocks of a log, each handed over to a `RelayedLog` of another process.

    Args:
        log: not yet read.
        sender: to the other process.
    """
    sender.put(RelayedPart(LogFigures.of(log)))
    for block in log.blocks():
        sender.put(RelayedPart(LogFigures.of(log), block))
        yield block
    sender.put(RelayedPart(LogFigures.of(log), last=True))


class RelayedLog(LogFigures):
    """A `Log` that another process reads; where that one ends early, it is read here.

    It says of itself what the log said when the block given last was read.

    Args:
        path: as of `open_log`.
        wanted: likewise.
        receive: the next thing that the other process handed over; raises `EOFError` when it has
            ended.
    """

    def __init__(
        self, path: Path, wanted: tuple[int, int | None] | None, receive: Callable[[], Any]
    ) -> None:
        self._path, self._wanted, self._receive = path, wanted, receive
        self._events: list[IntakeEvent] = []

    def blocks(self) -> Iterator[RecordBlock]:
        """As `Log` says.

        Raises:
            InputError: the file cannot be read, as the other process found.
        """
        given = 0
        for part in self._parts():
            self._take(part.figures)
            if part.last:
                return
            if part.block is not None:
                given += 1
                yield part.block
        # The same blocks come of the same file: on from where the other process got.
        log = open_log(self._path, self._wanted)
        self._take(LogFigures.of(log))
        for block in islice(log.blocks(), given, None):
            self._take(LogFigures.of(log))
            yield block
        self._take(LogFigures.of(log))

    def _parts(self) -> Iterator[RelayedPart]:
        while True:
            try:
                part = self._receive()
            except (EOFError, OSError):
                return
            if isinstance(part, Exception):
                raise part
            yield part

    def _take(self, figures: LogFigures) -> None:
        vars(self).update(vars(figures))

    def records(self) -> Iterator[Record]:
        """As `Log` says."""
        return one_by_one(self.blocks(), self._events)

    def take_events(self) -> list[IntakeEvent]:
        """As `Telemetry` says."""
        events = self._events[:]
        self._events.clear()
        return events

    def as_dict(self) -> dict[str, Any]:
        """As `Telemetry` says."""
        return {**self.telemetry}
