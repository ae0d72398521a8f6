"""From the bytes of a .tlog to its frames, a piece at a time.

The rules for a frame are those of `frames`, here applied to arrays. A record is 8 bytes of time and
a frame, so each frame's length gives the position of the next one's magic byte. Every byte that
could be a magic byte and leads to another one is a candidate; runs of candidates that lead to each
other are the chain, and only where a run ends is anything decided one by one. Then the checksums of
all frames in the chain are taken together.

- A frame whose checksum is right is good, whatever follows.
- One that is wrong, or of an unknown type, keeps its place when a record follows it and no good
  frame begins inside of it: its definition has changed, or its content is damaged.
- Else the chain is broken, and goes on with the next good frame.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.telemetry.checksums import RunningChecksum, checksums_agree, rows_of
from gcs_sysid.telemetry.frame_block import BAD_CRC, OK, UNKNOWN, FrameBlock
from gcs_sysid.telemetry.frames import (
    CHECKSUM,
    CRC_EXTRA,
    FLAG_SIGNED,
    HEADER_1,
    HEADER_2,
    LONGEST_FRAME,
    MAGIC_1,
    MAGIC_2,
    SIGNATURE,
    Frame,
    Validity,
    find_frame,
    read_frame,
)
from gcs_sysid.telemetry.repeated_bytes import RepeatedBytes

STAMP = 8
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

        Args:
            content: from where the last piece was done.
            final: whether the file ends with it.

        Returns:
            The frames that are decided, and how many bytes are done. The bytes after that must
            come again, before those that follow.
        """
        size = len(content)
        data = np.frombuffer(content + bytes(LONGEST_FRAME + STAMP), np.uint8)
        limit = size if final else size - self.MARGIN
        at, head = _RecordChain(content, data, limit).frames(hunting=self._hunting)
        stop = at + head.size
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
        time_us, damaged = self._times(data, at, gaps, at - before >= STAMP, kept)
        counts.repaired_times += damaged
        head = head.first(kept)
        block = FrameBlock(
            data=data,
            at=at[:kept],
            number=counts.frames,
            time_us=time_us,
            message_id=head.message_id,
            payload_at=head.payload_at,
            payload_size=head.payload_size,
            size=head.size,
            sequence=head.sequence,
            system=head.system,
            component=head.component,
            version=head.version,
            validity=head.validity,
        )
        counts.frames += kept
        counts.bad_crc += int(np.count_nonzero(block.validity == BAD_CRC))
        counts.unknown += int(np.count_nonzero(block.validity == UNKNOWN))
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


def _around(places: Array, at: Array, size: Array) -> tuple[Array, Array]:
    """(n,) indices of the first of some places inside of frames, and of the first behind them."""
    starts, stops = (some.astype(places.dtype) for some in (at, at + size))  # else all the places
    return np.searchsorted(places, starts, side="right"), np.searchsorted(places, stops)


def _is_magic(data: Array) -> Mask:
    is_magic: Mask = data - np.uint8(MAGIC_2) <= MAGIC_1 - MAGIC_2  # what is less wraps around
    return is_magic


class _Headers:
    """Headers of the frames at given positions, and whether they are valid."""

    def __init__(self, data: Array, at: Array) -> None:
        head = rows_of(data, at, HEADER_2)
        second = head[:, 0] == MAGIC_2
        self.version = second + np.uint8(1)
        self.payload_size = head[:, 1].copy()
        self.payload_at = at + np.where(second, HEADER_2, HEADER_1)
        payload_end = self.payload_at + self.payload_size
        signed = second & (head[:, 2] == FLAG_SIGNED)
        self.size = payload_end + CHECKSUM + SIGNATURE * signed - at
        self.sequence = np.where(second, head[:, 4], head[:, 2])
        self.system = np.where(second, head[:, 5], head[:, 3])
        self.component = np.where(second, head[:, 6], head[:, 4])
        low, middle, high = (head[:, i].astype(np.int32) for i in (7, 8, 9))
        self.message_id = np.where(second, low | middle << 8 | high << 16, head[:, 5])
        extra = _EXTRA[np.minimum(self.message_id, _IDS - 1)]
        length = payload_end - at - 1
        right = checksums_agree(data, at + 1, length, extra.astype(np.uint8))
        self.validity = np.where(extra < 0, UNKNOWN, np.where(right, OK, BAD_CRC)).astype(np.uint8)

    def first(self, count: int) -> "_Headers":
        """The same of the first few."""
        part = _Headers.__new__(_Headers)
        part.__dict__ = {name: column[:count] for name, column in self.__dict__.items()}
        return part


def _bytes_behind(data: Array, at: Array) -> Callable[[int], Array]:
    """Gives the bytes so many behind (n,) rising positions; where those are all bytes, in place."""
    n, first = len(at), int(at[0]) if len(at) else 0
    if n and int(at[-1]) - first == n - 1:
        return lambda offset: data[first + offset : first + offset + n]
    return lambda offset: data[offset:].take(at)


def _are_right(data: Array, at: Array, agree: Callable[[Array, Array, Array], Mask]) -> Mask:
    """(n,) whether frames at given positions are of known types, with the right checksum.

    Args:
        data: in which they lie.
        at: (n,) their magic bytes.
        agree: `checksums_agree` of positions, lengths and extra bytes.
    """
    behind = _bytes_behind(data, at)
    length = behind(1) + np.intp(HEADER_1 - 1)  # without the magic byte
    extra = _EXTRA.take(behind(5))
    newer = np.flatnonzero(behind(0) == MAGIC_2)
    if len(newer):
        length[newer] += HEADER_2 - HEADER_1
        low, middle, high = (data[at[newer] + i].astype(np.int32) for i in (7, 8, 9))
        extra[newer] = _EXTRA[np.minimum(low | middle << 8 | high << 16, _IDS - 1)]
    right = extra >= 0
    if right.all():
        return agree(at + np.intp(1), length, extra.astype(np.uint8))
    known = np.flatnonzero(right)
    extra = extra[known].astype(np.uint8)
    right[known] = agree(at[known] + np.intp(1), length[known], extra)
    return right


class _RecordChain:
    """The frames in a piece of a file.

    Args:
        content: the piece.
        data: the same as an array, with zeros behind it.
        limit: frames are wanted that begin up to there.
    """

    _TRIED = 4096
    """Bytes of a piece hunted through one by one, before all its good frames are found together."""
    _CROWD = 8
    """Bytes for each candidate, at most, from which on their checksums are taken from those of the
    whole piece."""
    _FEW_RUNS = 4
    """Candidates for each run, at least, where runs are few."""
    _NOWHERE = 2**30
    """Behind every piece."""
    _SEARCHED = 2**16
    """Bytes searched together for magic bytes."""
    _CACHED = 2**14
    """Candidates looked at together: their arrays stay in the cache."""

    def __init__(self, content: bytes, data: Array, limit: int) -> None:
        self._content = content
        self._data = data
        self._limit = limit
        at = np.concatenate(
            [
                np.flatnonzero(_is_magic(data[i : min(i + self._SEARCHED, len(content))])) + i
                for i in range(0, max(len(content), 1), self._SEARCHED)
            ]
        ).astype(np.int32)
        parts = [
            self._led_to(at[i : i + self._CACHED]) for i in range(0, max(len(at), 1), self._CACHED)
        ]
        # Where whole frames could begin, by their headers alone, and where the record after each
        # has its magic byte.
        self._whole, self._follows = (np.concatenate(some) for some in zip(*parts, strict=True))
        self._tried = 0
        self._good: Array | None = None

    def _led_to(self, at: Array) -> tuple[Array, Array]:
        """Which of some magic bytes may begin a whole frame, and where the next one's would be."""
        behind = _bytes_behind(self._data, at)
        second = behind(0) == MAGIC_2
        follows = at + behind(1)
        follows += HEADER_1 + CHECKSUM + STAMP
        follows += second * np.uint8(HEADER_2 - HEADER_1)
        flags = behind(2) * second
        if flags.any():
            follows += (flags == FLAG_SIGNED) * np.uint8(SIGNATURE)
            follows[flags > FLAG_SIGNED] = self._NOWHERE
        fits = follows <= len(self._content) + STAMP
        return (at, follows) if fits.all() else (at[fits], follows[fits])

    def good(self) -> Array:
        """(n,) where a frame with a right checksum begins, inside of others too."""
        if self._good is None:
            at, size = self._whole, len(self._content)
            repeats = RepeatedBytes(self._data, at, size, LONGEST_FRAME + STAMP)
            if repeats:
                right = repeats.fill(self._are_good(at[repeats.others]))
            else:
                right = self._are_good(at)
            self._good = at[right]
        return self._good

    def _are_good(self, at: Array) -> Mask:
        """(n,) whether the checksum of each candidate is right."""
        data = self._data
        if self._CROWD * len(at) < len(data):
            return _are_right(data, at, partial(checksums_agree, data))
        agree = RunningChecksum(data).agree
        pieces = (at[i : i + self._CACHED] for i in range(0, len(at), self._CACHED))
        return np.concatenate([_are_right(data, piece, agree) for piece in pieces])

    def frames(self, *, hunting: bool) -> tuple[Array, _Headers]:
        """Where the frames begin, and what they say.

        Args:
            hunting: whether the piece begins in garbage, not with a record.
        """
        chain = self._wanted(self._by_length(hunting=hunting))
        head = _Headers(self._data, chain)
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
        chain = self._wanted(np.concatenate([*pieces, chain[done:]]))
        return chain, _Headers(self._data, chain)

    def _wanted(self, chain: Array) -> Array:
        return chain[: np.searchsorted(chain, self._limit, side="right")]

    def _by_length(self, *, hunting: bool) -> Array:
        """The chain by frame lengths, checksums aside."""
        begins: list[int] = []  # of runs, or ~position of a frame that is not of one
        record: int | None = 0
        if hunting and self._limit >= 0:
            position, record = self._next(0, hunting=True)
            if record is None:
                return np.empty(0, np.intp)
            begins.append(~position)
        leading = _is_magic(self._data.take(self._follows))  # to another record's
        linked, follows = self._whole, self._follows
        if not leading.all():
            linked, follows = linked[leading], follows[leading]
        # Runs of candidates that lead to each other, and where the last of each leads.
        last = np.flatnonzero(np.append(follows[:-1] != linked[1:], [True] * min(len(linked), 1)))
        has_runs = len(last) < len(linked)
        enter, go_on = self._ways(linked, follows, last)
        take = begins.append
        while record is not None and record <= self._limit:
            at = record + STAMP
            following = enter(at)
            if following:
                while following:
                    take(at)
                    at = following
                    following = go_on(at)
                record = at - STAMP
            else:
                position, record = self._next(record, hunting=False)
                if record is not None:
                    take(~position)
        begin = np.array(begins, np.intp)
        alone = begin < 0
        if not has_runs:
            return np.where(alone, ~begin, begin)
        start = np.where(alone, begin, np.searchsorted(linked, begin.astype(np.int32)))
        count = np.ones(len(begin), np.intp)
        count[~alone] = last[np.searchsorted(last, start[~alone])] + 1 - start[~alone]
        index = np.repeat(start - np.cumsum(count) + count, count) + np.arange(count.sum())
        chain = ~index
        chain[index >= 0] = linked[index[index >= 0]]
        return chain

    def _ways(
        self, linked: Array, follows: Array, last: Array
    ) -> tuple[Callable[[int], int | None], Callable[[int], int | None]]:
        """Give where the run leads in which a candidate is, of any, and of one that a run leads to.

        Args:
            linked: (n,) the candidates.
            follows: (n,) where each leads.
            last: which of them are the last of a run.
        """
        leads = follows[last]
        if self._FEW_RUNS * len(last) < len(linked):
            index = np.searchsorted(linked, leads)
            met = np.flatnonzero(linked.take(index, mode="clip") == leads)
            run = np.searchsorted(last, index[met])
            ways = dict(zip(leads[met].tolist(), leads[run].tolist(), strict=True))

            def enter(at: int) -> int | None:
                index = int(np.searchsorted(linked, linked.dtype.type(at)))
                if index == len(linked) or linked[index] != at:
                    return None
                return int(leads[np.searchsorted(last, index)])

            return enter, ways.get
        if len(last) < len(linked):
            follows = np.repeat(leads, np.diff(last, prepend=-1))
        room = np.zeros(len(self._data), np.int32)
        for first in range(0, len(linked), self._CACHED):
            some = slice(first, first + self._CACHED)
            room[linked[some].astype(np.intp)] = follows[some]
        # Read in place: in garbage there are as many runs as bytes, most of which none is led to.
        return room.data.__getitem__, room.data.__getitem__

    def _next(self, record: int, *, hunting: bool) -> tuple[int, int | None]:
        """Where the next frame begins, and the record after it; None when there is none."""
        content = self._content
        if record >= len(content):
            return len(content), None
        if not hunting:
            frame = read_frame(content, record + STAMP)
            if frame is not None and (
                frame.valid is Validity.OK or record_follows(content, record + STAMP, frame)
            ):
                return record + STAMP, record + STAMP + len(frame.raw)
        stop = min(record + self._TRIED - self._tried, len(content))
        if stop > record:
            position, frame = find_frame(content, record, stop, final=True)
            self._tried += position - record
            if frame is not None:
                return position, position + len(frame.raw)
        # Much of the piece is garbage, of which every byte may look like a frame's first.
        found = self.good()
        index = int(np.searchsorted(found, record))
        if index == len(found):
            return len(content), None
        position = int(found[index])
        frame = read_frame(content, position)
        return position, None if frame is None else position + len(frame.raw)

    def _detour(self, chain: Array, record: int) -> tuple[list[int], int]:
        """Frames from a hunt on until they meet the chain again, and where in it they do."""
        found: list[int] = []
        following: int | None = record
        hunting = True
        while following is not None and following <= self._limit:
            position, following = self._next(following, hunting=hunting)
            hunting = False
            if following is None:
                break
            index = int(np.searchsorted(chain, position))
            if index < len(chain) and chain[index] == position:
                return found, index
            found.append(position)
        return found, len(chain)

    def _rejected(self, chain: Array, head: _Headers) -> Array:
        """Which frames of the chain have a wrong checksum and a good frame inside.

        A damaged length can lead to another magic byte by chance.
        """
        bad = np.flatnonzero(head.validity == BAD_CRC)
        if not len(bad):
            return bad
        first, behind = _around(self._whole, chain[bad], head.size[bad])
        count = behind - first
        if int(count.sum()) > len(self._whole) // 2:
            good = self.good()
            first, behind = _around(good, chain[bad], head.size[bad])
            rejected: Array = bad[behind > first]
            return rejected
        owner = np.repeat(np.arange(len(bad)), count)
        nth = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
        inside = self._whole[first[owner] + nth]
        good = self._are_good(inside)
        holding: Array = bad[np.unique(owner[good])]
        return holding


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
    position, frame = find_frame(head, 0, min(_RecordChain._TRIED, len(head)), final=True)
    places = [position] if frame is not None else []
    if not places or not _begins_record(head, position):
        data = np.frombuffer(head + bytes(LONGEST_FRAME + STAMP), np.uint8)
        places = _RecordChain(head, data, len(head)).good().tolist()
    return any(_begins_record(head, at) for at in places)


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
    intact = stop == len(data) if magic >= len(data) else data[magic] in (MAGIC_1, MAGIC_2)
    if not intact or frame.valid is not Validity.BAD_CRC:
        return intact
    return find_frame(data, at + 1, stop, final=True)[1] is None
