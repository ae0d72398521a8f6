"""The frames of a blackbox session, and their values.

As in the reference decoder a frame counts when another follows it; else it is damaged, the search
continues after its first byte, and P frames count again after the next I frame. Only the end of a
frame marks where the next one begins: every byte that could begin one is tried, those of one letter
at once; then the chain is followed from end to beginning.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.errors import InputError
from gcs_sysid.telemetry.blackbox_fields import ByteWindow, FrameLayout
from gcs_sysid.telemetry.blackbox_format import MARKERS, MOTOR_0, Header
from gcs_sysid.telemetry.blackbox_predictors import FrameTable, main_frames, slow_frames

I, P, G, H, S, E = MARKERS[0], MARKERS[1], MARKERS[2], MARKERS[3], MARKERS[4], MARKERS[5]  # noqa: E741
RESUME, DISARM, FLIGHT_MODE, LOG_END = 14, 15, 30, 255
"""Events: logging goes on after a pause (loop, us), a motor stop (reason), modes (new, old)."""
LONGEST_EVENT = 256
_CACHED = 2**14
"""Positions looked at together: their arrays stay in the cache."""
_END_MESSAGE = np.frombuffer(b"End of log\0", np.uint8)
_OVER = 2**30
"""Length of an event that ends the log, so that it leads nowhere."""
_OVER_LENGTH = 2 + len(_END_MESSAGE)

_EVENTS = {
    0: (0, 1, 0), 10: (5, 0, 0), 11: (4, 0, 0), 12: (8, 0, 0), RESUME: (0, 2, 0),
    DISARM: (0, 1, 0), 20: (1, 1, 2), FLIGHT_MODE: (0, 2, 0), 40: (0, 1, 0), 41: (5, 0, 0),
}  # fmt: skip
"""Event -> bytes, numbers of variable length, bytes."""
_ADJUSTMENT, _FLOAT = 13, 0x80
_BEFORE, _NUMBERS, _BEHIND = np.array(
    [[_EVENTS.get(event, (0, 0, 0))[i] for event in range(256)] for i in range(3)], np.int32
)
_HAS_FIELDS = np.isin(np.arange(256), [*_EVENTS, _ADJUSTMENT])
_IS_MARKER = np.isin(np.arange(256), list(MARKERS))
_AT_ONCE = 2**19
"""Bytes searched together."""
_MOST_VALUES = 4
"""Values a byte: firmware writes one or two, a hostile file could claim hundreds."""
_FREE_VALUES = 2**20
_MARGIN = 16
"""Bytes behind the longest frame."""
_IS_USED = np.isin(np.arange(256), [RESUME, DISARM])


@dataclass(frozen=True)
class Found:
    """Frames that follow each other, some of them damaged; (k,) each.

    Attributes:
        at: positions of their letters.
        ends: positions behind them.
        letters: their types.
        whole: whether another frame follows.
        gap: whether what follows is a letter of a type that the header does not describe.
        over: whether it says that the log ends.
    """

    at: Array
    ends: Array
    letters: Array
    whole: Mask
    gap: Mask
    over: Mask


def find_frames(
    window: ByteWindow, at: int, stops: tuple[int, int], layouts: dict[int, FrameLayout]
) -> Found:
    """The frames that begin in a window's first bytes.

    Args:
        window: of a session's bytes.
        at: position from which on to search.
        stops: where those first bytes end, and where the session does.
        layouts: of all types that the header describes.
    """
    raw, size, stop = window.raw, min(stops), stops[1]
    known = np.isin(np.arange(256), [*layouts, E])
    first = raw[:size]
    marks = _IS_MARKER.take(raw)
    marks[stop : stop + 1] = True
    may_begin = marks[:size].copy()
    for letter in set(MARKERS) - {*layouts, E}:
        may_begin &= first != letter
    lengths = np.zeros(size, np.int32)
    for letter in np.flatnonzero(known).tolist():
        begin = np.flatnonzero(first == letter)
        for i in range(0, len(begin), _CACHED):
            some = begin[i : i + _CACHED]
            lengths[some] = _lengths(window, letter, some, marks, stop, layouts)
    place, whole = _way(at, may_begin, lengths)
    length = lengths.take(place)
    over = length == _OVER
    length[over] = _OVER_LENGTH
    ends = place + length
    gap = whole & (ends < stop) & ~known[raw.take(ends, mode="clip")]
    return Found(place, ends, raw[place], whole, gap, over)


def _lengths(
    window: ByteWindow, letter: int, begin: Array, marks: Mask, stop: int,
    layouts: dict[int, FrameLayout],
) -> Array:  # fmt: skip
    """(k,) bytes of frames of one letter that begin at (k,) positions; 0 where no other follows.

    Args:
        window: of a session's bytes.
        letter: of the frames.
        begin: (k,) where they could begin.
        marks: of each byte of the window, whether a frame may end before it.
        stop: where the session ends.
        layouts: of all types but events.
    """
    at = begin + 1
    if letter == E:
        ends, over = _event_ends(window, at)
        longest = LONGEST_EVENT
    else:
        ends, longest = layouts[letter].ends(window, at), layouts[letter].longest
    whole = marks.take(ends, mode="clip")
    lengths = ends - begin
    whole &= lengths <= longest + 1
    lengths *= whole
    if letter == E:
        lengths[over & (ends <= stop)] = _OVER
    return lengths


def _way(at: int, may_begin: Mask, lengths: Array) -> tuple[Array, Mask]:
    """Where the frames begin that are met on the way through a window, and which are whole.

    Args:
        at: position from which on to search.
        may_begin: (n,) which bytes could begin a frame.
        lengths: (n,) of the frames; 0 for those that are not whole, behind which the search goes
            on after the first byte.
    """
    is_whole = lengths != 0
    hops: list[int] = []
    length, find = lengths.data, is_whole.tobytes().find  # read in place
    hop = find(1, at)
    while hop >= 0:
        hops.append(hop)
        hop = find(1, hop + length[hop])
    place = np.array(hops, np.intp)
    # What lies between them is searched: damaged, where it could begin a frame.
    from_each = np.append(at, place + lengths.take(place))
    to_each = np.append(place, len(lengths))
    gaps = to_each > from_each
    edges = np.zeros(len(lengths) + 1, np.int8)
    edges[from_each[gaps]] = 1
    edges[to_each[gaps]] = -1
    met = np.cumsum(edges[:-1], dtype=np.int8).view(bool)
    met &= may_begin
    met[place] = True
    place = np.flatnonzero(met)
    return place, is_whole.take(place)


def _event_ends(window: ByteWindow, at: Array) -> tuple[Array, Mask]:
    """(k,) positions behind events whose types are at (k,) positions, and which end the log."""
    raw = window.raw
    event = raw.take(at)
    ends = at + 1
    some = np.flatnonzero(_HAS_FIELDS.take(event))
    if len(some):
        here, which = at[some], event[some]
        numbers = window.nth(here + 1 + _BEFORE[which], _NUMBERS[which])
        ends[some] = numbers + _BEHIND[which]
        changes = some[which == _ADJUSTMENT]
        changed = at[changes]
        whole_number = window.nth(changed + 2, 1)
        ends[changes] = np.where(raw[changed + 1] < _FLOAT, whole_number, changed + 6)
    over = np.zeros(len(at), bool)
    last = np.flatnonzero(event == LOG_END)
    ends[last] += len(_END_MESSAGE)
    for i, byte in enumerate(_END_MESSAGE):
        last = last[raw[at[last] + 1 + i] == byte]
    over[last] = True
    return ends, over


@dataclass(frozen=True)
class BlackboxFrames:
    """What a session holds.

    Attributes:
        main: I and P frames that could be computed.
        time_us: (n,) of the main frames, without the wraps of the 32-bit clock.
        slow: S frames.
        events: (k, 4) order, event, and its first two numbers; pauses and motor stops.
        counts: letter -> frames found, damaged ones not counted.
        damaged: frames that no other follows.
        lost: main frames that are whole, but what they build on is not, or their time cannot be.
        garbage_bytes: bytes that belong to no frame.
    """

    main: FrameTable
    time_us: Array
    slow: FrameTable
    events: Array
    counts: dict[str, int]
    damaged: int
    lost: int
    garbage_bytes: int


def read_frames(
    data: bytes, header: Header, stop: int, wanted: Sequence[str] | None = None
) -> BlackboxFrames:
    """Read the frames of a session.

    Args:
        data: the file.
        header: of the session.
        stop: where the session ends, at the latest.
        wanted: columns of main and S frames to compute, where they are there; None: all.

    Raises:
        InputError: it claims more values than its bytes can hold.
    """
    layouts = {ord(k): FrameLayout(frame, header.version) for k, frame in header.frames.items()}
    columns = dict.fromkeys((I, P), _columns(header, wanted))
    if S in layouts:
        names = header.frames["S"].names
        columns[S] = _named(names, names if wanted is None else wanted)
    room = _MOST_VALUES * (stop - header.data) + _FREE_VALUES
    values = {k: [np.empty((0, len(of)), np.int64)] for k, of in columns.items()}
    orders = {k: [np.empty(0, np.int64)] for k in columns}
    breaks, events = [np.empty(0, np.int64)], [np.empty((0, 4), np.int64)]
    counts = dict.fromkeys(MARKERS, 0)
    passed = damaged = framed = 0
    end = stop
    for window, start, frames in _windows(data, header.data, stop, layouts):
        for letter in counts:
            counts[letter] += int(np.count_nonzero(frames.whole & (frames.letters == letter)))
        for letter, of in columns.items():
            rows = np.flatnonzero(frames.whole & (frames.letters == letter))
            room -= len(rows) * len(of)
            if room < 0:
                raise InputError("its frames claim more values than their bytes can hold")
            at = frames.at[rows] - start + 1
            values[letter].append(layouts[letter].decode(window, at, of))
            orders[letter].append(passed + rows)
        rows = np.flatnonzero(frames.whole & (frames.letters == E))
        events.append(_events(window, frames.at[rows] - start, passed + rows))
        breaks.append(passed + np.flatnonzero(frames.gap | ~frames.whole))
        passed += len(frames.at)
        damaged += int(np.count_nonzero(~frames.whole))
        framed += int((frames.ends - frames.at)[frames.whole].sum())
        if frames.over[-1:].any():
            end = int(frames.ends[-1])
    written = {
        letter: FrameTable(
            tuple(layouts[letter].definition.names[i] for i in of),
            np.concatenate(orders[letter]),
            np.concatenate(values[letter]),
        )
        for letter, of in columns.items()
    }
    used_events = np.concatenate(events)
    resumed = used_events[used_events[:, 1] == RESUME][:, [0, 2, 3]]
    lost_at = np.sort(np.concatenate([*breaks, resumed[:, 0]]), kind="stable")  # of two runs
    main, time_us = main_frames(header, written[I], written[P], lost_at, resumed)
    none = FrameTable((), np.zeros(0, np.int64), np.zeros((0, 0), np.int64))
    slow = slow_frames(header, written[S]) if S in written else none
    return BlackboxFrames(
        main=main, time_us=time_us, slow=slow, events=used_events,
        counts={chr(k): count for k, count in counts.items()},
        damaged=damaged,
        lost=counts[I] + counts[P] - len(time_us),
        garbage_bytes=end - header.data - framed,
    )  # fmt: skip


def _columns(header: Header, wanted: Sequence[str] | None) -> Array:
    """Those wanted, and those that others are computed from."""
    names = header.frames["I"].names
    needed = {"loopIteration", "time", *(names if wanted is None else wanted)}
    if any(MOTOR_0 in header.frames[letter].predictors for letter in "IP"):
        needed.add("motor[0]")
    return _named(names, needed)


def _named(names: Sequence[str], wanted: Collection[str]) -> Array:
    return np.array([i for i, name in enumerate(names) if name in wanted], np.int64)


def _windows(
    data: bytes, start: int, stop: int, layouts: dict[int, FrameLayout]
) -> Iterator[tuple[ByteWindow, int, Found]]:
    """Stretches of a session, the position in the file of each, and the frames that begin in it."""
    margin = max(LONGEST_EVENT, *(layout.longest for layout in layouts.values())) + _MARGIN
    at = start
    for first in range(start, max(stop, start + 1), _AT_ONCE):
        if at >= first + _AT_ONCE:  # the log has ended
            return
        last = min(first + _AT_ONCE + margin, stop)
        raw = np.frombuffer(data, np.uint8, last - first, first)
        if last == stop:
            raw = np.append(raw, np.zeros(margin, np.uint8))
        window = ByteWindow(raw)
        stops = _AT_ONCE, stop - first
        found = find_frames(window, max(at - first, 0), stops, layouts)
        at = first + _AT_ONCE
        if found.whole[-1:].any():
            at = stop if found.over[-1] else max(first + int(found.ends[-1]), at)
        shifted = replace(found, at=found.at + first, ends=found.ends + first)
        yield window, first, shifted


def _events(window: ByteWindow, at: Array, order: Array) -> Array:
    """(k, 4) as in `BlackboxFrames`: events used of those at (n,) positions, with (n,) order."""
    event = window.raw[at + 1]
    used = np.flatnonzero(_IS_USED[event])
    numbers = [window.numbers(window.nth(at[used] + 2, n)) for n in (0, 1)]
    return np.column_stack([order[used], event[used].astype(np.int64), *numbers])
