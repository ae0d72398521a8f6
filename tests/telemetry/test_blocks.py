"""Frames taken in blocks make the same records, figures and events as one by one."""

import math
import random
import struct
from functools import partial
from itertools import pairwise
from operator import attrgetter

import numpy as np
import pytest

from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.intake import Intake
from gcs_sysid.telemetry.message_table import MESSAGES
from gcs_sysid.telemetry.messages import MESSAGE_IDS
from gcs_sysid.telemetry.monitor import SequenceCount
from gcs_sysid.telemetry.tlog import TlogReader
from gcs_sysid.telemetry.tlog_writer import reset_mark
from testbed.recordings import in_sequence
from tests.telemetry.conftest import random_message

START = 1_750_000_000_000_000


class Flier:
    """A vehicle that sends everything that is read, and now and then something odd."""

    def __init__(self, sender, rng, autopilot):
        self.sender = sender
        self.rng = rng
        self.autopilot = autopilot
        self.t = rng.choice([5.0, 4_294_960.0, 4_284.0])  # a stamp wraps soon
        self.unix = 0.0
        self.offset = 0

    def us(self):
        return round((self.t + self.unix) * 1e6)

    def ms(self):
        return round(self.t * 1e3) % 2**32

    def number(self, low=-2.0, high=2.0):
        return self.rng.uniform(low, high) if self.rng.random() > 0.01 else self.odd()

    def odd(self):
        return self.rng.choice([float("nan"), float("inf"), 0.0, 1e30])

    def numbers(self, count):
        return [self.number() for _ in range(count)]

    def whole(self, count, low, high):
        return [self.rng.choice([0, self.rng.randint(low, high)]) for _ in range(count)]

    def message(self):
        names = ["HEARTBEAT", "PARAM_VALUE", "SYSTEM_TIME", "EXTENDED_SYS_STATE", "PING"]
        names += [row.name for row in MESSAGES]
        return self.of(self.rng.choice(["HIGHRES_IMU", "ATTITUDE", "ESC_TELEMETRY_1_TO_4", *names]))

    def of(self, name):
        """A message with random values, but a stamp of now, and values that a vehicle may have."""
        if name == "HEARTBEAT":
            return self.heartbeat()
        rng, cls = self.rng, mavlink.mavlink_map[MESSAGE_IDS[name]]
        message = random_message(cls, rng)
        likely = {
            "time_usec": self.us() % rng.choice([2**32, 2**64]) if name == "RAW_IMU" else self.us(),
            "time_boot_ms": self.ms(),
            "id": int(rng.random() < 0.2),
            "index": rng.choice([0, 4]),
            "port": int(rng.random() < 0.1),
            "active": rng.choice([0, 3, 4, 16, 32, 0b11111111, 2**31]),
            "time_unix_usec": rng.choice([0, round((1.7e9 + self.t) * 1e6)]),
            "landed_state": rng.randrange(5),
            "param_id": b"P%d" % rng.randrange(9),
            "voltage_battery": rng.choice([0, 15_432, 0xFFFF]),
        }
        quaternion = self.quaternion()
        likely |= dict(zip(("q1", "q2", "q3", "q4"), quaternion, strict=True)) | {"q": quaternion}
        for field, kind in zip(cls.fieldnames, cls.fieldtypes, strict=True):
            if field in likely:
                value = likely[field]
                if field == "time_usec" and name == "SERVO_OUTPUT_RAW":
                    value %= 2**32
                setattr(message, field, value)
            elif kind == "float" and isinstance(getattr(message, field), float):
                setattr(message, field, self.number())
        return message

    def heartbeat(self):
        armed = self.rng.choice([0, mavlink.MAV_MODE_FLAG_SAFETY_ARMED])
        status = self.rng.choice([mavlink.MAV_STATE_STANDBY, mavlink.MAV_STATE_ACTIVE])
        return mavlink.MAVLink_heartbeat_message(2, self.autopilot, armed, 0, status, 3)

    def quaternion(self):
        q = np.array([self.rng.gauss(0.0, 1.0) for _ in range(4)])
        return (q / np.linalg.norm(q) * self.number(0.85, 1.05)).tolist()

    def step(self, oddities):
        self.t += self.rng.choice([0.0, 0.004, 0.004, 0.02, -0.003])
        if self.rng.random() < oddities:
            self.t = self.rng.choice(
                [self.t + 5.0, self.t + 30.0, self.t - 5.0, self.t - 0.5, 2.0, 0.0]
            )
        if self.rng.random() < oddities:
            self.unix = self.rng.choice([0.0, 1.7e9])
        if self.rng.random() < oddities:
            self.autopilot = self.rng.choice([3, 12])
        if self.rng.random() < oddities:
            self.sender.packer.seq = self.rng.randrange(256)
        self.t = max(self.t, 0.0)
        message = self.message()
        return self.sender.raw(message, 2 if message.id > 255 else self.rng.choice([1, 2]))


def log_of(make_sender, seed, oddities, count):
    """The bytes of a .tlog with two vehicles and a ground station."""
    rng = random.Random(seed)
    autopilot = rng.choice([mavlink.MAV_AUTOPILOT_PX4, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA])
    vehicle, other = (Flier(make_sender(i, 1), rng, autopilot) for i in (1, 2))
    station = make_sender(255, 190)
    records = []
    for i in range(count):
        if rng.random() < 0.05:
            beat = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
            raw = reset_mark().raw if rng.random() < oddities else station.raw(beat)
        else:
            raw = (other if rng.random() < 0.1 else vehicle).step(oddities)
        if rng.random() < oddities:
            raw = raw[:-1] + bytes([raw[-1] ^ 1])
        records.append(struct.pack(">Q", START + 4000 * i) + raw)
    for _ in range(round(oddities * count)):
        i = rng.randrange(count - 1)
        records[i], records[i + 1] = records[i + 1], records[i]
    return b"".join(records)


def in_pieces(block, rng):
    """A block cut at random places."""
    cuts = sorted(rng.sample(range(1, len(block)), min(40, len(block) - 1)))
    return [block.part(a, b) for a, b in pairwise([0, *cuts, len(block)])]


def comparable(records):
    """With something that equals itself where an accelerometer has no value."""
    return [
        record._replace(values=tuple(None if math.isnan(v) else v for v in record.values))
        for record in records
    ]


def whole(block):
    return [block]


def in_blocks(path, window, wanted, cut):
    intake = Intake(wanted)
    blocks = TlogReader(path, window).blocks()
    return intake, [intake.block(piece) for block in blocks for piece in cut(block)]


def singly(block):
    return [block.part(i, i + 1) for i in range(len(block))]


def told(made):
    """Records and events of blocks."""
    records = [record for block in made for record in in_sequence(block)]
    return comparable(records), [event for block in made for _, event in block.events]


def compare(path, cuts, wanted=None):
    """Each frame a block of its own, against the log in other windows and pieces.

    Args:
        path: of a log.
        cuts: (bytes of a window, what makes pieces of a block).
        wanted: system and perhaps component.

    Returns:
        Blocks of the last of them.
    """
    single, made_singly = in_blocks(path, 1 << 20, wanted, singly)
    expected = told(made_singly)
    for window, cut in cuts:
        blocks, made = in_blocks(path, window, wanted, cut)
        assert told(made) == expected
        assert blocks.as_dict() == single.as_dict()
        assert blocks.health() == single.health()
        assert vars(blocks.decoder.clock) == vars(single.decoder.clock)
        for name in ("turning", "fates", "decoder.dropped", "drift.bounds"):
            assert attrgetter(name)(blocks) == attrgetter(name)(single), name
    return made


def cuts(seed):
    """Small and large windows, and pieces cut at random places."""
    at_random = partial(in_pieces, rng=random.Random(seed))
    return [(3000, whole), (30_000, whole), (1 << 20, whole), (1 << 20, at_random)]


def seeds(first, count):
    """The first ones have every case once; the others repeat them, in `make test-all` alone."""
    later = (pytest.param(seed, marks=pytest.mark.thorough) for seed in range(first, count))
    return pytest.mark.parametrize("seed", [*range(first), *later])


@pytest.mark.slow
@seeds(4, 20)
def test_blocks_make_what_single_frames_make(tmp_path, make_sender, seed):
    path = tmp_path / "odd.tlog"
    path.write_bytes(log_of(make_sender, seed, [0.0, 0.001, 0.01][seed % 3], 450))
    compare(path, cuts(seed), [None, (2, None), None, (9, 1)][seed % 4])


@pytest.mark.slow
@seeds(2, 8)
def test_blocks_go_over_from_a_stray_heartbeat_to_the_vehicle_alike(tmp_path, make_sender, seed):
    path = tmp_path / "stray.tlog"
    stray = struct.pack(">Q", START - 4000) + make_sender(66, 1).heartbeat().raw
    path.write_bytes(stray + log_of(make_sender, seed, [0.0, 0.01][seed % 2], 300))
    made = compare(path, cuts(seed))
    told = [event.text for block in made for _, event in block.events if event.kind == "vehicles"]
    assert sum("the first received, sends heartbeats only" in text for text in told) == 1


@pytest.mark.parametrize("seed", range(20))
def test_sequence_numbers_are_counted_alike(seed):
    rng = random.Random(seed)
    disorder = [0.0, 2.0, 70.0, 150.0][seed % 4]
    numbers = sorted(range(3000), key=lambda n: n + disorder * rng.random())
    numbers = [n % 256 for n in numbers if rng.random() > [0.0, 0.1, 0.9][seed % 3]]
    single, blocks = SequenceCount(), SequenceCount()
    at = 0
    while at < len(numbers):
        piece = numbers[at : at + rng.randrange(1, 500)]
        at += len(piece)
        for number in piece:
            single.count(number)
        blocks.count_block(np.array(piece, np.uint8))
        assert vars(blocks) == vars(single)


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize(
    "name", ["public/real-quad-mavlink1.tlog", "px4-esc-cg.tlog", "ardupilot-sitl.tlog"]
)
def test_blocks_of_recorded_flights_make_what_single_frames_make(shared_logs, tmp_path, name):
    """A part of each, which ends within a frame."""
    path = tmp_path / "part.tlog"
    path.write_bytes((shared_logs / name).read_bytes()[:100_000])
    compare(path, [(1 << 16, whole), (1 << 21, whole)])


def test_tracks_tell_where_their_samples_stand(tmp_path, make_sender):
    vehicle = make_sender()
    frames = [vehicle.heartbeat(), *(vehicle.imu(1.0 + 0.1 * i) for i in range(3))]
    frames += [vehicle.attitude(1.3), vehicle.imu(1.3)]
    path = tmp_path / "short.tlog"
    path.write_bytes(b"".join(struct.pack(">Q", START) + frame.raw for frame in frames))
    (block,) = compare(path, [(1 << 20, whole)])
    tracks = {track.stream: track for track in block.tracks}
    assert tracks[Stream.IMU].order.tolist() == [1, 2, 3, 5]
    assert tracks[Stream.IMU].values.shape == (4, 6)
    assert tracks[Stream.ATTITUDE].order.tolist() == [4]
    assert [(order, event.kind) for order, event in block.events] == [(0, "vehicle")]
