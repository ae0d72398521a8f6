"""Recordings survive crashes, and disks that are slow, full, gone or unwritable."""

import errno
import io
import os
import signal
import subprocess
import sys
import textwrap
import threading

import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.telemetry import tlog_writer
from gcs_sysid.telemetry.frames import Validity
from gcs_sysid.telemetry.tlog import TlogReader
from gcs_sysid.telemetry.tlog_writer import TlogWriter, unused_path
from tests.telemetry.in_memory import as_bytes

START = 1_750_000_000_000_000
PATIENCE = 60.0
"""s; what has not happened by then never will."""


@pytest.fixture
def flight(stream):
    return [(START + 4000 * i, frame) for i, frame in enumerate(stream[1])]


@pytest.fixture(autouse=True)
def hasty(monkeypatch):
    """Nothing waits for a disk to recover, or for one that does not answer."""
    monkeypatch.setattr(TlogWriter, "WRITE_EVERY", 0.005)
    monkeypatch.setattr(TlogWriter, "RETRY_EVERY", 0.005)


def write_all(writer, records):
    for t, frame in records:
        writer.write(t, [frame])


class Disk:
    """A file on a disk of some room, which may hold up whoever writes."""

    def __init__(self, room=10**9):
        self.room = room
        self.answers = threading.Event()
        self.answers.set()
        self.reached = threading.Event()  # somebody has begun to write
        self.error = None
        self.content = io.BytesIO()
        self.opened = []
        self.closed = False

    def open(self, path, mode):
        if self.error is not None and not self.opened:
            raise self.error
        self.opened.append(path)
        return self

    def write(self, data):
        if len(data):
            self.reached.set()
        assert self.answers.wait(PATIENCE)
        if len(data) and self.error is not None:
            raise self.error
        free = self.room - self.content.tell()
        if len(data) and free <= 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        return self.content.write(data[:free])

    def seek(self, to):
        self.content.seek(to)

    def truncate(self, to):
        self.content.truncate(to)

    def fileno(self):
        raise OSError("no real file")

    def close(self):
        self.closed = True


@pytest.fixture
def disk(monkeypatch):
    disk = Disk()
    monkeypatch.setattr(tlog_writer, "open_file", disk.open)
    monkeypatch.setattr(tlog_writer, "sync", lambda _: None)
    monkeypatch.setattr(TlogWriter, "SYNC_EVERY", 3600.0)
    return disk


def until(writer, said):
    """Wait until the writer says something; all that it said until then."""
    told = []
    pause = threading.Event()
    for _ in range(round(PATIENCE / 0.005)):
        told += writer.take_events()
        for place, text in enumerate(told, 1):
            if said in text:
                with writer._wake:  # what it said since is for the next who waits
                    writer._events.extendleft(reversed(told[place:]))
                return told[:place]
        pause.wait(0.005)
    raise AssertionError(told)


def test_what_is_written_is_read(tmp_path, flight):
    path = tmp_path / "new folder" / "flight.tlog"
    with TlogWriter(path) as writer:
        write_all(writer, flight)
    assert path.read_bytes() == as_bytes(flight)
    assert list(TlogReader(path)) == flight
    assert writer.summary() == f"recorded to {path}"


@pytest.mark.slow
def test_an_existing_file_is_not_overwritten(tmp_path, flight):
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"precious")
    with pytest.raises(InputError, match="exists already"):
        TlogWriter(path)
    with TlogWriter(path, beside=True) as writer:
        write_all(writer, flight[:2])
    assert writer.recorded == (tmp_path / "flight-2.tlog",)
    assert path.read_bytes() == b"precious"
    assert unused_path(path).name == "flight-3.tlog"


@pytest.mark.slow
def test_a_file_that_appears_meanwhile_is_not_overwritten(tmp_path, flight, monkeypatch):
    path = tmp_path / "flight.tlog"
    real, taken = tlog_writer.open_file, []

    def late(wanted, mode):
        if not taken:
            taken.append(wanted)
            wanted.write_bytes(b"precious")
        return real(wanted, mode)

    monkeypatch.setattr(tlog_writer, "open_file", late)
    with TlogWriter(path) as writer:
        write_all(writer, flight)
        until(writer, "continues in")
    assert path.read_bytes() == b"precious"
    assert list(TlogReader(tmp_path / "flight-2.tlog")) == flight


def test_a_recording_of_nothing_is_not_kept(tmp_path):
    with TlogWriter(tmp_path / "flight.tlog") as writer:
        writer.flush()
        assert writer.path.exists()
    assert list(tmp_path.iterdir()) == []
    assert writer.summary() == f"nothing received: {writer.path} was not kept"


def test_an_unwritable_folder_is_told_and_nothing_is_lost_once_it_is_writable(tmp_path, flight):
    in_the_way = tmp_path / "folder"
    in_the_way.write_text("")
    path = in_the_way / "flight.tlog"
    with TlogWriter(path) as writer:
        (told,) = until(writer, "not recording: cannot write")
        assert str(path) in told
        assert "retried every" in told
        assert writer.problem
        write_all(writer, flight)
        writer.flush()  # returns, although there is nothing to flush to
        in_the_way.unlink()
        until(writer, f"recording continues in {path}")
        assert writer.problem == ""
    assert list(TlogReader(path)) == flight
    assert writer.dropped == 0


def test_a_full_disk_that_has_room_again_costs_nothing(disk, flight, tmp_path):
    disk.room = len(as_bytes(flight[:7])) + 3  # in the midst of a record
    with TlogWriter(tmp_path / "flight.tlog") as writer:
        write_all(writer, flight)
        told = until(writer, "recording stopped")
        assert told == [
            f"recording stopped: {writer.path} (No space left on device); "
            f"retried every {TlogWriter.RETRY_EVERY:g} s"
        ]
        assert disk.content.getvalue() == as_bytes(flight[:7])  # whole records only
        disk.room = 10**9
        until(writer, "recording continues in")
    assert disk.content.getvalue() == as_bytes(flight)
    assert len(disk.opened) == 1
    assert disk.closed
    assert (writer.dropped, writer.problem) == (0, "")


def test_a_disk_that_stays_full_is_told_once_and_holds_bounded_memory(
    disk, flight, tmp_path, monkeypatch
):
    monkeypatch.setattr(TlogWriter, "MOST_PENDING", 2000)
    disk.room = len(as_bytes(flight[:3]))
    with TlogWriter(tmp_path / "flight.tlog") as writer:
        write_all(writer, flight[:4])
        told = until(writer, "recording stopped")
        for _ in range(50):
            write_all(writer, flight)
            assert sum(len(data) for data, _ in writer._pending) <= 2000
            writer.flush()
        told += writer.take_events()
    assert len(told) == 2  # that it stopped, and that frames are lost from now on
    assert "the disk does not keep up, frames are lost" in told[1]
    assert writer.dropped == 4 + 50 * len(flight) - 3
    assert disk.content.getvalue() == as_bytes(flight[:3])
    assert writer.summary() == (
        f"recording stopped: {writer.path} (No space left on device); {writer.dropped} frames are "
        f"missing; recorded before: {writer.path}"
    )


def test_a_disk_that_does_not_answer_holds_up_nobody(disk, flight, tmp_path, monkeypatch):
    """What comes waits in memory while there is room for it, and is written once it can be."""
    monkeypatch.setattr(TlogWriter, "MOST_PENDING", 4 * len(as_bytes(flight)))
    monkeypatch.setattr(TlogWriter, "STALLED_AFTER", -1.0)
    disk.answers.clear()
    with TlogWriter(tmp_path / "flight.tlog") as writer:
        writer.write(START, [flight[0][1]])
        assert disk.reached.wait(PATIENCE)
        for _ in range(10):  # returns at once, every time
            write_all(writer, flight)
        first, second = writer.take_events()
        assert "the disk does not answer, frames wait in memory" in first
        assert "frames are lost" in second
        lost = writer.dropped
        assert 6 * len(flight) - 10 < lost < 6 * len(flight) + 10  # of ten times, four fit
        disk.answers.set()
        (told,) = until(writer, "recording continues in")
        assert told.endswith(f"{lost} frames are missing so far")
        write_all(writer, flight)
    assert writer.dropped == lost
    assert writer.summary().endswith(f"; {lost} frames are missing")
    records = list(read_tlog_of(disk, tmp_path))
    assert len(records) == 1 + 11 * len(flight) - lost
    assert all(record in flight for record in records)
    assert records[-len(flight) :] == flight


def read_tlog_of(disk, folder):
    path = folder / "content.tlog"
    path.write_bytes(disk.content.getvalue())
    reader = TlogReader(path)
    yield from reader
    assert reader.counts.garbage_bytes == 0


def test_a_disk_that_never_answers_is_left_behind(disk, flight, tmp_path):
    disk.answers.clear()
    writer = TlogWriter(tmp_path / "flight.tlog")
    write_all(writer, flight[:1])
    assert disk.reached.wait(PATIENCE)
    write_all(writer, flight[1:])
    writer.close(patience=0.01)
    assert writer.problem == f"recording cut short: {writer.path} (the disk does not answer)"
    assert writer.dropped == len(flight) - 1
    disk.answers.set()  # lets its thread go


def test_a_slow_sync_does_not_hold_up_the_writing(tmp_path, flight, monkeypatch):
    syncing, go_on = threading.Event(), threading.Event()

    def slow(_file):
        syncing.set()
        assert go_on.wait(PATIENCE)

    monkeypatch.setattr(TlogWriter, "SYNC_EVERY", 0.001)
    monkeypatch.setattr(tlog_writer, "sync", slow)
    path = tmp_path / "flight.tlog"
    with TlogWriter(path) as writer:
        assert syncing.wait(PATIENCE)
        write_all(writer, flight)
        writer.flush()
        assert list(TlogReader(path)) == flight
        go_on.set()


def test_a_sync_that_fails_begins_another_file(tmp_path, flight, monkeypatch):
    """What the system could not put on the disk, it may have forgotten."""
    failed = threading.Event()

    def fail_once(_file):
        if not failed.is_set():
            failed.set()
            raise OSError(errno.EIO, "Input/output error")

    path = tmp_path / "flight.tlog"
    with TlogWriter(path) as writer:
        write_all(writer, flight[:5])
        writer.flush()
        monkeypatch.setattr(tlog_writer, "sync", fail_once)
        writer._sync_error = OSError(errno.EIO, "Input/output error")
        until(writer, "Input/output error")
        write_all(writer, flight[5:])
        until(writer, "continues in")
    assert list(TlogReader(path)) == flight[:5]
    assert list(TlogReader(tmp_path / "flight-2.tlog")) == flight[5:]
    assert writer.summary() == f"recorded to {path} and {tmp_path / 'flight-2.tlog'}"


@pytest.mark.skipif(os.name == "nt", reason="an open file cannot be removed there")
def test_a_file_that_was_removed_is_begun_anew(tmp_path, flight, monkeypatch):
    monkeypatch.setattr(TlogWriter, "SYNC_EVERY", 0.001)
    path = tmp_path / "logs" / "flight.tlog"
    with TlogWriter(path) as writer:
        write_all(writer, flight[:5])
        writer.flush()
        path.unlink()
        path.parent.rmdir()
        until(writer, "recording continues in")
        write_all(writer, flight[5:])
    assert list(TlogReader(path)) == flight[5:]
    assert writer.recorded == (path,)


def test_a_file_that_fails_again_and_again_is_given_up(disk, flight, tmp_path):
    disk.error = None
    with TlogWriter(tmp_path / "flight.tlog") as writer:
        writer.flush()
        disk.error = OSError(errno.EIO, "Input/output error")
        write_all(writer, flight)
        told = until(writer, "start another recording")
        writer.write(START, [flight[0][1]])
    assert len(disk.opened) == TlogWriter.MOST_FILES
    assert sum("tried again" in text for text in told) <= TlogWriter.MOST_FILES
    assert writer.dropped == len(flight) + 1


@pytest.mark.slow
def test_a_recording_killed_in_flight_is_readable(tmp_path):
    path = tmp_path / "killed.tlog"
    program = textwrap.dedent(
        """
        import sys, time
        from gcs_sysid.telemetry.dialect import mavlink
        from gcs_sysid.telemetry.frames import read_frame
        from gcs_sysid.telemetry.tlog_writer import TlogWriter
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
    reader = TlogReader(path)
    records = list(reader)
    assert len(records) > 200
    assert all(frame.valid is Validity.OK for _, frame in records)
    assert last - records[-1][0] < 1_000_000
