"""Finds the frames of a blackbox session, and computes their values.

Only the end of a frame marks where the next one begins. Every byte that could begin one is tried,
all of them at once; then the chain is followed from end to beginning. As in the reference decoder a
frame counts when another follows it; else it is damaged, the search continues after its first byte,
and P frames count again after the next I frame.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.errors import InputError
from gcs_sysid.telemetry.blackbox_fields import CACHED, ByteWindow, Layout
from gcs_sysid.telemetry.blackbox_format import MARKERS, MOTOR_0, Header
from gcs_sysid.telemetry.blackbox_predictors import Table, fixed_frames, main_frames
from gcs_sysid.telemetry.repeated_bytes import PERIOD, Repeats

I, P, G, H, S, E = MARKERS[0], MARKERS[1], MARKERS[2], MARKERS[3], MARKERS[4], MARKERS[5]  # noqa: E741
RESUME, DISARM, FLIGHT_MODE, LOG_END = 14, 15, 30, 255
"""Events: logging goes on after a pause (loop, us), a motor stop (reason), modes (new, old)."""

_AT_ONCE = 2**19
"""Bytes searched together."""
_MOST_VALUES = 4
"""Values a byte: firmware writes one or two, a hostile file could claim hundreds."""
_FREE_VALUES = 2**20
_LONGEST_EVENT = 256
_MARGIN = 16
"""Bytes behind the longest frame."""
_FEW_JUMPS = 2**13
_END_MESSAGE = np.frombuffer(b"End of log\0", np.uint8)

_EVENTS = {
    0: (0, 1, 0), 10: (5, 0, 0), 11: (4, 0, 0), 12: (8, 0, 0), RESUME: (0, 2, 0),
    DISARM: (0, 1, 0), 20: (1, 1, 2), FLIGHT_MODE: (0, 2, 0), 40: (0, 1, 0), 41: (5, 0, 0),
}  # fmt: skip
"""Event -> bytes, numbers of variable length, bytes."""
_ADJUSTMENT, _FLOAT = 13, 0x80
_BEFORE, _NUMBERS, _BEHIND = np.array(
    [[_EVENTS.get(event, (0, 0, 0))[i] for event in range(256)] for i in range(3)], np.int32
)
_IS_MARKER = np.isin(np.arange(256), list(MARKERS))
_IS_USED = np.isin(np.arange(256), [RESUME, DISARM])


@dataclass(frozen=True)
class Frames:
    """What a session holds.

    Attributes:
        main: I and P frames that could be computed.
        time_us: (n,) of the main frames, without the wraps of the 32-bit clock.
        slow: S frames.
        gps: G frames.
        home: H frames.
        events: (k, 4) order, event, and its first two numbers; pauses and motor stops.
        counts: letter -> frames found, damaged ones not counted.
        damaged: frames that no other follows.
        lost: main frames that are whole, but what they build on is not, or their time cannot be.
        garbage_bytes: bytes that belong to no frame.
    """

    main: Table
    time_us: Array
    slow: Table
    gps: Table
    home: Table
    events: Array
    counts: dict[str, int]
    damaged: int
    lost: int
    garbage_bytes: int


@dataclass(frozen=True)
class _Found:
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


def read_frames(
    data: bytes, header: Header, stop: int, wanted: Sequence[str] | None = None
) -> Frames:
    """Read the frames of a session.

    Args:
        data: the file.
        header: of the session.
        stop: where the session ends, at the latest.
        wanted: columns of main and S frames to compute, where they are there, and none of G and
            H frames; None: all.

    Raises:
        InputError: it claims more values than its bytes can hold.
    """
    layouts = {ord(k): Layout(frame, header.version) for k, frame in header.frames.items()}
    columns = {letter: np.arange(layout.fields) for letter, layout in layouts.items()}
    columns[I] = columns[P] = _columns(header, wanted)
    claimed = {letter: len(of) for letter, of in columns.items()}
    if wanted is not None:
        columns |= {letter: np.arange(0) for letter in layouts if letter in (G, H)}
        if S in layouts:
            columns[S] = _named(header.frames["S"].names, wanted)
    room = _MOST_VALUES * (stop - header.data) + _FREE_VALUES
    values = {k: [np.empty((0, len(of)), np.int64)] for k, of in columns.items()}
    orders = {k: [np.empty(0, np.int64)] for k in layouts}
    breaks, events = [np.empty(0, np.int64)], [np.empty((0, 4), np.int64)]
    counts = dict.fromkeys(MARKERS, 0)
    passed = damaged = told = 0
    end = stop
    for window, start, frames in _windows(data, header.data, stop, layouts):
        for letter, layout in layouts.items():
            rows = np.flatnonzero(frames.whole & (frames.letters == letter))
            room -= len(rows) * claimed[letter]
            if room < 0:
                raise InputError("its frames claim more values than their bytes can hold")
            at = frames.at[rows] - start + 1
            values[letter].append(layout.decode(window, at, columns[letter]))
            orders[letter].append(passed + rows)
            counts[letter] += len(rows)
        rows = np.flatnonzero(frames.whole & (frames.letters == E))
        counts[E] += len(rows)
        events.append(_events(window, frames.at[rows] - start, passed + rows))
        breaks.append(passed + np.flatnonzero(frames.gap | ~frames.whole))
        passed += len(frames.at)
        damaged += int(np.count_nonzero(~frames.whole))
        told += int((frames.ends - frames.at)[frames.whole].sum())
        if frames.over[-1:].any():
            end = int(frames.ends[-1])
    written = {
        letter: Table(
            tuple(layout.definition.names[i] for i in columns[letter]),
            np.concatenate(orders[letter]),
            np.concatenate(values[letter]),
        )
        for letter, layout in layouts.items()
    }
    used_events = np.concatenate(events)
    resumed = used_events[used_events[:, 1] == RESUME][:, [0, 2, 3]]
    lost_at = np.sort(np.concatenate([*breaks, resumed[:, 0]]), kind="stable")  # of two runs
    main, time_us = main_frames(header, written[I], written[P], lost_at, resumed)
    slow, gps, home = (
        fixed_frames(header, chr(k), written.get(k), main, time_us, written.get(H))
        for k in (S, G, H)
    )
    return Frames(
        main=main, time_us=time_us, slow=slow, gps=gps, home=home, events=used_events,
        counts={chr(k): count for k, count in counts.items()},
        damaged=damaged,
        lost=counts[I] + counts[P] - len(time_us),
        garbage_bytes=end - header.data - told,
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
    data: bytes, start: int, stop: int, layouts: dict[int, Layout]
) -> Iterator[tuple[ByteWindow, int, _Found]]:
    """Stretches of a session, the position in the file of each, and the frames that begin in it."""
    margin = max(_LONGEST_EVENT, *(layout.longest for layout in layouts.values())) + _MARGIN
    at = start
    for first in range(start, max(stop, start + 1), _AT_ONCE):
        if at >= first + _AT_ONCE:  # the log has ended
            return
        last = min(first + _AT_ONCE + margin, stop)
        raw = np.frombuffer(data, np.uint8, last - first, first)
        if last == stop:
            raw = np.append(raw, np.zeros(margin, np.uint8))
        window = ByteWindow(raw)
        found = _follow(window, max(at - first, 0), stop - first, layouts, margin)
        at = first + _AT_ONCE
        if found.whole[-1:].any():
            at = stop if found.over[-1] else max(first + int(found.ends[-1]), at)
        shifted = replace(found, at=found.at + first, ends=found.ends + first)
        yield window, first, shifted


def _follow(
    window: ByteWindow, at: int, stop: int, layouts: dict[int, Layout], margin: int
) -> _Found:
    """The frames that begin in a window's first bytes.

    Args:
        window: of a session's bytes.
        at: position from which on to search.
        stop: end of the session.
        layouts: of all types that the header describes.
        margin: bytes that decide where a frame ends.
    """
    raw = window.raw
    known = np.isin(np.arange(256), [*layouts, E])
    may_begin = known[raw[: min(_AT_ONCE, stop)]]
    begin = np.flatnonzero(may_begin).astype(np.int32)
    begun = np.zeros(len(may_begin) + 1, np.int32)  # frames that could begin before each byte
    np.cumsum(may_begin, out=begun[1:])
    candidates = begin
    repeats = Repeats(raw, begin, stop, margin) if _is_crowded(begin, raw) else None
    if repeats:
        candidates = begin[repeats.others]
    window.crowded = _is_crowded(candidates, raw)
    parts = [
        _ends(window, candidates[i : i + CACHED], stop, layouts)
        for i in range(0, max(len(candidates), 1), CACHED)
    ]
    ends, whole, over = (np.concatenate(some) for some in zip(*parts, strict=True))
    if repeats:
        ends, whole, over = repeats.fill(ends, PERIOD), repeats.fill(whole), repeats.fill(over)
    leads_to = begun.take(ends[whole], mode="clip")
    leads_to[over[whole]] = len(begin)
    rows = _way(int(np.searchsorted(begin, at)), whole, leads_to)
    begin, ends = begin[rows].astype(np.int64), ends[rows].astype(np.int64)
    found = _Found(begin, ends, raw[begin], whole[rows], whole[rows], over[rows])
    behind = raw[np.minimum(found.ends, len(raw) - 1)]
    return replace(found, gap=found.whole & (found.ends < stop) & ~known[behind])


def _is_crowded(begin: Array, raw: Array) -> bool:
    return 4 * len(begin) > len(raw)


def _ends(
    window: ByteWindow, begin: Array, stop: int, layouts: dict[int, Layout]
) -> tuple[Array, Mask, Mask]:
    """Where frames end that begin at (k,) positions, which are whole, and which end the log."""
    raw = window.raw
    letters = raw.take(begin)
    by_letter = np.argsort(letters, kind="stable")
    at = begin.take(by_letter) + 1
    ends = at.copy()
    over = np.zeros(len(begin), bool)
    counts = np.bincount(letters, minlength=256)
    behind_each = np.cumsum(counts)
    for letter in np.flatnonzero(counts).tolist():
        mine = slice(behind_each[letter] - counts[letter], behind_each[letter])
        if letter == E:
            behind, over[mine] = _event_ends(window, at[mine])
        else:
            behind = layouts[letter].ends(window, at[mine])
        longest = _LONGEST_EVENT if letter == E else layouts[letter].longest
        behind[behind - at[mine] > longest] = stop + 1
        ends[mine] = behind
    whole = _IS_MARKER.take(raw.take(ends, mode="clip"))
    whole |= ends == stop
    whole |= over
    whole &= ends <= stop
    found = np.empty_like(ends), np.empty_like(whole), np.empty_like(over)
    for values, sorted_values in zip(found, (ends, whole, over), strict=True):
        values[by_letter] = sorted_values
    return found


def _way(first: int, jumps: Mask, leads_to: Array) -> Array:
    """The rows met on the way from the first one to the end.

    Args:
        first: row to begin with.
        jumps: (n,) whether a row leads further than to the next one.
        leads_to: where those that do lead.
    """
    number = np.zeros(len(jumps) + 1, np.int32)  # jumps before each row
    np.cumsum(jumps, out=number[1:])
    count = len(leads_to)
    one = np.append(number.take(leads_to), np.int32(count))
    taken = _hops(one, int(number[first]), _FEW_JUMPS if count > _FEW_JUMPS else 0)
    begins = np.append(first, leads_to[taken])
    lengths = np.append(np.flatnonzero(jumps)[taken] + 1, len(jumps)) - begins
    rows: Array = np.repeat(begins - np.cumsum(lengths) + lengths, lengths)
    rows += np.arange(len(rows))
    return rows


def _hops(one: Array, jump: int, few: int) -> Array:
    """The jumps met from one on, each leading to another, the last of which leads nowhere.

    Args:
        one: (n + 1,) where each leads; n: nowhere.
        jump: the first.
        few: so many are followed one by one, as doubling costs as much as the bytes of a window.
    """
    count = len(one) - 1
    single: list[int] = []
    eighth: list[int] = []
    place = one.data  # read in place
    while jump < count and len(single) < few:
        single.append(jump)
        jump = place[jump]
    taken = np.empty(0, np.intp)
    if jump < count:  # in garbage there may be as many jumps as bytes: eight at a time
        two = one.take(one)
        four = two.take(two)
        place = four.take(four).data
        while jump < count:
            eighth.append(jump)
            jump = place[jump]
        taken = np.array(eighth, np.intp)
        for hop in (four, two, one):
            taken = np.column_stack([taken, hop[taken]]).ravel()
        taken = taken[taken < count]
    return np.append(np.array(single, np.intp), taken)


def _events(window: ByteWindow, at: Array, order: Array) -> Array:
    """(k, 4) as in `Frames`, those used of the events at (n,) positions, and with (n,) order."""
    event = window.raw[at + 1]
    used = np.flatnonzero(_IS_USED[event])
    numbers = [window.numbers(window.nth(at[used] + 2, n)) for n in (0, 1)]
    return np.column_stack([order[used], event[used].astype(np.int64), *numbers])


def _event_ends(window: ByteWindow, at: Array) -> tuple[Array, Mask]:
    """(k,) positions behind events whose types are at (k,) positions, and which end the log."""
    raw = window.raw
    event = raw[at]
    ends = window.nth(at + 1 + _BEFORE.take(event), _NUMBERS.take(event)) + _BEHIND.take(event)
    changes = np.flatnonzero(event == _ADJUSTMENT)
    changed = at[changes]
    whole_number = window.nth(changed + 2, 1)
    ends[changes] = np.where(raw[changed + 1] < _FLOAT, whole_number, changed + 6)
    last = event == LOG_END
    ends[last] = at[last] + 1 + len(_END_MESSAGE)
    message = raw[at[last, None] + 1 + np.arange(len(_END_MESSAGE))]
    last[last] = (message == _END_MESSAGE).all(axis=1)
    return ends, last
