"""Frames made by pymavlink's own packer, for all telemetry tests."""

import random

import pytest

from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frames import read_frame
from gcs_sysid.telemetry.message_table import MESSAGES
from gcs_sysid.telemetry.messages import MESSAGE_IDS
from testbed.recordings import records_of


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

    def message_interval(self, message_id, interval):
        return self.frame(mavlink.MAVLink_message_interval_message(message_id, interval))

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
            length = rng.randrange(0, count + 1) if count else 1
            text = "".join(rng.choices("ABCxyz_09 ", k=length))
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
    names = [
        "HEARTBEAT", "PARAM_VALUE", "MESSAGE_INTERVAL", "EXTENDED_SYS_STATE", "STATUSTEXT",
        "SYSTEM_TIME", "TIMESYNC", "PING", "VFR_HUD", "GPS_RAW_INT", "COMMAND_ACK",
        *(message.name for message in MESSAGES),
    ]  # fmt: skip
    classes = [mavlink.mavlink_map[MESSAGE_IDS[name]] for name in names]
    raws = []
    for _ in range(60):
        cls = rng.choice(classes)
        version = 2 if cls.id > 255 else rng.choice([1, 2])
        raws.append(source.raw(random_message(cls, rng), version))
    return b"".join(raws), [read_frame(raw) for raw in raws]


@pytest.fixture
def path(tmp_path, flight):
    """The file of an onboard log put together in the module's `flight`."""
    path = tmp_path / f"flight{flight.SUFFIX}"
    path.write_bytes(flight.bytes())
    return path


@pytest.fixture
def of():
    """Picks the records of a stream, and of a source where there are several."""

    def of(log, stream, source=""):
        return [r for r in records_of(log) if r.stream is stream and r.source == source]

    return of


def _damaged(data, rng):
    """A copy with bytes flipped, cut and inserted."""
    data = bytearray(data)
    for _ in range(rng.randrange(1, 8)):
        at = rng.randrange(len(data))
        match rng.randrange(3):
            case 0:
                data[at] ^= 1 << rng.randrange(8)
            case 1:
                del data[at : at + rng.randrange(1, 60)]
            case _:
                data[at:at] = rng.randbytes(rng.randrange(1, 60))
    return bytes(data)


@pytest.fixture(scope="session")
def damage():
    """Damages bytes: (data, rng) to a copy with bytes flipped, cut and inserted."""
    return _damaged
