"""Recordings written so that they survive: a crash, a slow disk, a full one, one that is gone.

The recorder hands frames over and never waits. A thread writes them, whole records only, a few
times a second: from then on they outlive this process. Another thread has them synced to the disk,
which on an SD card may take longer than a second, and blocks neither.

What the user did in a session is marked beside the vehicle's frames, as a STATUSTEXT of this tool's
own address, which was never sent: ground stations record their own messages too, and every reader
of .tlog files takes it for what it is, a line of text. In version 1, which readers of either
version understand.
"""

import errno
import io
import os
import struct
import threading
import time
from collections import deque
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from gcs_sysid.errors import InputError
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frames import Frame, read_frame
from gcs_sysid.telemetry.messages import picker
from gcs_sysid.telemetry.outgoing import OWN_COMPONENT, OWN_SYSTEM

NOT_RECORDING = "not recording"
"""How the line of a recording that has no file begins."""
_NO_ROOM = {errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC)}

RECORD_TIME = struct.Struct(">Q")
"""us since 1970, before each frame."""


class TlogWriter:
    """Records frames to a file from a thread of its own; the caller never waits for the disk.

    Trouble with the disk never raises. What cannot be written waits in memory, within bounds, and
    is tried again: in the same file once a full disk has room, in a new one beside it where the
    file fails or was removed. `beside`: where that name is taken, take the next one that is free.

    Attributes:
        path: where it records at present.
        problem: one line while the disk refuses, else "".
        dropped: frames that are in no file, because the disk did not keep up or failed.

    Raises:
        InputError: the file exists, and none beside it is wanted.
    """

    WRITE_EVERY = 0.1
    """s. What a kill -9 can cost: the rest lies with the operating system by then."""
    SYNC_EVERY = 0.7
    """s between syncs. What a power loss can cost, with `WRITE_EVERY`."""
    RETRY_EVERY = 2.0
    """s between attempts while the disk refuses."""
    MOST_PENDING = 16 * 2**20
    """Bytes held for a disk that does not take them, minutes of telemetry; what comes beyond is
    dropped and counted."""
    MOST_FILES = 20
    """Files begun for one recording: a disk that fails again and again is given up."""
    PATIENCE = 5.0
    """s that `close` waits for a disk that does not answer."""
    STALLED_AFTER = 3.0
    """s in one write from which a disk is said not to answer."""
    _MOST_EVENTS = 20
    """Events kept until taken."""

    def __init__(self, path: Path | str, *, beside: bool = False) -> None:
        self.path = Path(path)
        self.problem = ""
        self.dropped = 0
        if not beside and self.path.exists():
            raise InputError(
                f"{self.path} exists already and is not overwritten: give another file name"
            )
        self._wanted = self.path
        self._files: list[Path] = []  # those that hold records, in order
        self._begun = 0
        self._events: deque[str] = deque(maxlen=self._MOST_EVENTS)
        self._wake = threading.Condition()
        self._pending: list[tuple[bytes, int]] = []  # whole records, and how many
        self._waiting = 0  # bytes of them, and of what is being written
        self._closing = self._given_up = False
        self._asked, self._done = 1, 0  # flushes; the first opens the file
        self._busy_since: float | None = None
        self._stalled = self._dropping = False
        self._file: BinaryIO | None = None
        self._size = 0  # bytes of whole records in the file
        self._syncing = threading.Lock()  # held while a sync or a close is going on
        self._sync_error: OSError | None = None
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()
        threading.Thread(target=self._keep_synced, name="sync", daemon=True).start()

    # -- the caller's side

    @property
    def ended(self) -> bool:
        """Whether all is written and closed."""
        return self._ended.is_set()

    def write(self, time_us: int, frames: Iterable[Frame]) -> None:
        """Record frames that arrived at `time_us` (microseconds since 1970)."""
        stamp = RECORD_TIME.pack(time_us)
        parts = [part for frame in frames for part in (stamp, frame.raw)]
        data, count = b"".join(parts), len(parts) // 2
        with self._wake:
            since = self._busy_since
            if (
                since is not None
                and not self._stalled
                and time.monotonic() - since > self.STALLED_AFTER
            ):
                self._stalled = True
                self._events.append(f"{self.path}: the disk does not answer, frames wait in memory")
            if self._waiting + len(data) > self.MOST_PENDING and not self._dropping:
                self._dropping = True
                self._events.append(f"{self.path}: the disk does not keep up, frames are lost")
            if self._dropping or self._closing or self._given_up:
                self.dropped += count
                return
            self._pending.append((data, count))
            self._waiting += len(data)

    def flush(self) -> None:
        """Wait until what was written lies with the operating system, but not on a bad disk."""
        with self._wake:
            self._asked += 1
            asked = self._asked
            self._wake.notify_all()
            self._wake.wait_for(lambda: self._done >= asked or self.ended, 10.0)

    def finish(self) -> None:
        """Write what is left and close the file, without waiting for it: see `ended`."""
        with self._wake:
            self._closing = True
            self._wake.notify_all()

    def close(self, patience: float = PATIENCE) -> None:
        """Write what is left and close the file; a disk that does not answer is left behind."""
        self.finish()
        if self._ended.wait(patience) or self.ended:
            return
        with self._wake:
            self.dropped += sum(count for _, count in self._pending)
            self._pending.clear()
            self.problem = f"recording cut short: {self.path} (the disk does not answer)"

    def take_events(self) -> list[str]:
        """What happened since this was last asked, one line each."""
        with self._wake:
            events = list(self._events)
            self._events.clear()
        return events

    @property
    def recorded(self) -> tuple[Path, ...]:
        """The files that hold records, in order."""
        return tuple(self._files)

    def summary(self) -> str:
        """In one line, once it has ended: where the records are, or why they are not."""
        names = " and ".join(map(str, self.recorded))
        missing = f"; {self.dropped} frames are missing" if self.dropped else ""
        if not names:
            return self.problem or f"nothing received: {self.path} was not kept"
        if self.problem:
            return f"{self.problem}{missing}; recorded before: {names}"
        return f"recorded to {names}{missing}"

    def __enter__(self) -> "TlogWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # -- the recorder's thread

    def _run(self) -> None:
        closing = False
        looked = time.monotonic()
        while not closing:
            with self._wake:
                if not self._closing and self._asked == self._done:
                    self._wake.wait(self.RETRY_EVERY if self.problem else self.WRITE_EVERY)
                closing, asked = self._closing, self._asked
                chunks, self._pending = self._pending, []
            try:
                if not self._given_up:
                    now = time.monotonic()
                    if now - looked >= self.SYNC_EVERY:
                        looked = now
                        self._see_whether_there()
                    chunks = self._write(chunks)
            except (OSError, ValueError) as error:  # ValueError: a file closed by a stranger
                chunks = self._after(error, chunks)
            with self._wake:
                if closing or self._given_up:
                    self.dropped += sum(count for _, count in chunks)
                    self._waiting -= sum(len(data) for data, _ in chunks)
                else:
                    self._pending = chunks + self._pending
                self._done = asked
                self._wake.notify_all()
        self._close_file()
        self._ended.set()
        with self._wake:
            self._wake.notify_all()

    def _write(self, chunks: list[tuple[bytes, int]]) -> list[tuple[bytes, int]]:
        """Write whole records; empty, since what cannot be written raises."""
        error, self._sync_error = self._sync_error, None
        if error is not None:
            raise error
        if self._file is None:
            self._open()
        file = self._file
        assert file is not None
        if self.problem and chunks:  # it may hold a part of a record: overwrite that
            file.seek(self._size)
        view = memoryview(b"".join(data for data, _ in chunks))
        done = 0
        try:
            self._busy_since = time.monotonic()
            while done < len(view):
                done += file.write(view[done:])
        finally:
            self._busy_since = None
            if done and self.path not in self._files:
                self._files.append(self.path)
            while chunks and len(chunks[0][0]) <= done:
                data, _ = chunks.pop(0)
                done -= len(data)
                self._size += len(data)
                with self._wake:
                    self._waiting -= len(data)
        self._recovered()
        return chunks

    def _recovered(self) -> None:
        if not (self.problem or self._dropping or self._stalled):
            return
        with self._wake:
            if self._waiting > self.MOST_PENDING // 2:  # more has come meanwhile: first that
                return
            lost = f"; {self.dropped} frames are missing so far" if self._dropping else ""
            self._events.append(f"recording continues in {self.path}{lost}")
            self.problem, self._dropping, self._stalled = "", False, False

    def _open(self) -> None:
        """Open the next file."""
        self.path = unused_path(self._wanted)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        # "x": even a file that appears at this moment is not overwritten.
        self._file, self._size = open_file(self.path, "x"), 0
        self._begun += 1

    def _see_whether_there(self) -> None:
        """A removed file takes all that is written, and is lost."""
        if self._file is None:
            return
        status = os.fstat(self._file.fileno())
        # Not every file system counts names; on those the path itself must be missing too.
        if status.st_nlink == 0 and not self.path.exists():
            self._size = 0
            self._files = [path for path in self._files if path != self.path]
            raise FileNotFoundError(errno.ENOENT, "the file was removed")

    def _after(
        self, error: OSError | ValueError, chunks: list[tuple[bytes, int]]
    ) -> list[tuple[bytes, int]]:
        """See what can be done about an error; the chunks to try again."""
        why = getattr(error, "strerror", None) or str(error)
        if self._file is None:
            problem = f"{NOT_RECORDING}: cannot write {self.path} ({why})"
        else:
            problem = f"recording stopped: {self.path} ({why})"
            with suppress(OSError, ValueError):
                self._file.truncate(self._size)
            if getattr(error, "errno", None) not in _NO_ROOM:
                self._close_file()
        again = f"; retried every {self.RETRY_EVERY:g} s"
        if self._begun >= self.MOST_FILES:
            self._given_up = True
            again = "; it failed too often: start another recording"
        with self._wake:
            if problem != self.problem or self._given_up:
                self._events.append(problem + again)
            self.problem = problem
        return chunks

    def _close_file(self) -> None:
        """Close the file, synced; one that holds nothing was not kept."""
        file, self._file = self._file, None
        if file is None:
            return
        with self._syncing:
            with suppress(OSError, ValueError):
                sync(file)
            with suppress(OSError):
                file.close()
        if not self._size:
            with suppress(OSError):
                if self.path.stat().st_size == 0:
                    self.path.unlink()

    # -- the other thread

    def _keep_synced(self) -> None:
        while not self._ended.wait(self.SYNC_EVERY):
            with self._syncing:
                file = self._file
                if file is None or file.closed:
                    continue
                try:
                    sync(file)
                except OSError as error:
                    self._sync_error = error
                except ValueError:  # closed at this moment
                    continue


def open_file(path: Path, mode: str) -> BinaryIO:
    """A file without a buffer of its own; a kill costs nothing that was written to it."""
    return io.FileIO(path, mode)


def sync(file: BinaryIO) -> None:
    """Have what was written to a file put on the disk."""
    os.fsync(file.fileno())


def unused_path(path: Path) -> Path:
    """The path itself, or with -2, -3, ... before the suffix where that exists already."""
    candidate = path
    number = 2
    while candidate.exists():
        candidate = path.with_name(f"{path.stem}-{number}{path.suffix}")
        number += 1
    return candidate


RESET_TEXT = "gcs-sysid: estimate reset"

_text = picker("STATUSTEXT", "text")


def reset_mark() -> Frame:
    """The frame that marks where the user reset the estimate."""
    packer = mavlink.MAVLink(None, srcSystem=OWN_SYSTEM, srcComponent=OWN_COMPONENT)
    message = mavlink.MAVLink_statustext_message(
        mavlink.MAV_SEVERITY_NOTICE, RESET_TEXT.encode("ascii")
    )
    frame = read_frame(bytes(message.pack(packer, force_mavlink1=True)))
    assert frame is not None
    return frame


def is_reset_mark(frame: Frame) -> bool:
    """Whether a frame with a right checksum is that mark."""
    if frame.message_id != mavlink.MAVLINK_MSG_ID_STATUSTEXT:
        return False
    if (frame.system, frame.component) != (OWN_SYSTEM, OWN_COMPONENT):
        return False
    text: bytes = _text(frame.payload)[0]
    return text.split(b"\0", 1)[0] == RESET_TEXT.encode("ascii")
