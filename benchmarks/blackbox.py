"""How fast blackbox logs are read, beside orangebox, and whether every value is the same.

    python -m benchmarks.blackbox FILE...

Both read by turns, in one process. Times are of the processor, the medians of several turns.
"""

import logging
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from orangebox import Parser

from gcs_sysid.telemetry.blackbox import read_blackbox
from gcs_sysid.telemetry.blackbox_format import read_header, session_starts
from gcs_sysid.telemetry.blackbox_frames import BlackboxFrames, read_frames
from testbed.study import arguments


def whole(path: Path) -> BlackboxFrames:
    """Every field of the first session."""
    data = path.read_bytes()
    start, stop = session_starts(data)[:2]
    return read_frames(data, read_header(data, start, stop), stop)


def others(path: Path) -> tuple[list[str], list[tuple[Any, ...]]]:
    """The same by orangebox: names of columns, and the rows."""
    parser = Parser.load(str(path))
    return parser.field_names, [frame.data for frame in parser.frames()]


def differences(
    frames: BlackboxFrames, names: Sequence[str], rows: Sequence[tuple[Any, ...]]
) -> int:
    """How many values of main and S frames differ from orangebox's."""
    main, slow = frames.main, frames.slow
    columns = {name: i for i, name in enumerate(names)}
    if len(rows) != len(main.values):
        return main.values.size
    last = np.searchsorted(slow.order, main.order)
    held = np.vstack([np.full(slow.values.shape[1], -1), slow.values])[last]
    ours = np.hstack([main.values, held])
    chosen = [columns[name] for name in (*main.names, *slow.names)]
    theirs = np.array([[-1 if row[i] == "" else row[i] for i in chosen] for row in rows])
    return int((ours != theirs).sum())


def _median(read: Callable[[Path], Any], path: Path, times: list[float]) -> Any:
    began = time.process_time()
    result = read(path)
    times.append(time.process_time() - began)
    return result


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; 1 when a value differs."""
    parser = arguments(__doc__)
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE")
    parser.add_argument("--turns", type=int, default=3)
    options = parser.parse_args(argv)
    logging.disable(logging.CRITICAL)  # orangebox warns of every header that it misses
    print(f"{'file':16}{'MB':>6}{'frames':>8}{'values':>11}{'orangebox':>11}{'all':>8}{'ratio':>7}"
          f"{'records':>9}{'ratio':>7}{'differ':>8}")  # fmt: skip
    wrong = 0
    for path in options.files:
        times: dict[str, list[float]] = {"orangebox": [], "all": [], "records": []}
        for _ in range(options.turns):
            names, rows = _median(others, path, times["orangebox"])
            frames = _median(whole, path, times["all"])
            _median(read_blackbox, path, times["records"])
        slow, ours, records = (statistics.median(times[key]) for key in times)
        differ = differences(frames, names, rows)
        wrong += differ
        print(f"{path.name:16}{path.stat().st_size / 1e6:6.1f}{len(rows):8}"
              f"{frames.main.values.size:11}{slow:9.2f} s{ours:6.2f} s{slow / ours:7.0f}"
              f"{records:7.2f} s{slow / records:7.0f}{differ:8}")  # fmt: skip
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
