"""Logs of gigabytes: what memory and processor time they take, by `gcs-sysid inspect`.

    python -m benchmarks.reliability.large --folder ../shared/logs --gigabytes 2

Recorded logs are repeated until they are as large as wanted: whole ones for .tlog and .bin, in
which the clock then goes back as after a reboot, the data section alone for .ulg. A file at a
time, which is deleted afterwards; `--analyze` identifies from it too.
"""

import os
import struct
import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.reliability.garbage_cost import LOGS
from testbed.study import arguments, run

KINDS = (".tlog", ".ulg", ".bin")
MEGABYTE = 1_000_000
_HEADER, _DATA = 16, ord("D")


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


def main() -> None:
    """Print a row for each log and command."""
    parser = arguments(__doc__)
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
                cost = run(("gcs_sysid", *words))
                print(
                    f"{kind:<8}{megabytes:>8.0f}  {words[0]:<10}{cost.status:>5}"
                    f"{cost.seconds:>9.1f}{cost.seconds / megabytes:>8.3f}"
                    f"{cost.peak / MEGABYTE:>9.0f}",
                    flush=True,
                )
                if cost.status not in (0, 1):
                    print(f"  {cost.said.strip()}")


if __name__ == "__main__":
    main()
