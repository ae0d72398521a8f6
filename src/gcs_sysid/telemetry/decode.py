"""Frames of one vehicle -> records: samples as columns, by the table of messages, and states.

What comes out depends on the frames and their order alone, never on when they came, nor on how
they are cut into blocks: a live session, which takes a few frames at a time, and the analysis of
its recording make the same records.

Messages with states (heartbeats, flight state, parameters) come once or twice a second, and what
they mean depends on those before: they are taken one by one. PARAM_VALUE has one float for values
of every type. PX4 puts an integer's bytes there as they are, ArduPilot converts the number: that
depends on the autopilot, the message does not say.
"""

import math
import struct
from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gcs_sysid.arrays import Array, Mask, complete_rows
from gcs_sysid.model.attitude import align_signs
from gcs_sysid.signals.records import Record, Stream
from gcs_sysid.telemetry import message_table
from gcs_sysid.telemetry.clock import DRIVING, ClockTimes, Stamp, VehicleClock, following
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frame_block import FrameBlock
from gcs_sysid.telemetry.frames import Frame
from gcs_sysid.telemetry.message_table import MOST_ROTORS, STAMP_FIELDS, Message, Preference
from gcs_sysid.telemetry.messages import MESSAGE_IDS, message_arrays, picker
from gcs_sysid.telemetry.track_collector import TrackCollector, usable

_param_value = picker("PARAM_VALUE", "param_id", "param_type", "param_value")

_INTEGERS = {
    mavlink.MAV_PARAM_TYPE_UINT8: struct.Struct("<B"),
    mavlink.MAV_PARAM_TYPE_INT8: struct.Struct("<b"),
    mavlink.MAV_PARAM_TYPE_UINT16: struct.Struct("<H"),
    mavlink.MAV_PARAM_TYPE_INT16: struct.Struct("<h"),
    mavlink.MAV_PARAM_TYPE_UINT32: struct.Struct("<I"),
    mavlink.MAV_PARAM_TYPE_INT32: struct.Struct("<i"),
}
STATE_IDS = frozenset(
    MESSAGE_IDS[name]
    for name in ("HEARTBEAT", "EXTENDED_SYS_STATE", "PARAM_VALUE", "MESSAGE_INTERVAL")
)
"""Ids of the messages that are read here."""

KNOWN_IDS = frozenset(MESSAGE_IDS.values())
"""A hostile sender can name 65 536 messages."""
_ARDUPILOT = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
_landed = picker("EXTENDED_SYS_STATE", "landed_state")
_interval = picker("MESSAGE_INTERVAL", "message_id", "interval_us")
_heartbeat = picker("HEARTBEAT", "autopilot", "base_mode", "system_status")


def read_parameter(payload: bytes, *, bytewise: bool) -> tuple[str, float]:
    """Name and value of a PARAM_VALUE.

    Args:
        payload: of the message, perhaps without its trailing zeros.
        bytewise: whether integers lie in the value's bytes (PX4) instead of in its number.

    Returns:
        The name ("" when it is not text) and the value; it may be NaN.
    """
    name, kind, value = _param_value(payload)
    text = name.split(b"\0", 1)[0].decode("ascii", "replace")
    if not text.isprintable() or "\N{REPLACEMENT CHARACTER}" in text:
        text = ""
    integer = _INTEGERS.get(kind) if bytewise else None
    if integer is not None:
        # From the payload itself, whose first field it is: a float would not keep all bits.
        (value,) = integer.unpack_from(payload.ljust(4, b"\0"))
    return text, float(value)


class VehicleStates:
    """Makes records from one vehicle's state messages.

    Attributes:
        autopilot: MAV_AUTOPILOT of the latest heartbeat; None before the first.
        parameters: name -> value of the autopilot's parameters received so far.
        intervals: message number -> us between two of them by the latest MESSAGE_INTERVAL, and how
            many of these had come by then.
        untimed: messages that gave no record because no stamp had been received.
    """

    LANDED_STATE_FOR = 5.0
    """s. ArduPilot's heartbeat gives the flight state only when no EXTENDED_SYS_STATE, which comes
    once or twice a second, came for this long."""
    MOST_PARAMETERS = 4096
    """Names kept: a hostile sender can make up more than any autopilot has."""

    def __init__(self) -> None:
        self.autopilot: int | None = None
        self.parameters: dict[str, float] = {}
        self.intervals: dict[int, tuple[int, int]] = {}
        self.untimed = 0
        self._intervals_received = 0
        self._armed: bool | None = None
        self._landed_received = -math.inf

    def forget_times(self) -> None:
        """Stamps of another boot do not apply."""
        self._landed_received = -math.inf

    def read(self, frame: Frame, now: float | None) -> Record | None:
        """Read one of the messages of `STATE_IDS`; the record that it makes, if any.

        `now` is s, the vehicle's clock; None before the first stamp.
        """
        if frame.message_id == MESSAGE_IDS["PARAM_VALUE"]:
            return self._read_parameter(frame.payload, now)
        if frame.message_id == MESSAGE_IDS["MESSAGE_INTERVAL"]:
            self._read_interval(frame.payload)
            return None
        if frame.message_id == MESSAGE_IDS["HEARTBEAT"]:
            return self._read_heartbeat(frame.payload, now)
        return self._read_landed(frame.payload, now)

    def _read_interval(self, payload: bytes) -> None:
        number, interval = _interval(payload)
        if number in KNOWN_IDS:
            self._intervals_received += 1
            self.intervals[number] = interval, self._intervals_received

    def _read_landed(self, payload: bytes, now: float | None) -> Record | None:
        (state,) = _landed(payload)
        if state == mavlink.MAV_LANDED_STATE_UNDEFINED:
            return None
        if now is None:
            self.untimed += 1
            return None
        self._landed_received = now
        # Taking off and landing are modes of flight; where the ground carries it, forces show.
        in_air = float(state != mavlink.MAV_LANDED_STATE_ON_GROUND)
        return Record(Stream.IN_AIR, now, (in_air,))

    def _read_heartbeat(self, payload: bytes, now: float | None) -> Record | None:
        self.autopilot, base_mode, status = _heartbeat(payload)
        if now is None:  # usual at the start: no reason to count it
            return None
        armed = bool(base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        # ArduPilot's status gives the flight state too. One message makes one record, so arming is
        # recorded when it changes and flight in between.
        if (
            armed == self._armed
            and self.autopilot == _ARDUPILOT
            and status in (mavlink.MAV_STATE_STANDBY, mavlink.MAV_STATE_ACTIVE)
            and not abs(now - self._landed_received) <= self.LANDED_STATE_FOR
        ):
            return Record(Stream.IN_AIR, now, (float(status == mavlink.MAV_STATE_ACTIVE),))
        self._armed = armed
        return Record(Stream.ARMED, now, (float(armed),))

    def _read_parameter(self, payload: bytes, now: float | None) -> Record | None:
        bytewise = self.autopilot == mavlink.MAV_AUTOPILOT_PX4
        name, value = read_parameter(payload, bytewise=bytewise)
        if not name or not math.isfinite(value):
            return None
        if len(self.parameters) >= self.MOST_PARAMETERS and name not in self.parameters:
            return None
        self.parameters[name] = value
        return Record(Stream.PARAMETER, now or 0.0, (value,), source=name)


_SYSTEM_TIME = MESSAGE_IDS["SYSTEM_TIME"]
_NO_TIMES = np.empty(0)
_NO_ORDER = np.empty(0, np.int64)


class Taken(NamedTuple):
    """How far `RecordDecoder.decode` came."""

    frames: int
    """How many were read."""
    moments: ClockTimes
    """The clock over them."""
    imu_times: Array
    """(n,) s, of the IMU's samples as they came."""


class RecordDecoder:
    """Makes records from the frames of one vehicle.

    Attributes:
        clock: the vehicle's clock by its stamps.
        states: heartbeats, flight and parameters.
    """

    def __init__(self) -> None:
        self.clock = VehicleClock()
        self.states = VehicleStates()
        self._table = {message.name: message for message in message_table.MESSAGES}
        self._ids = {MESSAGE_IDS[name] for name in self._table} | STATE_IDS | {_SYSTEM_TIME}
        self._dropped: Counter[str] = Counter()
        self._sensors: dict[str, int] = {}
        self._q_last = np.array([1.0, 0.0, 0.0, 0.0])
        self._imu_times = _NO_TIMES
        self._forget_times()

    @property
    def dropped(self) -> Counter[str]:
        """Reason -> number of messages that gave no record though they should have.

        "not finite", "no time" (no stamp, or one not to be believed).
        """
        untimed = self.states.untimed
        return self._dropped + Counter({"no time": untimed} if untimed else {})

    @property
    def dropped_messages(self) -> int:
        """How many messages gave no record though they should have."""
        return self._dropped["no time"] + self._dropped["not finite"] + self.states.untimed

    def reads(self, message_id: int) -> bool:
        """Whether there is anything to read in messages of a type."""
        return message_id in self._ids

    def decode(self, frames: FrameBlock, mine: Mask, out: TrackCollector) -> Taken:
        """Read the messages of the table, up to a stamp that sets the clock back, or one frame.

        State messages are not read; the caller gives them to `take_state` one by one, with the
        clock of `ClockTimes`.

        `mine` is (n,), which frames are the vehicle's, with right checksums; `out` takes the
        records.
        """
        messages = message_arrays(frames, self._table, mine)
        self._leave_out(messages, frames, mine)
        stop = self._learn_unix_time(frames, mine)
        reboots = self.clock.reboots
        stamps, moments, stop = self._stamps(messages, frames.number, stop)
        rebooted = self.clock.reboots != reboots
        if rebooted:
            stop = frames.number + 1
        if stop < frames.number + len(frames):
            for name, rows in messages.items():
                count = int(np.searchsorted(rows["_frame"], stop))
                messages[name] = rows[:count]
                if name in stamps:
                    stamps[name] = stamps[name][:count]
        self._imu_times = _NO_TIMES
        with np.errstate(invalid="ignore"):  # what is sent may be any kind of NaN
            self._read(messages, stamps, moments, out)
        if rebooted:
            self._forget_times()
        return Taken(stop - frames.number, moments, self._imu_times)

    def take_state(self, frame: Frame, now: float) -> Record | None:
        """Read a message with a state; the record that it makes, if any.

        `now` is s, the vehicle's clock; NaN before the first stamp.
        """
        return self.states.read(frame, now if now == now else None)

    def _forget_times(self) -> None:
        """Stamps of another boot do not apply."""
        self._preferences: defaultdict[Stream, Preference] = defaultdict(Preference)
        self.states.forget_times()
        self._sent_last = -np.inf

    def _leave_out(self, messages: dict[str, Array], frames: FrameBlock, mine: Mask) -> None:
        """Leave out what the table excludes."""
        for name, rows in messages.items():
            message, kept = self._table[name], np.ones(len(rows), bool)
            if message.sensor:
                first = self._sensors.setdefault(name, int(rows[message.sensor][0]))
                kept &= rows[message.sensor] == first
            for field, value in message.only.items():
                kept &= rows[field] == value
            if isinstance(message.offset, str):
                kept &= message.step * rows[message.offset].astype(np.int64) < MOST_ROTORS
            if message.autopilot is not None:
                kept &= self._autopilots(frames, mine, rows["_frame"]) == message.autopilot
            messages[name] = _kept(rows, kept)

    def _autopilots(self, frames: FrameBlock, mine: Mask, order: Array) -> Array:
        """(n,) MAV_AUTOPILOT by the latest heartbeat before frames of these numbers, else -1."""
        beats = message_arrays(frames, ("HEARTBEAT",), mine).get("HEARTBEAT")
        known = -1 if self.states.autopilot is None else self.states.autopilot
        if beats is None:
            return np.full(len(order), known)
        reported = np.concatenate([[known], beats["autopilot"].astype(int)])
        return reported[np.searchsorted(beats["_frame"], order)]

    def _learn_unix_time(self, frames: FrameBlock, mine: Mask) -> int:
        """Take a SYSTEM_TIME that comes first; number of the next one, from which frames are read
        again.
        """
        end = frames.number + len(frames)
        if self.clock.unix_minus_boot is not None:
            return end
        times = message_arrays(frames, ("SYSTEM_TIME",), mine).get("SYSTEM_TIME", ())
        for row in times:
            if int(row["_frame"]) > frames.number:
                if self.clock.gives_unix_time(*self._system_time(row)):
                    return int(row["_frame"])
            else:
                self.clock.system_time(*self._system_time(row))
                if self.clock.unix_minus_boot is not None:
                    return end
        return end

    @staticmethod
    def _system_time(row: Array) -> tuple[int, int]:
        return int(row["time_unix_usec"]), int(row["time_boot_ms"])

    def _stamps(
        self, messages: dict[str, Array], first: int, stop: int
    ) -> tuple[dict[str, Array], ClockTimes, int]:
        """Times of the messages with stamps that drive the clock, NaN where they have none.

        Frames are read from number `first` to before `stop`.

        Returns:
            Message name -> times, the clock, and the number of the first frame that is not read.
        """
        now = np.array([np.nan if self.clock.now is None else self.clock.now])
        stamped = {
            name: rows
            for name, rows in messages.items()
            if self._table[name].stamp in DRIVING and len(rows)
        }
        if not stamped:
            return {}, ClockTimes(_NO_ORDER, now), stop
        kinds = {name: self._table[name].stamp for name in stamped}
        order = np.concatenate([rows["_frame"] for rows in stamped.values()])
        raw = np.concatenate([rows[STAMP_FIELDS[kinds[name]]] for name, rows in stamped.items()])
        kind = np.repeat([*kinds.values()], [len(rows) for rows in stamped.values()])
        sorting = np.argsort(order)
        sorting = sorting[: np.searchsorted(order[sorting], stop)]
        alone = len(sorting) > 0 and int(order[sorting[0]]) == first
        t, after = self.clock.follow_stamps(kind[sorting], raw[sorting], may_go_back=alone)
        if len(t) < len(sorting):
            stop = int(order[sorting[len(t)]])
        sorting = sorting[: len(t)]
        times = np.full(len(order), np.nan)
        times[sorting] = t
        ends = np.cumsum([len(rows) for rows in stamped.values()])[:-1]
        moments = ClockTimes(order[sorting], np.concatenate([now, after]))
        return dict(zip(stamped, np.split(times, ends), strict=True)), moments, stop

    def _read(
        self,
        messages: dict[str, Array],
        stamps: dict[str, Array],
        moments: ClockTimes,
        out: TrackCollector,
    ) -> None:
        """Make records of the messages that are left."""
        there = [self._table[name] for name, rows in messages.items() if len(rows)]
        self._stamp_the_others(there, messages, stamps, moments)
        alike: dict[Stream, list[Message]] = {}
        for message in there:
            if message.source:
                self._give(message, messages[message.name], stamps[message.name], out)
            else:
                alike.setdefault(message.stream, []).append(message)
        for stream, some in alike.items():
            some.sort(key=lambda message: message.rank)
            self._give_best(stream, some, messages, stamps, out)

    def _stamp_the_others(
        self,
        there: Sequence[Message],
        messages: dict[str, Array],
        stamps: dict[str, Array],
        moments: ClockTimes,
    ) -> None:
        """Times of the messages whose stamps follow the clock, or that have none."""
        orders, times = [_NO_ORDER], [np.array([self._sent_last])]
        for message in there:
            if message.stamp is Stamp.US32:
                rows = messages[message.name]
                t = following(rows["time_usec"], moments.after(rows["_frame"]))
                stamps[message.name] = t
                timed = np.isfinite(t)
                orders.append(rows["_frame"][timed])
                times.append(t[timed])
        order, sent = np.concatenate(orders), np.concatenate(times)
        if len(orders) > 2:
            by_order = np.argsort(order)
            order, sent[1:] = order[by_order], sent[1:][by_order]
        self._sent_last = float(sent[-1])
        for message in there:
            if message.stamp is Stamp.NONE:
                at = messages[message.name]["_frame"]
                stamps[message.name] = np.maximum(
                    moments.after(at), sent[np.searchsorted(order, at)]
                )

    def _give_best(
        self,
        stream: Stream,
        some: Sequence[Message],
        messages: dict[str, Array],
        stamps: dict[str, Array],
        out: TrackCollector,
    ) -> None:
        """Pass on the best of messages with the same content, in the order of their ranks."""
        there = []
        for message in some:
            rows, t = messages[message.name], stamps[message.name]
            values = self._values(message, rows)
            if message.convert is not None:
                finite = complete_rows(values)
                self._drop("not finite", ~finite)
                rows, t, values = (_kept(part, finite) for part in (rows, t, values))
            there.append((message.rank, rows["_frame"], t, values))
        allowed = self._preferences[stream].allows([part[:3] for part in there])
        parts = [
            tuple(_kept(part, mask) for part in reported[1:])
            for reported, mask in zip(there, allowed, strict=True)
        ]
        order, t, values = (
            parts[0] if len(parts) == 1 else map(np.concatenate, zip(*parts, strict=True))
        )
        if len(parts) > 1:
            by_order = np.argsort(order)
            order, t, values = order[by_order], t[by_order], values[by_order]
        if stream is Stream.ATTITUDE:
            order, t, values = self._upright(order, t, values)
        self._add(out, stream, order, t, values)

    def _upright(self, order: Array, t: Array, q: Array) -> tuple[Array, Array, Array]:
        """Quaternions of unit length, each close to the one before (q and -q are one attitude)."""
        w, x, y, z = q.T
        norm = np.sqrt(w * w + x * x + y * y + z * z)
        sound: Mask = (norm > 0.9) & (norm < 1.1)
        self._drop("not finite", ~sound)
        order, t, q = order[sound], t[sound], q[sound] / norm[sound, None]
        timed = np.isfinite(t)
        chain = align_signs(np.vstack([self._q_last, q[timed]]))
        q[timed], self._q_last = chain[1:], chain[-1].copy()
        return order, t, q

    def _give(self, message: Message, rows: Array, t: Array, out: TrackCollector) -> None:
        """Pass on rotor messages, those of one offset and width together."""
        order, values = rows["_frame"], self._values(message, rows)
        whole = values.shape[1]
        if message.used is None and isinstance(message.offset, int):
            self._add(out, message.stream, order, t, values, message.offset, message.source)
            return
        width = whole if message.used is None else message.used(rows, values)
        offset = message.offset if isinstance(message.offset, int) else rows[message.offset]
        kinds = (whole + 1) * message.step * np.asarray(offset, np.int64) + width
        for kind in np.unique(kinds).tolist():
            first, size = divmod(kind, whole + 1)
            if size:
                some = kinds == kind
                at, times, reported = (_kept(part, some) for part in (order, t, values[:, :size]))
                self._add(out, message.stream, at, times, reported, first, message.source)

    @staticmethod
    def _values(message: Message, rows: Array) -> Array:
        """(n, width) of n messages in SI units."""
        fields = [rows[name] if name else np.zeros(len(rows)) for name in message.fields]
        if len(fields) == 1 and fields[0].ndim == 2:
            values = fields[0].astype(float)
        else:
            values = np.empty((len(rows), len(fields)))
            for column, reported in enumerate(fields):
                values[:, column] = reported
        if message.convert is not None:
            whole = complete_rows(values)
            if not whole.all():
                values[~whole] = np.nan
            values = message.convert(values)
        return values if message.scale == 1.0 else values * message.scale

    def _add(
        self,
        out: TrackCollector,
        stream: Stream,
        order: Array,
        t: Array,
        values: Array,
        offset: int = 0,
        source: str = "",
    ) -> None:
        """Pass on what has a time and is finite."""
        timed = np.isfinite(t)
        if stream is Stream.IMU:
            self._drop("accelerometer not finite", timed & ~complete_rows(values[:, 3:]))
        values, finite = usable(stream, values)
        sound = timed & finite
        if not sound.all():
            self._drop("no time", ~timed)
            self._drop("not finite", timed & ~finite)
            order, t, values = order[sound], t[sound], values[sound]
        if stream is Stream.IMU:
            self._imu_times = t
        out.add(stream, order, t, values, offset, source)

    def _drop(self, reason: str, rows: Mask) -> None:
        count = int(np.count_nonzero(rows))
        if count:
            self._dropped[reason] += count


def _kept(rows: Array, mask: Mask) -> Array:
    """Rows of a mask, which most often is true throughout: then they are not copied."""
    return rows if mask.all() else rows[mask]
