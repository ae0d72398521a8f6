"""A recording played over UDP to the live tool, which is watched: what it said and what it took."""

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from testbed.study import arguments, free_port
from testbed.watched import LEVELS, take_core

SETTLED_AFTER = 120.0
"""s, after which memory must not grow."""
LATE_MS = 10.0
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
        watched: more options of `testbed.watched`.
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
                *(sys.executable, "-m", "testbed.watched", str(self._times)),
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


def rows_of_times(times: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Those of what `testbed.watched` tells."""
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
