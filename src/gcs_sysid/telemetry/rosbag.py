"""Recordings of ROS 2: .mcap, .db3, or the folder of them that `ros2 bag record` makes.

px4_msgs are PX4's topics in another container, and read as those of its own logs. Of other messages
`ros_columns.toml`, or a mapping file, says which fields are which signal, as for tables. Files are
untrusted: what is unpacked is bounded, and what is damaged is left out.
"""

import mmap
import re
import sqlite3
import struct
import zlib
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from functools import lru_cache
from importlib import resources
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError, needed
from gcs_sysid.files import files_of, parse_toml, reading_log
from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry import ulog
from gcs_sysid.telemetry.mapped_table import (
    SIGNALS,
    TableMapping,
    mapping_of,
    read_mapping,
    recording_of,
)
from gcs_sysid.telemetry.ros_messages import JsonColumns, MessageColumns, short_type
from gcs_sysid.telemetry.track_collector import Recording
from gcs_sysid.telemetry.ulog_format import TopicLog

_HEAD = struct.Struct("<BQ")
"""Kind and size of a record."""
_MESSAGE = struct.Struct("<HIQQ")
"""Channel, number, ns when it was recorded, ns when it was sent."""
_UNDESCRIBED = (
    "the bag does not describe its messages, as of ROS 2 before Iron: convert it to MCAP where "
    "they are installed, with ros2 bag convert (docs/logs.md)"
)
_PX4 = re.compile(r"(.*/)?fmu/(?:out/)?(\w+?)(?:_v\d+)?(?:/out)?")
"""Namespace and name of a topic of PX4's."""
_INDEX = re.compile(r"\[(\d+|\*)\]")

_Columns = MessageColumns | JsonColumns
_IsRead = Callable[[str], bool]


class RosBag:
    """A recording read once, within bounds of time and memory.

    `wanted` gives of a topic and its type which fields are read; None: the topic is not.

    Attributes:
        kinds: name -> type of all topics.
        topics: name -> columns of those that are wanted, as of `MessageColumns`.
        counts: name -> messages of those.
        faults: why messages are not read -> how many.
        damaged: whether a file is not as it was written.
        garbage_bytes: behind the last whole record.

    Raises:
        InputError: it cannot be read, or is too large when unpacked.
    """

    MAGIC = b"\x89MCAP0\r\n"
    """Begins an MCAP file; the others are databases."""
    MOST_TOPICS = 1024
    MOST_BYTES_OF_CHUNK = 2**27
    SMALL, MOST_UNPACKED = 2**24, 100
    """Bytes that any file may become when unpacked, and so many for each that it has."""

    def __init__(self, path: Path, wanted: Callable[[str, str], _IsRead | None]) -> None:
        self._wanted = wanted
        self._read: dict[str, _Columns] = {}
        self.kinds: dict[str, str] = {}
        self.faults: dict[str, int] = {}
        self.damaged = False
        self.garbage_bytes = 0
        files = files_of(path)
        self._size = sum(file.stat().st_size for file in files)
        self._may_unpack = self.SMALL + self.MOST_UNPACKED * self._size
        try:
            for file in files:
                with open(file, "rb") as opened:
                    is_mcap = opened.read(len(self.MAGIC)) == self.MAGIC
                (self._read_mcap if is_mcap else self._read_database)(file)
        except InputError as error:
            raise InputError(f"{path}: {error}") from error
        self.counts = {name: content.count for name, content in self._read.items()}
        self.topics: dict[str, dict[str, Array]] = {}
        for name, content in self._read.items():
            if columns := content.columns():
                self.topics[name] = columns
            for why, count in content.unread.items():
                self._fault(f"{name}: {why}", count)
        self._read.clear()

    def _fault(self, why: str, count: int = 0) -> None:
        if why in self.faults or len(self.faults) < self.MOST_TOPICS:
            self.faults[why] = self.faults.get(why, 0) + count

    def _topic(self, name: str, kind: str, encoding: str, form: str, text: str) -> _Columns | None:
        """A topic, if it is wanted and can be read.

        `form` is the definition's; empty where there is none.
        """
        kind = short_type(kind)
        if name in self.kinds:
            return self._read.get(name) if self.kinds[name] == kind else None
        if len(self.kinds) >= self.MOST_TOPICS or not (name + kind).isprintable():
            return None
        self.kinds[name] = kind
        is_read = self._wanted(name, kind)
        if is_read is None:
            return None
        try:
            if encoding == "json":
                self._read[name] = JsonColumns(is_read)
            elif encoding != "cdr" or form not in ("", "ros2msg"):
                raise InputError(f"messages as {encoding[:40]!r}, described as {form[:40]!r}")
            elif not form:
                raise InputError(_UNDESCRIBED)
            else:
                self._read[name] = MessageColumns(kind, text, is_read)
        except InputError as error:
            self._fault(f"{name[:80]}: {error}")
        return self._read.get(name)

    def _count_bytes(self, size: int) -> None:
        self._may_unpack -= size
        if self._may_unpack < 0:
            raise InputError("too large when unpacked")

    def _read_database(self, path: Path) -> None:
        address = path.absolute().as_uri() + "?mode=ro&immutable=1"
        try:
            with closing(sqlite3.connect(address, uri=True)) as database:
                database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, self.MOST_BYTES_OF_CHUNK)
                database.execute("PRAGMA trusted_schema = OFF")
                self._take_rows(database)
        except (sqlite3.Error, UnicodeDecodeError) as error:
            self.damaged = True
            self._fault(f"damaged: {_printable(error)}")

    def _take_rows(self, database: sqlite3.Connection) -> None:
        # A view may have rows without end.
        of_kind = "SELECT name FROM sqlite_master WHERE type = 'table'"
        tables = {name for (name,) in database.execute(of_kind)}
        if not {"topics", "messages"} <= tables:
            raise InputError("a database that is no recording of ROS 2")
        of_each = "topic_type, encoding, encoded_message_definition FROM message_definitions"
        described = database.execute(f"SELECT {of_each}") if of_each.split()[-1] in tables else ()
        definitions = {kind: words for kind, *words in described}
        topics = {}
        for number, name, kind, encoding in database.execute(
            "SELECT id, name, type, serialization_format FROM topics"
        ):
            words = [name, kind, encoding, *definitions.get(kind, ("", ""))]
            topic = self._topic(*words) if all(isinstance(w, str) for w in words) else None
            if topic is not None:
                topics[number] = topic
        marks = ",".join("?" * len(topics))
        for number, time, message in database.execute(
            f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks})", [*topics]
        ):
            if number in topics and isinstance(time, int) and isinstance(message, bytes):
                self._count_bytes(len(message))
                topics[number].add(message, time)

    def _read_mcap(self, path: Path) -> None:
        needed("mcap", "reading MCAP")
        records = _McapRecords(self._topic, self._count_bytes)
        with (
            open(path, "rb") as file,
            mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content,
        ):
            end = records.scan(content, len(self.MAGIC))
            self.garbage_bytes += len(content) - end
            self.damaged |= end < len(content) or bool(records.faults)
        for why, count in records.faults.items():
            self._fault(why, count)


class _McapRecords:
    """The records of an MCAP file, one after the other: a file that was cut short has no index."""

    def __init__(
        self,
        topic_of: Callable[[str, str, str, str, str], _Columns | None],
        count_bytes: Callable[[int], None],
    ) -> None:
        import lz4.frame
        import zstandard
        from mcap import data_stream, exceptions, opcode, records

        self._unpack_lz4 = lz4.frame.LZ4FrameDecompressor
        self._unpack_zstd = zstandard.ZstdDecompressor
        self._stream, self._kinds = data_stream.ReadDataStream, opcode.Opcode
        self._types: dict[int, Any] = {
            self._kinds.SCHEMA: records.Schema,
            self._kinds.CHANNEL: records.Channel,
            self._kinds.CHUNK: records.Chunk,
        }
        self._damage = (
            exceptions.McapError, zstandard.ZstdError, struct.error, ValueError, RuntimeError,
            OverflowError,
        )  # fmt: skip
        self._topic_of, self._count_bytes = topic_of, count_bytes
        self._schemas: dict[int, Any] = {}
        self._channels: dict[int, _Columns | None] = {}
        self._known: dict[int, Mapping[int, Any]] = {
            self._kinds.SCHEMA: self._schemas,
            self._kinds.CHANNEL: self._channels,
        }
        self.faults: dict[str, int] = {}

    def scan(self, content: Any, at: int, *, inside: bool = False) -> int:
        """Take the records of a file, or of a chunk; where the last whole one ends."""
        kinds = self._kinds
        of_message, of_chunk, of_end = map(int, (kinds.MESSAGE, kinds.CHUNK, kinds.DATA_END))
        while (start := at + _HEAD.size) <= len(content):
            kind, size = _HEAD.unpack_from(content, at)
            following = start + size
            if following > len(content):
                break
            if kind == of_message and size >= _MESSAGE.size:
                number, _, time, _ = _MESSAGE.unpack_from(content, start)
                topic = self._channels.get(number)
                if topic is not None:
                    topic.add(content[start + _MESSAGE.size : following], time)
            elif kind in self._known:
                number = int.from_bytes(content[start : start + 2], "little")
                if number not in self._known[kind] and len(self._known[kind]) < RosBag.MOST_TOPICS:
                    self._take(kind, content[start:following])
            elif inside or kind == 0:
                break  # there are no others in a chunk
            elif kind == of_chunk:
                self._take(kind, content[start:following])
            elif kind == of_end:
                return len(content)
            at = following
        return at

    def _take(self, kind: int, content: bytes) -> None:
        try:
            self._take_record(kind, self._types[kind].read(self._stream(BytesIO(content))))
        except self._damage as error:
            why = f"damaged {self._kinds(kind).name.lower()}: {_printable(error)}"
            self.faults[why] = self.faults.get(why, 0) + 1

    def _take_record(self, kind: int, record: Any) -> None:
        if kind == self._kinds.SCHEMA:
            self._schemas[record.id] = record
        elif kind == self._kinds.CHUNK:
            content = self._unpacked(record)
            if self.scan(content, 0, inside=True) < len(content):
                raise ValueError("its records do not end with it")
        else:
            schema = self._schemas.get(record.schema_id)
            words = ("", "", b"") if schema is None else (schema.name, schema.encoding, schema.data)
            self._channels[record.id] = self._topic_of(
                record.topic, words[0], record.message_encoding, words[1], words[2].decode()
            )

    def _unpacked(self, chunk: Any) -> bytes:
        size = chunk.uncompressed_size
        self._count_bytes(size)
        if size > RosBag.MOST_BYTES_OF_CHUNK:
            raise ValueError(f"{size:,} bytes when unpacked")
        content: bytes = chunk.data
        if chunk.compression == "zstd":
            content = self._unpack_zstd().stream_reader(content).read(size)
        elif chunk.compression == "lz4":
            content = self._unpack_lz4().decompress(content, max_length=size)
        elif chunk.compression:
            raise ValueError(f"packed by {chunk.compression[:20]!r}")
        wrong_sum = chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc
        if len(content) != size or wrong_sum:
            raise ValueError("wrong checksum or length")
        return content


def _printable(error: Exception) -> str:
    """What a library says of what is in a file."""
    return "".join(letter for letter in str(error)[:80] if letter.isprintable())


def read_rosbag(path: Path, mapping_path: Path | None = None) -> Recording:
    """Read a recording of ROS 2.

    The columns of a mapping file are `topic.field`; None: by their types.

    Raises:
        InputError: it cannot be read, or holds nothing of a flight.
    """
    with reading_log(path), np.errstate(invalid="ignore", over="ignore"):
        if mapping_path is None:
            recording, bag = _by_type(path)
        else:
            recording, bag = _by_mapping(path, mapping_path)
    recording.damaged, recording.garbage_bytes = bag.damaged, bag.garbage_bytes
    recording.dropped |= bag.faults
    return recording


def _by_mapping(path: Path, mapping_path: Path) -> tuple[Recording, RosBag]:
    mapping = read_mapping(mapping_path)

    def wanted(topic: str, _: str) -> _IsRead | None:
        of_topic = [c[len(topic) + 1 :] for c in mapping.columns if c.startswith(f"{topic}.")]
        return _is_among(of_topic) if of_topic else None

    bag = RosBag(path, wanted)
    return _recording(path, bag, mapping, mapping_path), bag


def _by_type(path: Path) -> tuple[Recording, RosBag]:
    text = (resources.files("gcs_sysid.telemetry") / "ros_columns.toml").read_text("utf-8")
    table = parse_toml(text, "ros_columns.toml", "a mapping file")
    rows = table.pop("message")
    fields: dict[str, set[str]] = {}
    for row in rows:
        row |= {key: row.get(key, value) for key, value in table.items()}
        read = fields.setdefault(row["type"], {row["time"]})
        read.update(column for name in SIGNALS if name in row for column in row[name]["columns"])

    def wanted(topic: str, kind: str) -> _IsRead | None:
        _, name = _px4_topic(topic, kind)
        if name in ulog.READ:
            return lambda column: ulog.is_read(name, column)
        return _is_among(fields[kind]) if kind in fields else None

    bag = RosBag(path, wanted)
    return _of_px4(path, bag) or _of_messages(path, bag, rows), bag


def _px4_topic(topic: str, kind: str) -> tuple[str, str]:
    """Namespace and PX4's name of a topic; "": it is none of PX4's."""
    found = _PX4.fullmatch(topic) if kind.startswith("px4_msgs/") else None
    return (found[1] or "", found[2]) if found is not None else ("", "")


def _of_px4(path: Path, bag: RosBag) -> Recording | None:
    """By PX4's topics, of the vehicle that has most messages; None: there are none."""
    vehicles: dict[str, TopicLog] = {}
    counts: dict[str, int] = {}
    for name, columns in bag.topics.items():
        vehicle, topic = _px4_topic(name, bag.kinds[name])
        if topic and "timestamp" in columns:
            topics = vehicles.setdefault(vehicle, TopicLog()).topics
            # A node that translates versions publishes a topic twice.
            if (topic, 0) not in topics or len(topics[topic, 0]["timestamp"]) < bag.counts[name]:
                topics[topic, 0] = columns
            counts[vehicle] = counts.get(vehicle, 0) + bag.counts[name]
    if not vehicles:
        return None
    chosen = max(counts, key=lambda vehicle: counts[vehicle])
    recording = ulog.recording_of(path, vehicles.pop(chosen))
    recording.dropped |= {f"of another vehicle: {name}": counts[name] for name in vehicles}
    return recording


def _of_messages(path: Path, bag: RosBag, rows: Iterable[Mapping[str, Any]]) -> Recording:
    """By the rows of `ros_columns.toml`."""
    chosen: dict[str, Any] = {}
    for row in rows:
        topic = _topic_of(bag, row)
        if topic is None:
            continue
        for signal in (name for name in SIGNALS if name in row and name not in chosen):
            names = _found(bag.topics[topic], row[signal]["columns"])
            if names:
                chosen[signal] = {
                    "frame": row["frame"],
                    "world": row["world"],
                    **row[signal],
                    "columns": [f"{topic}.{name}" for name in names],
                    "time": f"{topic}.{row['time']}",
                }
    if "gyro" not in chosen:
        raise InputError(f"{path}: {_why_not(bag)}")
    if "velocity" not in chosen:
        chosen.pop("position", None)
    recording = _recording(path, bag, mapping_of(path, chosen), path)
    for track in recording.tracks:
        down = track.values[:, -1]
        if track.stream is Stream.IMU and (down > 0.0).sum() > (down < 0.0).sum():
            raise InputError(
                f"{path}: its IMU is upside down if its axes are forward, left, up, as ROS has "
                'them: say what they are with --csv, such as frame = "FRD"'
            )
    return recording


def _topic_of(bag: RosBag, row: Mapping[str, Any]) -> str | None:
    """The topic that a row is of; None: there is none, or it is not clear which."""
    of_type = [name for name in bag.topics if bag.kinds[name] == row["type"]]
    for ending in row.get("topics", ("",)):
        fitting = [name for name in of_type if f"/{name}".endswith(ending and f"/{ending}")]
        if len(fitting) == 1:
            return fitting[0]
        if fitting:
            bag.faults.setdefault(f"{' or '.join(sorted(fitting)[:4])}: not clear which", 0)
    return None


def _pattern(names: Iterable[str]) -> re.Pattern[str]:
    return re.compile("|".join(re.escape(name).replace(r"\*", r"\d+") for name in names))


def _found(columns: Mapping[str, Array], names: list[str]) -> list[str]:
    """Names of columns with each `*` replaced by what there is, but for unused ones at the end."""
    if not any("*" in name for name in names):
        return names if columns.keys() >= set(names) else []
    pattern = _pattern(names)
    found = [name for name in columns if pattern.fullmatch(name)]
    found.sort(key=lambda name: [int(number) for number in re.findall(r"\d+", name)])
    while found and not (columns[found[-1]] != 0.0).any():
        found.pop()
    return found


def _is_among(names: Iterable[str]) -> _IsRead:
    """Whether a field is one of some columns; each of an array is, as are the parts of a time."""
    pattern = _pattern(_INDEX.sub("", name) for name in names)

    @lru_cache
    def is_read(field: str) -> bool:
        name = re.sub(r"\.(nano)?sec$", "", _INDEX.sub("", field))
        return pattern.fullmatch(name) is not None

    return is_read


def _why_not(bag: RosBag) -> str:
    """Why nothing of a flight was found."""
    for why, count in bag.faults.items():
        return f"{why} ({count} messages)" if count else why
    there = ", ".join(list(bag.kinds)[:8]) + (" ..." if len(bag.kinds) > 8 else "")
    if not there:
        return "no topic in it: nothing was recorded, or it was cut short"
    return f"no IMU known by its type: say with --csv which fields are what (docs/logs.md); {there}"


def _recording(path: Path, bag: RosBag, mapping: TableMapping, mapping_path: Path) -> Recording:
    columns = {
        f"{topic}.{name}": values
        for topic, found in bag.topics.items()
        for name, values in found.items()
    }
    missing = [name for name in mapping.columns if name not in columns]
    if missing:
        raise InputError(
            f"{path} has no field {missing[0]!r}, which {mapping_path} names (topic.field); "
            f"{_why_not(bag)}"
        )
    recording = recording_of(path, mapping, columns, mapping_path)
    recording.counts = bag.counts
    return recording
