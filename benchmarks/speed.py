"""How fast logs are read, side by side with other readers: `make bench-speed`.

Makes one long log (an emulated flight, repeated; kept under build/) and reads it, and the
recorded flights in ../shared/logs where these are, with each reader in a process of its own.
Of a .tlog all are asked for the same four message types. Times are of the processor, without
start-up, the least of several turns, in which all readers take part by turns; only their ratios
mean anything.
"""

import argparse
import importlib
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from testbed.study import PROJECT, arguments, run

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
    from gcs_sysid.telemetry.tlog import TlogReader

    return sum(len(rows) for part in TlogReader(path).messages(FOUR) for rows in part.values())


def read_records(path: str) -> None:
    """All that the analysis takes: chosen, checked, in SI units, as columns."""
    from gcs_sysid.telemetry.logs import open_log

    for _ in open_log(Path(path)).blocks():
        pass


def read_pymavlink(path: str) -> int:
    """With ESC_STATUS, which pymavlink's own dialects lack."""
    os.environ["MAVLINK20"] = "1"  # otherwise what it reads is turned into version 1
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


def read_orangebox(path: str) -> None:
    """Every field of the first session of a blackbox log."""
    import logging

    from orangebox import Parser

    logging.disable(logging.CRITICAL)  # it warns of every header that it misses
    for _ in Parser.load(path).frames():
        pass


def read_frames(path: str) -> None:
    """The same by our reader."""
    from gcs_sysid.telemetry import blackbox_format, blackbox_frames

    data = Path(path).read_bytes()
    start, stop = blackbox_format.session_starts(data)[:2]
    header = blackbox_format.read_header(data, start, stop)
    blackbox_frames.read_frames(data, header, stop)


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
    """One line of the table.

    Attributes:
        title: as printed.
        read: a log of that path; messages of the four types, where the reader reports them.
        needs: modules loaded before the clock starts.
        kinds: of logs that it reads.
        once: it takes so long that one turn must do.
        long_only: it reads the long log alone.
    """

    title: str
    read: Callable[[str], int | None]
    needs: tuple[str, ...] = ()
    kinds: tuple[str, ...] = (".tlog",)
    once: bool = False
    long_only: bool = False


_BLACKBOX = (".bbl", ".bfl")
KINDS = (".tlog", ".ulg", ".bin", *_BLACKBOX)
_OURS = "gcs_sysid.telemetry"
READERS = {
    "file": Reader("reading the file", read_file, kinds=KINDS),
    "decoder": Reader("this decoder, whole", read_decoder, (f"{_OURS}.tlog",)),
    "windows": Reader("this decoder, windows", read_windows, (f"{_OURS}.tlog",)),
    "frames": Reader(
        "frames, every field", read_frames, (f"{_OURS}.blackbox_frames",), _BLACKBOX
    ),
    "records": Reader("records of the chain", read_records, (f"{_OURS}.logs",), KINDS),
    "pyulog": Reader("pyulog", read_pyulog, ("pyulog", f"{_OURS}.ulog"), (".ulg",)),
    "DFReader": Reader(
        "pymavlink's DFReader", read_dataflash, ("pymavlink.DFReader",), (".bin",), once=True
    ),
    "orangebox": Reader("orangebox", read_orangebox, ("orangebox",), _BLACKBOX, once=True),
    "fasttlogparser": Reader("fasttlogparser", read_fasttlogparser, ("fasttlogparser",)),
    "pymavlink": Reader(
        "pymavlink", read_pymavlink, ("pymavlink.mavutil", f"{_OURS}.dialect"), once=True
    ),
    "mavpose": Reader("mavpose", read_mavpose, ("mavpose",), once=True),
    "analyze": Reader(
        "gcs-sysid analyze", read_analyze, ("gcs_sysid.cli.analyze_command",), once=True,
        long_only=True,
    ),
}  # fmt: skip


def read_here(name: str, path: str) -> None:
    """Read a log in this process and print what it took."""
    reader = READERS[name]
    for module in reader.needs:
        importlib.import_module(module)
    began = time.process_time()
    messages = reader.read(path)
    # Some print; the last line is ours.
    print(json.dumps([time.process_time() - began, messages]))


def measure(name: str, path: Path) -> Measured | str:
    """Read a log in a new process; its last line of trouble if that fails."""
    done = run(("benchmarks.speed", "--read", name, str(path)))
    if done.status:
        said = done.said.strip().splitlines()
        return said[-1] if said else f"exit status {done.status}"
    seconds, messages = json.loads(done.told.splitlines()[-1])
    return Measured(seconds, done.peak, messages)


def compare(path: Path, names: list[str], repeats: int, *, long: bool) -> dict[str, Measured | str]:
    """The least of every reader's turns, or why it has none."""
    best: dict[str, Measured | str] = {}
    for turn in range(repeats):
        for name in names:
            reader, seen = READERS[name], best.get(name)
            left_out = (turn and reader.once) or (reader.long_only and not long)
            if left_out or path.suffix.lower() not in reader.kinds or isinstance(seen, str):
                continue
            now = measure(name, path)
            if seen is None or isinstance(now, str):
                best[name] = now
            else:
                best[name] = min(seen, now)._replace(peak=max(seen.peak, now.peak))
    return best


def table(path: Path, measured: dict[str, Measured | str]) -> list[str]:
    """Lines that compare the readers on one log."""
    size = path.stat().st_size
    found = {name: m.seconds for name, m in measured.items() if isinstance(m, Measured)}
    other = next((n for n in ("pymavlink", "pyulog", "DFReader", "orangebox") if n in found), "")
    lines = [
        f"{path.name}, {size / MEGABYTE:.1f} MB",
        f"{'':<24}{'s':>8}{'of the four':>13}{'MB/s':>8}{f'x {other}' if other else '':>13}"
        f"{'x file':>8}{'peak MB':>9}{'x size':>8}",
    ]
    for name, m in measured.items():
        title = READERS[name].title
        if isinstance(m, str):
            lines.append(f"{title:<24}  left out: {m}")
            continue
        faster = f"{found[other] / m.seconds:.1f}" if other else "-"
        slower = f"{m.seconds / found['file']:.1f}" if found.get("file") else "-"
        messages = "-" if m.messages is None else str(m.messages)
        lines.append(
            f"{title:<24}{m.seconds:>8.2f}{messages:>13}{size / MEGABYTE / m.seconds:>8.0f}"
            f"{faster:>13}{slower:>8}{m.peak / MEGABYTE:>9.0f}{m.peak / size:>8.1f}"
        )
    return lines


BARS = {("decoder", "pymavlink"): 15, ("decoder", "fasttlogparser"): 1, ("analyze", "pymavlink"): 5}
"""Reader, other reader, and times the other's speed at least."""


def verdicts(path: Path, measured: dict[str, Measured | str]) -> list[str]:
    """What must hold on the long log, beside what was measured."""
    found = {name: m for name, m in measured.items() if isinstance(m, Measured)}
    rows = [
        (f"{ours}, x {other}", found[other].seconds / found[ours].seconds, f"at least {bar}")
        for (ours, other), bar in BARS.items()
        if ours in found and other in found
    ]
    if "decoder" in found:
        most = 3.5 * path.stat().st_size / MEGABYTE + 120.0
        rows.append(("decoder, peak MB", found["decoder"].peak / MEGABYTE, f"at most {most:.0f}"))
    return [
        f"{what:<42}{value:>7.{0 if 'MB' in what else 1}f}   {bar}" for what, value, bar in rows
    ]


def main() -> None:
    """Print a table for each log."""
    parser = arguments(__doc__)
    parser.add_argument("--size", type=float, default=200.0, metavar="MB", help="of the long log")
    parser.add_argument("--repeats", type=int, default=3, metavar="N", help="turns, each of all")
    parser.add_argument("--only", nargs="+", choices=READERS, default=[*READERS])
    parser.add_argument(
        "--logs", "--folder", nargs="+", type=Path, default=[PROJECT.parent / "shared" / "logs"],
        help="recorded logs, or folders of them",
    )  # fmt: skip
    parser.add_argument("--cache", type=Path, default=PROJECT / "build", help="for the long log")
    parser.add_argument("--read", nargs=2, metavar=("READER", "LOG"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.read:
        read_here(*options.read)
        return
    from benchmarks.speed_log import long_log

    if options.size:
        size = round(options.size * MEGABYTE)
        log = long_log(options.cache / f"speed-{size}.tlog", size)
        measured = compare(log, options.only, options.repeats, long=True)
        print("\n".join([*table(log, measured), "", *verdicts(log, measured)]), flush=True)
    paths = (
        f for given in options.logs for f in ([given] if given.is_file() else given.rglob("*"))
    )
    for recorded in sorted(path for path in paths if path.suffix.lower() in KINDS):
        rows = compare(recorded, options.only, options.repeats, long=False)
        print("\n".join(["", *table(recorded, rows)]), flush=True)


if __name__ == "__main__":
    main()
