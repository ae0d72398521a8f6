"""Recordings: .tlog files, read whatever they went through.

A .tlog is a row of records: 8 bytes big-endian microseconds since 1970 and one raw frame.
"""

from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError
from gcs_sysid.files import check_regular
from gcs_sysid.telemetry.file_windows import file_windows
from gcs_sysid.telemetry.frame_block import FrameBlock
from gcs_sysid.telemetry.frames import Frame
from gcs_sysid.telemetry.messages import message_arrays
from gcs_sysid.telemetry.tlog_scan import ScanCounts, Scanner, shows_a_record

WINDOW = 2**21
"""Bytes read at once. Working on them takes about ten times as much memory."""
HEAD = 2**20
"""Bytes that must show a record for the file to be a .tlog."""


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
            check_regular(self.path)
            size = self.path.stat().st_size
            with open(self.path, "rb") as file:
                head = file.read(HEAD)
        except OSError as error:
            raise InputError(f"cannot read {self.path}: {error.strerror}") from error
        if size == 0:
            raise InputError(f"{self.path} is empty: nothing was recorded in it")
        if not shows_a_record(head):
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
                for window in file_windows(file, self._window):
                    self.bytes_read = window.position + len(window.content)
                    block, window.done = scanner.scan(window.content, final=window.final)
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
