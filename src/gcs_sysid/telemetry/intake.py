"""From frames to records of one vehicle: the part that live sessions and logs share."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from gcs_sysid.records import Record, Stream
from gcs_sysid.telemetry.decode import RecordDecoder
from gcs_sysid.telemetry.frames import Frame, Validity
from gcs_sysid.telemetry.marks import is_reset_mark
from gcs_sysid.telemetry.messages import MESSAGE_IDS
from gcs_sysid.telemetry.monitor import LinkHealth, Monitor
from gcs_sysid.telemetry.outgoing import OWN_SYSTEM
from gcs_sysid.telemetry.vehicles import Vehicle, VehicleSelector

FATES = ("used", "not needed", "passed over", "dropped", "others")
_HEARTBEAT = MESSAGE_IDS["HEARTBEAT"]


@dataclass(frozen=True)
class IntakeEvent:
    """Something that happened on the way."""

    t: float
    """Vehicle time, s; after a reboot in the new count."""
    kind: str
    """"vehicle" (chosen), "vehicles" (another one that could be meant), "reboot" or "reset" (the
    user had the estimate begin anew)."""
    text: str


class Intake:
    """Takes the frames of a link or a log, gives the records of the chosen vehicle.

    Frames from before the vehicle's first heartbeat make no records.

    Attributes:
        selector: who was heard, who was chosen.
        decoder: makes the records; its `dropped` and `clock` are worth showing.
        monitor: counts and rates.
        turning: names of the messages that have told of all their rotors turning.
        fates: what became of the frames whose checksum is right, all of them: "used" (made a
            record), "not needed" (of a type that tells nothing for identification), "passed over"
            (a better message tells the same, or nothing new), "dropped" (see the decoder's),
            "others" (not the vehicle's, or before its first heartbeat).
        garbage_bytes: set by the caller, from `Receiver` or `TlogReader`.
    """

    def __init__(self, wanted: tuple[int, int | None] | None = None) -> None:
        self.selector = VehicleSelector(wanted)
        self.decoder = RecordDecoder()
        self.monitor = Monitor()
        self.turning: set[str] = set()
        self.fates = Counter(dict.fromkeys(FATES, 0))
        self.garbage_bytes = 0
        self._others: set[tuple[int, int]] = set()
        self._events: list[IntakeEvent] = []

    @property
    def vehicle(self) -> Vehicle | None:
        """The chosen vehicle; None until it has sent a heartbeat."""
        return self.selector.chosen

    @property
    def systems(self) -> list[Vehicle]:
        """All systems heard, in the order heard."""
        return list(self.selector.systems.values())

    @property
    def parameters(self) -> dict[str, float]:
        """The vehicle's parameters heard so far."""
        return self.decoder.parameters

    @property
    def clock(self) -> float | None:
        """The latest time on the vehicle's clock, s."""
        return self.decoder.clock.now

    def frames(self, frames: Iterable[Frame]) -> list[Record]:
        """Take frames in the order received; the records they make."""
        records: list[Record] = []
        for frame in frames:
            record = self.frame(frame)
            if record is not None:
                records.append(record)
        return records

    def frame(self, frame: Frame) -> Record | None:
        """Take one frame; the record it makes, if any."""
        if frame.system == OWN_SYSTEM and frame.valid is Validity.OK and is_reset_mark(frame):
            self._note("reset", "estimate reset by the user")
            return None
        self.monitor.take(frame)
        if frame.valid is not Validity.OK:
            chosen = self.selector.chosen
            if chosen is not None and (frame.system, frame.component) == chosen.address:
                self.monitor.take_chosen(frame, self.clock)
            return None
        known = self.selector.chosen is not None
        is_chosen = self.selector.take(frame)
        if frame.message_id == _HEARTBEAT:
            self._note_other((frame.system, frame.component))
        if not is_chosen:
            self.fates["others"] += 1
            return None
        clock = self.decoder.clock
        reboots = clock.reboots
        before = clock.now
        record = self.decoder.decode(frame)
        self.fates["used" if record is not None else self._why_unused(frame)] += 1
        if not known:
            self._note("vehicle", f"{self.selector.chosen} heard")
        if clock.reboots != reboots:
            self._note("reboot", f"the vehicle's clock went back from {before:.1f} s: reboot")
        self.monitor.take_chosen(frame, clock.now)
        if record is not None:
            self.monitor.take_record(record)
            if record.stream is Stream.ROTOR_SPEED and record.source not in self.turning:
                self._note_turning(record)
        return record

    def _why_unused(self, frame: Frame) -> str:
        """The fate of the vehicle's latest frame, which made no record."""
        if not self.decoder.reads(frame.message_id):
            return "not needed"
        dropped = self.decoder.dropped.total()
        if dropped == self.fates["dropped"]:
            return "passed over"
        return "dropped"

    def take_events(self) -> list[IntakeEvent]:
        """What happened since this was last asked."""
        events, self._events = self._events, []
        return events

    def health(self) -> LinkHealth:
        """Figures of the moment, for the live screen."""
        return self.monitor.health(self.garbage_bytes)

    def as_dict(self) -> dict[str, Any]:
        """The result's `telemetry`."""
        return {
            **self.monitor.as_dict(map(str, self.selector.systems.values()), self.garbage_bytes),
            "reboots": self.decoder.clock.reboots,
            "dropped": dict(self.decoder.dropped),
            "fates": dict(self.fates),
        }

    def _note_other(self, who: tuple[int, int]) -> None:
        """Tell of a vehicle that could be meant as well, when the user chose none."""
        chosen, other = self.selector.chosen, self.selector.systems.get(who)
        if chosen is None or other is None or self.selector.wanted is not None:
            return
        if other.is_autopilot and who != chosen.address and who not in self._others:
            self._others.add(who)
            self._note(
                "vehicles",
                f"more than one vehicle speaks: {other} too; using {chosen}, the first heard "
                f"(choose with --vehicle {other.system}:{other.component})",
            )

    def _note_turning(self, record: Record) -> None:
        # Outputs without a motor stay at zero in messages that have room for more.
        if sum(1 for speed in record.values if speed) >= min(4, len(record.values)):
            self.turning.add(record.source)

    def _note(self, kind: str, text: str) -> None:
        self._events.append(IntakeEvent(self.clock or 0.0, kind, text))
        del self._events[:-1000]  # nobody asks: keep it bounded
