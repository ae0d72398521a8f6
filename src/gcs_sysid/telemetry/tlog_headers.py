"""Headers of the frames of a .tlog at many positions at once, and whether checksums are right."""

from collections.abc import Callable

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.telemetry.checksums import checksums_agree, rows_of
from gcs_sysid.telemetry.frame_block import BAD_CRC, OK, UNKNOWN
from gcs_sysid.telemetry.frames import (
    CHECKSUM,
    CRC_EXTRA,
    FLAG_SIGNED,
    HEADER_1,
    HEADER_2,
    MAGIC_2,
    SIGNATURE,
)

_IDS = max(CRC_EXTRA) + 2
_EXTRA = np.full(_IDS, -1, np.int16)
"""Message id -> CRC_EXTRA, -1 where none is known; the last entry is for all larger ids."""
for _message_id, _extra in CRC_EXTRA.items():
    _EXTRA[_message_id] = _extra[0]


class Headers:
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

    def first(self, count: int) -> "Headers":
        """The same of the first few."""
        part = Headers.__new__(Headers)
        part.__dict__ = {name: column[:count] for name, column in self.__dict__.items()}
        return part


def bytes_behind(data: Array, at: Array) -> Callable[[int], Array]:
    """Gives the bytes so many behind (n,) rising positions; where those are all bytes, in place."""
    n, first = len(at), int(at[0]) if len(at) else 0
    if n and int(at[-1]) - first == n - 1:
        return lambda offset: data[first + offset : first + offset + n]
    return lambda offset: data[offset:].take(at)


def are_right(data: Array, at: Array, agree: Callable[[Array, Array, Array], Mask]) -> Mask:
    """(n,) whether frames at given positions are of known types, with the right checksum.

    Args:
        data: in which they lie.
        at: (n,) their magic bytes.
        agree: `checksums_agree` of positions, lengths and extra bytes.
    """
    behind = bytes_behind(data, at)
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
