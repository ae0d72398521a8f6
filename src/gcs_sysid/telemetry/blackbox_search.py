"""Searches the bytes of a blackbox session for frames that follow each other.

Only the end of a frame marks where the next one begins. Every byte that could begin one is tried,
those of one letter at once; then the chain is followed from end to beginning.
"""

from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.telemetry.blackbox_fields import FrameLayout
from gcs_sysid.telemetry.blackbox_format import MARKERS
from gcs_sysid.telemetry.byte_window import ByteWindow
from gcs_sysid.telemetry.repeated_bytes import RepeatedBytes

I, P, G, H, S, E = MARKERS[0], MARKERS[1], MARKERS[2], MARKERS[3], MARKERS[4], MARKERS[5]  # noqa: E741
RESUME, DISARM, FLIGHT_MODE, LOG_END = 14, 15, 30, 255
"""Events: logging goes on after a pause (loop, us), a motor stop (reason), modes (new, old)."""
LONGEST_EVENT = 256

_FEW_JUMPS, _FEW_GAPS = 2**13, 2**8
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
    window: ByteWindow,
    at: int,
    stops: tuple[int, int],
    layouts: dict[int, FrameLayout],
    margin: int,
) -> Found:
    """The frames that begin in a window's first bytes.

    Args:
        window: of a session's bytes.
        at: position from which on to search.
        stops: where those first bytes end, and where the session does.
        layouts: of all types that the header describes.
        margin: bytes that decide where a frame ends.
    """
    raw, size, stop = window.raw, min(stops), stops[1]
    known = np.isin(np.arange(256), [*layouts, E])
    first = raw[:size]
    marks = _IS_MARKER.take(raw)
    marks[stop : stop + 1] = True
    may_begin = marks[:size].copy()
    for letter in set(MARKERS) - {*layouts, E}:
        may_begin &= first != letter
    repeats = None
    if 4 * np.count_nonzero(may_begin) > size:
        repeats = RepeatedBytes(raw, size, stop, margin)
    lengths = np.zeros(size, np.int32)
    for letter in np.flatnonzero(known).tolist():
        mine = first == letter
        if repeats:
            mine &= repeats.others
        begin = np.flatnonzero(mine)
        window.share = len(begin) / len(raw)
        for i in range(0, len(begin), ByteWindow.CACHED):
            some = begin[i : i + ByteWindow.CACHED]
            lengths[some] = _lengths(window, letter, some, marks, stop, layouts)
    if repeats:
        repeats.repeat(lengths)
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
    place = _hops(at, is_whole, lengths)
    from_each = np.append(at, place + lengths.take(place))
    to_each = np.append(place, len(lengths))
    gaps = np.flatnonzero(to_each > from_each)
    if len(gaps) < _FEW_GAPS:
        between = np.zeros(len(lengths), bool)
        for first, behind in zip(from_each[gaps].tolist(), to_each[gaps].tolist(), strict=True):
            between[first:behind] = True
    else:
        edges = np.zeros(len(lengths) + 1, np.int8)
        edges[from_each[gaps]] = 1
        edges[to_each[gaps]] = -1
        between = np.cumsum(edges[:-1], dtype=np.int8).view(bool)
    between &= may_begin  # and damaged
    between[place] = True
    place = np.flatnonzero(between)
    return place, is_whole.take(place)


def _hops(at: int, is_whole: Mask, lengths: Array) -> Array:
    """(k,) where the whole frames begin that follow each other from a position on.

    Args:
        at: the position.
        is_whole: (n,) whether a whole frame begins at each byte.
        lengths: (n,) of the frames.
    """
    # As many are followed one by one as cost less than to look at all of the window.
    single: list[int] = []
    length, find = lengths.data, is_whole.tobytes().find  # read in place
    at = find(1, at)
    for few in (_FEW_JUMPS // 8, _FEW_JUMPS):
        while at >= 0 and len(single) < few:
            single.append(at)
            at = find(1, at + length[at])
        if at < len(lengths) // 16:
            break
    place = np.array(single, np.intp)
    if at < 0:
        return place
    # In garbage there may be as many jumps as bytes: eight at a time.
    jumps = at + np.flatnonzero(is_whole[at:])
    number = np.zeros(len(lengths) - at + 1, np.int32)  # jumps before each byte
    np.cumsum(is_whole[at:], out=number[1:])
    count = len(jumps)
    one = number.take(jumps - at + lengths.take(jumps), mode="clip")
    one = np.append(one, np.int32(count))
    two = one.take(one)
    four = two.take(two)
    leads_to = four.take(four).data
    eighth: list[int] = []
    jump = 0
    while jump < count:
        eighth.append(jump)
        jump = leads_to[jump]
    taken = np.array(eighth, np.intp)
    for hop in (four, two, one):
        taken = np.column_stack([taken, hop[taken]]).ravel()
    return np.append(place, jumps[taken[taken < count]])


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
