"""Recordings: .tlog files, read whatever they went through.

A .tlog is a row of records: 8 bytes big-endian microseconds since 1970 and one raw frame. The rules
for a frame are those of `frames`, here applied to arrays. Each frame's length gives the position of
the next one's magic byte: the chain is followed by that alone, and then the checksums of all its
frames are taken together.

- A frame whose checksum is right is good, whatever follows.
- One that is wrong, or of an unknown type, keeps its place when a record follows it and no good
  frame begins inside of it: its definition has changed, or its content is damaged.
- Else the chain is broken, and goes on with the next good frame.
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.errors import InputError
from gcs_sysid.files import StretchSearch, check_regular, file_windows
from gcs_sysid.telemetry.frame_block import FrameBlock, checksums_agree, rows_of
from gcs_sysid.telemetry.frames import (
    CHECKSUM,
    CRC_EXTRA,
    FLAG_SIGNED,
    HEADER_1,
    HEADER_2,
    LONGEST_1,
    LONGEST_FRAME,
    MAGIC_1,
    MAGIC_2,
    SIGNATURE,
    Frame,
    Validity,
    find_frame,
    read_frame,
)
from gcs_sysid.telemetry.messages import message_arrays
from gcs_sysid.telemetry.tlog_writer import RECORD_TIME

STAMP = RECORD_TIME.size
_EMPTY_1, _EMPTY_2 = HEADER_1 + CHECKSUM, HEADER_2 + CHECKSUM
_MAGICS = (MAGIC_1, MAGIC_2)
_LONGEST_1 = np.array(LONGEST_1)
_IDS = max(CRC_EXTRA) + 2
_EXTRA = np.full(_IDS, -1, np.int16)
"""Message id -> CRC_EXTRA, -1 where none is known; the last entry is for all larger ids."""
for _message_id, _extra in CRC_EXTRA.items():
    _EXTRA[_message_id] = _extra[0]


@dataclass
class ScanCounts:
    """What was seen in a file so far.

    Attributes:
        frames: frames of any validity.
        bad_crc: those of them with a wrong checksum: another definition, or damaged.
        unknown: those of unknown types.
        garbage_bytes: bytes that belong to no record.
        resyncs: how often the chain of records was broken and found again.
        repaired_times: record times that were damaged.
        cut_short: bytes of a last record whose end is missing; garbage too.
    """

    frames: int = 0
    bad_crc: int = 0
    unknown: int = 0
    garbage_bytes: int = 0
    resyncs: int = 0
    repaired_times: int = 0
    cut_short: int = 0


class Scanner:
    """Cuts the pieces of a file into frames, one piece after the other.

    Attributes:
        counts: of what was seen so far.
    """

    MARGIN = 3 * (STAMP + LONGEST_FRAME)
    """Bytes that must follow a record before it is decided, unless the file ends: the record after
    it, and what may begin inside of either."""
    CLOCK_STEP = 60_000_000
    """us. A record's time further than this from those of both neighbors, which agree with each
    other, is damaged."""
    FAR_STEP = 86_400_000_000
    """us. The same where there is only one neighbor."""
    ALONE = 2**20
    """Bytes of garbage after which no neighbor is waited for, however long it goes on."""

    def __init__(self) -> None:
        self.counts = ScanCounts()
        self._hunting = False  # whether the last piece ended in garbage
        self._behind_us: float = np.nan  # the last record's time as it stood there
        self._time_us = 0  # and as it was believed

    def scan(self, content: bytes, *, final: bool) -> tuple[FrameBlock, int]:
        """Cut one piece.

        Returns:
            The frames that are decided, and how many bytes are done. The bytes after that must
            come again, before those that follow.
        """
        size = len(content)
        limit = size if final else size - self.MARGIN
        chain = _RecordChain(content, limit)
        at, head = chain.frames(hunting=self._hunting)
        stop = at + head["size"]
        before = np.concatenate([np.zeros(1, at.dtype), stop])[:-1]
        start = np.maximum(at - STAMP, before)
        hunting = self._hunting
        behind = int(stop[-1]) if len(at) else 0
        if final:
            kept, done, rest = len(at), size, size - behind
            if len(at) and _is_cut_short(content[behind:]):
                self.counts.cut_short = rest
            self._hunting = hunting and not len(at)
        elif len(at) and limit - STAMP - behind < self.ALONE:
            # The last frame comes again: its time is judged with its neighbor's.
            kept, done, rest = len(at) - 1, int(start[-1]), 0
            self._hunting = hunting and done == 0
        else:
            kept, done = len(at), max(limit - STAMP, 0)
            rest = done - behind
            self._hunting = hunting or done > 0
        gaps = start - before
        counts = self.counts
        counts.garbage_bytes += int(gaps.sum()) + rest
        counts.resyncs += int(np.count_nonzero(gaps))
        if hunting and len(at) and done and not gaps[0]:
            counts.resyncs += 1  # found where the piece begins
        time_us, damaged = self._times(chain.data, at, gaps, at - before >= STAMP, kept)
        counts.repaired_times += damaged
        block = FrameBlock(
            data=chain.data,
            at=at[:kept],
            number=counts.frames,
            time_us=time_us,
            **{name: column[:kept] for name, column in head.items()},
        )
        counts.frames += kept
        counts.bad_crc += int(np.count_nonzero(block.validity == Validity.BAD_CRC))
        counts.unknown += int(np.count_nonzero(block.validity == Validity.UNKNOWN))
        return block, done

    def _times(
        self, data: Array, at: Array, gaps: Array, stamped: Mask, kept: int
    ) -> tuple[Array, int]:
        """(kept,) uint64 record times, and how many of them were damaged.

        Args:
            data: the piece.
            at: (n,) where its frames begin.
            gaps: (n,) bytes of garbage before each record.
            stamped: (n,) which have a whole time before them.
            kept: how many of them are decided.
        """
        time_us = np.zeros(len(at), np.uint64)
        time_us[stamped] = rows_of(data, at[stamped] - STAMP, STAMP).view(">u8")[:, 0]
        if not kept:
            return time_us[:0], 0
        steps = abs(np.diff(time_us.astype(float), prepend=self._behind_us))
        steps[0] = 0.0 if np.isnan(steps[0]) else steps[0]
        if stamped.all() and steps.max() <= self.CLOCK_STEP:  # as nearly always
            self._behind_us, self._time_us = float(time_us[kept - 1]), int(time_us[kept - 1])
            return time_us[:kept], 0
        around = np.full(len(at) + 2, np.nan)
        around[0] = self._behind_us
        around[1:-1] = np.where(stamped, time_us, np.nan)
        past, here, ahead = around[:-2], around[1:-1], around[2:].copy()
        # So that windows of any size judge alike.
        ahead[:-1][gaps[1:] >= self.ALONE] = np.nan
        spike = (abs(here - past) > self.CLOCK_STEP) & (abs(here - ahead) > self.CLOCK_STEP)
        spike &= abs(ahead - past) <= self.CLOCK_STEP
        # The first and the last of a file have one neighbor, which must not be far away.
        spike |= np.isnan(past) & (abs(here - ahead) > self.FAR_STEP)
        spike |= np.isnan(ahead) & (abs(here - past) > self.FAR_STEP)
        damaged = (spike | ~stamped)[:kept]
        time_us = time_us[:kept]
        if damaged.any():
            sound = np.flatnonzero(~damaged)
            last = np.searchsorted(sound, np.arange(kept), side="right") - 1
            first = self._time_us or (int(time_us[sound[0]]) if len(sound) else 0)
            held = time_us[sound[np.maximum(last, 0)]] if len(sound) else time_us
            time_us = np.where(last >= 0, held, np.uint64(first))
        self._behind_us, self._time_us = float(here[kept - 1]), int(time_us[-1])
        return time_us, int(np.count_nonzero(damaged))


def _is_magic(data: Array) -> Mask:
    return data - np.uint8(MAGIC_2) <= MAGIC_1 - MAGIC_2  # what is less wraps around


def _headers(data: Array, at: Array) -> dict[str, Array]:
    """What the headers of (n,) frames say, and their validity: columns of a `FrameBlock`."""
    head = rows_of(data, at, HEADER_2)
    second = head[:, 0] == MAGIC_2
    payload_size = head[:, 1].copy()
    payload_at = at + np.where(second, HEADER_2, HEADER_1)
    payload_end = payload_at + payload_size
    signed = second & (head[:, 2] == FLAG_SIGNED)
    low, middle, high = (head[:, i].astype(np.int32) for i in (7, 8, 9))
    message_id = np.where(second, low | middle << 8 | high << 16, head[:, 5])
    extra = _EXTRA[np.minimum(message_id, _IDS - 1)]
    right = checksums_agree(data, at + 1, payload_end - at - 1, extra.astype(np.uint8))
    return {
        "message_id": message_id,
        "payload_at": payload_at,
        "payload_size": payload_size,
        "size": payload_end + CHECKSUM + SIGNATURE * signed - at,
        "sequence": np.where(second, head[:, 4], head[:, 2]),
        "system": np.where(second, head[:, 5], head[:, 3]),
        "component": np.where(second, head[:, 6], head[:, 4]),
        "version": second + np.uint8(1),
        "validity": np.select(
            [extra < 0, right], [Validity.UNKNOWN, Validity.OK], Validity.BAD_CRC
        ).astype(np.uint8),
    }


class _RecordChain:
    """The frames in a piece of a file.

    Frames are wanted that begin up to `limit`.

    Attributes:
        data: the piece as an array, with zeros behind it.
    """

    def __init__(self, content: bytes, limit: int) -> None:
        self._content = content
        self._padded = content + bytes(LONGEST_FRAME + STAMP)
        self.data = np.frombuffer(self._padded, np.uint8)
        self._limit = limit
        self._good = StretchSearch()

    def frames(self, *, hunting: bool) -> tuple[Array, dict[str, Array]]:
        """Where the frames begin, and what they say.

        Args:
            hunting: whether the piece begins in garbage, not with a record.
        """
        chain = self._by_length(hunting=hunting)
        head = _headers(self.data, chain)
        rejected = self._rejected(chain, head)
        if not len(rejected):
            return chain, head
        pieces, done = [], 0
        for index in rejected.tolist():
            if index < done:
                continue
            pieces.append(chain[done:index])
            found, done = self._detour(chain, int(chain[index]) - STAMP)
            pieces.append(np.array(found, chain.dtype))
        chain = np.concatenate([*pieces, chain[done:]])
        return chain, _headers(self.data, chain)

    def _by_length(self, *, hunting: bool) -> Array:
        """The chain by frame lengths, checksums aside."""
        content, size, limit = self._padded, len(self._content), self._limit
        chain: list[int] = []
        record: int | None = 0
        if hunting and limit >= 0:
            record = self._next(0, chain, hunting=True)
        while record is not None and record <= limit:
            at = record + STAMP
            magic = content[at]
            if magic == MAGIC_2 and content[at + 2] <= FLAG_SIGNED:
                stop = at + content[at + 1] + _EMPTY_2 + SIGNATURE * content[at + 2]
            elif magic == MAGIC_1:
                stop = at + content[at + 1] + _EMPTY_1
            else:
                stop = size
            following = stop + STAMP
            if following < size and content[following] in _MAGICS:
                chain.append(at)
                record = stop
            else:
                record = self._next(record, chain, hunting=False)
        if chain and chain[-1] > limit:
            chain.pop()
        return np.array(chain, np.intp)

    def _next(self, record: int, found: list[int], *, hunting: bool) -> int | None:
        """Add where the next frame begins; the record after it, None when there is none."""
        content = self._content
        at: int | None = record + STAMP
        frame = None if hunting else read_frame(content, record + STAMP)
        if frame is None or not (
            frame.valid is Validity.OK or record_follows(content, record + STAMP, frame)
        ):
            at = self.next_good(record)
            frame = None if at is None else read_frame(content, at)
        if at is None or frame is None:
            return None
        found.append(at)
        return at + len(frame.raw)

    def next_good(self, start: int) -> int | None:
        """Where the first whole frame with a right checksum begins from a position on."""
        return self._good.next(start, len(self._content), self._good_in)

    def _good_in(self, start: int, stop: int) -> list[int]:
        at = np.flatnonzero(_is_magic(self.data[start:stop])) + start
        good: list[int] = self._are_good(at).tolist()
        return good

    def _are_good(self, at: Array) -> Array:
        """Those of (n,) magic bytes at which a whole frame with a right checksum begins."""
        at = at[
            np.where(
                self.data[at] == MAGIC_1,
                self.data[at + 1] <= _LONGEST_1[self.data[at + 5]],
                self.data[at + 2] <= FLAG_SIGNED,
            )
        ]
        head = _headers(self.data, at)
        return at[(head["validity"] == Validity.OK) & (at + head["size"] <= len(self._content))]

    def _detour(self, chain: Array, record: int) -> tuple[list[int], int]:
        """Frames from a hunt on until they meet the chain again, and where in it they do."""
        found: list[int] = []
        following = self._next(record, found, hunting=True)
        while following is not None:
            index = int(np.searchsorted(chain, found[-1]))
            if index < len(chain) and chain[index] == found[-1]:
                return found[:-1], index
            if following > self._limit:
                break
            following = self._next(following, found, hunting=False)
        return [at for at in found if at <= self._limit], len(chain)

    def _rejected(self, chain: Array, head: dict[str, Array]) -> Array:
        """Which frames of the chain have a wrong checksum and a good frame inside.

        A damaged length can lead to another magic byte by chance.
        """
        bad = np.flatnonzero(head["validity"] == Validity.BAD_CRC)
        if not len(bad):
            return bad
        begin = chain[bad]
        at = np.flatnonzero(_is_magic(self.data))
        owner = np.searchsorted(begin, at) - 1
        inside = (owner >= 0) & (at < (begin + head["size"][bad])[owner])
        good = self._are_good(at[inside])
        return bad[np.unique(np.searchsorted(begin, good) - 1)]


def _is_cut_short(rest: bytes) -> bool:
    """Whether the last bytes of a file are a record whose end is missing."""
    frame = rest[STAMP:]
    if len(frame) < 3:
        return bool(rest) and frame[:1] in (b"", bytes([MAGIC_1]), bytes([MAGIC_2]))
    if frame[0] == MAGIC_1:
        return HEADER_1 + frame[1] + CHECKSUM > len(frame)
    size = HEADER_2 + frame[1] + CHECKSUM + SIGNATURE * frame[2]
    return frame[0] == MAGIC_2 and frame[2] <= FLAG_SIGNED and size > len(frame)


def shows_a_record(head: bytes) -> bool:
    """Whether a record whose checksum is right, followed by another or the end, is in there."""
    chain = _RecordChain(head, len(head))
    at = chain.next_good(0)
    while at is not None and not _begins_record(head, at):
        at = chain.next_good(at + 1)
    return at is not None


def _begins_record(head: bytes, at: int) -> bool:
    frame = read_frame(head, at)
    return (
        frame is not None
        and at >= STAMP
        and (record_follows(head, at, frame) or at + len(frame.raw) + STAMP > len(head))
    )


def record_follows(data: bytes, at: int, frame: Frame) -> bool:
    """Whether another record, or the end of the data, comes after a frame."""
    stop = at + len(frame.raw)
    magic = stop + STAMP
    intact = stop == len(data) if magic >= len(data) else data[magic] in _MAGICS
    if not intact or frame.valid is not Validity.BAD_CRC:
        return intact
    return find_frame(data, at + 1, stop, final=True)[1] is None


WINDOW = 2**21
"""Bytes read at once. Working on them takes about ten times as much memory."""
HEAD = 2**20
"""Bytes that must show a record for the file to be a .tlog."""


class TlogReader:
    """Reads a .tlog of any ground station, in windows of bounded memory.

    Frames of unknown types and with a wrong checksum come too where the chain of records is intact.
    Where it is broken, the reader hunts for the next frame whose checksum is right. `window` is
    bytes read at once.

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


def read_messages(
    path: Path | str, names: Collection[str] | None = None
) -> tuple[dict[str, Array], ScanCounts]:
    """All messages of a .tlog.

    Without names: of all types that the dialect knows.

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
