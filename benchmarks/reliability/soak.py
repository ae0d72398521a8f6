"""Hours of flight with faults drawn at random, compressed: `make soak`, `make soak-short`.

    python -m benchmarks.reliability.soak [--minutes 60 | --flights 5] [--seed 1]

Round after round, as long as the minutes last or as many as asked for: traps and faults of the line
are drawn by the seed, the emulator flies the article's mission with
them, 1 kHz of IMU and rotor speeds, into a recording, as fast as it can; and a live session takes
that recording's datagrams as fast as it can, records and identifies. The sessions follow each other
in one process.

After each round it is checked that

- the session ended by itself and without a defect;
- each parameter is right or said not to be: an error of more than 5 % and of more than three
  half widths of its interval, under a verdict other than "refused", counts as wrong;
- no file or socket is left open, and memory has not grown by 20 MB since the tenth round (by 60 MB
  since the second, before that), what waits for Python's garbage collector left out;
- the session takes a second of flight in less than half a second of processor time.
"""

import ctypes
import gc
import random
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gcs_sysid.live.live_session import LiveOptions, LiveSession
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.results.result import Result
from gcs_sysid.significance import Z95
from gcs_sysid.telemetry.link import Link, ReceivedBytes
from gcs_sysid.telemetry.tlog import TlogReader
from gcs_sysid.telemetry.urls import parse_url
from sim_bridge.playback import moments
from testbed.study import arguments, flown
from testbed.watched import resident

TRAPS = (
    "rpm-repeats", "rpm-signed", "quaternion-flips", "gyro-outliers=0.0005", "imu-frozen=0.005",
    "skips", "disorder", "wrap-us=20", "wrap-ms=30", "clock-drift=200", "reboot=30", "forwarded",
    "radio", "imu-nan=20:0.5", "imu-stuck=30:0.5", "attitude-nan=25:1", "rpm-stuck=40:1",
    "clock-jump=30:2",
)  # fmt: skip
FAULTS = (
    "loss=0.05", "bursts=0.05:5", "silence=20:2", "corrupt=0.01", "jitter", "reorder",
    "duplicate", "garbage=500", "forged", "flood=2000",
)  # fmt: skip
"""What the tool claims to bear, with sizes."""
MOST = 3
"""Of both kinds in one flight."""
NOT_SENT = ("ACTUATOR_OUTPUT_STATUS", "SERVO_OUTPUT_RAW", "ATTITUDE_QUATERNION")
SHOWN = ("Ixx", "Iyy", "Izz", "k_T", "k_M")
WRONG, WIDTHS = 5.0, 3.0
GROWN_MB, UNSETTLED_MB, SLOW = 20.0, 60.0, 0.5
SETTLED = 10
"""Rounds after which the heap has room for all that faults bring."""
_ADDRESS = ("10.0.0.1", 14550)
_AT_ONCE = 16
"""Datagrams given at a time."""


@dataclass(frozen=True)
class Round:
    """What came out of one flight.

    Attributes:
        drawn: traps and faults, as on the emulator's command line.
        seconds: of flight.
        processor: s that the session took.
        verdict: its.
        worst: largest error of a parameter in %, None without any.
        memory: MB.
        handles: files and sockets open.
        wrong: what was not as it should be, one line each.
    """

    drawn: tuple[str, ...]
    seconds: float
    processor: float
    verdict: str
    worst: float | None
    memory: float
    handles: int
    wrong: tuple[str, ...]


def draw(random_: random.Random) -> tuple[list[str], list[str]]:
    """Sensor faults and faults of the line of one flight."""
    every = [("trap", text) for text in TRAPS] + [("fault", text) for text in FAULTS]
    some = random_.sample(every, random_.randint(0, MOST))
    return [t for kind, t in some if kind == "trap"], [t for kind, t in some if kind == "fault"]


class Played(Link):
    """A recording as datagrams that are always there."""

    datagrams = True

    def __init__(self, recording: Path) -> None:
        super().__init__(parse_url("udpin:127.0.0.1:14550"))
        self._rest: Iterator[tuple[float, list[bytes]]] = moments(TlogReader(recording))

    def receive(self, timeout: float) -> list[ReceivedBytes]:
        """The next few."""
        del timeout
        chunks = []
        for _, frames in self._rest:
            chunks.append(ReceivedBytes(b"".join(frames), _ADDRESS))
            if len(chunks) == _AT_ONCE:
                return chunks
        self.ended = True
        return chunks

    def send(self, data: bytes) -> None:
        """Nobody listens."""

    def close(self) -> None:
        """Nothing to give back."""


def open_handles() -> int:
    """Files and sockets of this process."""
    return len(list(Path("/proc/self/fd").iterdir()))


def wrong_numbers(result: Result, truth: dict[str, Any]) -> tuple[float | None, list[str]]:
    """The largest error in %, and a line for each parameter that is wrong and does not say so."""
    worst, lines = None, []
    for name in SHOWN:
        estimate = result.parameters.get(name)
        if estimate is None or estimate.value is None or estimate.std is None:
            continue
        share = 100.0 / abs(truth[name])
        error, half = share * abs(estimate.value - truth[name]), Z95 * share * estimate.std
        worst = max(worst or 0.0, error)
        if result.verdict != "refused" and error > max(WRONG, WIDTHS * half):
            lines.append(f"{name} is wrong by {error:.1f} % and says {half:.1f} %")
    return worst, lines


def emulate(folder: Path, seed: int, trapped: list[str], faulty: list[str]) -> tuple[Path, Any]:
    """Fly once; the recording and what is true."""
    words = ["--rate", "1000", "--seed", str(seed)]
    words += [word for name in NOT_SENT for word in ("--trap", f"never-sent={name}")]
    words += [word for text in trapped for word in ("--trap", text)]
    return flown([*words, *(w for text in faulty for w in ("--fault", text))], folder)


def fly(folder: Path, seed: int) -> Round:
    """One round."""
    trapped, faulty = draw(random.Random(seed))
    log, truth = emulate(folder, seed, trapped, faulty)
    record = folder / "own.tlog"
    record.unlink(missing_ok=True)
    wrong = []
    began = time.process_time()
    session = LiveSession(
        Played(log),
        load_airframe("paper"),
        LiveOptions(rate=1000.0, refit_interval=0.5, predict=False),
        record_to=record,
    )
    session.start()
    session.join()
    spent = time.process_time() - began
    result, problem = session.final, session.problem
    assert result is not None
    del session
    gc.collect()
    if problem is not None:
        wrong.append(f"{type(problem).__name__}: {problem}")
    worst, lines = wrong_numbers(result, truth)
    seconds = float(result.telemetry["duration"])
    if spent > SLOW * max(seconds, 1.0):
        wrong.append(f"{seconds:.0f} s of flight took {spent:.0f} s of processor time")
    if not record.exists() or record.stat().st_size < 0.5 * log.stat().st_size:
        wrong.append("the recording is not whole")
    return Round(
        (*trapped, *faulty), seconds, spent, result.verdict, worst,
        1e-6 * in_use(), open_handles(), (*wrong, *lines),
    )  # fmt: skip


def in_use() -> float:
    """Bytes in memory once the allocator has given back what is free.

    A heap keeps the peak of its temporaries in pieces: 100 to 270 MB where 95 are in use.
    """
    with suppress(OSError, AttributeError):  # glibc alone has it
        ctypes.CDLL(None).malloc_trim(0)
    return float(resident())


def reference(rounds: Sequence[Round]) -> Round:
    """The round that memory and handles of the last are compared with."""
    return rounds[SETTLED - 1 if len(rounds) >= SETTLED else min(1, len(rounds) - 1)]


def against(first: Round, now: Round, room: float = GROWN_MB) -> list[str]:
    """What has grown since an earlier round, memory by more than `room` MB."""
    lines = []
    if now.memory - first.memory > room:
        lines.append(f"memory grew by {now.memory - first.memory:.1f} MB")
    if now.handles > first.handles:
        lines.append(f"{now.handles - first.handles} more files or sockets are open")
    return lines


def main() -> int:
    """Fly until the minutes are over."""
    parser = arguments(__doc__)
    parser.add_argument("--minutes", type=float, default=60.0, help="default: 60")
    parser.add_argument("--flights", type=int, help="so many flights of a minute, and no minutes")
    parser.add_argument("--seed", type=int, default=1, help="of the first round (default: 1)")
    options = parser.parse_args()
    until = time.monotonic() + 60.0 * options.minutes
    rounds: list[Round] = []

    def goes_on() -> bool:
        if options.flights is not None:
            return len(rounds) < options.flights
        return not rounds or time.monotonic() < until

    bad = 0
    print(f"{'seed':<6}{'flight':>8}{'load':>7}{'MB':>8}{'open':>6}  verdict, worst error, drawn")
    with tempfile.TemporaryDirectory() as folder:
        while goes_on():
            seed = options.seed + len(rounds)
            now = fly(Path(folder), seed)
            rounds.append(now)
            worst = "-" if now.worst is None else f"{now.worst:.1f} %"
            print(
                f"{seed:<6}{now.seconds:>6.0f} s{100 * now.processor / now.seconds:>5.0f} %"
                f"{now.memory:>8.1f}{now.handles:>6}  {now.verdict}, {worst}, "
                f"{' '.join(now.drawn) or 'nothing'}",
                flush=True,
            )
            room = GROWN_MB if len(rounds) > SETTLED else UNSETTLED_MB
            for line in (*now.wrong, *against(reference(rounds), now, room)):
                bad += 1
                print(f"      WRONG: {line}", flush=True)
    flown = sum(each.seconds for each in rounds)
    print(
        f"{len(rounds)} flights, {flown / 3600.0:.2f} h; {bad} things wrong; "
        f"session {100 * sum(r.processor for r in rounds) / flown:.0f} % of a core in real time; "
        f"memory {reference(rounds).memory:.1f} to {rounds[-1].memory:.1f} MB"
    )
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
