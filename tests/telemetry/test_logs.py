"""One door to every kind of recording, told by content; every ground station's .tlog."""

import gzip
import os
import random
import struct
import sys
import zipfile
from pathlib import Path

import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.logs import open_log
from gcs_sysid.telemetry.tlog import TlogReader
from testbed.recordings import records_of

WALL = 1_750_000_000.0


def record_of(wall, frame):
    return struct.pack(">Q", round(wall * 1e6)) + frame.raw


def flight(sender, seconds=30.0, rate=1.0):
    """(wall, frame) of a vehicle whose clock runs at a rate of the wall clock."""
    rows = []
    for i in range(round(seconds * 50)):
        t = 5.0 + 0.02 * i * rate
        wall = WALL + 0.02 * i
        if i % 50 == 0:
            rows.append((wall, sender.heartbeat()))
        rows.append((wall, sender.imu(t, gyro=(0.01 * (i % 7), 0.0, 0.0))))
        rows.append((wall, sender.attitude(t, roll=0.001 * (i % 90))))
    return rows


def write(path, rows):
    path.write_bytes(b"".join(record_of(wall, frame) for wall, frame in rows))
    return path


@pytest.mark.parametrize("name", ["flight.tlog", "flight.ulg", "flight", "flight.bin"])
def test_a_tlog_is_known_whatever_its_name(tmp_path, sender, name):
    log = open_log(write(tmp_path / name, flight(sender)))
    assert log.kind == "tlog"
    assert sum(r.stream is Stream.IMU for r in records_of(log)) == 1500
    assert str(log.vehicle) == "PX4 quadrotor 1:1"
    assert log.share_read == 1.0


def test_onboard_logs_are_known_whatever_their_names(tmp_path, ulog_file, dataflash_file):
    ulog_file.topic("vehicle_attitude", ["float[4] q"])
    ulog_file.row("vehicle_attitude", 1.0, 1.0, 0.0, 0.0, 0.0)
    (tmp_path / "a.tlog").write_bytes(ulog_file.bytes())
    assert open_log(tmp_path / "a.tlog").kind == "ulog"
    dataflash_file.type("EV", "QB", "TimeUS,Id")
    dataflash_file.row("EV", 1_000_000, 10)
    (tmp_path / "b.tlog").write_bytes(dataflash_file.bytes())
    assert open_log(tmp_path / "b.tlog").kind == "dataflash"


@pytest.mark.parametrize("rate", [0.98, 1.0, 1.008])
def test_drift_of_the_vehicles_clock_is_told(tmp_path, sender, rate):
    log = open_log(write(tmp_path / "flight.tlog", flight(sender, rate=rate)))
    assert log.drift.ppm is None
    assert records_of(log)
    assert log.drift.ppm == pytest.approx(1e6 * (rate - 1.0), abs=50.0)


def test_qgroundcontrol_has_milliseconds_and_its_own_messages(tmp_path, sender, make_sender):
    station = make_sender(255, 190)
    rows = []
    for wall, frame in flight(sender):
        wall = round(wall, 3)
        rows.append((wall, frame))
        if frame.message_id == 0:
            beat = station.heartbeat(
                type=mavlink.MAV_TYPE_GCS, autopilot=mavlink.MAV_AUTOPILOT_INVALID
            )
            rows.append((wall, beat))
    plain = records_of(open_log(write(tmp_path / "plain.tlog", flight(make_sender()))))
    log = open_log(write(tmp_path / "qgc.tlog", rows))
    assert records_of(log) == plain
    assert [str(system) for system in log.systems] == [
        "PX4 quadrotor 1:1",
        "ground station 255:190",
    ]


def test_mavproxy_marks_the_link_and_may_hear_all_twice(tmp_path, sender, make_sender):
    """The low two bits of its times are the number of the link."""
    plain = records_of(open_log(write(tmp_path / "plain.tlog", flight(make_sender()))))
    data = b""
    for wall, frame in flight(sender):
        for link in (0, 1):
            data += struct.pack(">Q", round(wall * 1e6) & ~3 | link) + frame.raw
    (tmp_path / "twice.tlog").write_bytes(data)
    log = open_log(tmp_path / "twice.tlog")
    records = records_of(log)
    assert records == plain
    assert log.as_dict()["lost"] == 0
    assert log.drift.ppm == pytest.approx(0.0, abs=50.0)


def test_mission_planner_writes_both_directions_out_of_order(tmp_path, sender, make_sender):
    rng = random.Random(3)
    station = make_sender(255, 190)
    rows = []
    for wall, frame in flight(sender):
        rows.append((wall, frame))
        if rng.random() < 0.2:
            ask = mavlink.MAVLink_request_data_stream_message(1, 1, 0, 4, 1)
            rows.append((wall - rng.uniform(0.0, 0.5), station.frame(ask)))
    # Neighbors change places, but the first heartbeat.
    order = sorted(range(len(rows)), key=lambda i: i + 2.5 * rng.random() * (i > 0))
    log = open_log(write(tmp_path / "mp.tlog", [rows[i] for i in order]))
    records = records_of(log)
    times = {stream: [r.t for r in records if r.stream is stream] for stream in Stream}
    assert sorted(times[Stream.IMU]) == pytest.approx([5.0 + 0.02 * i for i in range(1500)])
    assert len(times[Stream.ATTITUDE]) == 1500
    told = log.as_dict()
    assert (told["lost"], told["reboots"], told["dropped"]) == (0, 0, {})


def test_the_vehicle_wanted_is_the_onboard_logs_own_or_none(tmp_path, ulog_file):
    ulog_file.parameter("MAV_SYS_ID", 4)
    ulog_file.topic("vehicle_attitude", ["float[4] q"])
    ulog_file.row("vehicle_attitude", 1.0, 1.0, 0.0, 0.0, 0.0)
    path = tmp_path / "flight.ulg"
    path.write_bytes(ulog_file.bytes())
    assert len(records_of(open_log(path, (4, None)))) == 2
    other = open_log(path, (5, 1))
    assert other.vehicle is None
    assert records_of(other) == []
    assert [str(system) for system in other.systems] == ["PX4 vehicle 4:1"]


def test_pauses_of_an_onboard_imu_are_gaps(tmp_path, dataflash_file):
    log = dataflash_file
    log.type("IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    for i in range(500):
        t = 1_000_000 + 4000 * i + (700_000 if i >= 250 else 0)
        log.row("IMU", t, 0, 0.0, 0.0, 0.0, 0.0, 0.0, -9.8)
    path = tmp_path / "gap.bin"
    path.write_bytes(log.bytes())
    gaps = open_log(path).as_dict()["imu_gaps"]
    assert gaps["count"] == 1
    assert gaps["last"][0]["length"] == pytest.approx(0.704)


def test_a_log_is_read_as_it_was_packed(tmp_path, sender, ulog_file):
    ulog_file.topic("vehicle_attitude", ["float[4] q"])
    ulog_file.row("vehicle_attitude", 1.0, 1.0, 0.0, 0.0, 0.0)
    (tmp_path / "a.gz").write_bytes(gzip.compress(ulog_file.bytes()))
    with zipfile.ZipFile(tmp_path / "b.zip", "w") as archive:
        archive.writestr("__MACOSX/logs/._a.ulg", b"of a file system")
        archive.writestr("logs/a.ulg", ulog_file.bytes())
    for name in ("a.gz", "b.zip"):
        log = open_log(tmp_path / name)
        assert (log.kind, len(records_of(log))) == ("ulog", 1)
    plain = write(tmp_path / "a.tlog", flight(sender))
    (tmp_path / "c.gz").write_bytes(gzip.compress(plain.read_bytes()))
    log = open_log(tmp_path / "c.gz")
    assert records_of(log) == records_of(open_log(plain))
    assert log.share_read == 1.0


def test_of_several_logs_in_a_zip_none_is_chosen(tmp_path):
    with zipfile.ZipFile(tmp_path / "two.zip", "w") as archive:
        archive.writestr("a.ulg", b"ULog")
        archive.writestr("b.ulg", b"ULog")
    with pytest.raises(InputError, match="holds 2 files: unpack it"):
        open_log(tmp_path / "two.zip")


def test_a_log_that_cannot_be_unpacked_is_named_as_it_was_given(tmp_path):
    (tmp_path / "a.gz").write_bytes(gzip.compress(b"ULog" + bytes(100)))
    with pytest.raises(InputError, match=r"a\.gz cannot be read as a PX4 log"):
        open_log(tmp_path / "a.gz")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is empty"),
        (b"t,ax,ay,az\n" * 100, "is not a .tlog"),
        (b"FMT, 128, 89, FMT, BBnNZ\n" * 100, "no entry found"),
        (bytes(10_000), "holds zeros alone"),
        (b"#ROSBAG V2.0\n", "bag of ROS 1: convert it"),
        (b"ULogEnc" + bytes(100), "encrypted PX4 log: decrypt"),
        (b"\n<!DOCTYPE html>\n<html>", "web page: download the log itself"),
        (b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
        (b"BZh91AY", "archive: unpack it"),
        (b'{\n "verdict": "partial"}', "is JSON, such as a result"),
        (b"\x1f\x8b\x08" + bytes(40), "cannot be unpacked"),
        (b"PK\3\4" + bytes(40), "cannot be unpacked"),
    ],
    ids=["empty", "csv", "text dataflash", "zeros", "bag", "ulge", "html", "lfs", "bzip2", "json",
          "gzip", "zip"],
)  # fmt: skip
def test_what_is_no_log_gives_one_line(tmp_path, content, says):
    path = tmp_path / "some.log"
    path.write_bytes(content)
    with pytest.raises(InputError, match=says) as caught:
        open_log(path)
    assert "\n" not in str(caught.value)


def test_missing_files_and_folders_give_one_line(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        open_log(tmp_path / "missing.ulg")
    with pytest.raises(InputError, match="is a folder"):
        open_log(tmp_path)


@pytest.mark.skipif(sys.platform == "win32", reason="no such pipes there")
def test_a_pipe_that_nobody_writes_to_holds_nothing_up(tmp_path):
    for name in ("a.tlog", "a.ulg", "a.bin"):
        os.mkfifo(tmp_path / name)
        with pytest.raises(InputError, match="pipe or a device"):
            open_log(tmp_path / name)
    with pytest.raises(InputError, match="pipe or a device"):
        TlogReader(tmp_path / "a.tlog")


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="no such device there")
def test_a_device_is_no_log():
    with pytest.raises(InputError, match="pipe or a device"):
        open_log(Path("/dev/zero"))
