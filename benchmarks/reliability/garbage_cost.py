"""What garbage in logs costs: processor time per megabyte against a clean log's.

python -m benchmarks.reliability.garbage_cost --folder ../shared/logs

Into the middle of a log of each kind go megabytes of one pattern; times are of opening and reading
all records. The clean log and the one with garbage take turns, and the least of each counts.
"""

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from random import Random

from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.logs import open_log

LOGS = {
    ".tlog": "ap_euler_two_flights.tlog",
    ".ulg": "px4-sih-default.ulg",
    ".bin": "ardupilot-sitl.bin",
    ".BFL": "real/LOG00281.BFL",
}
MOST = 8_000_000
"""Bytes that are taken of a log."""


def _drawn(letters: bytes, size: int = 2**20) -> bytes:
    """So many letters by chance."""
    return bytes(Random(1).choices(letters, k=size))


PATTERNS = {
    "FD": b"\xfd", "FE": b"\xfe", "FD 09 00 00": b"\xfd\x09\0\0", "FE 00": b"\xfe\0",
    "00": b"\0", "00 00 5A": b"\0\0\x5a", "D": b"D", "A3 95": b"\xa3\x95",
    "A3 95 80": b"\xa3\x95\x80", "A3 95 01": b"\xa3\x95\x01", "I": b"I", "P": b"P",
    "IE": b"IE", "H ": b"H ", "S": b"S", "PPE": b"PPE", "IPSE": b"IPSE",
    "IPSE drawn": _drawn(b"IPSE"), "P I 80 0 drawn": _drawn(b"PI\x80\0"),
    "IPGHSE drawn": _drawn(b"IPGHSE"), "I P drawn": _drawn(b"IP"), "S E drawn": _drawn(b"SE"),
    "S 0 drawn": _drawn(b"S\0"), "S S 80 drawn": _drawn(b"SS\x80"),
    "P FF drawn": _drawn(b"P\xff"), "P 5x80 drawn": _drawn(b"P\x80\x80\x80\x80\x80"),
    "I P 80 to FF": _drawn(b"IP\x80\x81\xfe\xff"), "E FF drawn": _drawn(b"E\xff"),
    "E events": _drawn(b"EEEEE\x0e\x0e\x0d\x0d\x1e\x1e"),
    **{f"IPSE of {period}": _drawn(b"IPSE", period) for period in (13, 345, 839, 841, 3001)},
}  # fmt: skip


TURNS = 3


def measure(path: Path, contents: Sequence[bytes]) -> list[tuple[float, int]]:
    """Ms of processor time per megabyte, and IMU samples, of logs that take turns."""
    least, samples = [float("inf")] * len(contents), [0] * len(contents)
    for _ in range(TURNS):
        for i, content in enumerate(contents):
            path.write_bytes(content)
            began = time.process_time()
            blocks = list(open_log(path).blocks())
            least[i] = min(least[i], (time.process_time() - began) / len(content) * 1e9)
            tracks = [track for block in blocks for track in block.tracks]
            samples[i] = sum(len(track.t) for track in tracks if track.stream is Stream.IMU)
    return list(zip(least, samples, strict=True))


def main() -> None:
    """Print a row for each pattern."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.reliability.garbage_cost")
    parser.add_argument("--folder", type=Path, default=Path("../shared/logs"))
    parser.add_argument("--megabytes", type=float, default=20.0, help="of garbage")
    options = parser.parse_args()
    table: dict[str, list[str]] = {name: [] for name in ("clean, ms/MB", *PATTERNS)}
    with tempfile.TemporaryDirectory() as folder:
        for suffix, name in LOGS.items():
            data = (options.folder / name).read_bytes()[:MOST]
            path = Path(folder) / f"log{suffix}"
            cheapest = float("inf")
            for what, pattern in PATTERNS.items():
                size = round(options.megabytes * 1e6)
                garbage = (pattern * (size // len(pattern) + 1))[:size]
                half = len(data) // 2
                hurt = data[:half] + garbage + data[half:]
                (clean, samples), (cost, found) = measure(path, (data, hurt))
                lost = f" ({samples - found} lost)" if found < samples - 1 else ""
                table[what].append(f"{cost / clean:.2f}{lost}")
                cheapest = min(cheapest, clean)
            table["clean, ms/MB"].append(f"{cheapest:.1f}")
    print(f"{'':<14}" + "".join(f"{suffix:>20}" for suffix in LOGS))
    for what, cells in table.items():
        print(f"{what:<14}" + "".join(f"{cell:>20}" for cell in cells), flush=True)


if __name__ == "__main__":
    main()
