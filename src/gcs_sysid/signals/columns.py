"""Records as columns: whole stretches of streams as arrays, in the order in which they came."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.signals.records import Record, Stream

Key = tuple[Stream, str, int]
"""Key of a stream: stream, source, first rotor."""


@dataclass(frozen=True)
class Track:
    """The samples of one stream.

    Attributes:
        stream: what the values are.
        t: (n,) s, vehicle clock; rising, but in a `RecordBlock` as the samples came.
        values: (n, width), laid out as `Stream` says.
        offset: as in `Record`.
        source: as in `Record`.
        order: (n,) rising, where each sample stands among those of all tracks of a
            `RecordBlock`: in a .tlog the number of its frame. Empty elsewhere.
    """

    stream: Stream
    t: Array
    values: Array
    offset: int = 0
    source: str = ""
    order: Array = field(default_factory=lambda: np.empty(0, np.int64))

    @property
    def key(self) -> Key:
        """Which stream it is."""
        return self.stream, self.source, self.offset

    def part(self, rows: slice | Mask | NDArray[np.intp]) -> "Track":
        """Some of the samples."""
        return Track(
            self.stream,
            self.t[rows],
            self.values[rows],
            self.offset,
            self.source,
            self.order[rows],
        )

    def between(self, first: int, stop: int) -> "Track":
        """The samples with orders from `first` to before `stop`."""
        return self.part(slice(*np.searchsorted(self.order, (first, stop)).tolist()))


@dataclass(frozen=True)
class IntakeEvent:
    """Something that happened on the way."""

    t: float
    """Vehicle time, s; after a reboot in the new count."""
    kind: str
    """"vehicle" (chosen), "vehicles" (another one that could be meant), "reboot" or "reset" (of the
    estimate, by the user)."""
    text: str


@dataclass(frozen=True)
class RecordBlock:
    """Records that follow each other in a log, as columns.

    Attributes:
        tracks: the samples, one track for each stream, source, offset and width; their `order`
            gives the sequence. A frame makes at most one sample.
        parameters: (order, record) of those reported, rising.
        events: (order, event), rising; each was known before the sample of the same order.
    """

    tracks: tuple[Track, ...] = ()
    parameters: tuple[tuple[int, Record], ...] = ()
    events: tuple[tuple[int, IntakeEvent], ...] = ()

    def __len__(self) -> int:
        return sum(len(track.t) for track in self.tracks) + len(self.parameters)

    def windows(self, imu_samples: int | None = None) -> Iterator["RecordBlock"]:
        """Parts that follow each other.

        Parameters and events are parts of their own, and come before what follows them.

        Args:
            imu_samples: of the IMU in a part, which ends with the last of them; None: any number.
        """
        if not len(self) and not self.events:
            return
        cuts, end = {0}, 0
        for track in self.tracks:
            end = max(end, int(track.order[-1]) + 1)
            if track.stream is Stream.IMU and imu_samples and len(track.t) > imu_samples:
                cuts |= set((track.order[imu_samples - 1 :: imu_samples] + 1).tolist())
                cuts.add(int(track.order[-1]) + 1)
        for number, _ in (*self.parameters, *self.events):
            cuts |= {number, number + 1}
        cuts.add(end)
        if max(cuts) == end and len(cuts) <= 2:
            yield self
            return
        last = max(cuts)
        bounds = np.array([*sorted(cuts), last + 1])
        parameters, events = (_starts(some, bounds) for some in (self.parameters, self.events))
        for i, (first, stop) in enumerate(pairwise(bounds.tolist())):
            tracks = (track.between(first, stop) for track in self.tracks)
            window = RecordBlock(
                tuple(track for track in tracks if len(track.t)),
                self.parameters[parameters[i] : parameters[i + 1]],
                self.events[events[i] : events[i + 1]],
            )
            if len(window) or window.events:
                yield window

    @property
    def imu_samples(self) -> int:
        """How many samples of the IMU there are."""
        return sum(len(track.t) for track in self.tracks if track.stream is Stream.IMU)


def _starts(entries: Sequence[tuple[int, object]], bounds: Array) -> list[int]:
    """Which of some entries, of rising order, is the first in each of the parts by bounds."""
    starts: list[int] = np.searchsorted([order for order, _ in entries], bounds).tolist()
    return starts


def by_key(tracks: Iterable[Track]) -> dict[Key, Track]:
    """Tracks by their streams; those of one stream are joined, narrower ones lack last values."""
    parts: dict[Key, list[Track]] = {}
    for track in tracks:
        parts.setdefault(track.key, []).append(track)
    return {key: some[0] if len(some) == 1 else _joined(some) for key, some in parts.items()}


def stacked(parts: Sequence[Array]) -> Array:
    """(n, width) of tables that follow each other; narrower ones lack their last values: NaN."""
    width = max(part.shape[1] for part in parts)
    if any(part.shape[1] < width for part in parts):
        room = (((0, 0), (0, width - part.shape[1])) for part in parts)
        padded = zip(parts, room, strict=True)
        parts = [np.pad(part, more, constant_values=np.nan) for part, more in padded]
    return np.concatenate(parts)


def _joined(parts: Sequence[Track]) -> Track:
    """Tracks of one stream as one: all at once, as a long log has hundreds."""
    order = np.concatenate([part.order for part in parts])
    t = np.concatenate([part.t for part in parts])
    values = stacked([part.values for part in parts])
    if (np.diff(order) < 0).any():
        rows = np.argsort(order, kind="stable")
        t, values, order = t[rows], values[rows], order[rows]
    return replace(parts[0], t=t, values=values, order=order)
