"""Which messages make records, and how: one row a message.

A link and a .tlog are read by this table alone. To take up another message that the dialect has,
add its row; `Message` documents the fields of a row.

Where several messages have the same content (IMU, attitude, velocity), the best that arrives is
taken: the one of the lowest rank. Rotor messages are all passed on under their own names: which of
them is usable shows only in flight.

Logs that an autopilot wrote itself have rows of their own, `OnboardMessage`, in its names.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.model.attitude import from_angles
from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.clock import Stamp
from gcs_sysid.telemetry.dialect import mavlink

RPM = 2.0 * math.pi / 60.0
"""rad/s per revolution a minute."""
MOST_ROTORS = 64
"""As many as the definition of ESC_STATUS allows; its index could be higher."""
_ARDUPILOT = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
_MILLI_G = 1e-3 * GRAVITY
"""m/s^2 per thousandth of standard gravity."""


def used_sensors(_messages: Array, rpm: Array) -> Array:
    """(n,) how many sensors n messages RPM report; absent ones are -1."""
    return np.where(rpm[:, 0] < 0.0, 0, np.where(rpm[:, 1] >= 0.0, 2, 1))


def used_outputs(messages: Array, outputs: Array) -> Array:
    """(n,) how many outputs n messages ACTUATOR_OUTPUT_STATUS report, at least four.

    `active` is by the definition a mask, from PX4 a count; either way outputs beyond it are unused.
    """
    most = outputs.shape[1]
    active = messages["active"].astype(float)
    bit_length = np.frexp(active)[1]
    count = np.where(active <= most, active, np.minimum(bit_length, most)).astype(int)
    count[count == 0] = most
    there = np.isfinite(outputs) & (np.arange(most) < count[:, None])
    return np.maximum(_to_last(there), np.minimum(count, 4))


def used_servos(_messages: Array, servos: Array) -> Array:
    """(n,) how many servos n messages SERVO_OUTPUT_RAW report, at least four; 0: not there."""
    return np.maximum(_to_last(servos != 0.0), 4)


def _to_last(there: Mask) -> Array:
    """(n,) how many entries of each row there are up to the last true one."""
    count = there.shape[1] - np.argmax(there[:, ::-1], axis=1)
    return np.where(there.any(axis=1), count, 0)


STAMP_FIELDS = {
    Stamp.US64: "time_usec",
    Stamp.MS32: "time_boot_ms",
    Stamp.US64_OR_32: "time_usec",
    Stamp.US32: "time_usec",
}


@dataclass(frozen=True)
class Message:
    """How one message makes records.

    Attributes:
        name: in the dialect.
        stream: what it measures.
        stamp: kind of its time stamp.
        fields: that make up the record's values, arrays with all their elements; "": zero, for
            what the message does not hold.
        scale: SI unit per unit of the fields, one for all or one for each value.
        rank: among the messages of a stream, 0 the best; of rotors all are passed on.
        offset: index of the first rotor, or the field with it.
        step: rotors from one value of that field to the next.
        sensor: field that numbers sensors: the first received counts, a second one is another
            stream and not more samples.
        only: field -> value of those that are read.
        autopilot: MAV_AUTOPILOT that alone is believed to mean this by it.
        convert: (n, fields) numbers as they were sent to (n, width) values, before they are
            scaled; all must be finite.
        used: messages and their (n, width) values -> (n,) how many of the first values are there.
    """

    name: str
    stream: Stream
    stamp: Stamp
    fields: tuple[str, ...]
    scale: float | tuple[float, ...] = 1.0
    rank: int = 0
    offset: int | str = 0
    step: int = 1
    sensor: str = ""
    only: Mapping[str, int] = field(default_factory=dict)
    autopilot: int | None = None
    convert: Callable[[Array], Array] | None = None
    used: Callable[[Array, Array], Array] | None = None

    @property
    def source(self) -> str:
        """As in `Record`."""
        rotors = self.stream in (Stream.ROTOR_SPEED, Stream.ROTOR_COMMAND)
        return self.name if rotors else ""


def _sum_of_cells(volts: Array) -> Array:
    """(n, 1) of (n, cells), 0 where none is reported."""
    # UINT16_MAX: there is no such cell, or its voltage is not known.
    return np.where(volts >= 65535.0, 0.0, volts).sum(axis=1, keepdims=True)


_AXES = ("xgyro", "ygyro", "zgyro", "xacc", "yacc", "zacc")
_MILLI = (1e-3, 1e-3, 1e-3, _MILLI_G, _MILLI_G, _MILLI_G)
_SERVOS = tuple(f"servo{i}_raw" for i in range(1, 17))

MESSAGES: tuple[Message, ...] = (
    Message("HIGHRES_IMU", Stream.IMU, Stamp.US64, _AXES, sensor="id"),
    # By the definition in the sensor's own counts; ArduPilot sends what SCALED_IMU has, with
    # stamps a thousand times finer.
    Message(
        "RAW_IMU", Stream.IMU, Stamp.US64_OR_32, _AXES, _MILLI, rank=1,
        only={"id": 0}, autopilot=_ARDUPILOT,
    ),
    Message("SCALED_IMU", Stream.IMU, Stamp.MS32, _AXES, _MILLI, rank=2),
    Message(
        "ATTITUDE", Stream.ATTITUDE, Stamp.MS32, ("roll", "pitch", "yaw"), convert=from_angles
    ),
    Message(
        "ATTITUDE_QUATERNION", Stream.ATTITUDE, Stamp.MS32, ("q1", "q2", "q3", "q4"), rank=1
    ),
    Message(
        "LOCAL_POSITION_NED", Stream.VELOCITY, Stamp.MS32, ("vx", "vy", "vz", "x", "y", "z")
    ),
    # North and east would need an origin, and are not used.
    Message(
        "GLOBAL_POSITION_INT", Stream.VELOCITY, Stamp.MS32,
        ("vx", "vy", "vz", "", "", "relative_alt"),
        (0.01, 0.01, 0.01, 0.0, 0.0, -1e-3), rank=1,
    ),
    # Sent when asked. Its stamp is that of the setpoint, which may be long past.
    Message(
        "ATTITUDE_TARGET", Stream.RATE_SETPOINT, Stamp.NONE,
        ("body_roll_rate", "body_pitch_rate", "body_yaw_rate"),
    ),
    # The sign is only the sense of rotation, which the airframe gives.
    Message(
        "ESC_STATUS", Stream.ROTOR_SPEED, Stamp.US64, ("rpm",), RPM, offset="index",
        convert=np.abs,
    ),
    Message("RPM", Stream.ROTOR_SPEED, Stamp.NONE, ("rpm1", "rpm2"), RPM, used=used_sensors),
    *(
        Message(
            f"ESC_TELEMETRY_{first}_TO_{first + 3}", Stream.ROTOR_SPEED, Stamp.NONE, ("rpm",), RPM,
            offset=first - 1,
        )
        for first in (1, 5, 9, 13, 17, 21, 25, 29)
    ),
    Message(
        "ACTUATOR_OUTPUT_STATUS", Stream.ROTOR_COMMAND, Stamp.US64, ("actuator",),
        used=used_outputs,
    ),
    Message(
        "SERVO_OUTPUT_RAW", Stream.ROTOR_COMMAND, Stamp.US32, _SERVOS, offset="port", step=16,
        used=used_servos,
    ),
    Message(
        "SYS_STATUS", Stream.VOLTAGE, Stamp.NONE, ("voltage_battery",), 1e-3,
        convert=_sum_of_cells,
    ),
    Message(
        "BATTERY_STATUS", Stream.VOLTAGE, Stamp.NONE, ("voltages",), 1e-3, rank=1,
        only={"id": 0}, convert=_sum_of_cells,
    ),
)  # fmt: skip
"""HEARTBEAT, EXTENDED_SYS_STATE, PARAM_VALUE and SYSTEM_TIME are rare and carry states: they are
read by `decode.VehicleStates`, and by the clock."""

INERTIAL = frozenset(message.name for message in MESSAGES if message.stream is Stream.IMU)
"""Messages with IMU data."""


class Preference:
    """Lets messages of a stream through only while none that ranks better comes."""

    PREFERRED_FOR = 1.0
    """s. The next best message is used only when no better one came for this long."""

    def __init__(self) -> None:
        self._received: dict[int, float] = {}

    def allows(self, ranked: Sequence[tuple[int, Array, Array]]) -> list[Mask]:
        """Note messages, and return which of them to use.

        Args:
            ranked: of each kind its rank, the (n,) places of its messages in the order of
                arrival, and their times in s, NaN where there is none; the best first.

        Returns:
            Of each kind (n,) whether to use the message.
        """
        received: list[tuple[int, Array, Array]] = []
        masks = []
        came = {rank for rank, _, _ in ranked}
        silent = [(k, t) for k, t in self._received.items() if k not in came]
        for rank, order, t in ranked:
            allowed = np.ones(len(t), bool)
            for better, last in silent:
                if better < rank:
                    allowed &= ~(np.abs(t - last) <= self.PREFERRED_FOR)
            for better, better_order, better_t in received:
                if better < rank:
                    last_t = better_t[np.searchsorted(better_order, order)]
                    allowed &= ~(np.abs(t - last_t) <= self.PREFERRED_FOR)
            masks.append(allowed)
            timed = np.isfinite(t)
            times = np.concatenate([[self._received.get(rank, np.nan)], t[timed]])
            received.append((rank, order[timed], times))
            if len(times) > 1:
                self._received[rank] = float(times[-1])
        return masks


@dataclass(frozen=True)
class OnboardMessage:
    """How one topic (.ulg) or type of entry (.bin) makes samples.

    Attributes:
        name: of the topic or entry.
        stream: what it measures.
        fields: that make up the values; in a topic, `q[4]` are `q[0]` to `q[3]`, and `output[n]`
            as many as its field `n` says.
        scale: SI unit per unit of the fields.
        rank: among those of a stream of which one is read, 0 the best; the others are read
            where it is missing.
        is_equal_to: value of a state's only field at which it is true; None: not a state.
        offset: topic and fields that are subtracted, by their latest values.
        sensors: which of several: "first" (another one is another stream, not more samples),
            "primary" (of the estimator that the autopilot flies by), or "all".
        convert: (n, fields) numbers as they are logged to (n, width) values, before the scale.
    """

    name: str
    stream: Stream
    fields: tuple[str, ...]
    scale: float = 1.0
    rank: int = 0
    is_equal_to: int | None = None
    offset: tuple[str, tuple[str, ...]] | None = None
    sensors: str = "first"
    convert: Callable[[Array], Array] | None = None

    def values(self, columns: Array) -> Array:
        """(n, width) in SI units of (n, fields) numbers."""
        if self.is_equal_to is not None:
            return columns == self.is_equal_to
        values = columns if self.convert is None else self.convert(columns)
        return values if self.scale == 1.0 else values * self.scale
