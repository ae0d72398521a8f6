"""The frames of a blackbox session, and their values.

As in the reference decoder a frame counts when another follows it; else it is damaged, the search
continues after its first byte, and P frames count again after the next I frame. Only the end of a
frame marks where the next one begins: every byte that could begin one is tried, those of one letter
at once; then the chain is followed from end to beginning.

Values are differences. Between two I frames they add up: one sum over all frames for the predictor
"as before", two for "in a straight line". "The mean of the last two" is rounded at every step, so
it is taken step by step, but for all chains of P frames together.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.errors import InputError
from gcs_sysid.telemetry.blackbox_format import (
    AVERAGE_2,
    INCREMENT,
    MARKERS,
    MOTOR_0,
    PREVIOUS,
    STRAIGHT_LINE,
    UNCUT,
    ByteWindow,
    Definition,
    FrameLayout,
    Header,
)

_LONGEST_CHAIN = 4096
"""P frames after an I frame; firmware writes 1024 at most."""
WRAP = 2**32
MOST_TIME, MOST_LOOPS = 10_000_000, 5_000
"""us and loops between two frames that belong together; as the reference decoder."""


@dataclass(frozen=True)
class FrameTable:
    """Frames of one type.

    Attributes:
        names: of the columns.
        order: (n,) rising, the place of each among the frames of all types.
        values: (n, columns) integers as logged.
    """

    names: tuple[str, ...]
    order: Array
    values: Array

    def columns(self, *names: str) -> Array | None:
        """(n, names) as floats; None when one of them is not there."""
        if not set(names) <= set(self.names):
            return None
        return self.values[:, [self.names.index(name) for name in names]].astype(float)


def main_frames(
    header: Header, keys: FrameTable, deltas: FrameTable, breaks: Array, resumed: Array
) -> tuple[FrameTable, Array]:
    """The I and P frames that can be computed and believed, and (n,) us of each.

    Args:
        header: of the session.
        keys: the I frames as written.
        deltas: the P frames as written, with the same columns.
        breaks: (k,) rising places where P frames lose what they build on.
        resumed: (k, 3) order, loop and us of events that mark a pause.
    """
    order = np.concatenate([keys.order, deltas.order])
    sorting = np.argsort(order, kind="stable")
    order, is_key = order[sorting], sorting < len(keys.order)
    rows = np.arange(len(order))
    key = np.maximum.accumulate(np.where(is_key, rows, -1))
    since = np.searchsorted(breaks, order) - np.searchsorted(breaks, order[key])
    sound = is_key | ((key >= 0) & (since == 0) & (rows - key <= _LONGEST_CHAIN))
    order, is_key = order[sound], is_key[sound]
    values = np.asfortranarray(np.concatenate([keys.values, deltas.values])[sorting[sound]])
    if not len(order):
        return FrameTable(keys.names, order, values), order
    chains = _chains(is_key)
    _predict(header, keys.names, values, chains)
    loop = values[:, keys.names.index("loopIteration")] % WRAP
    clock = values[:, keys.names.index("time")] % WRAP
    jump, forward = np.diff(loop, prepend=loop[:1]), np.diff(clock, prepend=clock[:1]) % WRAP
    wrong = ~is_key & ((jump < 0) | (jump >= MOST_LOOPS) | (forward >= MOST_TIME))
    sound = chains.since(np.cumsum(wrong)) == 0
    passed = chains.since(np.cumsum(np.where(is_key, 0, forward)))
    first = chains.first
    last = first + np.bincount(chains.number, sound).astype(np.int64) - 1
    table = np.column_stack([order[first], loop[first], clock[first], loop[last], clock[last]])
    starts = _believed_starts(table, passed[last], resumed)
    sound &= starts[chains.number] >= 0
    time = starts[chains.number] + passed
    return FrameTable(keys.names, order[sound], values[sound]), time[sound]


class _Chains(NamedTuple):
    """I frames, each followed by its P frames."""

    first: Array
    """(k,) rows of the I frames."""
    lengths: Array
    """(k,) rows from each I frame to the next."""
    number: Array
    """(n,) which chain a row belongs to."""

    def held(self, values: Array) -> Array:
        """(k,) of the I frames as (n,)."""
        return np.repeat(values, self.lengths)

    def since(self, sums: Array) -> Array:
        """What (n,) sums have grown by since the I frame."""
        return sums - self.held(sums[self.first])


def _chains(is_key: Mask) -> _Chains:
    """Of (n,) rows, the first of which is an I frame."""
    first = np.flatnonzero(is_key)
    return _Chains(first, np.diff(first, append=len(is_key)), np.cumsum(is_key) - 1)


def _predict(header: Header, names: tuple[str, ...], values: Array, chains: _Chains) -> None:
    """Add the predictions to (n, columns) values as written, in place."""
    keys, deltas = (header.frames[letter].only(names) for letter in "IP")
    constants = header.constants()
    motor = names.index("motor[0]") if "motor[0]" in names else 0
    top = values[chains.first]
    for definition, rows in ((keys, top), (deltas, values)):
        predictors = np.array(definition.predictors)
        if definition is deltas:
            rows[chains.first] = 0
            _add_earlier(header, names, predictors, rows, top, chains, definition)
        for predictor, constant in constants.items():
            rows[:, predictors == predictor] += constant
        _wrap(rows, definition)
        if MOTOR_0 in definition.predictors:
            rows[:, predictors == MOTOR_0] += rows[:, [motor]]
            _wrap(rows, definition)
    values[chains.first] = top


def _add_earlier(
    header: Header, names: tuple[str, ...], predictors: Array, values: Array, top: Array,
    chains: _Chains, definition: Definition,
) -> None:  # fmt: skip
    """Add to P frames what is predicted from earlier ones.

    Args:
        header: of the session.
        names: of the columns.
        predictors: (columns,) of P frames.
        values: (n, columns) as written; 0 in the I frames, where any value may come to stand.
        top: (k, columns) of the I frames.
        chains: of the frames.
        definition: of the P frames' columns.
    """
    for predictor in (PREVIOUS, STRAIGHT_LINE):
        for column in np.flatnonzero(predictors == predictor).tolist():
            sums = chains.since(np.cumsum(values[:, column]))
            if predictor == STRAIGHT_LINE:
                sums = chains.since(np.cumsum(sums))
            values[:, column] = sums + chains.held(top[:, column])
    columns = np.flatnonzero(predictors == AVERAGE_2)
    if len(columns):
        written = np.ascontiguousarray(values[:, columns])
        written[chains.first] = top[:, columns]
        low = definition.lowest()[columns]
        values[:, columns] = _averages(written, chains.first, low)
    counted = np.flatnonzero(predictors == INCREMENT)
    loop = names.index("loopIteration")
    if loop in counted:
        n = np.arange(len(values)) - chains.held(chains.first)
        values[:, loop] = _logged_after(header, chains.held(top[:, loop]), n)
    steps = _logged_after(header, values[:-1, loop], np.ones(1, np.int64)) - values[:-1, loop]
    steps = chains.since(np.append([0], np.cumsum(steps)))
    for column in counted[counted != loop].tolist():
        values[:, column] = chains.held(top[:, column]) + steps


def _averages(values: Array, first: Array, low: Array) -> Array:
    """Add to differences the mean of the two values before, rounded towards zero.

    Args:
        values: (n, columns) I frames as they are and P frames as written; changed.
        first: (k,) rows of the I frames.
        low: (columns,) lowest values of columns that are cut to 32 bits.
    """
    lengths = np.diff(first, append=len(values))
    by_length = np.argsort(-lengths, kind="stable")
    starts, shorter = first[by_length], -lengths[by_length]
    for step in range(1, int(lengths.max())):
        rows = starts[: np.searchsorted(shorter, -step)] + step
        both = values[rows - 1] + values[rows - min(step, 2)]
        both += both < 0
        both >>= 1
        values[rows] = _cut(both + values[rows], low)
    return values


def _logged_after(header: Header, loop: Array, n: Array) -> Array:
    """The n-th loop that is logged after a loop; for n = 0 that loop."""
    logged, interval = header.logged, header.interval
    before = loop // interval * len(logged)
    rank = before + np.searchsorted(logged, loop % interval, side="right") + n - 1
    later = rank // len(logged) * interval + logged[rank % len(logged)]
    return np.where(n == 0, loop, later)


def _outside(values: Array, low: Array) -> Mask:
    """(columns,) whether some value needs more than 32 bits and must not."""
    if not len(values):
        return np.zeros(len(low), bool)
    outside: Mask = (values.min(axis=0) < low) | (values.max(axis=0) >= low + WRAP)
    outside &= low != UNCUT
    return outside


def _cut(values: Array, low: Array) -> Array:
    return np.where(low == UNCUT, values, (values - low) % WRAP + low)


def _wrap(values: Array, definition: Definition) -> None:
    """Cut values to 32 bits where the reference does, in place."""
    low = definition.lowest()
    outside = _outside(values, low)
    if outside.any():
        values[:, outside] = _cut(values[:, outside], low[outside])


def slow_frames(header: Header, written: FrameTable) -> FrameTable:
    """S frames, which build on no others, from those as written."""
    definition = header.frames["S"].only(written.names)
    constants = header.constants()
    values = written.values + [constants.get(p, 0) for p in definition.predictors]
    _wrap(values, definition)
    return replace(written, values=values)


def latest(order: Array, values: Array, places: Array) -> Array:
    """(k,) the last of (n,) values before each place; 0 before the first."""
    before = np.searchsorted(order, places)
    return np.append([0], values)[before]


def _believed_starts(chains: Array, passed: Array, resumed: Array) -> Array:
    """(k,) us at which the I frames begin, without wraps; -1 for those not believed.

    As in the reference decoder an I frame must come soon after the last main frame, or after an
    event that marks a pause. The reference decoder loses all that follows a wrong clock; here two
    chains that agree overrule one that does not.

    Args:
        chains: (k, 5) place, loop and us of the I frame, loop and us of the last frame that counts.
        passed: (k,) us between the two.
        resumed: (k, 3) place, loop and us of events.
    """
    pauses = np.searchsorted(resumed[:, 0], chains[:, 0]).tolist()  # before each
    lasting = np.append([0], np.cumsum(np.diff(resumed[:, 2]) % WRAP))  # from the first one
    starts = [-1] * len(chains)
    rows, times = chains.tolist(), passed.tolist()
    start = -1
    last: tuple[int, int] | None = None
    doubted: tuple[int, int, int] | None = None
    now = paused = 0
    for i, (_, loop, clock, end_loop, end_clock) in enumerate(rows):
        if pauses[i] > paused:
            now += (int(resumed[paused, 2]) - last[1]) % WRAP if last else int(resumed[paused, 2])
            now += int(lasting[pauses[i] - 1] - lasting[paused])
            paused = pauses[i]
            last, doubted = (int(resumed[paused - 1, 1]), int(resumed[paused - 1, 2])), None
        if last is None or _follows(last, loop, clock):
            start = now + (clock - last[1]) % WRAP if last else clock
        elif doubted is not None and _follows(doubted[1:], loop, clock):
            before = (clock - rows[doubted[0]][2]) % WRAP
            start = now + (clock - last[1] + WRAP // 2) % WRAP - WRAP // 2
            start += WRAP if start < before else 0
            starts[doubted[0]] = max(start - before, 0)
        else:
            doubted = (i, end_loop, end_clock)
            continue
        starts[i] = start
        now = start + times[i]
        last, doubted = (end_loop, end_clock), None
    return np.array(starts, np.int64)


def _follows(last: tuple[int, int], loop: int, clock: int) -> bool:
    return 0 <= loop - last[0] < MOST_LOOPS and (clock - last[1]) % WRAP < MOST_TIME


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

    Of main and S frames the columns wanted are computed, where they are there; None: all.

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
