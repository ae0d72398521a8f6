"""A fast link for minutes on one core: nothing lost, nothing late, no more memory.

    python -m benchmarks.reliability.rate [--minutes 10] [--core 1]

The emulator flies in advance, at 1 kHz HIGHRES_IMU, 500 Hz ESC_STATUS, 100 Hz ATTITUDE and
ACTUATOR_OUTPUT_STATUS, 50 Hz LOCAL_POSITION_NED and the usual rest, and writes a recording. That
is played in real time over UDP (`sim_bridge --play`) to `gcs-sysid live --headless`, which records
as it always does and runs on one core.

Lost is what was sent and is not in the tool's count, by numbers sent and by sequence numbers. The
times are those of `benchmarks.reliability.watched`: from the system's stamp on a datagram's arrival
until all that was handed over with it is processed, and the estimate renewed where that is due
(each 0.5 s of the vehicle's clock); the latter are told apart too. The grid stays 0.04 s behind the
newest stamp by design; that is no delay of the processor, and not counted.
"""

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.reliability.watched import LEVELS, take_core
from testbed.ground_cycles import FAST, emulate, flights_in
from testbed.study import arguments, free_port

SETTLED_AFTER = 120.0
"""s, after which memory must not grow."""
LATE_MS, GROWN_MB = 10.0, 5.0
BARRED = 99.0
"""%, the percentile that must not be late."""
_STARTS, _DRAINS = 60.0, 1.5
"""s at most for the tool to listen, and to take what is left."""


class Run(NamedTuple):
    """What the tool said and what was seen of it."""

    result: dict[str, Any]
    times: dict[str, Any]
    errors: str


class Tool:
    """`gcs-sysid live --headless`, watched, in a process of its own.

    Args:
        folder: for its files.
        core: it runs on; None: any.
        alone: whether no other program gets that core before it.
        words: more of its command line.
        watched: more options of `benchmarks.reliability.watched`.
    """

    def __init__(
        self,
        folder: Path,
        core: int | None,
        *words: str,
        alone: bool = False,
        watched: Sequence[str] = (),
    ) -> None:
        self.port = free_port()
        self._result, self._times = folder / "result.jsonl", folder / "times.json"
        self._said = (folder / "said.txt").open("w+")
        pinned = [] if core is None else ["--core", str(core)]
        pinned += [*watched, "--alone"] if alone else watched
        self._process = subprocess.Popen(
            [
                *(sys.executable, "-m", "benchmarks.reliability.watched", str(self._times)),
                *(*pinned, "--", "live", f"udpin:127.0.0.1:{self.port}", "--headless"),
                *("--airframe", "paper", "--json", str(self._result), *words),
            ],
            stdout=subprocess.DEVNULL,
            stderr=self._said,
        )
        self._wait_until("listening on")

    def _wait_until(self, said: str) -> None:
        """Wait until it has said so."""
        until = time.monotonic() + _STARTS
        while said not in self.said():
            if self._process.poll() is not None or time.monotonic() > until:
                sys.exit(f"the tool does not start: {self.said()}")
            time.sleep(0.1)

    def said(self) -> str:
        """What it has written on standard error so far."""
        self._said.seek(0)
        return self._said.read()

    def end(self) -> Run:
        """Let it take what is left, end it as a user would, and read what it wrote."""
        time.sleep(_DRAINS)
        self._process.send_signal(signal.SIGINT)
        self._process.wait(timeout=60)
        errors = self.said()
        self._said.close()
        if not self._times.exists():
            sys.exit(errors)
        last = self._result.read_text().splitlines()[-1]
        return Run(json.loads(last), json.loads(self._times.read_text()), errors)


def play(recording: Path, port: int, core: int | None, *, alone: bool = False) -> int:
    """Play a recording to the end, on a core; how many frames were sent."""

    def pin() -> None:
        take_core(core, alone=alone)

    url = f"udpout:127.0.0.1:{port}"
    sender = subprocess.run(
        [sys.executable, "-m", "sim_bridge", "--play", str(recording), "--connect", url],
        check=True,
        capture_output=True,
        text=True,
        preexec_fn=pin if os.name == "posix" else None,
    )
    played = re.search(r"played (\d+) frames", sender.stderr)
    assert played is not None
    return int(played[1])


def growth(memory: list[tuple[float, int]], settled: float = SETTLED_AFTER) -> tuple[float, float]:
    """MB at most in the last minute, and how many more than when it had settled.

    A fit takes some MB for a moment and gives them back, so it is the highest of each minute that
    is compared with the first of them after all had settled.

    Args:
        memory: (s, bytes), rising in time.
        settled: s.
    """
    begin = min(settled, 0.5 * memory[-1][0])
    peaks: dict[int, float] = {}
    for t, size in memory:
        if t >= begin:
            minute = int((t - begin) // 60.0)
            peaks[minute] = max(peaks.get(minute, 0.0), 1e-6 * size)
    first, *_ = highest = list(peaks.values())
    return highest[-1], max(highest) - first


def parser_of(doc: str | None) -> argparse.ArgumentParser:
    """With what the studies on a link share."""
    parser = arguments(doc)
    last = max((os.cpu_count() or 2) - 1, 1)
    parser.add_argument("--core", type=int, default=last, help="of the tool (default: the last)")
    parser.add_argument(
        "--alone",
        action="store_true",
        help="keep the machine's other work off the cores of tool and sender: it runs ahead of "
        "all else (SCHED_FIFO), which root alone may ask for",
    )
    return parser


def table(rows: list[tuple[str, str, str]]) -> str:
    """What, measured, bar."""
    rows = [("what", "measured", "bar"), *rows]
    return "\n".join(f"{what:<58}{measured:>26}{bar:>12}" for what, measured, bar in rows)


def main() -> None:
    """Fly, play, print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, help="default: 10")
    parser.add_argument("--flight", type=Path, help="play this recording instead")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        flight = options.flight
        if flight is None:
            flight = folder / "flight.tlog"
            print("flying in advance", file=sys.stderr)
            emulate(flight, rates=FAST, flights=flights_in(60.0 * options.minutes))
        before = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
        words = ["--rate", "1000", "--record", str(folder / "own.tlog")]
        tool = Tool(folder, options.core, *words, alone=options.alone)
        print("playing", file=sys.stderr)
        sent = play(flight, tool.port, None if options.core == 0 else 0, alone=options.alone)
        run = tool.end()
        recorded = (folder / "own.tlog").stat().st_size
    print(table(rows_of(run, sent)))
    print(f"recorded {1e-6 * recorded:.1f} MB; load of the machine before: {before:.1f}")


def rows_of(run: Run, sent: int) -> list[tuple[str, str, str]]:
    """The table's."""
    told, times = run.result["telemetry"], run.times
    size, grown = growth(times["memory"])
    return [
        ("length of the flight", f"{told['duration']:.0f} s", ""),
        ("messages sent", f"{sent}", ""),
        ("not received, by their number", f"{sent - told['received']}", "0"),
        ("lost, by their sequence numbers", f"{told['lost']}", "0"),
        ("dropped by the system", f"{told['receiver']['kernel_drops']}", "0"),
        ("share of one core", f"{100 * times['processor']:.0f} %", ""),
        ("  of that, the receiver", f"{100 * times['receiver']:.0f} %", ""),
        ("data that waited at most", f"{told['receiver']['longest_wait']:.2f} s", ""),
        *rows_of_times(times),
        ("memory in the last minute", f"{size:.1f} MB", ""),
        ("growth since minute 2", f"{grown:.2f} MB", f"< {GROWN_MB:.0f} MB"),
    ]


def rows_of_times(times: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Those of what `benchmarks.reliability.watched` tells."""
    rows = [
        ("datagrams not taken", f"{times['not_taken']}", "0"),
        ("renewed estimates", f"{times['renewals']}", ""),
    ]
    for kind, what in (
        ("taken_ms", "datagram's arrival until it is taken"),
        ("renewed_ms", "the same of those that had an estimate renewed"),
    ):
        for level, ms in zip(LEVELS, times[kind], strict=False):
            bar = f"< {LATE_MS:.0f} ms" if kind == "taken_ms" and level == BARRED else ""
            rows.append((f"{what}, {level:g} %", f"{ms:.2f} ms", bar))
    return rows


if __name__ == "__main__":
    main()
