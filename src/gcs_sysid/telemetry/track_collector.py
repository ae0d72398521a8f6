"""Logs as records: whole streams as arrays, merged in order.

A log that the autopilot wrote itself (.ulg, .bin) is no row of frames. Its readers turn each of
its topics into a `Track`; merging those by time gives the same records as a link would have
given. A ground station's log (.tlog) gives its tracks block by block, in the order of its frames.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gcs_sysid.arrays import Array, Mask, complete_rows
from gcs_sysid.model.attitude import align_signs
from gcs_sysid.signals.columns import IntakeEvent, RecordBlock, Track
from gcs_sysid.signals.records import Record, Stream
from gcs_sysid.telemetry.clock import JUMP_AHEAD

_AT_ONCE = 2**16
"""Samples looked at together, where copies of all would take much memory."""


def interpolated(t: Array, times: Array, values: Array) -> Array:
    """(n, width) at t, straight between samples; NaN before the first and after the last."""
    if not len(times):
        return np.full((len(t), values.shape[1]), np.nan)
    order = np.argsort(times, kind="stable")
    columns = [np.interp(t, times[order], column[order], np.nan, np.nan) for column in values.T]
    return np.column_stack(columns)


class TrackCollector:
    """Puts a `RecordBlock` together from pieces that follow each other."""

    def __init__(self) -> None:
        self.parameters: list[tuple[int, Record]] = []
        self.events: list[tuple[int, IntakeEvent]] = []
        # (stream, source, offset, width) -> pieces (order, t, values).
        self._pieces: dict[_Key, list[tuple[Array, Array, Array]]] = {}
        self._new: list[Array] = []

    def add(
        self,
        stream: Stream,
        order: Array,
        t: Array,
        values: Array,
        offset: int = 0,
        source: str = "",
    ) -> None:
        """Add samples of one stream that come after those it has; arguments as of `Track`."""
        if len(order):
            key = stream, source, offset, values.shape[1]
            self._pieces.setdefault(key, []).append((order, t, values))
            self._new.append(order)

    def add_record(self, order: int, record: Record) -> None:
        """Add one record."""
        at, t = np.array([order]), np.array([record.t])
        if record.stream is Stream.PARAMETER:
            self._new.append(at)
            self.parameters.append((order, record))
        else:
            values = np.array([record.values], dtype=float)
            self.add(record.stream, at, t, values, record.offset, record.source)

    def new_orders(self) -> Array:
        """(n,) rising, where the records stand that came since this was last asked."""
        made: Array = np.sort(np.concatenate([np.array([], np.int64), *self._new]))
        self._new.clear()
        return made

    def block(self) -> RecordBlock:
        """All of it."""
        tracks = []
        for (stream, source, offset, _), pieces in self._pieces.items():
            order, t, values = (np.concatenate(column) for column in zip(*pieces, strict=True))
            if (np.diff(order) < 0).any():  # of several messages
                by_order = np.argsort(order)
                order, t, values = order[by_order], t[by_order], values[by_order]
            tracks.append(Track(stream, t, values, offset, source, order))
        return RecordBlock(tuple(tracks), tuple(self.parameters), tuple(self.events))


_Key = tuple[Stream, str, int, int]


@dataclass
class Recording:
    """Content of an onboard log as read.

    Attributes:
        tracks: the streams.
        system: MAVLink system id that the vehicle has on a link.
        component: the same for the component id.
        vehicle_type: MAV_TYPE.
        autopilot: MAV_AUTOPILOT.
        parameters: (t, name, value) as they were set, in the order of t.
        counts: topic or message name -> entries read.
        dropped: reason -> samples that make no record: "no time", "not finite".
        garbage_bytes: bytes that belong to no entry, where the reader counts them.
        damaged: whether the file is not as it was written.
        lost: entries that the autopilot knows it could not write.
        dropouts: (t, length) in s of pauses in the writing.
        extras: name -> (n,) s and (n, width) in SI units of what is no stream yet.
        problems: as of `Telemetry`.
        clock: (n,) s of the log at which a GPS receiver gave (n,) s of its own.
    """

    STATE_EVERY = 1.0
    """s between two reports of a state that is only logged when it changes."""
    STATE_FOR = 86400.0
    """s of log accepted: a later time is damaged."""

    tracks: list[Track]
    system: int
    component: int
    vehicle_type: int
    autopilot: int
    parameters: list[tuple[float, str, float]] = field(default_factory=list)
    counts: Mapping[str, int] = field(default_factory=dict)
    dropped: dict[str, int] = field(default_factory=dict)
    garbage_bytes: int = 0
    damaged: bool = False
    lost: int = 0
    dropouts: list[tuple[float, float]] = field(default_factory=list)
    extras: dict[str, tuple[Array, Array]] = field(default_factory=dict)
    problems: tuple[str, ...] = ()
    clock: tuple[Array, Array] = field(default_factory=lambda: (np.empty(0), np.empty(0)))

    def add(
        self, stream: Stream, t: Array, values: Array, offset: int = 0, source: str = ""
    ) -> None:
        """Add a stream in SI units, in the order of the file; what is unsound is left out.

        Args:
            stream: what the values are.
            t: (n,) s, vehicle clock.
            values: (n, width) or (n,); attitudes of any sign and nearly unit length.
            offset: as in `Record`.
            source: as in `Record`.
        """
        if not len(t):
            return
        with np.errstate(invalid="ignore", over="ignore"):  # damaged numbers may be anything
            self._add(stream, t, values, offset, source)

    def _add(self, stream: Stream, t: Array, values: Array, offset: int, source: str) -> None:
        values = np.ascontiguousarray(values, float).reshape(len(t), -1)
        if stream is Stream.ATTITUDE:
            values = upright(values)
        believable = believable_times(t)
        values, finite = usable(stream, values)
        self._drop("no time", ~believable)
        self._drop("not finite", believable & ~finite)
        sound = believable & finite
        if not sound.all():  # copies of a long log are most of what it takes
            t, values = t[sound], values[sound]
        if (t[1:] < t[:-1]).any():
            order = np.argsort(t, kind="stable")
            t, values = t[order], values[order]
        if len(t):
            self.tracks.append(Track(stream, t, values, offset, source))

    def add_state(self, stream: Stream, changes: Mapping[float, bool], end: float) -> None:
        """Add a state by the times at which it changed, repeated every second as on a link."""
        at = np.array(list(changes))
        self._drop("no time", ~np.isfinite(at))
        at = np.sort(at[np.isfinite(at)])
        if not len(at):
            return
        end = min(max(at[0], end), at[0] + self.STATE_FOR)
        t = np.union1d(at, np.arange(at[0], end, self.STATE_EVERY))
        states = np.array([changes[key] for key in at.tolist()])
        self.add(stream, t, states[np.searchsorted(at, t, side="right") - 1])

    def add_clock(self, t: Array, gps: Array, valid: Mask) -> None:
        """(n,) s of the log and of GPS, each solution once; where there is none it is not valid."""
        t, gps = t[valid], gps[valid]
        new = np.diff(gps, prepend=-np.inf) > 0.0
        self.clock = t[new], gps[new]

    def add_voltage(self, t: Array, volts: Array) -> None:
        """Add the battery's, as an extra too: (n,) s and (n,) or (n, 1) V."""
        if not len(t):
            return
        self.extras["battery voltage"] = t, volts
        reported = np.isfinite(volts).reshape(len(t), -1).all(axis=1)
        self.add(Stream.VOLTAGE, t[reported], volts[reported])

    def _drop(self, reason: str, rows: Mask) -> None:
        if rows.any():
            self.dropped[reason] = self.dropped.get(reason, 0) + int(rows.sum())

    def block(self) -> RecordBlock:
        """Everything in the order of time; at the same time, parameters first, then tracks."""
        return in_order(self.tracks, self.parameters)


def in_order(
    tracks: Sequence[Track], parameters: Sequence[tuple[float, str, float]] = ()
) -> RecordBlock:
    """As `Recording.block` says, of its tracks and parameters."""
    reported = np.array([t for t, _, _ in parameters])
    order = _ranks(np.concatenate([reported, *(track.t for track in tracks)]))
    ends = np.cumsum([len(reported), *(len(track.t) for track in tracks)])
    records = [
        (number, Record(Stream.PARAMETER, t, (value,), source=name))
        for number, (t, name, value) in zip(
            order[: len(reported)].tolist(), parameters, strict=True
        )
    ]
    return RecordBlock(
        tuple(
            replace(track, order=order[end - len(track.t) : end])
            for track, end in zip(tracks, ends[1:].tolist(), strict=True)
        ),
        tuple(sorted(records)),
    )


def usable(stream: Stream, values: Array) -> tuple[Array, Mask]:
    """(n, width) values of a stream, and (n,) those of them that are finite, or of use."""
    finite = complete_rows(values)
    if stream is Stream.IMU and not finite.all():
        # Nearly everything depends on the gyro: one without an accelerometer is of use.
        values = values.copy()
        values[~finite, 3:] = np.nan
        finite = complete_rows(values[:, :3])
    return values, finite


def upright(q: Array) -> Array:
    """(n, 4) quaternions of unit length and like signs; NaN where they are none."""
    norm = np.linalg.norm(q, axis=1, keepdims=True)
    q = np.where(np.abs(norm - 1.0) < 0.1, q / np.maximum(norm, 0.1), np.nan)
    sound = np.isfinite(q).all(axis=1)
    if sound.any():
        aligned = align_signs(q[sound])
        q[sound] = aligned * np.copysign(1.0, aligned[0, 0])
    return q


def _ranks(times: Array) -> Array:
    """(n,) where each comes in the order of all; of equal ones, the first first."""
    rows = np.argsort(times, kind="stable")
    ranks = np.empty(len(rows), np.int64)
    for start in range(0, len(rows), _AT_ONCE):
        stop = min(start + _AT_ONCE, len(rows))
        ranks[rows[start:stop]] = np.arange(start, stop)
    return ranks


def believable_times(t: Array) -> Mask:
    """(n,) whether each time agrees with its neighbors: a damaged stamp may be anything."""
    if len(t) < 5:
        return np.isfinite(t)
    padded = np.pad(t, 2, mode="reflect")
    believable = np.empty(len(t), bool)
    for start in range(0, len(t), _AT_ONCE):
        piece = padded[start : start + _AT_ONCE + 4]
        middle = np.median(np.lib.stride_tricks.sliding_window_view(piece, 5), axis=1)
        np.less(np.abs(piece[2:-2] - middle), JUMP_AHEAD, out=believable[start : start + _AT_ONCE])
    return believable
