"""Frames of a recording sent again: their stamps go on, their numbers run on."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.telemetry.frame_block import FrameBlock, checksums
from gcs_sysid.telemetry.frames import CRC_EXTRA
from gcs_sysid.telemetry.messages import HEADER, LAYOUTS, message_dtype
from gcs_sysid.telemetry.tlog import TlogReader

_UNIT = {"time_usec": 1, "time_boot_ms": 1000}
"""us in the unit of each field that holds a time."""


def frames_of(path: Path) -> FrameBlock:
    """A whole recording in one block."""
    (frames,) = TlogReader(path, path.stat().st_size + 1).blocks()
    return frames


def later(frames: FrameBlock, us: int, number: int) -> FrameBlock:
    """The frames `us` (whole ms) later, with running sequence numbers; checksums are as they were.

    Args:
        frames: of one sender.
        us: may be below zero; stamps wrap as the vehicle's do.
        number: of frames that were sent before.
    """
    data = frames.data.copy()
    sequence = (number + np.arange(len(frames))).astype(np.uint8)
    data[frames.at + np.where(frames.version == 2, 4, 2)] = sequence
    for message_id in np.unique(frames.message_id).tolist():
        fields = message_dtype(LAYOUTS[message_id].name).fields or {}
        for name in fields.keys() & _UNIT.keys():
            kind, offset = fields[name][:2]
            offset -= np.dtype(HEADER).itemsize
            rows = np.flatnonzero(frames.message_id == message_id)
            # Where a message ends with a time whose zeros were cut, there is no room for a later
            # one: none of those that are read.
            rows = rows[frames.payload_size[rows] >= offset + kind.itemsize]
            amount = us // _UNIT[name] % 256**kind.itemsize
            add_to(data, frames.payload_at[rows] + offset, kind.str, np.array(amount, kind))
    time_us = (frames.time_us.astype(np.int64) + us).astype(np.uint64)
    return replace(frames, data=data, sequence=sequence, time_us=time_us)


def add_to(data: Array, at: Array, kind: str, amount: Array) -> None:
    """Add to the numbers at some positions, in place; whole ones wrap.

    Args:
        data: (size,) bytes.
        at: (n,) positions.
        kind: of the numbers, of which `amount` may have several to a position.
        amount: one for all, or (n, m).
    """
    count = amount.shape[1] if amount.ndim else 1
    places = at[:, None] + np.arange(count * np.dtype(kind).itemsize)
    values = data[places].view(kind)
    values += amount.astype(kind)
    data[places] = values.view(np.uint8)


def as_log(frames: FrameBlock) -> memoryview:
    """The bytes of a recording of the frames: its stamps are theirs, the checksums right."""
    data = frames.data.copy()
    data[(frames.at - 8)[:, None] + np.arange(8)] = (
        frames.time_us.astype(">u8").view(np.uint8).reshape(-1, 8)
    )
    extra = np.array([CRC_EXTRA[i][0] for i in frames.message_id.tolist()], np.uint8)
    end = frames.payload_at + frames.payload_size
    checksum = checksums(data, frames.at + 1, end - frames.at - 1, extra)
    data[end], data[end + 1] = checksum & 0xFF, checksum >> 8
    return memoryview(data)
