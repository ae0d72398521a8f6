"""PX4's own logs (.ulg): each topic as the stream that it would be on a link.

Which topic is which message was measured on a flight recorded both ways:

- `sensor_combined` less `estimator_sensor_bias` is HIGHRES_IMU (the same stamps, equal to
  1e-5 rad/s): the mean over the last interval, stamped with its end. `vehicle_angular_velocity`
  is low-passed and differs by 0.08 rad/s.
- `actuator_motors` is the command at the full rate; `actuator_outputs`, the same in the driver's
  unit, is usually thinned to 10 Hz.
"""

import contextlib
import errno
import io
import struct
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import numpy as np
from pyulog import ULog
from pyulog.exceptions import ULogException

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError
from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.rotor_messages import RPM
from gcs_sysid.telemetry.track_collector import Recording

MAGIC = b"ULog\x01\x12\x35"
_ENTRY_HEAD = 3
"""Bytes before the content of an entry."""
_ZEROS = 2**16
"""Bytes of zeros that are kept at the end: as many as an entry can hold."""
_PIECE = 2**20
"""Bytes looked at together."""

_TOPICS = [
    "sensor_combined", "estimator_sensor_bias", "vehicle_attitude", "vehicle_local_position",
    "actuator_motors", "actuator_outputs", "esc_status", "vehicle_land_detected",
    "vehicle_status",
]  # fmt: skip
_AUTO_TAKEOFF, _AUTO_LAND = 17, 18
"""vehicle_status.nav_state while EXTENDED_SYS_STATE says taking off or landing."""
_ARMED = 2
"""vehicle_status.arming_state."""
_FIRST_MOTOR = 101
"""esc_report.actuator_function of motor 1."""

Topic = dict[str, Array]


def read_ulog(path: Path) -> Recording:
    """Read a .ulg file.

    Raises:
        InputError: it cannot be read, is no ULog, or holds no data.
    """
    log = _load(path)
    topics: dict[tuple[str, int], Topic] = {}
    for dataset in log.data_list:
        if len(dataset.data.get("timestamp", ())):
            topics.setdefault((dataset.name, dataset.multi_id), dataset.data)
    if not topics:
        raise InputError(f"{path} holds no flight data: the log ends before any was written")
    status = topics.get(("vehicle_status", 0), {})
    parameters = _parameters(log)
    first = {name: value for _, name, value in reversed(parameters)}
    recording = Recording(
        tracks=[],
        system=_constant(status, "system_id") or int(first.get("MAV_SYS_ID", 1.0)),
        component=_constant(status, "component_id") or 1,
        vehicle_type=_constant(status, "system_type") or mavlink.MAV_TYPE_GENERIC,
        autopilot=mavlink.MAV_AUTOPILOT_PX4,
        parameters=parameters,
        counts={
            name if not multi_id else f"{name}_{multi_id}": len(topic["timestamp"])
            for (name, multi_id), topic in sorted(topics.items())
        },
        damaged=bool(log.file_corruption),
        dropouts=[(d.timestamp * 1e-6, d.duration * 1e-3) for d in log.dropouts],
    )
    for (name, multi_id), topic in topics.items():
        t = topic["timestamp"] * 1e-6
        try:
            _add_topic(recording, name, multi_id, t, topic, topics, first.get("THR_MDL_FAC", 0.0))
        except KeyError as error:  # of another age, or its description is damaged
            recording.dropped[f"{name} has no field {error}"] = len(t)
    return recording


def _load(path: Path) -> ULog:
    said = io.StringIO()  # pyulog prints what it finds wrong
    try:
        with open(path, "rb") as file, contextlib.redirect_stdout(said):
            return ULog(_Handle(_without_zeros(file)), _TOPICS)
    except OSError as error:
        if error.errno == errno.EINVAL:  # pyulog went back by a damaged length, out of the file
            raise InputError(f"{path} cannot be read as a PX4 log: it is damaged") from error
        raise InputError(f"cannot read {path}: {error.strerror}") from error
    except (
        ULogException, struct.error, ValueError, KeyError, IndexError, TypeError, AttributeError,
        OverflowError, RecursionError, MemoryError,
    ) as error:  # fmt: skip
        raise InputError(f"{path} cannot be read as a PX4 log: {error}") from error


def _without_zeros(file: BinaryIO) -> BinaryIO:
    """A log without the zeros behind it, as a power cut leaves them.

    pyulog takes every three of them for a message: two seconds a megabyte.
    """
    size = end = file.seek(0, io.SEEK_END)
    content = b""
    while end and not content:
        start = max(end - _PIECE, 0)
        file.seek(start)
        content = file.read(end - start).rstrip(b"\0")
        end = start
    file.seek(0)
    kept = end + len(content) + _ZEROS
    return file if size <= kept else io.BytesIO(file.read(kept))


class _Handle:
    """A file for pyulog, which goes back by the length of what it wanted, not of what it got.

    Where a damaged length leads out of the file, it would begin again somewhere in the middle,
    and often without end.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._asked = self._missing = 0
        self.tell, self.close = file.tell, file.close
        self.read: Callable[[int], bytes] = self._read_definition

    def _read_definition(self, size: int) -> bytes:
        data = self._file.read(size)
        self._asked, self._missing = size, size - len(data)
        return data

    def seek(self, offset: int, whence: int = 0) -> int:
        """As files do, from where all that was asked for would have ended."""
        if whence == 1:
            if offset == -(_ENTRY_HEAD + self._asked):
                self.read = self._file.read  # the definitions end: what follows must be fast
            offset += self._missing
        self._missing = 0
        return self._file.seek(offset, whence)


def _add_topic(
    recording: Recording,
    name: str,
    multi_id: int,
    t: Array,
    topic: Topic,
    topics: dict[tuple[str, int], Topic],
    thrust_factor: float,
) -> None:
    source = f"{name}_{multi_id}" if multi_id else name
    if name == "actuator_outputs":
        count = int(topic["noutputs"].max())
        recording.add(Stream.ROTOR_COMMAND, t, _columns(topic, "output", count), source=source)
    elif multi_id:  # a second sensor or estimator is another stream, not more samples
        return
    elif name == "sensor_combined":
        recording.add(Stream.IMU, t, _imu(t, topic, topics.get(("estimator_sensor_bias", 0))))
    elif name == "vehicle_attitude":
        recording.add_attitude(t, _columns(topic, "q", 4))
    elif name == "vehicle_local_position":
        values = [topic[field] for field in ("vx", "vy", "vz", "x", "y", "z")]
        recording.add(Stream.VELOCITY, t, np.column_stack(values))
    elif name == "actuator_motors":
        recording.add(Stream.ROTOR_COMMAND, t, _motors(topic, thrust_factor), source=source)
    elif name == "esc_status":
        recording.add(Stream.ROTOR_SPEED, t, _speeds(topic), source=source)
    elif name == "vehicle_land_detected":
        _add_flight(recording, t, topic, topics.get(("vehicle_status", 0)))
    elif name == "vehicle_status":
        recording.add(Stream.ARMED, t, topic["arming_state"] == _ARMED)


def _parameters(log: ULog) -> list[tuple[float, str, float]]:
    start = log.start_timestamp * 1e-6
    initial = ((start, name, value) for name, value in log.initial_parameters.items())
    changed = ((t * 1e-6, name, value) for t, name, value in log.changed_parameters)
    return [
        (t, name, float(value))
        for t, name, value in (*initial, *changed)
        if isinstance(value, int | float) and np.isfinite(value) and name.isprintable()
    ]


def _constant(topic: Topic, field: str) -> int | None:
    return int(topic[field][0]) if field in topic else None


def _columns(topic: Topic, field: str, count: int) -> Array:
    """(n, count) of an array field; KeyError when the topic has not all of it."""
    if not count:
        raise KeyError(field)
    with np.errstate(invalid="ignore"):  # damaged values may be NaN
        return np.column_stack([topic[f"{field}[{i}]"] for i in range(count)]).astype(float)


def _imu(t: Array, topic: Topic, bias: Topic | None) -> Array:
    """(n, 6) gyro and specific force, less the estimator's biases, as HIGHRES_IMU has them."""
    values = np.hstack([_columns(topic, "gyro_rad", 3), _columns(topic, "accelerometer_m_s2", 3)])
    if bias is not None:
        biases = np.hstack([_columns(bias, "gyro_bias", 3), _columns(bias, "accel_bias", 3)])
        last = np.searchsorted(bias["timestamp"] * 1e-6, t, side="right") - 1
        values -= np.where(last[:, None] >= 0, biases[np.maximum(last, 0)], 0.0)
    return values


def _motors(topic: Topic, thrust_factor: float) -> Array:
    """(n, motors) commands, 0 to 1, that the drivers scale to their range.

    The topic holds the thrust wanted; the driver's side makes it a command by inverting
    T = (1 - c) u + c u^2, c being THR_MDL_FAC. A stopped motor is NaN there, and 0 here.
    """
    count = sum(1 for field in topic if field.startswith("control["))
    thrust = _columns(topic, "control", count)
    used = np.flatnonzero(np.isfinite(thrust).any(axis=0))
    thrust = np.nan_to_num(thrust[:, : used[-1] + 1 if len(used) else 0], nan=0.0).clip(-1.0, 1.0)
    if not 1e-6 < thrust_factor <= 1.0:
        return thrust
    half = 0.5 * (1.0 - thrust_factor) / thrust_factor
    magnitude = np.sqrt(half**2 + np.abs(thrust) / thrust_factor) - half
    return np.copysign(magnitude, thrust)


def _speeds(topic: Topic) -> Array:
    """(n, motors) rad/s without sign, in motor order where the ESCs tell their motors."""
    count = sum(1 for field in topic if field.endswith(".esc_rpm"))
    count = min(int(topic["esc_count"].max()), count) or count
    if not count:
        raise KeyError("esc")
    rpm = np.column_stack([topic[f"esc[{i}].esc_rpm"] for i in range(count)])
    functions = [topic.get(f"esc[{i}].actuator_function") for i in range(count)]
    motors = [int(f.max()) - _FIRST_MOTOR for f in functions if f is not None]
    if sorted(motors) == list(range(count)):
        rpm = rpm[:, np.argsort(motors)]
    speeds: Array = np.abs(rpm.astype(float)) * RPM
    return speeds


def _add_flight(recording: Recording, t: Array, landed: Topic, status: Topic | None) -> None:
    """In the air, and neither taking off nor landing by itself, as EXTENDED_SYS_STATE says it."""
    if status is None:
        recording.add(Stream.IN_AIR, t, landed["landed"] == 0)
        return
    status_t = status["timestamp"] * 1e-6
    both = np.union1d(t, status_t)
    flies = landed["landed"][np.maximum(np.searchsorted(t, both, side="right") - 1, 0)] == 0
    mode = status["nav_state"][np.maximum(np.searchsorted(status_t, both, side="right") - 1, 0)]
    recording.add(Stream.IN_AIR, both, flies & ~np.isin(mode, (_AUTO_TAKEOFF, _AUTO_LAND)))
