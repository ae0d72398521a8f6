"""Messages with states, not samples: heartbeats, flight state, parameters.

They come once or twice a second, and what they mean depends on those before: they are taken one
by one.

The autopilot's parameters as PARAM_VALUE carries them.

The message has one float for values of every type. PX4 puts an integer's bytes there as they
are, ArduPilot converts the number: that depends on the autopilot, the message does not say.
"""

import math
import struct

from gcs_sysid.signals.records import Record, Stream
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frames import Frame
from gcs_sysid.telemetry.messages import MESSAGE_IDS, picker

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

        Args:
            frame: whose checksum is right.
            now: s, the vehicle's clock; None before the first stamp.
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
