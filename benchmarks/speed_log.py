"""One long log for `benchmarks.speed`: an emulated flight, flown again and again.

The emulator flies a minute or so with an IMU of 250 Hz, attitude at 100 Hz and rotor speeds; the
frames of that flight are repeated with later times, running sequence numbers and new checksums.
"""

import tempfile
from pathlib import Path

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.telemetry.frame_block import FrameBlock, checksums
from gcs_sysid.telemetry.frames import CRC_EXTRA
from gcs_sysid.telemetry.messages import HEADER, LAYOUTS, message_dtype
from gcs_sysid.telemetry.tlog import TlogReader
from testbed.study import flown

_BOTH = ["--rotor-input", "both", "--rate", "250"]
FLIGHT = ["--airframe", "paper", "--mission", "all-axes", "--noise", "mems", "--seed", "1", *_BOTH]
_UNIT = {"time_usec": 1, "time_boot_ms": 1000}
"""us in the unit of each field that holds a time."""
_PAUSE_US = 4000
"""Between one flight and the next: a step of the IMU."""


def long_log(path: Path, size: int) -> Path:
    """Write a log of a size in bytes, or a record less, unless it is there already.

    Args:
        path: of the log; what lies there is taken to be it.
        size: bytes.
    """
    if path.exists():
        return path
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        flight, _ = flown(FLIGHT, Path(folder))
        part = path.with_suffix(".part")  # what is broken off is not taken for the whole
        with open(part, "wb") as file:
            (frames,) = TlogReader(flight, flight.stat().st_size + 1).blocks()
            span = round(float(np.ptp(frames.time_us.astype(float)))) + _PAUSE_US
            # Whole milliseconds, so that all kinds of stamp move by the same time.
            span += -span % 1000
            number = 0
            while fits := _whole(frames, size - file.tell()):
                file.write(_later(frames, number, span)[:fits])
                number += 1
        part.replace(path)
    return path


def _whole(frames: FrameBlock, size: int) -> int:
    """Bytes of the records that lie wholly within the first `size` bytes."""
    ends = frames.at + frames.size
    return int(ends[ends <= size].max(initial=0))


def _later(frames: FrameBlock, number: int, span: int) -> memoryview:
    """The records as they come the n-th time, `span` us after each other."""
    data = frames.data.copy()
    later = number * span
    _add(data, frames.at - 8, ">u8", later)
    sequence_at = frames.at + np.where(frames.version == 2, 4, 2)
    sent = int(frames.sequence[-1]) - int(frames.sequence[0]) + 1
    data[sequence_at] += np.uint8(number * sent % 256)
    header = np.dtype(HEADER).itemsize
    for message_id in np.unique(frames.message_id).tolist():
        fields = message_dtype(LAYOUTS[message_id].name).fields or {}
        for name in fields.keys() & _UNIT.keys():
            kind, offset = fields[name][:2]
            rows = np.flatnonzero(frames.message_id == message_id)
            # Where a message ends with a time whose zeros were cut, there is no room for a later
            # one: none of those that are read.
            rows = rows[frames.payload_size[rows] >= offset - header + kind.itemsize]
            _add(data, frames.payload_at[rows] + offset - header, kind.str, later // _UNIT[name])
    extra = np.array([CRC_EXTRA[i][0] for i in frames.message_id.tolist()], np.uint8)
    end = frames.payload_at + frames.payload_size
    checksum = checksums(data, frames.at + 1, end - frames.at - 1, extra)
    data[end], data[end + 1] = checksum & 0xFF, checksum >> 8
    return memoryview(data)


def _add(data: Array, at: Array, kind: str, amount: int) -> None:
    """Add to the whole numbers at some positions; they wrap."""
    size = np.dtype(kind).itemsize
    places = at[:, None] + np.arange(size)
    values = data[places].view(kind)
    values += np.array(amount % 256**size).astype(values.dtype)
    data[places] = values.view(np.uint8)
