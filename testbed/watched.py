"""The live tool with its arrivals stamped: `gcs-sysid` in a process that keeps its own times.

    python -m testbed.watched TIMES.json [--core N] ... -- live URL --headless ...

runs the words after `--` as `gcs-sysid` would, with the same code all the way. The system stamps
each datagram as it comes in (SO_TIMESTAMPNS, Linux alone), long before Python sees it; the
receiver's process (`testbed.stamped_receiver`) writes the stamps down.

A datagram counts as taken when all that was handed over together with it is processed: decoded, on
the grid of samples and, where it completes a block of samples (0.1 s of the vehicle's clock), rows
made, changes looked for, and the estimate renewed where that is due.
"""

import json
import os
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.__main__ import main as gcs_sysid
from gcs_sysid.live import receiver_process
from gcs_sysid.live.live_estimate import LiveEstimate
from gcs_sysid.telemetry.transceiver import ReceivedFrames
from testbed.stamped_receiver import ARRIVAL
from testbed.study import arguments

LEVELS = (50.0, 95.0, 99.0, 99.9, 100.0)
SAMPLED_EVERY = 0.5
"""s between looks at the memory."""


class Kept:
    """Numbers in a room of fixed size, so that keeping them does not look like a leak."""

    def __init__(self, most: int) -> None:
        self._numbers = np.ones(most, np.int64)
        self.count = 0

    def add(self, numbers: Sequence[int]) -> None:
        """Keep these too, as far as there is room."""
        end = min(self.count + len(numbers), len(self._numbers))
        self._numbers[self.count : end] = numbers[: end - self.count]
        self.count = end

    @property
    def numbers(self) -> NDArray[np.int64]:
        """All that are kept."""
        return self._numbers[: self.count]


class Times:
    """What was seen of the process.

    Datagrams are identified by their bytes, counted from the first on: all that arrives is frames,
    and all of it is handed over in order.

    Attributes:
        memory: (s since the start, bytes) of resident memory.
    """

    def __init__(self) -> None:
        self.memory: list[tuple[float, int]] = []
        self._arrived, self._ends = Kept(1_500_000), Kept(1_500_000)
        self._taken_ends, self._taken, self._renewed = (Kept(1_500_000) for _ in range(3))
        self._bytes = self._taken_bytes = 0

    def arrive(self, ns: int, size: int) -> None:
        """A datagram arrived at `ns` since 1970."""
        self._bytes += size
        self._arrived.add([ns])
        self._ends.add([self._bytes])

    def take(self, size: int, ns: int, *, renewed: bool) -> None:
        """So many bytes were processed by `ns`; whether that renewed the estimate."""
        self._taken_bytes += size
        self._taken_ends.add([self._taken_bytes])
        self._taken.add([ns])
        self._renewed.add([int(renewed)])

    def as_dict(self) -> dict[str, Any]:
        """Percentiles in ms at `LEVELS`, and the memory."""
        ends = self._ends.numbers
        with_ = np.searchsorted(self._taken_ends.numbers, ends)
        there = with_ < self._taken.count
        with_ = with_[there]
        waited = self._taken.numbers[with_] - self._arrived.numbers[there]
        renewed = waited[self._renewed.numbers[with_] == 1]
        return {
            "datagrams": int(np.count_nonzero(there)),
            "not_taken": int(np.count_nonzero(~there)),
            "taken_ms": levels(waited),
            "renewals": int(self._renewed.numbers.sum()),
            "renewed_ms": levels(renewed),
            "memory": self.memory,
        }


def levels(ns: NDArray[np.int64]) -> list[float]:
    """Percentiles at `LEVELS`, in ms."""
    return (1e-6 * np.percentile(ns, LEVELS)).tolist() if len(ns) else []


def resident() -> int:
    """Bytes of memory that this process and its receiver have in use."""
    children = Path("/proc/self/task").glob("*/children")
    pids = ["self", *(pid for each in children for pid in each.read_text().split())]
    pages = 0
    for pid in pids:
        try:
            pages += int(Path(f"/proc/{pid}/statm").read_text().split()[1])
        except OSError:  # it has just ended
            continue
    return pages * os.sysconf("SC_PAGE_SIZE")


def watch(times: Times) -> None:
    """Have the tool's estimate keep times from now on."""
    learn = LiveEstimate.learn

    def timed(estimate: LiveEstimate, batch: ReceivedFrames, garbage_bytes: int) -> None:
        before = estimate.chain.renewals
        learn(estimate, batch, garbage_bytes)
        size = sum(len(frame.raw) for frame in batch.frames)
        times.take(size, time.time_ns(), renewed=estimate.chain.renewals > before)

    LiveEstimate.learn = timed  # type: ignore[method-assign]


def read_arrivals(path: Path, times: Times) -> None:
    """Take what the receiver has written down."""
    data = path.read_bytes() if path.exists() else b""
    for us, size in ARRIVAL.iter_unpack(data[: len(data) // ARRIVAL.size * ARRIVAL.size]):
        times.arrive(1000 * us, size)


def take_core(core: int | None, *, alone: bool) -> None:
    """Run on one core from now on; `alone`: ahead of all other programs, where that is allowed."""
    if core is not None and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {core})
    if alone and hasattr(os, "sched_setscheduler"):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))


def _sample(times: Times, stop: threading.Event) -> None:
    began = time.monotonic()
    while not stop.wait(SAMPLED_EVERY):
        times.memory.append((time.monotonic() - began, resident()))


def main() -> int:
    """Run the tool."""
    parser = arguments(__doc__)
    parser.add_argument("times", type=Path)
    parser.add_argument("--core", type=int)
    parser.add_argument("--alone", action="store_true")
    parser.add_argument("--nice", type=int, default=0, help="of the session, not of its receiver")
    parser.add_argument("words", nargs="+")
    options = parser.parse_args()
    take_core(options.core, alone=options.alone)
    times, stop = Times(), threading.Event()
    watch(times)
    folder = tempfile.TemporaryDirectory()
    arrivals = Path(folder.name) / "arrivals"
    stamped = "testbed.stamped_receiver"
    receiver_process.COMMAND = [sys.executable, "-m", stamped, str(arrivals)]
    if options.nice:
        start = receiver_process.ReceiverProcess.__init__

        def then_slow(receiver: Any, *words: Any, **settings: Any) -> None:
            start(receiver, *words, **settings)
            os.nice(options.nice)

        receiver_process.ReceiverProcess.__init__ = then_slow  # type: ignore[method-assign]
    sampler = threading.Thread(target=_sample, args=(times, stop))
    sampler.start()
    began = time.monotonic()
    try:
        status = gcs_sysid(options.words)
    finally:
        stop.set()
        sampler.join()
        used = os.times()  # of the receiver too, which has ended
        share = sum(used[:4]) / (time.monotonic() - began)
        receiver = (used.children_user + used.children_system) / (time.monotonic() - began)
        read_arrivals(arrivals, times)
        folder.cleanup()
        told = {**times.as_dict(), "processor": share, "receiver": receiver}
        options.times.write_text(json.dumps(told))
    return status


if __name__ == "__main__":
    sys.exit(main())
