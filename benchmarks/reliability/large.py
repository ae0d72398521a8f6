"""Logs of gigabytes: what memory and processor time they take, by `gcs-sysid inspect`.

    python -m benchmarks.reliability.large --folder ../shared/logs --gigabytes 2

Recorded logs are repeated until they are as large as wanted: whole ones for .tlog and .bin, in
which the clock then goes back as after a reboot, the data section alone for .ulg. A file at a
time, which is deleted afterwards; `--analyze` identifies from it too.
"""

import argparse
import os
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from benchmarks.reliability.garbage_cost import LOGS

KINDS = (".tlog", ".ulg", ".bin")
MEGABYTE = 1_000_000
_HEADER, _DATA = 16, ord("D")


class Cost(NamedTuple):
    """What a command took."""

    status: int
    seconds: float
    peak: float
    """Bytes of memory at most."""
    said: str


def data_of_ulg(log: bytes) -> bytes:
    """The entries of a .ulg that hold samples, without its definitions."""
    at, parts = _HEADER, []
    while at + 3 <= len(log):
        size, kind = struct.unpack_from("<HB", log, at)
        if kind == _DATA:
            parts.append(log[at : at + 3 + size])
        at += 3 + size
    return b"".join(parts)


def pieces(kind: str, log: bytes) -> Iterator[bytes]:
    """A log, and what may follow it for ever."""
    yield log
    more = data_of_ulg(log) if kind == ".ulg" else log
    while True:
        yield more


def write(path: Path, kind: str, log: bytes, size: int) -> None:
    """Repeat a log in a file of at least so many bytes."""
    with open(path, "wb") as file:
        for piece in pieces(kind, log):
            file.write(piece)
            if file.tell() >= size:
                return


def cost_of(*words: str) -> Cost:
    """Run a command of the program."""
    with tempfile.TemporaryFile("w+") as said:
        process = subprocess.Popen(
            [sys.executable, "-m", "gcs_sysid", *words], stdout=said, stderr=said
        )
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        lines = said.read().strip().splitlines()
    peak = usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    seconds = usage.ru_utime + usage.ru_stime
    return Cost(process.returncode, seconds, float(peak), lines[-1] if lines else "")


def main() -> None:
    """Print a row for each log and command."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.reliability.large")
    parser.add_argument("--folder", type=Path, default=Path("../shared/logs"))
    parser.add_argument("--gigabytes", type=float, default=2.0)
    parser.add_argument("--scratch", type=Path, help="folder for the logs (default: temporary)")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=[*KINDS])
    parser.add_argument("--analyze", action="store_true", help="identify too")
    options = parser.parse_args()
    print(f"{'log':<8}{'MB':>8}  {'command':<10}{'exit':>5}{'s':>9}{'s/MB':>8}{'peak MB':>9}")
    for kind in options.kinds:
        with tempfile.TemporaryDirectory(dir=options.scratch) as folder:
            path = Path(folder) / f"large{kind}"
            log = (options.folder / LOGS[kind]).read_bytes()
            write(path, kind, log, round(options.gigabytes * 1e9))
            megabytes = path.stat().st_size / MEGABYTE
            commands = [["inspect", str(path)]]
            if options.analyze:
                words = ["analyze", str(path), "--airframe", "px4-quad-x", "--arm", "0.25"]
                commands.append([*words, "--mass", "1.5", "--json", os.devnull])
            for words in commands:
                cost = cost_of(*words)
                print(
                    f"{kind:<8}{megabytes:>8.0f}  {words[0]:<10}{cost.status:>5}"
                    f"{cost.seconds:>9.1f}{cost.seconds / megabytes:>8.3f}"
                    f"{cost.peak / MEGABYTE:>9.0f}",
                    flush=True,
                )
                if cost.status not in (0, 1):
                    print(f"  {cost.said}")


if __name__ == "__main__":
    main()
