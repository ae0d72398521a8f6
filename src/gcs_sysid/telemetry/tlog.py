"""Recordings: .tlog files, written so that they survive, read whatever they went through.

A .tlog is a row of records: 8 bytes big-endian microseconds since 1970 and one raw frame.
"""

import os
import struct
import threading
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

from gcs_sysid.errors import InputError
from gcs_sysid.telemetry.frames import (
    LONGEST_FRAME,
    MAGIC_1,
    MAGIC_2,
    Frame,
    Validity,
    find_frame,
    read_frame,
)

STAMP = 8
_stamp = struct.Struct(">Q")

WRITE_EVERY = 0.25
"""s. What a kill -9 can cost: the rest lies with the operating system by then."""
SYNC_EVERY = 1.0
"""s. What a power loss can cost. An fsync takes milliseconds on an SSD and up to a second on
an SD card, so it happens in the recorder's own thread, where it keeps nobody waiting."""
MOST_PENDING = 16 * 2**20
"""Bytes held for a disk that does not take them; what comes beyond is dropped and counted."""

WINDOW = 2**20
PLAUSIBLE_STEP = 86_400_000_000
"""us. After a break in the file, a stamp further than this from the last one is not believed."""


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

    Iterating gives (time_us, frame) for every record, frames of unknown types and with a
    wrong checksum too where the chain of records is intact. Where it is broken, the reader
    hunts for the next frame whose checksum is right.

    Attributes:
        garbage_bytes: bytes that belong to no record.
        bad_crc: frames whose checksum is wrong.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.garbage_bytes = 0
        self.bad_crc = 0
        try:
            if self.path.is_dir():
                raise InputError(f"{self.path} is a folder: give a .tlog file")
            size = self.path.stat().st_size
            with open(self.path, "rb") as file:
                head = file.read(WINDOW)
        except OSError as error:
            raise InputError(f"cannot read {self.path}: {error.strerror}") from error
        if size == 0:
            raise InputError(f"{self.path} is empty: nothing was recorded in it")
        if not _looks_like_tlog(head):
            raise InputError(f"{self.path} is not a .tlog: no MAVLink record found in it")

    def __iter__(self) -> Iterator[tuple[int, Frame]]:
        self.garbage_bytes = self.bad_crc = 0
        last_us = 0
        with open(self.path, "rb") as file:
            data = file.read(WINDOW)
            at = 0
            ended = False
            while True:
                # The longest record and the header after it must lie in the window.
                if not ended and len(data) - at < 2 * (STAMP + LONGEST_FRAME):
                    more = file.read(WINDOW)
                    ended = not more
                    data = data[at:] + more
                    at = 0
                    continue
                if at >= len(data):
                    return
                frame = read_frame(data, at + STAMP)
                if frame is not None and (
                    frame.valid is Validity.OK or _record_follows(data, at + STAMP, frame)
                ):
                    (last_us,) = _stamp.unpack_from(data, at)
                    start = at
                else:
                    position, frame = find_frame(
                        data, at, len(data) if ended else len(data) - LONGEST_FRAME, final=True
                    )
                    if frame is None:
                        # A record's stamp may lie just before the frame that comes next.
                        start = len(data) if ended else max(at, position - STAMP)
                        self.garbage_bytes += start - at
                        at = start
                        if ended:
                            return
                        more = file.read(WINDOW)
                        ended = not more
                        data = data[at:] + more
                        at = 0
                        continue
                    start = max(at, position - STAMP)
                    if position - start == STAMP:
                        (stamp,) = _stamp.unpack_from(data, start)
                        if not last_us or abs(stamp - last_us) < PLAUSIBLE_STEP:
                            last_us = stamp
                    self.garbage_bytes += start - at
                    at = position + len(frame.raw)
                    yield last_us, frame
                    continue
                if frame.valid is Validity.BAD_CRC:
                    self.bad_crc += 1
                at = start + STAMP + len(frame.raw)
                yield last_us, frame


def read_tlog(path: Path | str) -> TlogReader:
    """Open a .tlog for reading; `InputError` when it is none."""
    return TlogReader(path)


def _record_follows(data: bytes, at: int, frame: Frame) -> bool:
    """Whether another record, or the end of the data, comes after a frame."""
    stop = at + len(frame.raw)
    magic = stop + STAMP
    intact = stop == len(data) if magic >= len(data) else data[magic] in (MAGIC_1, MAGIC_2)
    if not intact or frame.valid is not Validity.BAD_CRC:
        return intact
    # A corrupted length byte can lead to another record by chance; then good ones lie inside.
    return find_frame(data, at + 1, stop, final=True)[1] is None


def _looks_like_tlog(head: bytes) -> bool:
    """Whether a record whose checksum is right, followed by another or the end, is in there."""
    at = 0
    while at < len(head):
        at, frame = find_frame(head, at, len(head), final=True)
        if frame is None:
            return False
        if at >= STAMP and (
            _record_follows(head, at, frame) or at + len(frame.raw) + STAMP > len(head)
        ):
            return True
        at += 1
    return False
