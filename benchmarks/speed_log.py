"""One long log for `benchmarks.speed`: an emulated flight, flown again and again.

The emulator flies a minute or so with an IMU of 250 Hz, attitude at 100 Hz and rotor speeds; the
frames of that flight are repeated.
"""

import tempfile
from pathlib import Path

import numpy as np

from testbed.repeated import as_log, frames_of, later
from testbed.study import flown

_BOTH = ["--rotor-input", "both", "--rate", "250"]
FLIGHT = ["--airframe", "paper", "--mission", "all-axes", "--noise", "mems", "--seed", "1", *_BOTH]
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
        frames = frames_of(flown(FLIGHT, Path(folder))[0])
    span = round(float(np.ptp(frames.time_us.astype(float)))) + _PAUSE_US
    span += -span % 1000
    ends = frames.at + frames.size
    part = path.with_suffix(".part")  # what is broken off is not taken for the whole
    with open(part, "wb") as file:
        number = 0
        while fits := int(ends[ends <= size - file.tell()].max(initial=0)):
            file.write(as_log(later(frames, number * span, number * len(frames)))[:fits])
            number += 1
    part.replace(path)
    return path
