"""How fast logs are read, side by side with other readers: `make bench-speed`.

Makes one long log (an emulated flight, repeated; kept under build/) and reads it, and the
recorded flights in ../shared/logs where these are, with each reader in a process of its own.
All are asked for the same four message types. Times are of the processor, without start-up, the
least of several turns, in which all readers take part by turns; only their ratios mean anything.
"""

import argparse
import importlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from testbed.study import arguments

PROJECT = Path(__file__).resolve().parents[1]
FOUR = ("HIGHRES_IMU", "ATTITUDE", "ESC_STATUS", "LOCAL_POSITION_NED")
MEGABYTE = 1_000_000


class Measured(NamedTuple):
    """What one reader did with one log."""

    seconds: float
    """Processor time."""
    peak: float
    """Bytes of memory at most, interpreter and libraries included."""
    messages: int | None
    """Messages of the four types; None where the reader does not report them."""
    longest: float = 0.0
    """Processor time of the process that takes most, where there are two; else 0."""


def read_file(path: str) -> None:
    """Only read the bytes."""
    with open(path, "rb") as file:
        while file.read(2**21):
            pass


def read_decoder(path: str) -> int:
    """Structured arrays of the whole log."""
    from gcs_sysid.telemetry.tlog import read_messages

    messages, _ = read_messages(path, FOUR)
    return sum(map(len, messages.values()))


def read_windows(path: str) -> int:
    """The same, window by window, keeping nothing."""
    from gcs_sysid.telemetry.tlog import read_tlog

    return sum(len(rows) for part in read_tlog(path).messages(FOUR) for rows in part.values())


def read_records(path: str) -> None:
    """All that the analysis takes: chosen, checked, in SI units, as columns."""
    from gcs_sysid.telemetry.logs import open_log

    for _ in open_log(Path(path)).blocks():
        pass


def read_pymavlink(path: str) -> int:
    """With ESC_STATUS, which pymavlink's own dialects lack."""
    from pymavlink import mavutil

    from gcs_sysid.telemetry.dialect import mavlink

    mavutil.mavlink = mavlink
    log = mavutil.mavlink_connection(path)
    log.mav.robust_parsing = True
    count = 0
    while log.recv_match(type=list(FOUR)) is not None:
        count += 1
    return count


def read_pyulog(path: str) -> None:
    """The topics that the chain takes."""
    from pyulog import ULog

    from gcs_sysid.telemetry.ulog import READ

    ULog(path, sorted(READ))


def read_dataflash(path: str) -> None:
    """Pymavlink's reader of .bin, for the entries that the chain takes most of."""
    from pymavlink.DFReader import DFReader_binary

    log = DFReader_binary(path)
    while log.recv_match(type=["IMU", "ATT", "RCOU", "XKF1", "ESC"]) is not None:
        pass


def read_fasttlogparser(path: str) -> int:
    """C++ behind pybind11."""
    import fasttlogparser

    messages, _ = fasttlogparser.parseTLog(path, whitelist=list(FOUR))
    return sum(len(next(iter(fields.values()))) for fields in messages.values())


def read_mavpose(path: str) -> int:
    """Pandas on pymavlink; it reads all types."""
    import mavpose

    log = mavpose.load(path)
    return sum(len(log.frame(name)) for name in FOUR if name in log)


def read_analyze(path: str) -> None:
    """The whole `gcs-sysid analyze`."""
    from gcs_sysid.__main__ import main

    # 1: the flights allow no answer, which is no less work.
    if main(["analyze", path, "--airframe", "paper", "--json", os.devnull]) not in (0, 1):
        raise RuntimeError("analyze did not take the log")


class Reader(NamedTuple):
    """One line of the table."""

    title: str
    read: Callable[[str], int | None]
    needs: tuple[str, ...]
    """Modules loaded before the clock starts."""
    once: bool = False
    """Whether it takes so long that one turn must do."""
    long_only: bool = False
    """Whether it reads the long log alone."""
    kinds: tuple[str, ...] = (".tlog",)
    """Of logs that it reads."""


READERS = {
    "file": Reader("reading the file", read_file, (), kinds=(".tlog", ".ulg", ".bin")),
    "decoder": Reader("this decoder, whole", read_decoder, ("gcs_sysid.telemetry.tlog",)),
    "windows": Reader("this decoder, windows", read_windows, ("gcs_sysid.telemetry.tlog",)),
    "records": Reader(
        "records of the chain",
        read_records,
        ("gcs_sysid.telemetry.logs",),
        kinds=(".tlog", ".ulg", ".bin"),
    ),
    "pyulog": Reader(
        "pyulog", read_pyulog, ("pyulog", "gcs_sysid.telemetry.ulog"), kinds=(".ulg",)
    ),
    "DFReader": Reader(
        "pymavlink's DFReader", read_dataflash, ("pymavlink.DFReader",), once=True, kinds=(".bin",)
    ),
    "fasttlogparser": Reader("fasttlogparser", read_fasttlogparser, ("fasttlogparser",)),
    "pymavlink": Reader(
        "pymavlink", read_pymavlink, ("pymavlink.mavutil", "gcs_sysid.telemetry.dialect"), once=True
    ),
    "mavpose": Reader("mavpose", read_mavpose, ("mavpose",), once=True),
    "analyze": Reader(
        "gcs-sysid analyze",
        read_analyze,
        ("gcs_sysid.cli.analyze_command",),
        once=True,
        long_only=True,
    ),
}


def read_here(name: str, path: str) -> None:
    """Read a log in this process and print what it took."""
    reader = READERS[name]
    for module in reader.needs:
        importlib.import_module(module)
    # Some print; the last line is ours.
    began, others = time.process_time(), _of_children()
    messages = reader.read(path)
    own, other = time.process_time() - began, _of_children() - others
    longest = max(own, other) if other else 0.0
    measured = Measured(own + other, peak_memory(), messages, longest)
    print(json.dumps(measured._asdict()))


def _of_children() -> float:
    """S of processor time of the processes started here that have ended."""
    try:
        import resource
    except ImportError:
        return 0.0
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def peak_memory() -> float:
    """Bytes of memory that this process has held at most."""
    try:
        # Since the program was loaded; getrusage includes the parent's.
        status = Path("/proc/self/status").read_text()
        return 1024.0 * int(status.split("VmHWM:")[1].split()[0])
    except OSError:
        import resource

        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return float(peak) * (1 if sys.platform == "darwin" else 1024)


def measure(name: str, path: Path) -> Measured | str:
    """Read a log in a new process; its last line of trouble if that fails."""
    # Without this, pymavlink turns what it reads into version 1.
    environment = {**os.environ, "MAVLINK20": "1", "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "benchmarks.speed", "--read", name, str(path)]
    done = subprocess.run(
        command, check=False, capture_output=True, text=True, env=environment, cwd=PROJECT
    )
    if done.returncode:
        said = done.stderr.strip().splitlines()
        return said[-1] if said else f"exit status {done.returncode}"
    return Measured(**json.loads(done.stdout.splitlines()[-1]))


def compare(path: Path, names: list[str], repeats: int, *, long: bool) -> dict[str, Measured | str]:
    """The least of every reader's turns, or why it has none."""
    best: dict[str, Measured | str] = {}
    for turn in range(repeats):
        for name in names:
            reader = READERS[name]
            if (turn and reader.once) or (reader.long_only and not long):
                continue
            if path.suffix not in reader.kinds:
                continue
            seen = best.get(name)
            if isinstance(seen, str):
                continue
            now = measure(name, path)
            if seen is None or isinstance(now, str):
                best[name] = now
            else:
                peak = max(seen.peak, now.peak)
                best[name] = min(seen, now)._replace(peak=peak)
    return best


def table(path: Path, measured: dict[str, Measured | str]) -> list[str]:
    """Lines that compare the readers on one log."""
    size = path.stat().st_size
    lines = [
        f"{path.name}, {size / MEGABYTE:.1f} MB",
        f"{'':<24}{'s':>8}{'of the four':>13}{'MB/s':>8}{'x pymavlink':>13}{'x file':>8}"
        f"{'peak MB':>9}{'x size':>8}",
    ]
    found = {name: m for name, m in measured.items() if isinstance(m, Measured)}
    for name, m in measured.items():
        title = READERS[name].title
        if isinstance(m, str):
            lines.append(f"{title:<24}  left out: {m}")
            continue
        pymavlink, file = found.get("pymavlink"), found.get("file")
        faster = f"{pymavlink.seconds / m.seconds:.1f}" if pymavlink else "-"
        slower = f"{m.seconds / file.seconds:.1f}" if file else "-"
        messages = "-" if m.messages is None else str(m.messages)
        lines.append(
            f"{title:<24}{m.seconds:>8.2f}{messages:>13}{size / MEGABYTE / m.seconds:>8.0f}"
            f"{faster:>13}{slower:>8}{m.peak / MEGABYTE:>9.0f}{m.peak / size:>8.1f}"
        )
    return lines


BARS = {
    "decoder, x pymavlink": 15.0,
    "decoder, x fasttlogparser": 1.0,
    "analyze, x pymavlink": 5.0,
}
_BESIDE = "analyze, its longer process, x pymavlink"


def verdicts(path: Path, measured: dict[str, Measured | str]) -> list[str]:
    """What must hold on the long log, beside what was measured."""
    seconds = {name: m.seconds for name, m in measured.items() if isinstance(m, Measured)}
    lines = []
    for what, bar in BARS.items():
        reader, other = what.split(", x ")
        if reader in seconds and other in seconds:
            times = seconds[other] / seconds[reader]
            lines.append(f"{what:<40}{times:>9.1f}   at least {bar:.0f}")
    analyze = measured.get("analyze")
    if isinstance(analyze, Measured) and analyze.longest and "pymavlink" in seconds:
        lines.append(f"{_BESIDE:<40}{seconds['pymavlink'] / analyze.longest:>9.1f}   at least 10")
    decoder = measured.get("decoder")
    if isinstance(decoder, Measured):
        most = 3.5 * path.stat().st_size / MEGABYTE + 120.0
        peak = decoder.peak / MEGABYTE
        lines.append(f"{'decoder, peak MB':<40}{peak:>9.0f}   at most {most:.0f}")
    return lines


def main() -> None:
    """Print a table for each log."""
    parser = arguments(__doc__)
    parser.add_argument("--size", type=float, default=200.0, metavar="MB", help="of the long log")
    parser.add_argument("--repeats", type=int, default=3, metavar="N", help="turns, each of all")
    parser.add_argument("--only", nargs="+", choices=READERS, default=[*READERS])
    parser.add_argument("--folder", type=Path, default=PROJECT.parent / "shared" / "logs")
    parser.add_argument("--cache", type=Path, default=PROJECT / "build", help="for the long log")
    parser.add_argument("--read", nargs=2, metavar=("READER", "LOG"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.read:
        read_here(*options.read)
        return
    from benchmarks.speed_log import long_log

    size = round(options.size * MEGABYTE)
    log = long_log(options.cache / f"speed-{size}.tlog", size)
    measured = compare(log, options.only, options.repeats, long=True)
    print("\n".join([*table(log, measured), "", *verdicts(log, measured)]), flush=True)
    logs = (path for path in options.folder.rglob("*") if path.suffix in (".tlog", ".ulg", ".bin"))
    for recorded in sorted(logs):
        rows = compare(recorded, options.only, options.repeats, long=False)
        print("\n".join(["", *table(recorded, rows)]), flush=True)


if __name__ == "__main__":
    main()
