"""A fast link without the machine's other work: a session whose clock is its own processor time.

    python -m benchmarks.reliability.own_clock FLIGHT.tlog

What other programs take of the processor is in all times that `benchmarks.reliability.rate` shows.
Here a recording, as that study plays it, is handed to a session in this process, with the coach, a
recording and results as JSON lines. The session's clock goes on by the processor time that its
thread takes and leaps over what it waits for: as on a core that nobody else uses, but for caches.
A datagram arrives when its time on that clock has come, whatever the session does at that moment.
A second table shows the calls of more than 5 ms, which are what data wait for.
"""

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from benchmarks.reliability import watched
from benchmarks.reliability.long_calls import LongCalls
from benchmarks.reliability.rate import growth, rows_of_times, table
from gcs_sysid.cli.output import JsonLines
from gcs_sysid.live import live_session as live
from gcs_sysid.live.flight_coach import CoachOptions
from gcs_sysid.live.live_estimate import LiveOptions
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.telemetry.link import Address, Link, ReceivedBytes, UdpLink
from gcs_sysid.telemetry.tlog import read_tlog
from gcs_sysid.telemetry.urls import parse_url
from sim_bridge.playback import moments
from testbed.study import arguments

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

    def receive(self, timeout: float) -> list[ReceivedBytes]:
        """What has arrived; leaps to the next datagram if that comes in time."""
        if self._began is None:
            self._began = self._clock.now()
        if self._next is not None:
            left = self._began + self._next[0] - self._clock.now()
            self._clock.wait(min(left, timeout))
        now = self._clock.now()
        chunks: list[ReceivedBytes] = []
        while self._next is not None and len(chunks) < UdpLink.DATAGRAMS_AT_ONCE:
            arrived, data = self._began + self._next[0], self._next[1]
            if arrived > now:
                break
            chunks.append(ReceivedBytes(data, _VEHICLE))
            self._times.arrive(int(1e9 * arrived), len(data))
            self._next = next(self._datagrams, None)
        self.ended = self._next is None
        return chunks

    def send(self, data: bytes) -> None:
        """Nobody listens."""

    def close(self) -> None:
        """There is nothing to close."""


def run(recording: Path, folder: Path) -> tuple[watched.Times, live.LiveSession, LongCalls]:
    """Take a recording as it came; the times of it, the session at its end, its long calls."""
    clock, times = OwnClock(), watched.Times()
    watched.watch(times)
    calls = LongCalls(time.thread_time)
    calls.watch()
    link = PlayedLink(recording, clock, times)
    options = LiveOptions(rate=1000, refit_interval=0.5, predict=False, coach=CoachOptions())
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
    return times, session, calls


def main() -> None:
    """Play, print the table."""
    parser = arguments(__doc__)
    parser.add_argument("flight", type=Path, help="a recording, as `sim-bridge --tlog` makes it")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        times, session, calls = run(options.flight, Path(name))
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
    print(f"\n{calls.table()}")


if __name__ == "__main__":
    main()
