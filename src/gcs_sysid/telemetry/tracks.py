"""Onboard logs as records: whole streams as arrays, merged by time.

A log that the autopilot wrote itself (.ulg, .bin) is no row of frames. Its readers turn each of
its topics into a `Track`; merging those gives the same records as a link would have given.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.model.attitude import align_signs
from gcs_sysid.records import Record, Stream
from gcs_sysid.telemetry.clock import JUMP_AHEAD

STATE_EVERY = 1.0
"""s between two reports of a state that is only logged when it changes."""
_ROWS_AT_ONCE = 4096


@dataclass(frozen=True)
class Track:
    """The samples of one stream.

    Attributes:
        stream: what the values are.
        t: (n,) s, vehicle clock, rising.
        values: (n, width), laid out as `Stream` says.
        offset: as in `Record`.
        source: as in `Record`.
    """

    stream: Stream
    t: Array
    values: Array
    offset: int = 0
    source: str = ""

    def records(self) -> Iterator[Record]:
        """One by one, without holding them all."""
        for start in range(0, len(self.t), _ROWS_AT_ONCE):
            rows = slice(start, start + _ROWS_AT_ONCE)
            for t, values in zip(self.t[rows].tolist(), self.values[rows].tolist(), strict=True):
                yield Record(self.stream, t, tuple(values), self.offset, self.source)


@dataclass
class Recording:
    """What a reader makes of an onboard log.

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
    """

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

    def add(
        self, stream: Stream, t: Array, values: Array, offset: int = 0, source: str = ""
    ) -> None:
        """Add a stream in SI units, in the order of the file; what is unsound is left out.

        Args:
            stream: what the values are.
            t: (n,) s, vehicle clock.
            values: (n, width) or (n,).
            offset: as in `Record`.
            source: as in `Record`.
        """
        if not len(t):
            return
        values = values.astype(float).reshape(len(t), -1)
        believable = believable_times(t)
        whole = np.isfinite(values)
        finite = whole.all(axis=1)
        if stream is Stream.IMU:
            # Nearly everything rests on the gyro: one without an accelerometer is of use.
            finite = whole[:, :3].all(axis=1)
            values[finite & ~whole.all(axis=1), 3:] = np.nan
        self._drop("no time", ~believable)
        self._drop("not finite", believable & ~finite)
        sound = believable & finite
        t, values = t[sound], values[sound]
        order = np.argsort(t, kind="stable")
        if len(t):
            self.tracks.append(Track(stream, t[order], values[order], offset, source))

    def add_attitude(self, t: Array, q: Array) -> None:
        """Add (n, 4) quaternions of any sign and nearly unit length."""
        norm = np.linalg.norm(q, axis=1, keepdims=True)
        q = np.where(np.abs(norm - 1.0) < 0.1, q / np.maximum(norm, 0.1), np.nan)
        sound = np.isfinite(q).all(axis=1)
        if sound.any():
            aligned = align_signs(q[sound])
            q[sound] = aligned * np.copysign(1.0, aligned[0, 0])
        self.add(Stream.ATTITUDE, t, q)

    def add_state(self, stream: Stream, changes: Mapping[float, bool], end: float) -> None:
        """Add a state by the times at which it changed, told every second like on a link."""
        if not changes:
            return
        at = np.array(sorted(changes))
        t = np.union1d(at, np.arange(at[0], max(end, at[0]), STATE_EVERY))
        states = np.array([changes[key] for key in at.tolist()])
        self.add(stream, t, states[np.searchsorted(at, t, side="right") - 1])

    def _drop(self, reason: str, rows: Mask) -> None:
        if rows.any():
            self.dropped[reason] = self.dropped.get(reason, 0) + int(rows.sum())

    def records(self) -> Iterator[Record]:
        """Everything in the order of time."""
        parameters = [
            Track(Stream.PARAMETER, np.array([t]), np.array([[value]]), source=name)
            for t, name, value in self.parameters
        ]
        return merged([*parameters, *self.tracks])


def merged(tracks: Sequence[Track]) -> Iterator[Record]:
    """The records of all tracks in the order of time; at the same time, of the tracks."""
    if not tracks:
        return
    order = np.argsort(np.concatenate([track.t for track in tracks]), kind="stable")
    owner = np.repeat(np.arange(len(tracks)), [len(track.t) for track in tracks])[order]
    rows = [track.records() for track in tracks]
    for index in owner.tolist():
        yield next(rows[index])


def believable_times(t: Array) -> Mask:
    """(n,) whether each time agrees with its neighbours: a damaged stamp may be anything."""
    if len(t) < 5:
        return np.isfinite(t)
    padded = np.pad(t, 2, mode="reflect")
    middle = np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=1)
    believable: Mask = np.abs(t - middle) < JUMP_AHEAD
    return believable
