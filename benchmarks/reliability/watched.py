"""The live tool with its arrivals stamped: `gcs-sysid` in a process that keeps its own times.

    python -m benchmarks.reliability.watched TIMES.json [--core N] ... -- live URL --headless ...

runs the words after `--` as `gcs-sysid` would, with the same code all the way. The system stamps
each datagram as it comes in (SO_TIMESTAMPNS, Linux alone), long before Python sees it. A datagram
counts as taken when the pipeline has taken all the frames that were read together with it: they
are records then, and in the estimator as far as its grid goes, and an estimate that was due has
been made.
"""

import argparse
import json
import os
import socket
import struct
import sys
import threading
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from gcs_sysid.__main__ import main as gcs_sysid
from gcs_sysid.cli import live
from gcs_sysid.session.pipeline import Pipeline
from gcs_sysid.telemetry import link
from gcs_sysid.telemetry.frames import Frame
from gcs_sysid.telemetry.link import LARGEST_DATAGRAM, Address, Link, UdpLink
from gcs_sysid.telemetry.urls import LinkUrl

SO_TIMESTAMPNS = 35
_STAMP = struct.Struct("@qq")
_SPACE = socket.CMSG_SPACE(_STAMP.size) if hasattr(socket, "CMSG_SPACE") else 0
LEVELS = (50.0, 95.0, 99.0, 99.9, 100.0)
SAMPLED_EVERY = 5.0
"""s between looks at the memory."""


class Times:
    """What was seen of the process.

    Attributes:
        waiting: ns since 1970, when the datagrams arrived that are not taken yet.
        taken: ns from arrival to taken, each datagram.
        renewed: ns to a renewed estimate, from the arrival of the oldest datagram of those taken
            together; one a renewal.
        memory: (s since the start, bytes) of resident memory.
    """

    def __init__(self) -> None:
        self.waiting: list[int] = []
        # Fixed in size, so that keeping times does not look like a leak.
        self.taken = np.zeros(4_000_000, np.int64)
        self.taken_count = 0
        self.renewed: list[int] = []
        self.memory: list[tuple[float, int]] = []
        self.taken.fill(1)

    def take(self, renewed: bool) -> None:
        """All that was waiting has been taken."""
        now = time.time_ns()
        if not self.waiting:
            return
        if renewed:
            self.renewed.append(now - min(self.waiting))
        end = min(self.taken_count + len(self.waiting), len(self.taken))
        self.taken[self.taken_count : end] = now - np.array(
            self.waiting[: end - self.taken_count], np.int64
        )
        self.taken_count = end
        self.waiting.clear()

    def as_dict(self) -> dict[str, Any]:
        """Percentiles in ms at `LEVELS`, and the memory."""

        def levels(values: Any) -> list[float]:
            return (1e-6 * np.percentile(values, LEVELS)).tolist() if len(values) else []

        return {
            "datagrams": self.taken_count,
            "taken_ms": levels(self.taken[: self.taken_count]),
            "renewals": len(self.renewed),
            "renewed_ms": levels(self.renewed),
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

        def _read(self, from_socket: socket.socket) -> tuple[bytes, Address]:
            data, about, _, source = from_socket.recvmsg(LARGEST_DATAGRAM, _SPACE)
            for level, kind, content in about:
                if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS:
                    seconds, ns = _STAMP.unpack(content)
                    times.waiting.append(seconds * 1_000_000_000 + ns)
            return data, source

    return StampedLink


def watch(times: Times) -> None:
    """Have the tool's link and pipeline keep times from now on."""
    stamped = stamped_link(times)
    take = Pipeline.take

    def timed(pipeline: Pipeline, frames: Iterable[Frame]) -> bool:
        renewed = take(pipeline, frames)
        times.take(renewed)
        return renewed

    def open_link(url: LinkUrl, *_: float) -> Link:
        return stamped(url)

    Pipeline.take = timed  # type: ignore[method-assign]
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
