"""Frames of a file as columns."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.telemetry.frames import (
    FLAG_SIGNED,
    HEADER_1,
    HEADER_2,
    LONGEST_FRAME,
    Frame,
    Validity,
)

OK, UNKNOWN, BAD_CRC = range(3)
_VALIDITY = (Validity.OK, Validity.UNKNOWN, Validity.BAD_CRC)
_NUMBERS = {validity: number for number, validity in enumerate(_VALIDITY)}
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
        validity: (n,) uint8: `OK`, `UNKNOWN` or `BAD_CRC`.
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

        Args:
            frames: in the order received.
            wall: when they came, s since 1970, all or (n,) each; None or 0: not known.
        """
        frames, came = list(frames), np.asarray(0.0 if wall is None else wall)
        raws = [frame.raw for frame in frames]
        header = np.array(
            [
                (
                    len(raw), frame.message_id, len(frame.payload), frame.sequence, frame.system,
                    frame.component, frame.version, _NUMBERS[frame.valid],
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

    def frame(self, index: int) -> Frame:
        """One of them as an object."""
        at, size = int(self.at[index]), int(self.size[index])
        raw = self.data[at : at + size].tobytes()
        start = int(self.payload_at[index]) - at
        version = int(self.version[index])
        return Frame(
            int(self.system[index]), int(self.component[index]), int(self.sequence[index]),
            int(self.message_id[index]), raw[start : start + int(self.payload_size[index])], raw,
            version, version == 2 and raw[2] == FLAG_SIGNED, _VALIDITY[self.validity[index]],
        )  # fmt: skip

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
                _VALIDITY[valid],
            )  # fmt: skip


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
