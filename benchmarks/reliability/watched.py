"""The live tool with its arrivals stamped: `gcs-sysid` in a process that keeps its own times.

    python -m benchmarks.reliability.watched TIMES.json [--core N] ... -- live URL --headless ...

runs the words after `--` as `gcs-sysid` would, with the same code all the way. The system stamps
each datagram as it comes in (SO_TIMESTAMPNS, Linux alone), long before Python sees it.

A datagram counts as taken when all that was read together with it is decoded and lies on the grid
of samples. One that completes a block of samples (0.1 s of the vehicle's clock) counts as taken
only when all of that block is learnt from: rows made, changes looked for, and the estimate renewed
where that is due.
"""

import argparse
import json
import os
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.__main__ import main as gcs_sysid
from gcs_sysid.cli import live_command as live
from gcs_sysid.session.chain import Chain
from gcs_sysid.session.pipeline import Pipeline
from gcs_sysid.signals.sampling import SampleBlock
from gcs_sysid.telemetry import link
from gcs_sysid.telemetry.frames import Frame
from gcs_sysid.telemetry.link import LARGEST_DATAGRAM, Address, Chunk, Link, UdpLink
from gcs_sysid.telemetry.urls import LinkUrl

SO_TIMESTAMPNS = 35
_STAMP = struct.Struct("@qq")
_SPACE = socket.CMSG_SPACE(_STAMP.size) if hasattr(socket, "CMSG_SPACE") else 0
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

    def levels(self) -> list[float]:
        """Percentiles at `LEVELS`, in ms of what are ns."""
        return (1e-6 * np.percentile(self.numbers, LEVELS)).tolist() if self.count else []


class Times:
    """What was seen of the process.

    Attributes:
        waiting: ns since 1970 when the datagrams arrived that are not taken yet, and their bytes.
        taken: ns from a datagram's arrival until it is taken, see the module.
        renewed: the same of those alone that had an estimate renewed.
        stretches: ns of processor time of the session's thread between two looks at the link.
        memory: (s since the start, bytes) of resident memory.
    """

    def __init__(self) -> None:
        self.waiting: list[tuple[int, int]] = []
        self.taken, self.renewed = Kept(4_000_000), Kept(10_000)
        self.stretches = Kept(4_000_000)
        self.memory: list[tuple[float, int]] = []
        self._looked: int | None = None
        self._current = range(0)
        self._held: set[int] = set()

    def frames(self, frames: Sequence[Frame]) -> Iterator[Frame]:
        """The frames of the datagrams that wait; whose frame is at hand, is kept in mind."""
        every = range(len(self.waiting))
        ends = list(accumulate(size for _, size in self.waiting))
        # Where there were other bytes than those of the frames, any datagram may be the one.
        told = bool(ends) and ends[-1] == sum(len(frame.raw) for frame in frames)
        at = number = 0
        for frame in frames:
            if told:
                number += at >= ends[number]
                at += len(frame.raw)
            self._current = every[number : number + 1] if told else every
            yield frame

    def admitted(self) -> None:
        """All that was waiting is on the grid; what made work is held until that is done."""
        now = time.time_ns()
        left = [at for number, (at, _) in enumerate(self.waiting) if number not in self._held]
        self.taken.add([now - at for at in left])
        self.waiting.clear()
        self._current = range(0)
        self._held.clear()

    def work(self, learn: Callable[[], None], renewals: Callable[[], int]) -> None:
        """Do the work that the datagrams at hand bring about."""
        held = [self.waiting[number][0] for number in self._current if number not in self._held]
        self._held |= set(self._current)
        before = renewals()
        learn()
        waited = [time.time_ns() - at for at in held]
        self.taken.add(waited)
        if renewals() > before:
            self.renewed.add(waited)

    def looks(self) -> None:
        """The session's thread is about to look at the link."""
        if self._looked is not None:
            self.stretches.add([time.thread_time_ns() - self._looked])

    def has_looked(self) -> None:
        """It has looked, and goes on."""
        self._looked = time.thread_time_ns()

    def as_dict(self) -> dict[str, Any]:
        """Percentiles in ms at `LEVELS`, and the memory."""
        return {
            "datagrams": self.taken.count,
            "taken_ms": self.taken.levels(),
            "renewals": self.renewed.count,
            "renewed_ms": self.renewed.levels(),
            "stretches_ms": self.stretches.levels(),
            "memory": self.memory,
        }


def resident() -> int:
    """Bytes of memory that this process has in use."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def stamped_link(times: Times) -> type[UdpLink]:
    """A `UdpLink` that notes when what it reads had arrived."""

    class StampedLink(UdpLink):
        def __init__(self, url: LinkUrl) -> None:
            super().__init__(url)
            self._socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)

        def receive(self, timeout: float) -> list[Chunk]:
            times.looks()
            chunks = super().receive(timeout)
            times.has_looked()
            return chunks

        def _read(self, from_socket: socket.socket) -> tuple[bytes, Address]:
            data, about, _, source = from_socket.recvmsg(LARGEST_DATAGRAM, _SPACE)
            for level, kind, content in about:
                if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS:
                    seconds, ns = _STAMP.unpack(content)
                    times.waiting.append((seconds * 1_000_000_000 + ns, len(data)))
            return data, source

    return StampedLink


def watch(times: Times) -> None:
    """Have the tool's link, pipeline and chain keep times from now on."""
    stamped = stamped_link(times)
    take, learn = Pipeline.take, Chain._learn

    def timed(pipeline: Pipeline, frames: Sequence[Frame], wall: float | None = None) -> bool:
        renewed = take(pipeline, times.frames(frames), wall)
        times.admitted()
        return renewed

    def timed_work(chain: Chain, blocks: tuple[SampleBlock, ...]) -> None:
        if blocks:
            times.work(lambda: learn(chain, blocks), lambda: chain.renewals)

    def open_link(url: LinkUrl, *_: float) -> Link:
        return stamped(url)

    Pipeline.take = timed  # type: ignore[method-assign, assignment]
    Chain._learn = timed_work  # type: ignore[method-assign]
    live.open_link = open_link


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
    parser = argparse.ArgumentParser(prog="python -m benchmarks.reliability.watched")
    parser.add_argument("times", type=Path)
    parser.add_argument("--core", type=int)
    parser.add_argument("--alone", action="store_true")
    parser.add_argument("--buffer", type=int, help="bytes asked of the system for what arrives")
    parser.add_argument("--mixed", action="store_true", help="never read the vehicle's apart")
    parser.add_argument("words", nargs="+")
    options = parser.parse_args()
    take_core(options.core, alone=options.alone)
    link.RECEIVE_BUFFER = options.buffer or link.RECEIVE_BUFFER
    if options.mixed:
        link.FLOOD = sys.maxsize
    times, stop = Times(), threading.Event()
    watch(times)
    sampler = threading.Thread(target=_sample, args=(times, stop))
    sampler.start()
    spent = time.process_time()
    began = time.monotonic()
    try:
        status = gcs_sysid(options.words)
    finally:
        stop.set()
        sampler.join()
        share = (time.process_time() - spent) / (time.monotonic() - began)
        options.times.write_text(json.dumps({**times.as_dict(), "processor": share}))
    return status


if __name__ == "__main__":
    sys.exit(main())
