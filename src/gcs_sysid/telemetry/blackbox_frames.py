"""The frames of a blackbox session, and their values.

As in the reference decoder a frame counts when another follows it; else it is damaged, the search
continues after its first byte, and P frames count again after the next I frame.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError
from gcs_sysid.telemetry.blackbox_fields import FrameLayout
from gcs_sysid.telemetry.blackbox_format import MARKERS, MOTOR_0, Header
from gcs_sysid.telemetry.blackbox_predictors import FrameTable, fixed_frames, main_frames
from gcs_sysid.telemetry.blackbox_search import (
    DISARM,
    LONGEST_EVENT,
    RESUME,
    E,
    Found,
    G,
    H,
    I,
    P,
    S,
    find_frames,
)
from gcs_sysid.telemetry.byte_window import ByteWindow

_AT_ONCE = 2**19
"""Bytes searched together."""
_MOST_VALUES = 4
"""Values a byte: firmware writes one or two, a hostile file could claim hundreds."""
_FREE_VALUES = 2**20
_MARGIN = 16
"""Bytes behind the longest frame."""
_IS_USED = np.isin(np.arange(256), [RESUME, DISARM])


@dataclass(frozen=True)
class BlackboxFrames:
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

    main: FrameTable
    time_us: Array
    slow: FrameTable
    gps: FrameTable
    home: FrameTable
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
        wanted: columns of main and S frames to compute, where they are there, and none of G and
            H frames; None: all.

    Raises:
        InputError: it claims more values than its bytes can hold.
    """
    layouts = {ord(k): FrameLayout(frame, header.version) for k, frame in header.frames.items()}
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
    passed = damaged = framed = 0
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
        framed += int((frames.ends - frames.at)[frames.whole].sum())
        if frames.over[-1:].any():
            end = int(frames.ends[-1])
    written = {
        letter: FrameTable(
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
    return BlackboxFrames(
        main=main, time_us=time_us, slow=slow, gps=gps, home=home, events=used_events,
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
        found = find_frames(window, max(at - first, 0), stops, layouts, margin)
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
