"""From frames to records of one vehicle: the part that live sessions and logs share."""

from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.signals.columns import IntakeEvent, RecordBlock, Track
from gcs_sysid.signals.motor_order import MotorOrder
from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.clock import ClockDrift, Stamp
from gcs_sysid.telemetry.decode import STATE_IDS, RecordDecoder
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frame_block import FrameBlock, SeenFrames, counts_of
from gcs_sysid.telemetry.frames import Frame, Validity
from gcs_sysid.telemetry.message_table import INERTIAL, MESSAGES, STAMP_FIELDS
from gcs_sysid.telemetry.messages import MESSAGE_IDS, field_bytes, picker
from gcs_sysid.telemetry.monitor import Monitor
from gcs_sysid.telemetry.outgoing import OWN_SYSTEM
from gcs_sysid.telemetry.tlog_writer import is_reset_mark
from gcs_sysid.telemetry.track_collector import TrackCollector
from gcs_sysid.telemetry.vehicles import (
    INERTIAL_IDS,
    Contradictions,
    MavlinkSystem,
    VehicleSelector,
)

FATES = ("used", "not needed", "passed over", "dropped", "others")
_HEARTBEAT = MESSAGE_IDS["HEARTBEAT"]
_STATUSTEXT = MESSAGE_IDS["STATUSTEXT"]
_heartbeat = picker("HEARTBEAT", "type", "autopilot", "base_mode")
_STATES = sorted(STATE_IDS)


_STAMPED_IDS = frozenset(MESSAGE_IDS[m.name] for m in MESSAGES if m.stamp is not Stamp.NONE)


class Intake:
    """Takes the frames of a link or a log, gives the records of the chosen vehicle.

    Frames from before the vehicle's first heartbeat make no records.

    Attributes:
        selector: vehicles found, and the one chosen.
        decoder: makes the records; its `dropped` and `clock` are worth showing.
        monitor: counts and rates.
        drift: of the vehicle's clock, by the times of reception, where known.
        turning: names of the messages that have shown all their rotors turning.
        fates: what became of the frames whose checksum is right, all of them: "used" (made a
            record), "not needed" (of a type of no use for identification), "passed over" (a better
            message has the same content, or nothing new), "dropped" (see the decoder's), "others"
            (not the vehicle's, or before its first heartbeat).
        garbage_bytes: set by the caller, from `Receiver` or `TlogReader`.
    """

    _MOST_OTHERS_LISTED = 4
    """Vehicles listed one by one; a hostile sender can make up hundreds."""
    _MORE = 3
    """Ratio of messages to the chosen vehicle's from which another vehicle is reported as a
    problem."""
    _LEAST_PART = 64
    """Frames read at once after an interruption: the vehicle's clock went back, or it is
    another."""
    _GROWTH = 2
    """Factor by which the next part is longer than what was taken."""

    recorded: float | None = None
    """When a log begins, s of Unix time; None of a link, or before its reader knows it."""

    def __init__(self, wanted: tuple[int, int | None] | None = None) -> None:
        self.selector = VehicleSelector(wanted)
        self.decoder = RecordDecoder()
        self.monitor = Monitor()
        self.drift = ClockDrift()
        self.turning: set[str] = set()
        self.fates = Counter(dict.fromkeys(FATES, 0))
        self.garbage_bytes = 0
        self._seen = SeenFrames(_STAMPED_IDS)
        self._others: set[tuple[int, int]] = set()
        self._contradictions = Contradictions()
        self._events: list[IntakeEvent] = []

    @property
    def vehicle(self) -> MavlinkSystem | None:
        """The chosen vehicle; None until it has sent a heartbeat."""
        return self.selector.chosen

    @property
    def systems(self) -> list[MavlinkSystem]:
        """All systems found, in the order found."""
        return list(self.selector.systems.values())

    @property
    def parameters(self) -> dict[str, float]:
        """The vehicle's parameters received so far."""
        return self.decoder.states.parameters

    @property
    def motor_order(self) -> MotorOrder:
        """Which motor each output drives, by the parameters received so far."""
        return MotorOrder.of("" if self.vehicle is None else self.vehicle.key, self.parameters)

    @property
    def intervals(self) -> dict[int, tuple[int, int]]:
        """Intervals from MESSAGE_INTERVAL, see `VehicleStates`."""
        return self.decoder.states.intervals

    @property
    def clock(self) -> float | None:
        """The latest time on the vehicle's clock, s."""
        return self.decoder.clock.now

    def frames(self, frames: Iterable[Frame], wall: float | None = None) -> RecordBlock:
        """As `block`, of frames in the order received; `take_events` returns the events too.

        `wall` is when they came, s, of any clock that runs on evenly; None: not known.
        """
        block = self.block(FrameBlock.of(frames, wall))
        self._events += [event for _, event in block.events]
        return block

    def block(self, frames: FrameBlock) -> RecordBlock:
        """Take frames, few or many: how they are cut into blocks does not matter.

        Returns:
            Their records and the events; `take_events` does not return these again.
        """
        out = TrackCollector()
        frames = self._seen.mark(frames)
        at, most = 0, len(frames)
        while at < len(frames):
            part = frames.part(at, min(at + most, len(frames)))
            taken = self._take_some(part, out)
            # A clock that goes back every few frames must not have all the others read again.
            most = self._GROWTH * (
                len(part) if taken == len(part) else max(taken, self._LEAST_PART)
            )
            at += taken
        block = out.block()
        for track in block.tracks:
            if track.stream is Stream.ROTOR_SPEED and track.source not in self.turning:
                self._note_turning(track)
        return block

    def _take_some(self, frames: FrameBlock, out: TrackCollector) -> int:
        """Take frames up to one by which the vehicle may change; returns how many."""
        good = frames.validity == Validity.OK
        stop = self._next_mark(frames, good)
        if stop == 0:
            self._note("reset", "estimate reset by the user")
            self._add_events(frames.number, out)
            return 1
        beats = good & (frames.message_id == _HEARTBEAT)
        chosen = self.selector.chosen
        if chosen is None or self._may_go_over:
            decisive = self._decisive(frames, good, beats)
            if decisive[0]:
                return self._decide(frames.part(0, 1), out, beat=bool(beats[0]))
            stop = min(stop, int(np.argmax(decisive)) if decisive.any() else len(frames))
            if chosen is None:
                self._count(frames.part(0, stop))
                self.fates["others"] += int(np.count_nonzero(good[:stop]))
                return stop
        return self._take_chosen(frames.part(0, stop), out)

    @staticmethod
    def _next_mark(frames: FrameBlock, good: Mask) -> int:
        """The first frame that is the user's mark in a recording; how many there are, if none."""
        marks = good & (frames.system == OWN_SYSTEM) & (frames.message_id == _STATUSTEXT)
        for row in np.flatnonzero(marks).tolist():
            if is_reset_mark(frames.frame(row)):
                return int(row)
        return len(frames)

    def _decisive(self, frames: FrameBlock, good: Mask, beats: Mask) -> Mask:
        """(n,) whether a frame may decide which vehicle is the chosen one."""
        chosen = self.selector.chosen
        if chosen is None:
            return beats
        decisive = beats
        if len(self.selector.autopilots) > 1:
            decisive = beats | (good & np.isin(frames.message_id, list(INERTIAL_IDS)))
        return decisive & ~self._from(frames, chosen)

    def _decide(self, one: FrameBlock, out: TrackCollector, *, beat: bool) -> int:
        """Take a single frame by which the vehicle may change."""
        frame, before = one.frame(0), self.selector.chosen
        if before is None:
            self.selector.notice(frame)
        if before is None and self.selector.is_chosen(frame):
            # A heartbeat makes no record before the first stamp, only itself known.
            self._take_chosen(one, out)
            self._note("vehicle", f"{self.selector.chosen} found")
        else:
            self._count(one)
            if beat:
                self.selector.notice(frame)
            if before is not None and self.selector.go_over(frame):
                self._switch_vehicle(before)
                self._take_chosen(one, out, counted=True)
            else:
                self.fates["others"] += 1
                if beat:
                    self._notice(frame)
        self._add_events(one.number, out)
        return 1

    def _take_chosen(
        self, frames: FrameBlock, out: TrackCollector, *, counted: bool = False
    ) -> int:
        """Take frames while the vehicle stays the same and its clock runs on; how many."""
        chosen = self.selector.chosen
        assert chosen is not None
        dropped, clock = self.decoder.dropped_messages, self.decoder.clock
        before, reboots = clock.now, clock.reboots
        chosens = self._from(frames, chosen) & (frames.validity != Validity.REPEATED)
        taken = self.decoder.decode(frames, (frames.validity == Validity.OK) & chosens, out)
        frames, chosens = frames.part(0, taken.frames), chosens[: taken.frames]
        good = frames.validity == Validity.OK
        if not counted:
            self._count(frames)
        if clock.reboots != reboots:
            self._note("reboot", f"the vehicle's clock went back from {before:.1f} s: reboot")
            self._add_events(frames.number, out)
        now = taken.moments.after(frames.number + np.arange(len(frames)))
        self.monitor.count_chosen(
            frames.message_id[chosens],
            frames.sequence[chosens],
            frames.size[chosens],
            now[chosens],
            frames.validity[chosens] == Validity.BAD_CRC,
        )
        self.monitor.imu_loss.add_times(taken.imu_times)
        states = np.logical_or.reduce([frames.message_id == number for number in _STATES])
        rows = np.flatnonzero(good & states & (chosens | (frames.message_id == _HEARTBEAT)))
        end = clock.now
        for row in rows.tolist():
            # Notes on it are at its own time.
            clock.now = None if np.isnan(now[row]) else float(now[row])
            self._take_state(frames.number + row, frames.frame(row), float(now[row]), out)
        clock.now = end
        self._settle(frames, good, chosens, now, dropped, out)
        return len(frames)

    def _settle(
        self,
        frames: FrameBlock,
        good: Mask,
        chosens: Mask,
        now: Array,
        dropped: int,
        out: TrackCollector,
    ) -> None:
        """Note what became of frames, and when those that made records came."""
        made = out.new_orders() - frames.number
        ours = good & chosens
        counts = counts_of(frames.message_id[ours])
        fates = {
            "used": len(made),
            "not needed": sum(n for i, n in counts.items() if not self.decoder.reads(i)),
            "dropped": self.decoder.dropped_messages - dropped,
        }
        fates["passed over"] = int(np.count_nonzero(ours)) - sum(fates.values())
        self.fates.update(fates, others=int(np.count_nonzero(good & ~chosens)))
        walls = frames.time_us[made]
        timed = (walls > 0) & np.isfinite(now[made])
        if not timed.all():
            made, walls = made[timed], walls[timed]
        self.drift.add_moments(now[made], walls * 1e-6)

    @staticmethod
    def _from(frames: FrameBlock, vehicle: MavlinkSystem) -> Mask:
        return (frames.system == vehicle.system) & (frames.component == vehicle.component)

    def _count(self, frames: FrameBlock) -> None:
        self.monitor.count_frames(frames.validity)
        good = frames.validity == Validity.OK
        self.selector.note_senders(frames.system[good], frames.component[good])

    def _take_state(self, order: int, frame: Frame, now: float, out: TrackCollector) -> None:
        """Take a state message, or any heartbeat."""
        if frame.message_id == _HEARTBEAT:
            self.selector.notice(frame)
            self._notice(frame)
        if self.selector.is_chosen(frame):
            record = self.decoder.take_state(frame, now)
            if record is not None:
                out.add_record(order, record)
        self._add_events(order, out)

    def _add_events(self, order: int, out: TrackCollector) -> None:
        out.events += [(order, event) for event in self.take_events()]

    def take_events(self) -> list[IntakeEvent]:
        """What happened since this was last asked."""
        events, self._events = self._events, []
        return events

    def health(self) -> dict[str, Any]:
        """Figures of the moment, for the live screen."""
        return self.monitor.health(self.garbage_bytes)

    def as_dict(self) -> dict[str, Any]:
        """The result's `telemetry`."""
        return {
            **self.monitor.as_dict(map(str, self.selector.systems.values()), self.garbage_bytes),
            "reboots": self.decoder.clock.reboots,
            "dropped": dict(self.decoder.dropped),
            "fates": dict(self.fates),
            "copies": self._seen.repeated,
        }

    @property
    def _may_go_over(self) -> bool:
        """Whether the vehicle, chosen automatically, has sent only heartbeats so far."""
        selector = self.selector
        return selector.chosen is not None and selector.wanted is None and self.clock is None

    def _switch_vehicle(self, first: MavlinkSystem) -> None:
        """Another vehicle is the chosen one: of the first there were heartbeats alone."""
        self._others.add(first.address)  # reported here
        self.decoder = RecordDecoder()
        self._contradictions = Contradictions()
        self.monitor.restart()
        self._note(
            "vehicles",
            f"{first}, the first received, sends heartbeats only: "
            f"using {self.vehicle}, which sends IMU data",
        )

    @property
    def problems(self) -> tuple[str, ...]:
        """Why what comes may not be the vehicle's, one line each."""
        return (*self._contradicting, *self._others_sending_more)

    @property
    def _others_sending_more(self) -> tuple[str, ...]:
        chosen, frames = self.selector.chosen, self.selector.frames
        if chosen is None or self.selector.wanted is not None:
            return ()
        counts = {each: frames.get(each.address, 0) for each in self.selector.autopilots}
        own, most = frames.get(chosen.address, 0), max(counts, key=counts.__getitem__, default=None)
        if most is None or counts[most] <= self._MORE * own:
            return ()
        return (
            f"{most} sent {counts[most]} messages, {chosen}, the first received, {own}: choose it "
            f"with --vehicle {most.system}:{most.component}",
        )

    @property
    def _contradicting(self) -> tuple[str, ...]:
        if not self._contradictions.found:
            return ()
        return (
            f"the heartbeats of {self.vehicle} contradict each other: another sender uses its "
            "address and may hide that it flies; use the autopilot's own log (.ulg, .bin), or "
            "signing (--signing-key)",
        )

    def _notice(self, heartbeat: Frame) -> None:
        """See whether a heartbeat is of another vehicle, or of a sender that poses as this one."""
        chosen, who = self.selector.chosen, (heartbeat.system, heartbeat.component)
        if chosen is None:
            return
        if who != chosen.address:
            self._note_other(chosen, who)
            return
        vehicle_type, autopilot, mode = _heartbeat(heartbeat.payload)
        armed = bool(mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        if self._contradictions.note_heartbeat(vehicle_type, autopilot, armed=armed):
            self._note("senders", *self._contradicting)

    def _note_other(self, chosen: MavlinkSystem, who: tuple[int, int]) -> None:
        """Report another vehicle that could be meant, when the user chose none."""
        other = self.selector.systems.get(who)
        if other is None or not other.is_autopilot or self.selector.wanted is not None:
            return
        if who in self._others or len(self._others) > self._MOST_OTHERS_LISTED:
            return
        self._others.add(who)
        if len(self._others) > self._MOST_OTHERS_LISTED:
            self._note(
                "vehicles",
                f"more than {self._MOST_OTHERS_LISTED} other vehicles: further ones are not listed",
            )
        else:
            self._note(
                "vehicles",
                f"several vehicles: {other} too; using {chosen}, the first "
                f"received "
                f"(choose with --vehicle {other.system}:{other.component})",
            )

    def _note_turning(self, track: Track) -> None:
        # Outputs without a motor stay at zero in messages that have room for more.
        for motors in self.motor_order.tracks([track]):
            speeds = motors.values
            least = max(min(4, speeds.shape[1]), 1)
            if (np.count_nonzero(speeds, axis=1) >= least).any():
                self.turning.add(track.source)

    def _note(self, kind: str, text: str) -> None:
        self._events.append(IntakeEvent(self.clock or 0.0, kind, text))
        del self._events[:-1000]  # not taken: keep it bounded


_AWAITED = frozenset(MESSAGE_IDS[name] for name in ("HEARTBEAT", "PARAM_VALUE", "MESSAGE_INTERVAL"))
"""Messages that are waited for: heartbeats and replies to requests."""
_Sender = tuple[int, int, int]
_STAMPS = {
    MESSAGE_IDS[message.name]: (
        field_bytes(message.name, STAMP_FIELDS[message.stamp]),
        1e-3 if message.stamp is Stamp.MS32 else 1e-6,
    )
    for message in MESSAGES
    if message.name in INERTIAL
}
"""Message -> where its stamp lies in the payload, all else of which is read later; its unit, s."""


class FrameGathering:
    """Frames of a link that wait, unread, until the vehicle's clock has passed a tick of the chain.

    Before that they change nothing that anybody sees, and reading a few at a time costs as much as
    reading all of a tenth of a second at once. How long they wait changes no number. `until_tick`
    gives s of the vehicle's clock until records change what anybody sees; it is asked when frames
    come after those last read.
    """

    _MOST_WAITING = 1024
    """Frames that wait: those of a tenth of a second on the fastest link."""
    _LONGEST_WAIT = 0.2
    """s of the receiving computer's clock that they wait where the vehicle's gives no time."""
    _ROUNDING = 2e-6
    """s, of stamps and ticks."""

    def __init__(self, intake: Intake, until_tick: Callable[[], float]) -> None:
        self._intake = intake
        self._until_tick = until_tick
        self._frames: list[Frame] = []
        self._walls: list[float] = []
        # (sender, message) -> s, its stamp when the waiting began, and its latest.
        self._from: dict[_Sender, float] = {}
        self._latest: dict[_Sender, float] = {}
        self._wait: float | None = 0.0

    def gather(self, frames: Iterable[Frame], wall: float | None = None) -> RecordBlock:
        """Take frames in the order received.

        `wall` is when they came, s since 1970; None: not known.

        Returns:
            Records of all that waited, where it is time to read them; else none.
        """
        before = len(self._frames)
        self._frames += frames
        self._walls += [wall or 0.0] * (len(self._frames) - before)
        due = len(self._frames) >= self._MOST_WAITING
        if wall is not None and self._frames:
            due |= not 0.0 <= wall - self._walls[0] < self._LONGEST_WAIT
        if self._wait is None:
            self._wait = self._until_tick()
        awaited = [self._is_awaited(frame) for frame in self._frames[before:]]
        return self.rest() if due or any(awaited) else RecordBlock()

    def rest(self) -> RecordBlock:
        """Records of all that waited."""
        if not self._frames:
            return RecordBlock()
        frames = FrameBlock.of(self._frames, np.array(self._walls))
        self._frames, self._walls = [], []
        self._from, self._latest, self._wait = self._latest, {}, None
        return self._intake.block(frames)

    def _is_awaited(self, frame: Frame) -> bool:
        """Whether a frame ends the waiting: by its time, or by what it is."""
        stamp = _STAMPS.get(frame.message_id)
        if stamp is None:
            return frame.message_id in _AWAITED or frame.system == OWN_SYSTEM
        place, unit = stamp
        sender = frame.system, frame.component, frame.message_id
        # Zeros that are cut off at the end of a payload are the highest bytes.
        self._latest[sender] = t = unit * int.from_bytes(frame.payload[place], "little")
        wait = self._wait or 0.0
        return not 0.0 <= t - self._from.setdefault(sender, t) < wait - self._ROUNDING
