"""Logs that were made to harm, and garbage of every kind inside of good ones."""

import struct
import sys
import time

import numpy as np
import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.results.result_file import read_result
from gcs_sysid.telemetry import ulog, ulog_format
from gcs_sysid.telemetry.blackbox import read_blackbox
from gcs_sysid.telemetry.dataflash import read_dataflash
from gcs_sysid.telemetry.log_formats import BLACKBOX_HEAD
from gcs_sysid.telemetry.logs import open_log
from gcs_sysid.telemetry.ulog import read_ulog
from gcs_sysid.telemetry.ulog_format import UlogFile
from testbed.fuzz.harness import one_line_errors
from testbed.hostile_logs import FILES, HEAD, PATTERNS, TOP, ULG, formats, measure, subscribed
from testbed.hostile_logs import ulg_entry as entry

SECONDS, MEGABYTES = 1.0, 200.0
SECONDS_A_MEGABYTE = 2.0


def row(size, number=0):
    return entry("D", struct.pack("<H", number) + bytes(size))


@pytest.mark.parametrize("name", ULG)
def test_definitions_made_to_harm_are_refused_at_once(tmp_path, name):
    path = tmp_path / "hostile.ulg"
    path.write_bytes(ULG[name]() + subscribed(*["sensor_combined"] * 50))
    before, began = peak_memory(), time.process_time()
    with pytest.raises(InputError, match="holds no flight data") as caught:
        read_ulog(path)
    assert time.process_time() - began < SECONDS
    assert peak_memory() - before < MEGABYTES
    assert len(str(caught.value)) < 400


READERS = {".toml": lambda path: load_airframe(str(path)), ".json": read_result}


@pytest.mark.thorough
@pytest.mark.parametrize(("suffix", "name"), FILES)
def test_files_made_to_harm_are_read_or_refused_within_bounds(tmp_path, suffix, name):
    path = tmp_path / f"hostile{suffix}"
    path.write_bytes(FILES[suffix, name]())
    before, began = peak_memory(), time.process_time()
    with one_line_errors():
        READERS.get(suffix, lambda path: list(open_log(path).blocks()))(path)
    assert time.process_time() - began < SECONDS
    assert peak_memory() - before < MEGABYTES


def peak_memory():
    """MB that this process has held at most."""
    resource = pytest.importorskip("resource")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e6 if sys.platform == "darwin" else 1e3)


def test_a_header_line_that_never_ends_well_costs_no_time(tmp_path):
    path = tmp_path / "hostile.bbl"
    path.write_bytes(BLACKBOX_HEAD + b"\n" + (b"H a:" * 4000 + b"\x01\n") * 16)
    began = time.process_time()
    with pytest.raises(InputError, match="does not describe the frames"):
        read_blackbox(path)
    assert time.process_time() - began < SECONDS


def test_rows_of_a_topic_that_nobody_subscribed_are_passed_over(tmp_path):
    path = tmp_path / "some.ulg"
    layout = formats(TOP + "float x;")
    path.write_bytes(layout + subscribed("sensor_combined") + (row(12, 7) + row(12)) * 9)
    file = UlogFile(path, {"sensor_combined"})
    assert len(file.topics["sensor_combined", 0]["x"]) == 9
    assert file.damaged
    assert file.garbage_bytes == 0


def test_rows_behind_garbage_are_found_without_a_sync(tmp_path):
    path = tmp_path / "some.ulg"
    layout = formats(TOP + "float x;") + subscribed("sensor_combined")
    for garbage in (b"\0", b"D" * 100, b"\x0e\0D\0", b"\xff" * 5000, b"\0\0\x5a" * 70_000):
        path.write_bytes(layout + row(12) * 3 + garbage + row(12) * 5)
        file = UlogFile(path, {"sensor_combined"})
        assert len(file.topics["sensor_combined", 0]["x"]) >= 7, garbage[:4]
        assert file.damaged


def test_a_subscription_behind_garbage_is_found(tmp_path):
    path = tmp_path / "some.ulg"
    path.write_bytes(
        formats(TOP + "float x;") + b"\0\0Z" * 50 + subscribed("sensor_combined") + row(12) * 4
    )
    assert len(UlogFile(path, {"sensor_combined"}).topics["sensor_combined", 0]["x"]) == 4


SYNC = ulog_format._SYNC
PARAMETER = entry("P", b"\x07float A" + struct.pack("<f", 1.0))
STATUS = entry("A", struct.pack("<BH", 0, 3) + b"vehicle_status")
DAMAGE = {
    "parameters, which nothing finds again": b"\xff" + PARAMETER * 300,
    "rows of a topic learned by now": b"\xff" + SYNC + (row(12, 7) * 3 + b"\xff\xff") * 30,
    "SYNC entries": (SYNC + b"\xff\xff" + PARAMETER) * 60,
    "a topic's name": b"\xffvehicle_status" * 100 + STATUS + PARAMETER,
}


@pytest.mark.parametrize("garbage", DAMAGE.values(), ids=DAMAGE)
def test_windows_of_any_size_give_the_same_of_a_damaged_ulog(tmp_path, monkeypatch, garbage):
    path = tmp_path / "some.ulg"
    layout = formats(TOP + "float x;", "vehicle_status:uint64_t timestamp;")
    path.write_bytes(layout + garbage + subscribed("sensor_combined") + row(12) * 4 + garbage)
    monkeypatch.setattr(UlogFile, "_MARGIN", 250)

    def read(window):
        monkeypatch.setattr(UlogFile, "_WINDOW", window)
        file = UlogFile(path, {"sensor_combined", "vehicle_status"})
        rows = [len(topic["timestamp"]) for topic in file.topics.values()]
        return rows, file.initial, file.changed, file.garbage_bytes, file.faults

    whole = read(2**20)
    assert whole[0] == [4]
    assert all(read(window) == whole for window in range(251, 900, 31))


def test_data_appended_after_a_crash_are_read(tmp_path):
    path = tmp_path / "some.ulg"

    def flags(offset):
        return entry("B", bytes(8) + b"\1" + bytes(7) + struct.pack("<3Q", offset, 0, 0))

    layout = formats(TOP + "float x;")[16:] + subscribed("sensor_combined")
    first = HEAD + flags(0) + layout + row(12) * 3 + row(12)[:7]  # torn
    first = HEAD + flags(len(first)) + first[len(HEAD + flags(0)) :]
    path.write_bytes(first + row(12) * 2)
    assert len(UlogFile(path, {"sensor_combined"}).topics["sensor_combined", 0]["x"]) == 5
    path.write_bytes(HEAD + entry("B", bytes(8) + b"\4" + bytes(31)) + layout)
    with pytest.raises(InputError, match="version of the format"):
        read_ulog(path)


GARBAGE = {
    "FD": b"\xfd", "FE": b"\xfe", "FD 09": b"\xfd\x09\0\0", "FE 00": b"\xfe\0", "zeros": b"\0",
    "00 00 5a": b"\0\0\x5a", "D": b"D", "A3 95": b"\xa3\x95", "A3 95 80": b"\xa3\x95\x80",
    "A3 95 01": b"\xa3\x95\x01",
}  # fmt: skip
MARKERS = {"P": b"P", "I": b"I", "IE": b"IE", "S": b"S", "PPE": b"PPE"} | {
    name: PATTERNS[name]
    for name in ("IPSE drawn", "P I 80 0 drawn", "P 5x80 drawn", "E events", "IPSE of 841")
}
"""Of a blackbox log, every byte of which may begin a frame."""
LOGS = {
    "tlog": "ap_euler_two_flights.tlog", "ulg": "px4-sih-default.ulg", "bin": "ardupilot-sitl.bin",
    "BFL": "real/LOG00281.BFL",
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("kind", LOGS)
def test_garbage_costs_time_by_its_size_alone(shared_logs, tmp_path, kind):
    data = (shared_logs / LOGS[kind]).read_bytes()[:700_000]
    path = tmp_path / f"log.{kind}"
    middle = len(data) // 2
    clean, samples = measure(path, data)
    for name, pattern in (GARBAGE | (MARKERS if kind == "BFL" else {})).items():
        garbage = (pattern * (10**6 // len(pattern) + 1))[: 10**6]
        hurt = data[:middle] + garbage + data[middle:]
        cost, found = measure(path, hurt)
        assert found >= 0.99 * samples, name
        assert cost - clean <= SECONDS_A_MEGABYTE, name


def as_pyulog(path):
    """What pyulog reads of a log, as `UlogFile` has it."""
    pyulog = pytest.importorskip("pyulog")
    log = pyulog.ULog(str(path), sorted(ulog.READ))
    topics = {(d.name, d.multi_id): d.data for d in log.data_list if len(d.data["timestamp"])}
    changed = [(t * 1e-6, name, value) for t, name, value in log.changed_parameters]
    dropouts = [(d.timestamp * 1e-6, d.duration * 1e-3) for d in log.dropouts]
    return topics, log.initial_parameters, changed, dropouts


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["public/px4-sitl.ulg", pytest.param("px4-sih-default.ulg", marks=pytest.mark.thorough)]
)
def test_a_log_is_read_as_by_pyulog(shared_logs, name):
    path = shared_logs / name
    topics, initial, changed, dropouts = as_pyulog(path)
    file = UlogFile(path, ulog.READ)
    assert set(file.topics) == set(topics)
    for key, columns in topics.items():
        assert set(file.topics[key]) == set(columns)
        for column, values in columns.items():
            np.testing.assert_array_equal(file.topics[key][column], values)
    assert file.initial == {k: v for k, v in initial.items() if isinstance(v, int | float)}
    assert file.changed == changed
    assert file.dropouts == dropouts
    assert not file.damaged


def test_a_dataflash_log_of_wrong_types_alone_is_refused(tmp_path):
    path = tmp_path / "hostile.bin"
    one = b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", 7, 3, b"X", b"", b"")
    path.write_bytes(one * 20_000 + b"\xa3\x95\x07" * 100_000)
    began = time.process_time()
    with pytest.raises(InputError, match="no entry found"):
        read_dataflash(path)
    assert time.process_time() - began < SECONDS
