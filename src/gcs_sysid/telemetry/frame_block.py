"""Frames of a file as columns, and their checksums (X.25, CRC-16/MCRF4XX) all at once.

Two bytes are taken per look-up, in all frames of one length together: the 16 bits of state and
the next 16 bits of the message, joined by exclusive or, index the state after them.
"""

from collections import deque
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, fields, replace

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.telemetry.frames import (
    FLAG_SIGNED,
    HEADER_1,
    HEADER_2,
    LONGEST_FRAME,
    Frame,
    Validity,
)

ROWS_AT_ONCE = 8192
"""Frames worked on together: their bytes, indices and states stay in the processor's cache."""


def _byte_table() -> Array:
    """(256,) the state after one byte, from the state's low byte joined with it."""
    state: Array = np.arange(256, dtype=np.uint16)
    for _ in range(8):
        state = (state >> 1) ^ np.where(state & 1, np.uint16(0x8408), np.uint16(0))
    return state


_BYTE = _byte_table()


def _word_table() -> Array:
    """(65536,) the state after two bytes, from the state joined with them."""
    word = np.arange(65536, dtype=np.uint16)
    once = (word >> 8) ^ _BYTE[word & 0xFF]
    return (once >> 8) ^ _BYTE[once & 0xFF]


_WORD = _word_table()


def checksums(data: Array, at: Array, length: Array, extra: Array) -> Array:
    """Checksums of pieces of a buffer.

    Args:
        data: (size,) uint8, contiguous.
        at: (n,) where each piece begins.
        length: (n,) bytes of each; the piece lies wholly in the buffer.
        extra: (n,) uint8, CRC_EXTRA: one more byte that the checksum covers.

    Returns:
        (n,) uint16.
    """
    result = np.empty(len(at), np.uint16)
    order = np.argsort(length.astype(np.uint16), kind="stable")  # a radix sort
    ends = np.flatnonzero(np.diff(length[order], append=-1)) + 1
    start = 0
    for end in ends.tolist():
        size = int(length[order[start]])
        for first in range(start, end, ROWS_AT_ONCE):
            rows = order[first : min(first + ROWS_AT_ONCE, end)]
            result[rows] = _equal_lengths(data, at.take(rows), size, extra.take(rows))
        start = end
    return result


def checksums_agree(data: Array, at: Array, length: Array, extra: Array) -> Mask:
    """(n,) whether the two bytes behind pieces are their checksums; see `checksums`."""
    end = at + length
    behind = data[end] | data[end + 1].astype(np.uint16) << 8
    return behind == checksums(data, at, length, extra)


def rows_of(data: Array, at: Array, size: int) -> Array:
    """(n, size) copies of the bytes that begin at each position."""
    # Overlapping items of `size` bytes: picking one copies it whole, not byte by byte.
    items = np.ndarray((len(data) - size + 1,), f"V{size}", data, strides=(1,))
    return items[at].view(np.uint8).reshape(len(at), size)


def _equal_lengths(data: Array, at: Array, size: int, extra: Array) -> Array:
    """(n,) uint16 state after `size` bytes from each position, and the extra ones."""
    state = np.full(len(at), 0xFFFF, np.uint16)
    if size % 2 and int(at.max()) + size == len(data):
        data = np.append(data, np.uint8(0))
    words = rows_of(data, at, size + size % 2).view("<u2")
    columns = np.ascontiguousarray(words.T, np.uint16)
    if size % 2:
        columns[-1] &= 0xFF
        columns[-1] |= extra.astype(np.uint16) << 8
    for column in columns:
        column ^= state
        state = _WORD.take(column)
    return state if size % 2 else (state >> 8) ^ _BYTE[(state ^ extra) & 0xFF]


_ROOM = bytes(LONGEST_FRAME)


@dataclass(frozen=True)
class FrameBlock:
    """Frames that follow each other in a file, as columns.

    Attributes:
        data: (size,) uint8 piece of the file, with at least `LONGEST_FRAME` bytes after the
            end of each frame.
        at: (n,) where each frame's magic byte lies in `data`.
        number: of the first frame, counted from the beginning of the file.
        time_us: (n,) uint64 the record's time, us since 1970; repaired where it was damaged. 0
            where it is not known.
        message_id: (n,) int32.
        payload_at: (n,) where its payload begins in `data`.
        payload_size: (n,) uint8, without the zeros that version 2 cuts.
        size: (n,) of the whole frame.
        sequence: (n,) uint8.
        system: (n,) uint8.
        component: (n,) uint8.
        version: (n,) uint8, 1 or 2.
        validity: (n,) uint8 of `Validity`.
    """

    data: Array
    at: Array
    number: int
    time_us: Array
    message_id: Array
    payload_at: Array
    payload_size: Array
    size: Array
    sequence: Array
    system: Array
    component: Array
    version: Array
    validity: Array

    @classmethod
    def of(cls, frames: Iterable[Frame], wall: Array | float | None = None) -> "FrameBlock":
        """Frames as they came over a link, read in one go.

        `wall` is when they came, s since 1970, all or (n,) each; None or 0: not known.
        """
        frames, came = list(frames), np.asarray(0.0 if wall is None else wall)
        raws = [frame.raw for frame in frames]
        header = np.array(
            [
                (
                    len(raw), frame.message_id, len(frame.payload), frame.sequence, frame.system,
                    frame.component, frame.version, frame.valid,
                )
                for frame, raw in zip(frames, raws, strict=True)
            ],
            np.int32,
        ).reshape(-1, 8)  # fmt: skip
        size, message_id, *narrow = header.T
        narrow = [column.astype(np.uint8) for column in narrow]
        payload_size, sequence, system, component, version, validity = narrow
        at = np.cumsum(size) - size
        return cls(
            data=np.frombuffer(b"".join([*raws, _ROOM]), np.uint8),
            at=at,
            number=0,
            time_us=np.full(len(frames), np.rint(1e6 * came), np.uint64),
            message_id=message_id,
            payload_at=at + np.where(version == 2, HEADER_2, HEADER_1),
            payload_size=payload_size,
            size=size,
            sequence=sequence,
            system=system,
            component=component,
            version=version,
            validity=validity,
        )

    def __len__(self) -> int:
        return len(self.at)

    def part(self, start: int, stop: int) -> "FrameBlock":
        """Frames [start, stop) of the block."""
        if start <= 0 and stop >= len(self.at):
            return self
        columns = {name: getattr(self, name)[start:stop] for name in _COLUMNS}
        return FrameBlock(data=self.data, number=self.number + start, **columns)

    @property
    def keys(self) -> Array:
        """(n,) uint64, the same for the same frame alone: of header, checksum and first bytes."""
        lead = rows_of(self.data, self.payload_at, 8).view("<u8")[:, 0]
        lead = lead << (8 * np.maximum(8 - self.payload_size.astype(np.int64), 0)).astype(np.uint64)
        lead[self.payload_size == 0] = 0
        end = self.payload_at + self.payload_size
        whole = self.message_id.astype(np.uint64)
        for part in (
            self.sequence,
            self.system,
            self.component,
            self.data[end],
            self.data[end + 1],
        ):
            whole = whole << np.uint64(8) | part
        # An odd number of the golden ratio spreads stamps, which are alike, over all bits.
        return lead * np.uint64(0x9E3779B97F4A7C15) ^ whole

    def frame(self, index: int) -> Frame:
        """One of them as an object."""
        return next(iter(self.part(index, index + 1)))[1]

    def __iter__(self) -> Iterator[tuple[int, Frame]]:
        """(time in us, frame) one by one."""
        data = self.data
        columns = (
            self.time_us, self.system, self.component, self.sequence, self.message_id, self.at,
            self.payload_at, self.payload_at + self.payload_size, self.at + self.size,
            self.version, self.validity,
        )  # fmt: skip
        for (
            time_us, system, component, sequence, message_id, at, start, end, stop, version, valid,
        ) in zip(*(column.tolist() for column in columns), strict=True):  # fmt: skip
            payload, raw = data[start:end].tobytes(), data[at:stop].tobytes()
            signed = version == 2 and raw[2] == FLAG_SIGNED
            yield time_us, Frame(
                system, component, sequence, message_id, payload, raw, version, signed,
                Validity(valid),
            )  # fmt: skip


class SeenFrames:
    """Finds frames that came before, as over two radios, half a minute ago at most.

    Sequence numbers wrap, or are all zero, so that what has no time stamp, such as a heartbeat, may
    come again with the same bytes: it is a copy where it does not follow in sequence. `stamped` are
    ids of messages with a time stamp.
    """

    _KEPT = 32_768
    """Frames that are remembered."""
    _LOST = 8
    """Frames that may be lost in a sequence, at most."""

    def __init__(self, stamped: Collection[int]) -> None:
        self._stamped = np.array(sorted(stamped))
        self._last = np.zeros(1 << 16, np.uint8)
        """Of each sender, the sequence number of its latest frame that was no copy."""
        self.repeated = 0
        """How many there were."""
        # Full from the start, of what no frame is, so that memory stays what it is.
        self._order = deque(-(2**63) - n for n in range(self._KEPT))
        self._places = dict(zip(self._order, range(-self._KEPT, 0), strict=True))
        """Key -> how many were remembered before it."""
        self._count = 0

    def mark(self, frames: FrameBlock) -> FrameBlock:
        """Frames in the order received; those that repeat one before are `REPEATED`."""
        rows = np.flatnonzero(frames.validity == Validity.OK)
        every = frames.keys[rows]
        keys = every.tolist()
        senders = frames.system[rows].astype(int) * 256 + frames.component[rows]
        sequence = frames.sequence[rows]
        doubtful = self._doubtful(every, keys)
        again, remembered = np.zeros(len(keys), bool), np.ones(len(keys), bool)
        if len(doubtful):
            stamped = np.isin(frames.message_id[rows[doubtful]], self._stamped)
            before, numbers, known = _rows_before(senders), sequence.tolist(), 0
            for i, is_stamped in zip(doubtful.tolist(), stamped.tolist(), strict=True):
                place = self._count + i - known
                if self._places.get(keys[i], place - self._KEPT - 1) < place - self._KEPT:
                    self._places[keys[i]] = place
                    continue
                known += 1
                remembered[i] = False
                last = before[i]
                while last >= 0 and again[last]:
                    last = before[last]
                number = numbers[i]
                then = numbers[last] if last >= 0 else int(self._last[senders[i]])
                ahead = (number - then) % 256
                again[i] = is_stamped or ahead > 1 + self._LOST or (number and not ahead)
        self._remember(every[remembered].tolist())
        self._last[senders[~again]] = sequence[~again]
        if not again.any():
            return frames
        self.repeated += int(np.count_nonzero(again))
        validity = frames.validity.copy()
        validity[rows[again]] = Validity.REPEATED
        return replace(frames, validity=validity)

    def _doubtful(self, every: Array, keys: list[int]) -> Array:
        """Rows of keys that came before, in the same block or earlier; mostly there are few."""
        if len(set(keys)) == len(keys) and self._places.keys().isdisjoint(keys):
            return np.empty(0, int)
        known = np.fromiter(map(self._places.__contains__, keys), bool, len(keys))
        _, which, count = np.unique(every, return_inverse=True, return_counts=True)
        return np.flatnonzero(known | (count[which] > 1))

    def _remember(self, keys: list[int]) -> None:
        """Remember some that are new, in the order received, and forget as many."""
        oldest = self._count - self._KEPT
        self._places.update(zip(keys, range(self._count, self._count + len(keys)), strict=True))
        self._count += len(keys)
        self._order.extend(keys)
        for place in range(oldest, oldest + len(keys)):
            key = self._order.popleft()
            if self._places[key] == place:  # and did not come again since
                del self._places[key]


def _rows_before(senders: Array) -> list[int]:
    """The row before each of the same sender; -1: there is none."""
    order = np.argsort(senders, kind="stable")
    before = np.full(len(senders), -1)
    same = senders[order[1:]] == senders[order[:-1]]
    before[order[1:][same]] = order[:-1][same]
    found: list[int] = before.tolist()
    return found


_COLUMNS = [field.name for field in fields(FrameBlock) if field.name not in ("data", "number")]


def counts_of(numbers: Array) -> dict[int, int]:
    """How often each of (n,) whole numbers comes, ids of messages or senders; in rising order."""
    few = numbers < 65536
    count = np.bincount(numbers[few])
    counts = {i: int(count[i]) for i in np.flatnonzero(count).tolist()}
    if not few.all():  # the ids of made-up types may be very large
        for i, n in zip(*np.unique(numbers[~few], return_counts=True), strict=True):
            counts[int(i)] = int(n)
    return counts
