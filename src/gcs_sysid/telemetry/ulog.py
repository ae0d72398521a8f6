"""PX4's own logs (.ulg): each topic as the stream that it would be on a link.

Which topic is which message was measured on a flight recorded both ways:

- `sensor_combined` less `estimator_sensor_bias` is HIGHRES_IMU (the same stamps, equal to
  1e-5 rad/s): the mean over the last interval, stamped with its end. `vehicle_angular_velocity`
  is low-passed and differs by 0.08 rad/s.
- `actuator_motors` is the command at the full rate; `actuator_outputs`, the same in the driver's
  unit, is usually thinned to 10 Hz.
"""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError
from gcs_sysid.signals.motor_order import AS_SENT, motor_of
from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.message_table import RPM, OnboardMessage
from gcs_sysid.telemetry.track_collector import Recording, interpolated
from gcs_sysid.telemetry.ulog_format import Topic, TopicLog, UlogFile

_ARMED = 2
"""vehicle_status.arming_state."""
_MOTORS, _ESCS, _LANDED, _STATUS, _BATTERY, _AIR = (
    "actuator_motors", "esc_status", "vehicle_land_detected", "vehicle_status", "battery_status",
    "vehicle_air_data",
)  # fmt: skip


def _names_in(fields: Sequence[str]) -> Iterator[str]:
    """`output` and `noutputs` of `output[noutputs]`."""
    return (name for field in fields for name in field.rstrip("]").split("["))


_HALVES = (
    (("vehicle_angular_velocity", ("xyz[3]",)), ("vehicle_acceleration", ("xyz[3]",))),
    (("sensor_gyro", ("x", "y", "z")), ("sensor_accel", ("x", "y", "z"))),
)
"""Topics of gyro and accelerometer, read where sensor_combined is missing."""
TOPICS = (
    OnboardMessage(
        "sensor_combined", Stream.IMU, ("gyro_rad[3]", "accelerometer_m_s2[3]"),
        offset=("estimator_sensor_bias", ("gyro_bias[3]", "accel_bias[3]")),
    ),
    OnboardMessage("vehicle_attitude", Stream.ATTITUDE, ("q[4]",)),
    OnboardMessage(
        "vehicle_local_position", Stream.VELOCITY, ("vx", "vy", "vz", "x", "y", "z")
    ),
    OnboardMessage("vehicle_rates_setpoint", Stream.RATE_SETPOINT, ("roll", "pitch", "yaw")),
    OnboardMessage(
        "actuator_outputs", Stream.ROTOR_COMMAND, ("output[noutputs]",), sensors="all"
    ),
    OnboardMessage(_STATUS, Stream.ARMED, ("arming_state",), is_equal_to=_ARMED),
)  # fmt: skip
"""Topics whose fields are the values. Motors, ESCs and flight take more, see `_add_topic`."""
_GPS = ("vehicle_gps_position", "sensor_gps")
"""The receiver that is used, and every one; the first is read where there are both."""
_OFFSETS = dict(row.offset for row in TOPICS if row.offset is not None)
_FIELDS = {
    _MOTORS: {"control"},
    _ESCS: {"esc_count", "esc_rpm", "esc_current", "actuator_function"},
    _LANDED: {"landed"},
    _BATTERY: {"voltage_v"},
    _AIR: {"baro_pressure_pa"},
    **{name: {"time_utc_usec"} for name in _GPS},
    **{row.name: {*_names_in(row.fields)} for row in TOPICS},
    **{name: {*_names_in(fields)} for name, fields in _OFFSETS.items()},
    **{name: {*_names_in(fields)} for halves in _HALVES for name, fields in halves},
}
_FIELDS[_STATUS] |= {"nav_state", "system_id", "component_id", "system_type"}
"""Topic -> fields that are read, of it or of each ESC in it."""
READ = {*_FIELDS}
"""Topics that are read at all."""
_NEEDED_BY_OTHERS = {_STATUS, *_OFFSETS}


def is_read(topic: str, column: str) -> bool:
    """Whether a column of one of the topics in `READ` is needed."""
    name = column.rpartition(".")[2].partition("[")[0]
    return column == "timestamp" or name in _FIELDS[topic]


def read_ulog(path: Path) -> Recording:
    """Read a .ulg file.

    Raises:
        InputError: it cannot be read, is no ULog, or holds no data.
    """
    log = UlogFile(path, READ, is_read)
    with np.errstate(invalid="ignore", over="ignore"):  # damaged numbers may be anything
        return recording_of(path, log)


def recording_of(path: Path, log: TopicLog) -> Recording:
    """What PX4's topics say; they are used up.

    Raises:
        InputError: there are none.
    """
    topics = log.topics
    if not topics:
        fault = next((f"{name}: {why}" for name, why in log.faults.items()), "")
        why = fault or "the log ends before any was written"
        raise InputError(f"{path} holds no flight data: {why}")
    status = topics.get(("vehicle_status", 0), {})
    initial = [(log.start, name, value) for name, value in log.initial.items()]
    parameters = [*initial, *log.changed]
    first = {name: value for _, name, value in reversed(parameters)}
    recording = Recording(
        tracks=[],
        system=_constant(status, "system_id") or int(first.get("MAV_SYS_ID", 1.0)),
        component=_constant(status, "component_id") or 1,
        vehicle_type=_constant(status, "system_type") or int(first.get("MAV_TYPE", 0.0)),
        autopilot=mavlink.MAV_AUTOPILOT_PX4,
        parameters=parameters,
        counts={
            name if not multi_id else f"{name}_{multi_id}": len(topic["timestamp"])
            for (name, multi_id), topic in sorted(topics.items())
        },
        garbage_bytes=log.garbage_bytes,
        damaged=log.damaged,
        dropouts=log.dropouts,
    )
    recording.dropped |= {f"{name}: {why}": 0 for name, why in log.faults.items() if name in READ}
    _add_halves(recording, topics)
    for name, multi_id in list(topics):
        # What no other topic needs is let go: its rows take as much memory as its track.
        take = topics.get if name in _NEEDED_BY_OTHERS else topics.pop
        topic = take((name, multi_id), {})
        t = topic["timestamp"] * 1e-6
        try:
            _add_topic(recording, name, multi_id, t, topic, topics, first)
        except KeyError as error:  # of another age, or its description is damaged
            recording.dropped[f"{name} has no field {error}"] = len(t)
    return recording


def _add_topic(
    recording: Recording,
    name: str,
    multi_id: int,
    t: Array,
    topic: Topic,
    topics: dict[tuple[str, int], Topic],
    parameters: Mapping[str, float],
) -> None:
    source = f"{name}_{multi_id}" if multi_id else name
    for row in TOPICS:
        if row.name == name and (not multi_id or row.sensors == "all"):
            values = row.values(_values(row, t, topic, topics))
            rotors = row.stream is Stream.ROTOR_COMMAND
            recording.add(row.stream, t, values, source=source if rotors else "")
    if multi_id:
        return
    if name == _MOTORS:
        commands = _motors(topic, parameters.get("THR_MDL_FAC", 0.0))
        recording.add(Stream.ROTOR_COMMAND, t, commands, source=source)
    elif name == _ESCS:
        rpm, by_motor = _of_escs(topic, "esc_rpm")
        speeds = np.abs(rpm) * RPM
        recording.add(Stream.ROTOR_SPEED, t, speeds, source=source if by_motor else AS_SENT)
        if by_motor and "esc[0].esc_current" in topic:
            recording.extras["motor currents"] = t, _of_escs(topic, "esc_current")[0]
    elif name == _BATTERY:
        recording.add_voltage(t, _columns(topic, "voltage_v"))
    elif name in _GPS and not (name == _GPS[1] and len(recording.clock[0])):
        recording.add_clock(t, topic["time_utc_usec"] * 1e-6, topic["time_utc_usec"] > 0)
    elif name == _AIR:
        recording.extras["pressure"] = t, _columns(topic, "baro_pressure_pa")
    elif name == _LANDED:
        recording.add(Stream.IN_AIR, t, topic["landed"] == 0)


def _add_halves(recording: Recording, topics: dict[tuple[str, int], Topic]) -> None:
    """The IMU of topics of gyro and accelerometer: those whose gyro comes most often."""
    if ("sensor_combined", 0) in topics:
        return
    found: list[tuple[Array, Array]] = []
    for halves in _HALVES:
        with contextlib.suppress(KeyError):  # one is missing, or of another age
            (t, gyro), (times, force) = (
                (topic["timestamp"] * 1e-6, _columns(topic, *fields))
                for topic, fields in ((topics[name, 0], fields) for name, fields in halves)
            )
            # Written one after the other: straight between those before and behind.
            found.append((t, np.hstack([gyro, interpolated(t, times, force)])))
    if found:
        recording.add(Stream.IMU, *max(found, key=lambda each: len(each[0])))


def _values(
    row: OnboardMessage, t: Array, topic: Topic, topics: dict[tuple[str, int], Topic]
) -> Array:
    """(n, fields) of a row's fields, less its offsets."""
    values = _columns(topic, *row.fields)
    if row.offset is not None:
        name, fields = row.offset
        size = topics.get((name, 0))
        if size is not None:
            offsets = _columns(size, *fields)
            last = np.searchsorted(size["timestamp"] * 1e-6, t, side="right") - 1
            for i in range(values.shape[1]):
                values[:, i] -= np.where(last >= 0, offsets[np.maximum(last, 0), i], 0.0)
    return values


def _constant(topic: Topic, field: str) -> int | None:
    return _whole(topic[field][0]) if field in topic else None


def _whole(number: Any) -> int:
    """A damaged log may give a count the type of a fraction."""
    return int(number) if np.isfinite(number) else 0


def _columns(topic: Topic, *fields: str) -> Array:
    """(n, count) of fields, see `OnboardMessage.fields`; KeyError when not all are there."""
    columns: list[Array] = []
    for field in fields:
        name, _, size = field.rstrip("]").partition("[")
        if not size:
            columns.append(topic[name])
            continue
        count = int(size) if size.isdigit() else _whole(topic[size].max())
        if count <= 0:
            raise KeyError(name)
        columns += (topic[f"{name}[{i}]"] for i in range(count))
    values = np.empty((len(columns[0]), len(columns)))
    for i, column in enumerate(columns):
        values[:, i] = column
    return values


def _motors(topic: Topic, thrust_factor: float) -> Array:
    """(n, motors) commands, 0 to 1, that the drivers scale to their range.

    The topic holds the thrust wanted; the driver's side makes it a command by inverting
    T = (1 - c) u + c u^2, c being THR_MDL_FAC. A stopped motor is NaN there, and 0 here.
    """
    count = sum(1 for field in topic if field.startswith("control["))
    used = [i for i in range(count) if np.isfinite(topic[f"control[{i}]"]).any()]
    if not used:
        if not count:
            raise KeyError("control")
        return np.empty((len(topic["timestamp"]), 0))
    thrust = _columns(topic, f"control[{used[-1] + 1}]")
    np.nan_to_num(thrust, copy=False, nan=0.0)
    np.clip(thrust, -1.0, 1.0, out=thrust)
    if not 1e-6 < thrust_factor <= 1.0:
        return thrust
    half = 0.5 * (1.0 - thrust_factor) / thrust_factor
    magnitude = np.sqrt(half**2 + np.abs(thrust) / thrust_factor) - half
    return np.copysign(magnitude, thrust)


def _of_escs(topic: Topic, field: str) -> tuple[Array, bool]:
    """(n, motors) what ESCs report; whether by motor, as they may report which they drive."""
    count = sum(1 for field in topic if field.endswith(".esc_rpm"))
    count = min(max(_whole(topic["esc_count"].max()), 0), count) or count
    if not count:
        raise KeyError("esc")
    values = np.column_stack([topic[f"esc[{i}].{field}"] for i in range(count)])
    functions = [topic.get(f"esc[{i}].actuator_function") for i in range(count)]
    motors = [motor_of("px4", float(f.max())) for f in functions if f is not None]
    where = {motor: i for i, motor in enumerate(motors) if motor >= 0}
    by_motor = bool(where) and sorted(where) == list(range(len(where)))
    if by_motor:
        values = values[:, [where[motor] for motor in range(len(where))]]
    return values.astype(float), by_motor
