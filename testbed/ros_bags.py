"""Recordings of ROS 2, made of PX4's logs or message by message."""

import io
import sqlite3
import struct
from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gcs_sysid.arrays import Array
from gcs_sysid.model.attitude import matrices
from gcs_sysid.signals.columns import Track
from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.ulog import READ
from gcs_sysid.telemetry.ulog_format import Formats, UlogFile

KINDS = {
    "bool": "?", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i",
    "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
_OF_ULOG = {"float": "float32", "double": "float64", "bool": "bool", "char": "uint8"}
_SECTION = "\n" + "=" * 80 + "\nMSG: "


def cdr(*parts: tuple[str, Any]) -> bytes:
    """A message of (type, value), each aligned to its size; a type may be `string`."""
    data = bytearray(b"\0\1\0\0")
    for kind, value in parts:
        text = value.encode() + b"\0" if kind == "string" else b""
        code = KINDS["uint32" if text else kind]
        data += bytes(-(len(data) - 4) % struct.calcsize(code))
        data += struct.pack("<" + code, len(text) if text else value) + text
    return bytes(data)


@dataclass
class Bag:
    """A recording: rows of topic, type, definition, and (ns, message)."""

    topics: list[tuple[str, str, str, Sequence[tuple[int, bytes]]]] = field(default_factory=list)

    def mcap(self, compression: str = "", chunk_size: int = 2**20) -> bytes:
        """As the MCAP library writes it."""
        from mcap.writer import CompressionType, Writer

        file = io.BytesIO()
        kind = {"": CompressionType.NONE, "lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}
        writer = Writer(file, chunk_size=chunk_size, compression=kind[compression])
        writer.start("ros2")
        messages = []
        for name, kind_, text, rows in self.topics:
            schema = writer.register_schema(kind_, "ros2msg", text.encode())
            channel = writer.register_channel(name, "cdr", schema)
            messages += [(t, channel, message) for t, message in rows]
        for t, channel, message in sorted(messages):
            writer.add_message(channel, t, message, t)
        writer.finish()  # type: ignore[no-untyped-call]
        return file.getvalue()

    def database(self, path: Path, *, described: bool = True) -> None:
        """Write it as rosbag2's plugin for SQLite does; before Iron it did not describe types."""
        with closing(sqlite3.connect(path)) as database:
            database.execute("CREATE TABLE topics(id, name, type, serialization_format)")
            database.execute("CREATE TABLE messages(id, topic_id, timestamp, data)")
            if described:
                database.execute(
                    "CREATE TABLE message_definitions(topic_type, encoding, "
                    "encoded_message_definition)"
                )
            for number, (name, kind, text, rows) in enumerate(self.topics):
                database.execute("INSERT INTO topics VALUES(?,?,?,'cdr')", (number, name, kind))
                if described:
                    database.execute(
                        "INSERT INTO message_definitions VALUES(?,'ros2msg',?)", (kind, text)
                    )
                database.executemany(
                    "INSERT INTO messages VALUES(0,?,?,?)", ((number, *row) for row in rows)
                )
            database.commit()


def px4_bag(path: Path) -> Bag:
    """A .ulg as the messages of px4_msgs that the vehicle would have sent to ROS 2."""
    log = UlogFile(path, READ)
    bag = Bag()
    for (name, multi_id), columns in log.topics.items():
        if not multi_id:
            sections: dict[str, list[str]] = {}
            layout: list[tuple[str, str, int]] = []
            size = _lay_out(log._formats, name, "", 0, layout, sections)
            table = np.zeros((len(columns["timestamp"]), 4 + size), np.uint8)
            table[:, 1] = 1
            for column, kind, at in layout:
                if column in columns:
                    values = columns[column].astype("<" + np.dtype(kind).str[1:])
                    table[:, 4 + at : 4 + at + values.itemsize] = values.view(np.uint8).reshape(
                        len(table), -1
                    )
            texts = [
                f"{_SECTION}px4_msgs/{_camel(kind)}\n" * (kind != name) + "\n".join(lines)
                for kind, lines in reversed(sections.items())
            ]
            times = (columns["timestamp"] * 1000).tolist()
            rows = [(t, row.tobytes()) for t, row in zip(times, table, strict=True)]
            bag.topics.append(
                (f"/fmu/out/{name}", f"px4_msgs/msg/{_camel(name)}", "".join(texts), rows)
            )
    return bag


def _camel(name: str) -> str:
    return "".join(word.capitalize() for word in name.split("_"))


def _lay_out(
    formats: Formats,
    name: str,
    prefix: str,
    at: int,
    layout: list[tuple[str, str, int]],
    sections: dict[str, list[str]],
) -> int:
    """Where each column is in CDR, and the fields of each type; the bytes up to here."""
    lines: list[str] = []
    for each in formats._formats[name]:
        if each.name.startswith("_padding"):
            continue
        kind = _OF_ULOG.get(each.kind, each.kind.removesuffix("_t"))
        size = "" if each.count is None else f"[{each.count}]"
        lines.append(f"{kind if kind in KINDS else _camel(each.kind)}{size} {each.name}  # of PX4")
        for i in range(1 if each.count is None else each.count):
            column = prefix + each.name + ("" if each.count is None else f"[{i}]")
            if kind in KINDS:
                width = struct.calcsize(KINDS[kind])
                at += -at % width
                layout.append((column, KINDS[kind], at))
                at += width
            else:
                at = _lay_out(formats, each.kind, column + ".", at, layout, sections)
    sections[name] = ["uint32 MESSAGE_VERSION = 0", *lines]
    return at


_HEADER = f"{_SECTION}std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id"
_VECTOR = f"{_SECTION}geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z"
_QUATERNION = (
    f"{_SECTION}geometry_msgs/Quaternion\nfloat64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1"
)
_IMU = f"""# of an IMU
std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance # row major
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance{_HEADER}{_VECTOR}{_QUATERNION}"""
_ODOMETRY = f"""std_msgs/Header header
string child_frame_id
geometry_msgs/PoseWithCovariance pose
geometry_msgs/TwistWithCovariance twist{_HEADER}{_QUATERNION}{_VECTOR}{_SECTION}geometry_msgs/Point
float64 x
float64 y
float64 z{_SECTION}geometry_msgs/Pose
Point position
Quaternion orientation{_SECTION}geometry_msgs/PoseWithCovariance
Pose pose
float64[36] covariance{_SECTION}geometry_msgs/Twist
Vector3 linear
Vector3 angular{_SECTION}geometry_msgs/TwistWithCovariance
Twist twist
float64[36] covariance"""
_ESCS = f"""std_msgs/Header header
mavros_msgs/ESCTelemetryItem[] esc_telemetry{_HEADER}{_SECTION}mavros_msgs/ESCTelemetryItem
std_msgs/Header header
float32 temperature
float32 voltage
int32 rpm
uint16 count"""
_STATE = f"std_msgs/Header header\nbool connected\nbool armed\nstring mode{_HEADER}"
_EXTENDED = f"""uint8 LANDED_STATE_IN_AIR = 2
std_msgs/Header header
uint8 vtol_state
uint8 landed_state{_HEADER}"""
_BATTERY = f"std_msgs/Header header\nfloat32 voltage\nfloat32[] cell_voltage{_HEADER}"


def _header(t: float, frame: str) -> list[tuple[str, Any]]:
    seconds, fraction = divmod(round(1e9 * t), 10**9)
    return [("int32", seconds), ("uint32", fraction), ("string", frame)]


def _doubles(*values: float) -> list[tuple[str, Any]]:
    return [("float64", value) for value in values]


def mavros_bag(tracks: Iterable[Track], vehicle: str = "/mavros") -> Bag:
    """Streams of a vehicle as MAVROS publishes them: forward, left, up in the body, and ENU.

    Written without the code that reads them: a turn is a matrix here.
    """
    bag = Bag()
    by_stream = {track.stream: track for track in tracks}

    def publish(stream: Stream, name: str, kind: str, text: str, parts: Any) -> None:
        track = by_stream.get(stream)
        rows = (
            []
            if track is None
            else [
                (round(1e9 * t), cdr(*parts(t, v)))
                for t, v in zip(track.t.tolist(), track.values, strict=True)
            ]
        )
        if rows:
            bag.topics.append((f"{vehicle}/{name}", kind, text, rows))

    def imu(t: float, v: Array) -> list[tuple[str, Any]]:
        gyro, force = v[:3] * (1, -1, -1), v[3:] * (1, -1, -1)
        return [*_header(t, "base_link"), *_doubles(0, 0, 0, 1, -1, *[0] * 8, *gyro, *[0] * 9,
                                                    *force, *[0] * 9)]  # fmt: skip

    attitude = by_stream[Stream.ATTITUDE]
    turns = matrices(attitude.values)

    def odometry(t: float, v: Array) -> list[tuple[str, Any]]:
        ned = turns[np.argmin(np.abs(attitude.t - t))]
        enu = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]]) @ ned @ np.diag([1, -1, -1])
        x, y, z, w = Rotation.from_matrix(enu).as_quat()
        body = (ned.T @ v[:3]) * (1, -1, -1)
        return [
            *_header(t, "map"), ("string", "base_link"), *_doubles(v[4], v[3], -v[5], x, y, z, w),
            *_doubles(*[0] * 36, *body, *[0] * 3, *[0] * 36),
        ]  # fmt: skip

    def escs(t: float, v: Array) -> list[tuple[str, Any]]:
        parts = [*_header(t, ""), ("uint32", len(v))]
        for speed in v:
            parts += [*_header(t, "esc"), ("float32", 40.0), ("float32", 15.0),
                      ("int32", round(speed * 30.0 / np.pi)), ("uint16", 7)]  # fmt: skip
        return parts

    publish(Stream.IMU, "imu/data_raw", "sensor_msgs/msg/Imu", _IMU, imu)
    publish(Stream.VELOCITY, "local_position/odom", "nav_msgs/msg/Odometry", _ODOMETRY, odometry)
    publish(
        Stream.ROTOR_SPEED, "esc_telemetry/telemetry", "mavros_msgs/msg/ESCTelemetry", _ESCS, escs
    )
    publish(
        Stream.ARMED, "state", "mavros_msgs/msg/State", _STATE,
        lambda t, v: [*_header(t, ""), ("bool", True), ("bool", bool(v[0])),
                      ("string", "OFFBOARD" if v[0] else "MANUAL")],
    )  # fmt: skip
    publish(
        Stream.IN_AIR, "extended_state", "mavros_msgs/msg/ExtendedState", _EXTENDED,
        lambda t, v: [*_header(t, ""), ("uint8", 3), ("uint8", 2 if v[0] else 1)],
    )  # fmt: skip
    publish(
        Stream.VOLTAGE, "battery", "sensor_msgs/msg/BatteryState", _BATTERY,
        lambda t, v: [*_header(t, ""), ("float32", v[0]), ("uint32", 1), ("float32", v[0])],
    )  # fmt: skip
    return bag
