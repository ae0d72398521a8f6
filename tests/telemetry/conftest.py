"""Frames made by pymavlink's own packer, and small onboard logs, for all telemetry tests."""

import random
import struct
from pathlib import Path

import pytest

from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frames import read_frame

SHARED_LOGS = Path(__file__).resolve().parents[3] / "shared" / "logs"


class Sender:
    """A system that packs messages with running sequence numbers."""

    def __init__(self, system=1, component=1, dialect=mavlink):
        self.dialect = dialect
        self.packer = dialect.MAVLink(None, srcSystem=system, srcComponent=component)

    def raw(self, message, version=2):
        raw = bytes(message.pack(self.packer, force_mavlink1=version == 1))
        self.packer.seq = (self.packer.seq + 1) % 256
        return raw

    def frame(self, message, version=2):
        frame = read_frame(self.raw(message, version))
        assert frame is not None
        return frame

    def heartbeat(self, **changes):
        fields = {
            "type": mavlink.MAV_TYPE_QUADROTOR,
            "autopilot": mavlink.MAV_AUTOPILOT_PX4,
            "base_mode": 0,
            "custom_mode": 0,
            "system_status": mavlink.MAV_STATE_ACTIVE,
        } | changes
        return self.frame(mavlink.MAVLink_heartbeat_message(**fields, mavlink_version=3))

    def imu(self, t, gyro=(0.1, 0.2, 0.3), acc=(0.0, 0.0, -9.8), imu_id=0):
        return self.frame(
            mavlink.MAVLink_highres_imu_message(
                round(t * 1e6), *acc, *gyro, 0, 0, 0, 1013.0, 0, 0, 20.0, 63, imu_id
            )
        )

    def attitude(self, t, roll=0.0, pitch=0.0, yaw=0.0):
        return self.frame(
            mavlink.MAVLink_attitude_message(round(t * 1e3), roll, pitch, yaw, 0, 0, 0)
        )


def random_message(cls, rng):
    """A message of a class with random values in every field; finite floats."""
    values = []
    for field, kind in zip(cls.fieldnames, cls.fieldtypes, strict=True):
        count = cls.array_lengths[cls.ordered_fieldnames.index(field)]
        if kind == "char":
            text = "".join(rng.choices("ABCxyz_09 ", k=rng.randrange(0, max(1, count) + 1)))
            values.append(text.encode())
            continue
        some = [_random_value(kind, rng) for _ in range(max(1, count))]
        values.append(some if count else some[0])
    return cls(*values)


def _random_value(kind, rng):
    if kind in ("float", "double"):
        return rng.choice([0.0, rng.uniform(-1e6, 1e6)])
    bits = int("".join(filter(str.isdigit, kind)))
    low, high = (
        (0, 2**bits - 1) if kind.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    )
    return rng.choice([0, 0, low, high, rng.randint(low, high)])


@pytest.fixture
def sender():
    return Sender()


@pytest.fixture
def make_sender():
    return Sender


@pytest.fixture
def make_message():
    return random_message


@pytest.fixture
def stream():
    """A stretch of telemetry: (bytes, frames), versions mixed."""
    rng = random.Random(7)
    source = Sender()
    classes = list(mavlink.mavlink_map.values())
    raws = []
    for _ in range(60):
        cls = rng.choice(classes)
        version = 2 if cls.id > 255 else rng.choice([1, 2])
        raws.append(source.raw(random_message(cls, rng), version))
    return b"".join(raws), [read_frame(raw) for raw in raws]


@pytest.fixture
def shared_logs():
    if not SHARED_LOGS.is_dir():
        pytest.skip("no ../shared/logs beside the project")
    return SHARED_LOGS


class UlogFile:
    """A PX4 log, put together entry by entry."""

    SIZES = {  # noqa: RUF012
        "uint64_t": "Q", "uint32_t": "I", "uint8_t": "B", "int8_t": "b", "int32_t": "i",
        "float": "f", "bool": "?", "uint16_t": "H",
    }  # fmt: skip

    def __init__(self, start_us=1_000_000):
        self.data = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", start_us)
        self._definitions = b""
        self._rows = b""
        self._topics = {}

    @staticmethod
    def _entry(kind, content):
        return struct.pack("<HB", len(content), ord(kind)) + content

    def parameter(self, name, value, t=None):
        kind = "int32_t" if isinstance(value, int) else "float"
        key = f"{kind} {name}".encode()
        entry = self._entry(
            "P", bytes([len(key)]) + key + struct.pack("<" + self.SIZES[kind], value)
        )
        if t is None:
            self._definitions += entry
        else:
            self._rows += entry

    def topic(self, name, fields, multi_id=0):
        """Fields as "type name" or "type[4] name"; a timestamp comes first by itself."""
        fields = ["uint64_t timestamp", *fields]
        if name not in [known for known, _ in self._topics]:
            text = f"{name}:{';'.join(fields)};"
            self._definitions += self._entry("F", text.encode())
        layout = "<"
        for field in fields:
            kind, _, count = field.split()[0].rstrip("]").partition("[")
            layout += f"{count}{self.SIZES[kind]}"
        number = len(self._topics)
        self._topics[name, multi_id] = number, struct.Struct(layout)
        self._rows += self._entry("A", struct.pack("<BH", multi_id, number) + name.encode())

    def row(self, name, t, *values, multi_id=0):
        number, layout = self._topics[name, multi_id]
        content = struct.pack("<H", number) + layout.pack(round(t * 1e6), *values)
        self._rows += self._entry("D", content)

    def dropout(self, milliseconds):
        self._rows += self._entry("O", struct.pack("<H", milliseconds))

    def bytes(self):
        return self.data + self._definitions + self._rows


class DataflashFile:
    """An ArduPilot log, put together entry by entry."""

    CODES = {  # noqa: RUF012
        "Q": "Q", "B": "B", "f": "f", "H": "H", "h": "h", "c": "h", "C": "H", "I": "I",
        "N": "16s", "Z": "64s", "M": "B", "e": "i", "b": "b",
    }  # fmt: skip

    def __init__(self):
        self.data = b""
        self._types = {}
        self.type("FMT", "BBnNZ", "Type,Length,Name,Format,Columns", number=128, size=89)

    def type(self, name, letters, columns, number=None, size=None):
        number = number or len(self._types) + 1
        if size is None:
            layout = struct.Struct("<" + "".join(self.CODES[c] for c in letters))
            size = layout.size + 3
            self._types[name] = number, layout
        self.data += b"\xa3\x95\x80" + struct.pack(
            "<BB4s16s64s", number, size, name.encode(), letters.encode(), columns.encode()
        )

    def row(self, name, *values):
        number, layout = self._types[name]
        values = [v.encode() if isinstance(v, str) else v for v in values]
        self.data += b"\xa3\x95" + bytes([number]) + layout.pack(*values)

    def bytes(self):
        return self.data


@pytest.fixture
def ulog_file():
    return UlogFile()


@pytest.fixture
def dataflash_file():
    return DataflashFile()
