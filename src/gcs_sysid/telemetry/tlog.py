"""Recordings: .tlog files, written so that they survive, read whatever they went through.

A .tlog is a row of records: 8 bytes big-endian microseconds since 1970 and one raw frame.
"""

import os
import struct
import threading
import time
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError
from gcs_sysid.telemetry.frame_block import FrameBlock
from gcs_sysid.telemetry.frames import Frame, find_frame
from gcs_sysid.telemetry.message_arrays import message_arrays
from gcs_sysid.telemetry.tlog_scan import STAMP, ScanCounts, Scanner, record_follows

_stamp = struct.Struct(">Q")

WRITE_EVERY = 0.25
"""s. What a kill -9 can cost: the rest lies with the operating system by then."""
SYNC_EVERY = 1.0
"""s. What a power loss can cost. An fsync takes milliseconds on an SSD and up to a second on
an SD card, so it happens in the recorder's own thread, where it keeps nobody waiting."""
MOST_PENDING = 16 * 2**20
"""Bytes held for a disk that does not take them; what comes beyond is dropped and counted."""

WINDOW = 2**21
"""Bytes read at once. Working on them takes about ten times as much memory."""
HEAD = 2**20
"""Bytes that must show a record for the file to be a .tlog."""


class TlogWriter:
    """Records frames to a file from a thread of its own; the caller never waits for the disk.

    Trouble with the disk does not raise: recording stops, and `problem` says why.

    Attributes:
        path: where it records.
        problem: one line when recording stopped or could not start, else "".
        dropped: frames not recorded because the disk did not keep up or failed.
    """

    def __init__(self, path: Path | str, *, overwrite: bool = False) -> None:
        self.path = Path(path)
        self.problem = ""
        self.dropped = 0
        self._pending = bytearray()
        self._wake = threading.Condition()
        self._closing = False
        self._asked = 0  # flushes asked for and done
        self._done = 0
        self._stopped = False
        self._file: BinaryIO | None = None
        if not overwrite and self.path.exists():
            raise InputError(
                f"{self.path} exists already and is not overwritten: give another file name"
            )
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            # "x": even a file that appears at this moment is not overwritten.
            self._file = open(self.path, "wb" if overwrite else "xb", buffering=0)  # noqa: SIM115
        except OSError as error:
            self.problem = f"not recording: cannot write {self.path} ({error.strerror})"
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        if self._file is None:
            self._stopped = True
        else:
            self._thread.start()

    @property
    def recording(self) -> bool:
        """Whether frames still reach the file."""
        return self._file is not None and not self.problem and not self._closing

    def write(self, time_us: int, frames: Iterable[Frame]) -> None:
        """Record frames that arrived at `time_us` (microseconds since 1970)."""
        stamp = _stamp.pack(time_us)
        with self._wake:
            for frame in frames:
                if self.recording and len(self._pending) < MOST_PENDING:
                    self._pending += stamp
                    self._pending += frame.raw
                else:
                    self.dropped += 1

    def flush(self) -> None:
        """Wait until all that was written lies with the operating system and is synced."""
        with self._wake:
            self._asked += 1
            asked = self._asked
            self._wake.notify_all()
            self._wake.wait_for(lambda: self._done >= asked or self._stopped, 10.0)

    def close(self) -> None:
        """Write what is left and close the file."""
        with self._wake:
            self._closing = True
            self._wake.notify_all()
        if self._thread.is_alive():
            self._thread.join()

    def __enter__(self) -> "TlogWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        assert self._file is not None
        synced = time.monotonic()
        with self._file as file:
            closing = False
            while not closing:
                with self._wake:
                    if not self._closing and self._asked == self._done:
                        self._wake.wait(WRITE_EVERY)
                    closing = self._closing
                    asked = self._asked
                    data, self._pending = self._pending, bytearray()
                try:
                    _write_all(file, data)
                    now = time.monotonic()
                    if closing or asked != self._done or now - synced >= SYNC_EVERY:
                        os.fsync(file.fileno())
                        synced = now
                except OSError as error:
                    self.problem = f"recording stopped: {self.path} ({error.strerror})"
                    closing = True
                with self._wake:
                    self._done = asked
                    self._stopped = closing
                    self._wake.notify_all()


def _write_all(file: BinaryIO, data: bytes | bytearray) -> None:
    view = memoryview(data)
    while view:
        view = view[file.write(view) :]


def unused_path(path: Path) -> Path:
    """The path itself, or with -2, -3, ... before the suffix where that exists already."""
    candidate = path
    number = 2
    while candidate.exists():
        candidate = path.with_name(f"{path.stem}-{number}{path.suffix}")
        number += 1
    return candidate


class TlogReader:
    """Reads a .tlog of any ground station, in windows of bounded memory.

    Frames of unknown types and with a wrong checksum come too where the chain of records is
    intact. Where it is broken, the reader hunts for the next frame whose checksum is right.

    Args:
        path: of the file.
        window: bytes read at once.

    Attributes:
        counts: of what was seen while it was last read.
        bytes_read: of the file, while it was last read.
    """

    def __init__(self, path: Path | str, window: int | None = None) -> None:
        self.path = Path(path)
        self.counts = ScanCounts()
        self.bytes_read = 0
        self._window = window or WINDOW
        try:
            if self.path.is_dir():
                raise InputError(f"{self.path} is a folder: give a .tlog file")
            size = self.path.stat().st_size
            with open(self.path, "rb") as file:
                head = file.read(HEAD)
        except OSError as error:
            raise InputError(f"cannot read {self.path}: {error.strerror}") from error
        if size == 0:
            raise InputError(f"{self.path} is empty: nothing was recorded in it")
        if not _looks_like_tlog(head):
            raise InputError(f"{self.path} is not a .tlog: no MAVLink record found in it")

    @property
    def garbage_bytes(self) -> int:
        """Bytes that belong to no record."""
        return self.counts.garbage_bytes

    @property
    def bad_crc(self) -> int:
        """Frames whose checksum is wrong."""
        return self.counts.bad_crc

    def blocks(self) -> Iterator[FrameBlock]:
        """All frames as columns, window by window.

        Raises:
            InputError: the file can no longer be read.
        """
        scanner = Scanner()
        self.counts = scanner.counts
        self.bytes_read = 0
        try:
            with open(self.path, "rb") as file:
                content, final = b"", False
                while not final:
                    more = file.read(self._window)
                    self.bytes_read += len(more)
                    final = len(more) < self._window
                    block, done = scanner.scan(content + more, final=final)
                    content = (content + more)[done:]
                    if len(block):
                        yield block
        except OSError as error:
            raise InputError(f"cannot read {self.path}: {error.strerror}") from error

    def __iter__(self) -> Iterator[tuple[int, Frame]]:
        """(time in us since 1970, frame) of every record."""
        for block in self.blocks():
            yield from block

    def messages(self, names: Collection[str] | None = None) -> Iterator[dict[str, Array]]:
        """Messages of the types named (None: of all that the dialect knows), window by window.

        Gives name -> structured array, see `message_arrays`, for the types that occur in the
        window. Joined, the windows are what `read_messages` gives.
        """
        for block in self.blocks():
            yield message_arrays(block, names)


def read_tlog(path: Path | str) -> TlogReader:
    """Open a .tlog for reading; `InputError` when it is none."""
    return TlogReader(path)


def read_messages(
    path: Path | str, names: Collection[str] | None = None
) -> tuple[dict[str, Array], ScanCounts]:
    """All messages of a .tlog.

    Args:
        path: of the file.
        names: of the message types wanted; None: all that the dialect knows.

    Returns:
        Message name -> structured array in the order of the file, see `message_arrays`, and
        what was seen in the file, losses included.

    Raises:
        InputError: the file cannot be read, or is no .tlog.
        KeyError: the dialect has no message of a name.
    """
    reader = TlogReader(path)
    parts: dict[str, list[Array]] = {}
    for window in reader.messages(names):
        for name, messages in window.items():
            parts.setdefault(name, []).append(messages)
    # One type after the other, so that the pieces of the others are not held twice.
    return {name: np.concatenate(parts.pop(name)) for name in list(parts)}, reader.counts


def _looks_like_tlog(head: bytes) -> bool:
    """Whether a record whose checksum is right, followed by another or the end, is in there."""
    at = 0
    while at < len(head):
        at, frame = find_frame(head, at, len(head), final=True)
        if frame is None:
            return False
        if at >= STAMP and (
            record_follows(head, at, frame) or at + len(frame.raw) + STAMP > len(head)
        ):
            return True
        at += 1
    return False
