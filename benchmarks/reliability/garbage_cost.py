"""What garbage in logs costs: processor time per megabyte against a clean log's.

python -m benchmarks.reliability.garbage_cost --folder ../shared/logs

Into the middle of a log of each kind go megabytes of one pattern; times are of opening and reading
all records, the least of the turns; the clean log is read before each pattern.
"""

import argparse
import tempfile
import time
from pathlib import Path

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
PATTERNS = {
    "FD": b"\xfd", "FE": b"\xfe", "FD 09 00 00": b"\xfd\x09\0\0", "FE 00": b"\xfe\0",
    "00": b"\0", "00 00 5A": b"\0\0\x5a", "D": b"D", "A3 95": b"\xa3\x95",
    "A3 95 80": b"\xa3\x95\x80", "A3 95 01": b"\xa3\x95\x01", "I": b"I", "P": b"P",
    "IE": b"IE", "H ": b"H ",
}  # fmt: skip


TURNS = 3


def measure(path: Path, content: bytes) -> tuple[float, int]:
    """Ms of processor time per megabyte, and IMU samples."""
    path.write_bytes(content)
    times, samples = [], 0
    for _ in range(TURNS):
        began = time.process_time()
        blocks = list(open_log(path).blocks())
        times.append(time.process_time() - began)
        tracks = [track for block in blocks for track in block.tracks]
        samples = sum(len(track.t) for track in tracks if track.stream is Stream.IMU)
    return min(times) / len(content) * 1e9, samples


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
            cells: dict[str, tuple[float, str]] = {}
            clean, samples = measure(path, data)
            for what, pattern in PATTERNS.items():
                size = round(options.megabytes * 1e6)
                garbage = (pattern * (size // len(pattern) + 1))[:size]
                half = len(data) // 2
                cost, found = measure(path, data[:half] + garbage + data[half:])
                lost = f" ({samples - found} lost)" if found < samples - 1 else ""
                cells[what] = cost, lost
                clean = min(clean, measure(path, data)[0])
            table["clean, ms/MB"].append(f"{clean:.1f}")
            for what, (cost, lost) in cells.items():
                table[what].append(f"{cost / clean:.2f}{lost}")
    print(f"{'':<14}" + "".join(f"{suffix:>20}" for suffix in LOGS))
    for what, cells in table.items():
        print(f"{what:<14}" + "".join(f"{cell:>20}" for cell in cells), flush=True)


if __name__ == "__main__":
    main()
