"""Messages as structured arrays hold what pymavlink reads, of every type and every log."""

import random

import numpy as np
import pytest
from pymavlink import mavutil

from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frame_block import FrameBlock
from gcs_sysid.telemetry.frames import Validity
from gcs_sysid.telemetry.messages import LAYOUTS, message_arrays
from gcs_sysid.telemetry.tlog import TlogReader, read_messages
from tests.telemetry.test_tlog_scan import START, STEP, as_log


@pytest.fixture
def pymavlink_reads(monkeypatch):
    """Reads a log with pymavlink: message name -> messages, without what it cannot read."""
    # The project's dialect; those of pymavlink lack messages.
    monkeypatch.setattr(mavutil, "mavlink", mavlink)

    def read(path):
        log = mavutil.mavlogfile(str(path), robust_parsing=True)
        found = {}
        while (message := log.recv_msg()) is not None:
            name = message.get_type()
            if name != "BAD_DATA" and not name.startswith("UNKNOWN"):
                found.setdefault(name, []).append(message)
        log.f.close()
        return found

    return read


def assert_same(name, rows, messages):
    """All fields of all messages of a type."""
    assert len(rows) == len(messages)
    stamps = [round(m._timestamp * 1e6) for m in messages]
    np.testing.assert_allclose(rows["_time_us"].astype(float), stamps, atol=1.0, rtol=0.0)
    assert rows["_sequence"].tolist() == [m.get_seq() for m in messages]
    assert rows["_system"].tolist() == [m.get_srcSystem() for m in messages]
    assert rows["_component"].tolist() == [m.get_srcComponent() for m in messages]
    for field in mavlink.mavlink_map[messages[0].get_msgId()].fieldnames:
        theirs = [getattr(m, field) for m in messages]
        ours = rows[field]
        if ours.dtype.kind == "S":
            texts = [value.split(b"\0", 1)[0].decode("utf-8", "replace") for value in ours]
            assert texts == [value.split("\0", 1)[0] for value in theirs], (name, field)
        else:
            np.testing.assert_array_equal(ours, np.array(theirs, ours.dtype), f"{name}.{field}")


def test_only_the_frames_asked_for_with_a_right_checksum(make_sender):
    sender = make_sender()
    frames = FrameBlock.of([sender.heartbeat(custom_mode=i) for i in range(4)])
    frames.validity[1] = Validity.BAD_CRC
    found = message_arrays(frames, ("HEARTBEAT",), np.array([True, True, False, True]))
    assert found["HEARTBEAT"]["custom_mode"].tolist() == [0, 3]


def test_every_type_is_read_as_pymavlink_reads_it(tmp_path, make_sender, make_message):
    rng = random.Random(4)
    sender = make_sender(7, 8)
    signer = make_sender(7, 9)
    signer.packer.signing.secret_key = bytes(range(32))
    signer.packer.signing.sign_outgoing = True
    raws = []
    for cls in mavlink.mavlink_map.values():
        for _ in range(6):
            version = 2 if cls.id > 255 else rng.choice([1, 2])
            raws.append(sender.raw(make_message(cls, rng), version))
            raws.append(signer.raw(make_message(cls, rng)))
    rng.shuffle(raws)
    path = tmp_path / "all.tlog"
    path.write_bytes(as_log(raws))
    ours, counts = read_messages(path)
    parser = mavlink.MAVLink(None)
    theirs = {}
    for i, raw in enumerate(raws):
        message = parser.decode(bytearray(raw))
        message._timestamp = (START + STEP * i) * 1e-6
        theirs.setdefault(message.get_type(), []).append(message)
    assert set(ours) == set(theirs) == {layout.name for layout in LAYOUTS.values()}
    assert (counts.frames, counts.bad_crc, counts.garbage_bytes) == (len(raws), 0, 0)
    for name, rows in ours.items():
        assert_same(name, rows, theirs[name])
    order = np.sort(np.concatenate([rows["_frame"] for rows in ours.values()]))
    assert order.tolist() == list(range(len(raws)))


def test_only_the_types_wanted_are_read(tmp_path, sender):
    path = tmp_path / "flight.tlog"
    path.write_bytes(as_log([sender.heartbeat().raw, sender.imu(1.0).raw, sender.imu(2.0).raw]))
    arrays, _ = read_messages(path, ["HIGHRES_IMU", "ATTITUDE"])
    assert {name: len(rows) for name, rows in arrays.items()} == {"HIGHRES_IMU": 2}
    assert arrays["HIGHRES_IMU"]["time_usec"].tolist() == [1_000_000, 2_000_000]
    assert arrays["HIGHRES_IMU"]["_frame"].tolist() == [1, 2]
    with pytest.raises(KeyError):
        read_messages(path, ["NO_SUCH_MESSAGE"])


@pytest.mark.slow
@pytest.mark.parametrize(
    "seeds",
    [
        range(10),
        *(pytest.param(range(k, k + 20), marks=pytest.mark.thorough) for k in range(10, 190, 20)),
    ],
)
def test_damaged_logs_give_no_less_than_pymavlink_and_nothing_wrong(
    damage, tmp_path, stream, pymavlink_reads, seeds
):
    raws = [frame.raw for frame in stream[1]] * 2
    path = tmp_path / "hurt.tlog"
    for seed in seeds:
        path.write_bytes(damage(as_log(raws), random.Random(seed)))
        good = [frame for _, frame in TlogReader(path) if frame.valid is Validity.OK]
        assert {frame.raw for frame in good} <= set(raws), seed
        arrays, counts = read_messages(path)
        found = sum(map(len, arrays.values()))
        assert found == len(good) == counts.frames - counts.bad_crc - counts.unknown
        theirs = pymavlink_reads(path)
        true = set(raws)
        assert found >= sum(
            bytes(message.get_msgbuf()) in true for some in theirs.values() for message in some
        ), seed


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize(
    "name",
    [
        *("px4-esc-cg.tlog", "px4-sih-default.tlog", "ardupilot-sitl.tlog"),
        "public/real-quad-mavlink1.tlog",
    ],
)
def test_recorded_flights_are_read_as_pymavlink_reads_them(shared_logs, pymavlink_reads, name):
    path = shared_logs / name
    ours, _ = read_messages(path)
    theirs = pymavlink_reads(path)
    assert set(ours) == set(theirs)
    for message, rows in ours.items():
        assert_same(message, rows, theirs[message])
