"""A fast link without the machine's other work: a session whose clock is its own processor time.

    python -m benchmarks.reliability.own_clock [FLIGHT.tlog] [--minutes M] [--rate HZ]

What other programs take of the processor is in all times that `benchmarks.reliability.rate` shows.
Here a recording, as that study plays it, is handed to a session in this process, with the coach, a
recording and results as JSON lines. The session's clock goes on by the processor time that its
thread takes and leaps over what it waits for: as on a core that nobody else uses, but for caches.
A datagram arrives when its time on that clock has come, whatever the session does at that moment.
"""

import argparse
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from benchmarks.reliability import watched
from benchmarks.reliability.flights import FAST, emulate, flights_in
from benchmarks.reliability.rate import growth, rows_of_times, table
from gcs_sysid.cli.output import JsonLines
from gcs_sysid.live import live_session as live
from gcs_sysid.live.flight_coach import CoachOptions
from gcs_sysid.live.live_options import LiveOptions
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.telemetry.link import Address, Chunk, Link
from gcs_sysid.telemetry.tlog import read_tlog
from gcs_sysid.telemetry.udp_link import DATAGRAMS_AT_ONCE
from gcs_sysid.telemetry.urls import parse_url
from sim_bridge.playback import moments

_VEHICLE: Address = ("127.0.0.1", 9)


class OwnClock:
    """Processor time of the thread that asks, and what it would have waited."""

    def __init__(self) -> None:
        self._waited = 0.0

    def now(self) -> float:
        """S."""
        return time.thread_time() + self._waited

    def now_ns(self) -> int:
        """Ns."""
        return int(1e9 * self.now())

    def wait(self, seconds: float) -> None:
        """Let so much time pass."""
        self._waited += max(seconds, 0.0)


class PlayedLink(Link):
    """Gives the datagrams of a recording when their time has come.

    Args:
        recording: of one vehicle.
        clock: that the times are of.
        times: note when datagrams arrived, and the looks.
    """

    datagrams = True

    def __init__(self, recording: Path, clock: OwnClock, times: watched.Times) -> None:
        super().__init__(parse_url("udpin:127.0.0.1:14550"))
        self._clock, self._times = clock, times
        self._began: float | None = None
        self._datagrams = self._read(recording)
        self._next: tuple[float, bytes] | None = next(self._datagrams, None)

    @staticmethod
    def _read(recording: Path) -> Iterator[tuple[float, bytes]]:
        for t, frames in moments(read_tlog(recording)):
            yield t, b"".join(frames)

    def receive(self, timeout: float) -> list[Chunk]:
        """What has arrived; leaps to the next datagram if that comes in time."""
        if self._began is None:
            self._began = self._clock.now()
        if self._next is not None:
            left = self._began + self._next[0] - self._clock.now()
            self._clock.wait(min(left, timeout))
        now = self._clock.now()
        chunks: list[Chunk] = []
        while self._next is not None and len(chunks) < DATAGRAMS_AT_ONCE:
            arrived, data = self._began + self._next[0], self._next[1]
            if arrived > now:
                break
            chunks.append(Chunk(data, _VEHICLE))
            self._times.arrive(int(1e9 * arrived), len(data))
            self._next = next(self._datagrams, None)
        self.ended = self._next is None
        return chunks

    def send(self, data: bytes) -> None:
        """Nobody listens."""

    def close(self) -> None:
        """There is nothing to close."""


def run(
    recording: Path, folder: Path, rate: float = 1000.0
) -> tuple[watched.Times, live.LiveSession]:
    """Take a recording as it came; the times of it, and the session at its end."""
    clock, times = OwnClock(), watched.Times()
    watched.watch(times)
    link = PlayedLink(recording, clock, times)
    options = LiveOptions(
        rate=rate, refit_interval=0.5, predict=False, coach=CoachOptions(), apart=True
    )
    results = JsonLines(str(folder / "result.jsonl"), force=True)
    session = live.LiveSession(
        link, load_airframe("paper"), options, folder / "own.tlog", on_result=results.write
    )

    parts: list[tuple[Any, Any]] = [
        (live, SimpleNamespace(monotonic=clock.now)),
        (watched, SimpleNamespace(time_ns=clock.now_ns)),
    ]
    for module, own in parts:
        module.time = own
    session.start()
    told = -watched.SAMPLED_EVERY
    while not session.join(0.2):
        t = session.latest()
        if t is not None and t.t - told >= watched.SAMPLED_EVERY:
            told = t.t
            times.memory.append((told, watched.resident()))
    return times, session


def main() -> None:
    """Play, print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.reliability.own_clock",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "flight",
        type=Path,
        nargs="?",
        help="a recording, as `sim-bridge --tlog` makes it (default: the flights of "
        "`benchmarks.reliability.rate`)",
    )
    parser.add_argument("--minutes", type=float, default=10.0, help="of those (default: 10)")
    parser.add_argument("--rate", type=float, default=1000.0, help="Hz of the IMU (default: 1000)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        flight = options.flight
        if flight is None:
            flight, seconds = Path(name) / "flight.tlog", 60.0 * options.minutes
            # At the usual rates all that rotors and IMU send comes equally often.
            rates = FAST if options.rate == 1000.0 else None
            many = flights_in(seconds)
            emulate(flight, rate=options.rate, rates=rates, flights=many, seconds=seconds)
        times, session = run(flight, Path(name), options.rate)
    if session.problem is not None:
        raise session.problem
    told = times.as_dict()
    size, grown = growth(times.memory)
    rows = [
        ("datagrams", f"{told['datagrams']}", ""),
        *rows_of_times(told),
        ("memory in the last minute", f"{size:.1f} MB", ""),
        ("growth since minute 2", f"{grown:.2f} MB", ""),
    ]
    print(table(rows))


if __name__ == "__main__":
    main()
