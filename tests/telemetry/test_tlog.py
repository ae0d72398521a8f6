"""Recordings survive; readers take whatever they find."""

import errno
import os
import random
import signal
import struct
import subprocess
import sys
import textwrap

import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.telemetry import tlog
from gcs_sysid.telemetry.frames import Validity
from gcs_sysid.telemetry.tlog import TlogReader, TlogWriter, read_tlog, unused_path

START = 1_750_000_000_000_000


@pytest.fixture
def flight(stream):
    return [(START + 4000 * i, frame) for i, frame in enumerate(stream[1])]


def as_bytes(records):
    return b"".join(struct.pack(">Q", t) + frame.raw for t, frame in records)


def test_what_is_written_is_read(tmp_path, flight):
    path = tmp_path / "new folder" / "flight.tlog"
    with TlogWriter(path) as writer:
        for t, frame in flight:
            writer.write(t, [frame])
    assert path.read_bytes() == as_bytes(flight)
    assert list(read_tlog(path)) == flight


def test_flushed_frames_are_in_the_file_while_it_is_open(tmp_path, flight):
    path = tmp_path / "flight.tlog"
    with TlogWriter(path) as writer:
        writer.write(START, [flight[0][1]])
        writer.flush()
        assert len(list(read_tlog(path))) == 1


def test_an_existing_file_is_not_overwritten_unless_told(tmp_path, flight):
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"precious")
    with pytest.raises(InputError, match="exists already"):
        TlogWriter(path)
    assert path.read_bytes() == b"precious"
    assert unused_path(path).name == "flight-2.tlog"
    with TlogWriter(path, overwrite=True) as writer:
        writer.write(*flight[0][:1], [flight[0][1]])
    assert list(read_tlog(path)) == flight[:1]


def test_an_unwritable_folder_is_told_and_does_not_raise(tmp_path, flight):
    (tmp_path / "file").write_text("")
    with TlogWriter(tmp_path / "file" / "flight.tlog") as writer:
        assert "cannot write" in writer.problem
        assert not writer.recording
        writer.write(START, [flight[0][1]])
        writer.flush()
        assert writer.dropped == 1


def test_a_full_disk_is_told_and_does_not_raise(tmp_path, flight, monkeypatch):
    def full(file, data):
        if data:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(tlog, "_write_all", full)
    with TlogWriter(tmp_path / "flight.tlog") as writer:
        writer.write(START, [flight[0][1]])
        writer.flush()
        assert "No space left" in writer.problem
        writer.write(START, [flight[1][1]])
        assert writer.dropped == 1


def test_a_disk_that_does_not_answer_holds_bounded_memory(tmp_path, flight, monkeypatch):
    monkeypatch.setattr(tlog, "MOST_PENDING", 1000)
    monkeypatch.setattr(tlog, "WRITE_EVERY", 3600.0)
    with TlogWriter(tmp_path / "flight.tlog") as writer:
        for _ in range(100):
            writer.write(START, [frame for _, frame in flight])
        assert len(writer._pending) < 2000
        assert writer.dropped > 1000


def test_a_recording_killed_in_flight_is_readable(tmp_path):
    path = tmp_path / "killed.tlog"
    program = textwrap.dedent(
        """
        import sys, time
        from gcs_sysid.telemetry.dialect import mavlink
        from gcs_sysid.telemetry.frames import read_frame
        from gcs_sysid.telemetry.tlog import TlogWriter
        packer = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        writer = TlogWriter(sys.argv[1])
        while True:
            beat = mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)
            writer.write(time.time_ns() // 1000, [read_frame(bytes(beat.pack(packer)))])
            print(time.time_ns() // 1000, flush=True)
            time.sleep(0.002)
        """
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program, path], stdout=subprocess.PIPE, text=True
    )
    try:
        last = 0
        for line in process.stdout:
            last = int(line)
            # Until more than one write has reached the file.
            if path.exists() and path.stat().st_size > 10_000:
                break
    finally:
        process.send_signal(getattr(signal, "SIGKILL", signal.SIGTERM))
        process.wait()
        process.stdout.close()
    reader = read_tlog(path)
    records = list(reader)
    assert len(records) > 200
    assert all(frame.valid is Validity.OK for _, frame in records)
    assert last - records[-1][0] < 1_000_000


def test_a_truncated_last_record_is_left_out(tmp_path, flight):
    data = as_bytes(flight)
    path = tmp_path / "cut.tlog"
    for cut in range(1, len(flight[-1][1].raw) + 8):
        path.write_bytes(data[:-cut])
        assert list(read_tlog(path)) == flight[:-1]


@pytest.mark.parametrize("seed", range(100))
def test_a_corrupted_log_gives_no_wrong_frame_and_goes_on(tmp_path, flight, seed):
    rng = random.Random(seed)
    data = bytearray(as_bytes(flight))
    for _ in range(5):
        at = rng.randrange(len(data))
        match rng.randrange(3):
            case 0:
                data[at] ^= 1 << rng.randrange(8)
            case 1:
                del data[at : at + rng.randrange(1, 40)]
            case _:
                data[at:at] = rng.randbytes(rng.randrange(1, 40))
    path = tmp_path / "hurt.tlog"
    path.write_bytes(data)
    good = [frame for _, frame in read_tlog(path) if frame.valid is Validity.OK]
    assert set(good) <= {frame for _, frame in flight}
    assert len(good) >= len(flight) - 12


def test_frames_with_a_changed_definition_keep_the_chain(tmp_path, flight):
    frame = flight[5][1]
    changed = frame._replace(raw=frame.raw[:-1] + bytes([frame.raw[-1] ^ 1]))
    path = tmp_path / "changed.tlog"
    path.write_bytes(as_bytes([*flight[:5], (flight[5][0], changed), *flight[6:]]))
    reader = read_tlog(path)
    records = list(reader)
    assert len(records) == len(flight)
    assert reader.bad_crc == 1
    assert reader.garbage_bytes == 0


def test_windows_do_not_change_what_is_read(tmp_path, flight, monkeypatch):
    data = bytearray(as_bytes(flight * 3))
    data[5000:5000] = bytes(random.Random(2).randbytes(2500))
    path = tmp_path / "long.tlog"
    path.write_bytes(data)
    whole = list(read_tlog(path))
    monkeypatch.setattr(tlog, "WINDOW", 1000)
    assert list(read_tlog(path)) == whole
    assert len(whole) > 100


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is empty"),
        (b"not a log at all\n" * 500, "is not a .tlog"),
        (b"ULog\x01\x12\x35\x01" + bytes(range(256)) * 300, "is not a .tlog"),
        (bytes(100_000), "is not a .tlog"),
    ],
    ids=["empty", "text", "ulog", "zeros"],
)
def test_a_file_that_is_no_tlog_gives_one_line(tmp_path, content, says):
    path = tmp_path / "some.tlog"
    path.write_bytes(content)
    with pytest.raises(InputError, match=says) as caught:
        TlogReader(path)
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_a_folder_give_one_line(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        read_tlog(tmp_path / "missing.tlog")
    with pytest.raises(InputError, match="is a folder"):
        read_tlog(tmp_path)


def test_random_files_are_never_taken_for_a_log(tmp_path):
    rng = random.Random(11)
    path = tmp_path / "noise.tlog"
    for _ in range(5):
        path.write_bytes(rng.randbytes(50_000))
        with pytest.raises(InputError):
            read_tlog(path)


@pytest.mark.skipif(os.name != "posix", reason="reads /dev/full")
def test_the_real_full_device_is_told(flight):
    with TlogWriter("/dev/full", overwrite=True) as writer:
        writer.write(START, [flight[0][1]])
        writer.flush()
        assert "recording stopped" in writer.problem
