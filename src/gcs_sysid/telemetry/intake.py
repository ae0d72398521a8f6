"""From frames to records of one vehicle: the part that live sessions and logs share."""

from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.signals.columns import IntakeEvent, RecordBlock
from gcs_sysid.signals.records import Record, Stream
from gcs_sysid.telemetry.block_decode import BlockDecoder
from gcs_sysid.telemetry.clock import ClockDrift
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frame_block import BAD_CRC, OK, FrameBlock, counts_of
from gcs_sysid.telemetry.frames import Frame, Validity
from gcs_sysid.telemetry.marks import is_reset_mark
from gcs_sysid.telemetry.messages import MESSAGE_IDS, picker
from gcs_sysid.telemetry.monitor import LinkHealth, Monitor
from gcs_sysid.telemetry.outgoing import OWN_SYSTEM
from gcs_sysid.telemetry.senders import Contradictions
from gcs_sysid.telemetry.track_collector import TrackCollector
from gcs_sysid.telemetry.vehicles import Vehicle, VehicleSelector

FATES = ("used", "not needed", "passed over", "dropped", "others")
_HEARTBEAT = MESSAGE_IDS["HEARTBEAT"]
_STATUSTEXT = MESSAGE_IDS["STATUSTEXT"]
_heartbeat = picker("HEARTBEAT", "type", "autopilot", "base_mode")
_RARE = [MESSAGE_IDS[name] for name in ("HEARTBEAT", "EXTENDED_SYS_STATE", "PARAM_VALUE")]
_MOST_OTHERS_TOLD = 4
"""Vehicles that are told of one by one; a hostile sender can make up hundreds."""
_MORE = 3
"""Times the messages of the chosen vehicle, from which another is told of when all is not well."""
_LEAST_SINGLE = 64
"""Frames taken one by one where a block cannot be read at once; doubled while that goes on."""


class Intake:
    """Takes the frames of a link or a log, gives the records of the chosen vehicle.

    Frames from before the vehicle's first heartbeat make no records.

    Attributes:
        selector: who was heard, who was chosen.
        decoder: makes the records; its `dropped` and `clock` are worth showing.
        monitor: counts and rates.
        drift: of the vehicle's clock, by the times at which frames came, as far as they are told.
        turning: names of the messages that have told of all their rotors turning.
        fates: what became of the frames whose checksum is right, all of them: "used" (made a
            record), "not needed" (of a type that tells nothing for identification), "passed over"
            (a better message tells the same, or nothing new), "dropped" (see the decoder's),
            "others" (not the vehicle's, or before its first heartbeat).
        garbage_bytes: set by the caller, from `Receiver` or `TlogReader`.
    """

    def __init__(self, wanted: tuple[int, int | None] | None = None) -> None:
        self.selector = VehicleSelector(wanted)
        self.decoder = BlockDecoder()
        self.monitor = Monitor()
        self.drift = ClockDrift()
        self.turning: set[str] = set()
        self.fates = Counter(dict.fromkeys(FATES, 0))
        self.garbage_bytes = 0
        self._others: set[tuple[int, int]] = set()
        self._contradictions = Contradictions()
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

    def frames(self, frames: Iterable[Frame], wall: float | None = None) -> list[Record]:
        """Take frames in the order received; the records they make. See `frame`."""
        records: list[Record] = []
        for frame in frames:
            record = self.frame(frame, wall)
            if record is not None:
                records.append(record)
        return records

    def frame(self, frame: Frame, wall: float | None = None) -> Record | None:
        """Take one frame; the record it makes, if any.

        Args:
            frame: as it came.
            wall: when it came, s, of any clock that runs on evenly; None: not known.
        """
        if frame.system == OWN_SYSTEM and frame.valid is Validity.OK and is_reset_mark(frame):
            self._note("reset", "estimate reset by the user")
            return None
        self.monitor.take(frame)
        if frame.valid is not Validity.OK:
            chosen = self.selector.chosen
            if chosen is not None and (frame.system, frame.component) == chosen.address:
                self.monitor.take_chosen(frame, self.clock)
            return None
        first = self.selector.chosen
        known = first is not None
        is_chosen = self.selector.take(frame)
        if first is not None and not is_chosen and self.clock is None:
            is_chosen = self.selector.go_over(frame)
            if is_chosen:
                self._begin_anew(first)
        if frame.message_id == _HEARTBEAT:
            self._hear(frame)
        if not is_chosen:
            self.fates["others"] += 1
            return None
        clock = self.decoder.clock
        reboots = clock.reboots
        before = clock.now
        dropped = self.decoder.dropped_messages
        record = self.decoder.decode(frame)
        if record is not None:
            self.fates["used"] += 1
        elif not self.decoder.reads(frame.message_id):
            self.fates["not needed"] += 1
        else:
            new = self.decoder.dropped_messages != dropped
            self.fates["dropped" if new else "passed over"] += 1
        if not known:
            self._note("vehicle", f"{self.selector.chosen} heard")
        if clock.reboots != reboots:
            self._note("reboot", f"the vehicle's clock went back from {before:.1f} s: reboot")
        self.monitor.take_chosen(frame, clock.now)
        if record is not None:
            self.monitor.take_record(record)
            if record.stream is Stream.ROTOR_SPEED and record.source not in self.turning:
                self._note_turning(record.source, np.array([record.values]))
            if wall is not None and clock.now is not None:
                self.drift.take(clock.now, wall)
        return record

    def block(self, frames: FrameBlock) -> RecordBlock:
        """Take many frames; the records that `frame` would make of them.

        What happened on the way is told in the block, and not by `take_events` again.
        """
        out = TrackCollector()
        at, single = 0, _LEAST_SINGLE
        while at < len(frames):
            done = 0
            if not self._is_doubtful:
                done = self._take_block(frames.part(at, len(frames)), out)
            at += done
            # Most often one frame is unusual, but it may be all of them.
            single = 2 * single if done < single else _LEAST_SINGLE
            if self.selector.chosen is None:  # a heartbeat comes, perhaps that of the vehicle
                single = 1
            doubtful = self._is_doubtful
            if doubtful:
                single = len(frames)
            for time_us, frame in frames.part(at, at + single):
                self._take_single(frames.number + at, time_us, frame, out)
                at += 1
                if doubtful and self.clock is not None:
                    break
        block = out.block()
        for track in block.tracks:
            if track.stream is Stream.ROTOR_SPEED:
                self._note_turning(track.source, track.values)
        return block

    def _take_block(self, frames: FrameBlock, out: TrackCollector) -> int:
        """Take frames up to one that only `frame` can take; returns how many."""
        chosen = self.selector.chosen
        good = frames.validity == OK
        marks = good & (frames.system == OWN_SYSTEM) & (frames.message_id == _STATUSTEXT)
        if marks.any():
            stop = int(np.argmax(marks))
            frames, good = frames.part(0, stop), good[:stop]
        beats = good & (frames.message_id == _HEARTBEAT)
        if chosen is not None and self._may_go_over:
            # Another vehicle's heartbeat: which of them is meant, is decided frame by frame.
            others = beats & ~self._from(frames, chosen)
            stop = int(np.argmax(others)) if others.any() else len(frames)
            frames, good, beats = frames.part(0, stop), good[:stop], beats[:stop]
            if not stop:
                return 0
        if chosen is None:
            stop = int(np.argmax(beats)) if beats.any() else len(frames)
            self._count(frames.part(0, stop))
            self.fates["others"] += int(np.count_nonzero(good[:stop]))
            return stop
        chosens = self._from(frames, chosen)
        others = good & ~chosens
        good &= chosens
        dropped = self.decoder.dropped_messages
        taken = self.decoder.take(frames, good, out)
        stop = taken.frames
        frames = frames.part(0, stop)
        beats, chosens, good = beats[:stop], chosens[:stop], good[:stop]
        self._count(frames)
        now = taken.moments.after(frames.number + np.arange(stop))
        self.monitor.take_chosen_block(
            frames.message_id[chosens],
            frames.sequence[chosens],
            frames.size[chosens],
            now[chosens],
            frames.validity[chosens] == BAD_CRC,
        )
        self.monitor.take_imu_times(taken.imu_times)
        rare = beats | (good & np.isin(frames.message_id, _RARE))
        clock = self.decoder.clock
        end = clock.now
        for row in np.flatnonzero(rare).tolist():
            clock.now = float(now[row])
            self._take_rare(frames.number + row, frames.frame(row), out)
        clock.now = end
        made = out.orders(frames.number) - frames.number
        fates = {
            "used": len(made),
            "not needed": sum(
                count
                for message_id, count in counts_of(frames.message_id[good]).items()
                if not self.decoder.reads(message_id)
            ),
            "dropped": self.decoder.dropped_messages - dropped,
        }
        fates["passed over"] = int(np.count_nonzero(good)) - sum(fates.values())
        self.fates.update(fates, others=int(np.count_nonzero(others[:stop])))
        self.drift.take_block(now[made], frames.time_us[made] * 1e-6)
        return stop

    @staticmethod
    def _from(frames: FrameBlock, vehicle: Vehicle) -> Mask:
        mask: Mask = (frames.system == vehicle.system) & (frames.component == vehicle.component)
        return mask

    def _count(self, frames: FrameBlock) -> None:
        self.monitor.take_block(frames.validity)
        good = frames.validity == OK
        self.selector.take_block(frames.system[good], frames.component[good])

    def _take_rare(self, order: int, frame: Frame, out: TrackCollector) -> None:
        """Take a message of a block that no columns are made of."""
        if frame.message_id == _HEARTBEAT:
            self.selector.hear(frame)
            self._hear(frame)
        record = self.decoder.decode(frame) if self.selector.is_chosen(frame) else None
        self._put(order, record, out)

    def _take_single(self, order: int, time_us: int, frame: Frame, out: TrackCollector) -> None:
        self._put(order, self.frame(frame, time_us * 1e-6), out)

    def _put(self, order: int, record: Record | None, out: TrackCollector) -> None:
        out.events += [(order, event) for event in self.take_events()]
        if record is not None:
            out.add_record(order, record)

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

    @property
    def _is_doubtful(self) -> bool:
        """Whether it may be another vehicle, of which there is one."""
        return self._may_go_over and len(self.selector.autopilots) > 1

    @property
    def _may_go_over(self) -> bool:
        """Whether the chosen vehicle, chosen by nobody, has told nothing but heartbeats yet."""
        selector = self.selector
        return selector.chosen is not None and selector.wanted is None and self.clock is None

    def _begin_anew(self, first: Vehicle) -> None:
        """Another vehicle is the chosen one: of the first there were heartbeats alone."""
        self._others.add(first.address)  # told of here
        self.decoder = BlockDecoder()
        self._contradictions = Contradictions()
        self.monitor.begin_anew()
        self._note(
            "vehicles",
            f"{first}, the first heard, sends nothing but heartbeats: "
            f"using {self.vehicle}, whose IMU data come",
        )

    @property
    def problems(self) -> tuple[str, ...]:
        """Why what comes may not be the vehicle's, one line each."""
        return (*self._contradicting, *self._others_told_more)

    @property
    def _others_told_more(self) -> tuple[str, ...]:
        chosen, frames = self.selector.chosen, self.selector.frames
        if chosen is None or self.selector.wanted is not None:
            return ()
        counts = {each: frames.get(each.address, 0) for each in self.selector.autopilots}
        own, most = frames.get(chosen.address, 0), max(counts, key=counts.__getitem__, default=None)
        if most is None or counts[most] <= _MORE * own:
            return ()
        return (
            f"{most} sent {counts[most]} messages, {chosen}, the first heard, {own}: choose it "
            f"with --vehicle {most.system}:{most.component}",
        )

    @property
    def _contradicting(self) -> tuple[str, ...]:
        if not self._contradictions.found:
            return ()
        return (
            f"the heartbeats of {self.vehicle} contradict each other: somebody else sends in its "
            "name too, and may hide that it flies; the autopilot's own log (.ulg, .bin) knows, and "
            "signing (--signing-key) keeps them out",
        )

    def _hear(self, heartbeat: Frame) -> None:
        """See whether a heartbeat is of another vehicle, or of somebody who poses as this one."""
        chosen, who = self.selector.chosen, (heartbeat.system, heartbeat.component)
        if chosen is None:
            return
        if who != chosen.address:
            self._note_other(chosen, who)
            return
        vehicle_type, autopilot, mode = _heartbeat(heartbeat.payload)
        armed = bool(mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        if self._contradictions.take(vehicle_type, autopilot, armed=armed):
            self._note("senders", *self._contradicting)

    def _note_other(self, chosen: Vehicle, who: tuple[int, int]) -> None:
        """Tell of a vehicle that could be meant as well, when the user chose none."""
        other = self.selector.systems.get(who)
        if other is None or not other.is_autopilot or self.selector.wanted is not None:
            return
        if who in self._others or len(self._others) > _MOST_OTHERS_TOLD:
            return
        self._others.add(who)
        if len(self._others) > _MOST_OTHERS_TOLD:
            self._note(
                "vehicles",
                f"more than {_MOST_OTHERS_TOLD} other vehicles speak: no more of them are told of",
            )
        else:
            self._note(
                "vehicles",
                f"more than one vehicle speaks: {other} too; using {chosen}, the first heard "
                f"(choose with --vehicle {other.system}:{other.component})",
            )

    def _note_turning(self, source: str, speeds: Array) -> None:
        # Outputs without a motor stay at zero in messages that have room for more.
        if (np.count_nonzero(speeds, axis=1) >= min(4, speeds.shape[1])).any():
            self.turning.add(source)

    def _note(self, kind: str, text: str) -> None:
        self._events.append(IntakeEvent(self.clock or 0.0, kind, text))
        del self._events[:-1000]  # nobody asks: keep it bounded
