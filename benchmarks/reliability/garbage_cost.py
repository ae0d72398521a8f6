"""What garbage in logs costs: processor time per megabyte against a clean log's.

python -m benchmarks.reliability.garbage_cost --folder ../shared/logs

Into the middle of a log of each kind go megabytes of one pattern; times are of opening and reading
all records, of the clean log and the one with garbage in turn.
"""

import tempfile
from pathlib import Path

from testbed.hostile_logs import PATTERNS, measure
from testbed.study import arguments

LOGS = {
    ".tlog": "ap_euler_two_flights.tlog",
    ".ulg": "px4-sih-default.ulg",
    ".bin": "ardupilot-sitl.bin",
    ".BFL": "real/LOG00281.BFL",
}
MOST = 8_000_000
"""Bytes that are taken of a log."""


def main() -> None:
    """Print a row for each pattern."""
    parser = arguments(__doc__)
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
                (clean, samples), (cost, found) = measure(path, data), measure(path, hurt)
                lost = f" ({samples - found} lost)" if found < samples - 1 else ""
                of_clean = clean / len(data)
                table[what].append(f"{cost / len(hurt) / of_clean:.2f}{lost}")
                cheapest = min(cheapest, 1e9 * of_clean)
            table["clean, ms/MB"].append(f"{cheapest:.1f}")
    print(f"{'':<14}" + "".join(f"{suffix:>20}" for suffix in LOGS))
    for what, cells in table.items():
        print(f"{what:<14}" + "".join(f"{cell:>20}" for cell in cells), flush=True)


if __name__ == "__main__":
    main()
