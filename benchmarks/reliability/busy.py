"""A fast link on a busy computer: what was delivered is recorded, and slowness is reported.

    python -m benchmarks.reliability.busy [--seconds 60] [--busy 4] [--handicap 0]

A flight at 1 kHz (the rates of `benchmarks.reliability.rate`) is played in real time over UDP to
`gcs-sysid live --headless`, which records, on two cores, and beside it so many processes do nothing
but count. The recording is compared with what was sent, frame by frame, and against the system's
own count of what it dropped on that port (/proc/net/udp and SO_RXQ_OVFL, Linux alone). The result
is compared with the analysis of the recording.

`--handicap N` runs the session's process at nice N, and its receiver not: a slower computer, which
shows what happens when the estimate cannot keep up. The player runs ahead of the busy ones where
that is allowed; were it late, the flight would only be slower.
"""

import multiprocessing
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.results.result import Result
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.telemetry.tlog import TlogReader
from testbed.fast_link import Tool, parser_of, play, rows_of_times, table
from testbed.ground_cycles import FAST, emulate

AGREES = 1e-9
"""Of a standard deviation, by which a live result and the analysis of its recording may differ."""


class Recorded(NamedTuple):
    """A recording, compared with what was sent."""

    sent: int
    missing: int
    added: int
    in_order: bool


def compare(sent: Iterable[bytes], recorded: Sequence[bytes]) -> Recorded:
    """Hold frames recorded against frames sent."""
    sent = list(sent)
    before, after = Counter(sent), Counter(recorded)
    missing, added = before - after, after - before
    left = [raw for raw in recorded if not added[raw]]
    rest = iter(sent)
    in_order = all(any(raw == other for other in rest) for raw in left)
    return Recorded(len(sent), missing.total(), added.total(), in_order)


def largest_difference(live: dict[str, Any], again: Result) -> float:
    """Of all values of two results, in standard deviations."""
    worst = 0.0
    for name, estimate in again.parameters.items():
        value = live["parameters"][name]["value"]
        if estimate.value is None or not estimate.std or value is None:
            continue
        worst = max(worst, abs(value - estimate.value) / estimate.std)
    return worst


def kernel_drops(port: int) -> int:
    """What the system dropped at sockets on a UDP port of this machine, by its own table."""
    rows = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
    return sum(int(row[-1]) for row in rows if int(row[1].rsplit(":", 1)[1], 16) == port)


def count_for_ever() -> None:
    """Be busy."""
    number = 0
    while True:
        number += 1


def main() -> int:
    """Fly, play, print the table; 1 when something is missing."""
    parser = parser_of(__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="of flight (default: 60)")
    parser.add_argument("--busy", type=int, default=4, help="processes (default: 4)")
    parser.add_argument(
        "--handicap", type=int, default=0, help="niceness of the session (default: 0)"
    )
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        flight, own = folder / "flight.tlog", folder / "own.tlog"
        print("flying in advance", file=sys.stderr)
        emulate(flight, rates=FAST, ground=3.0, seconds=options.seconds)
        load = os.getloadavg()[0]
        nice = ["--nice", str(options.handicap)] if options.handicap else []
        words = ["--rate", "1000", "--record", str(own)]
        tool = Tool(folder, None, *words, alone=options.alone, watched=nice)
        busy = [multiprocessing.Process(target=count_for_ever) for _ in range(options.busy)]
        for each in busy:
            each.start()
        try:
            print("playing", file=sys.stderr)
            play(flight, tool.port, None, alone=options.alone)
            dropped = kernel_drops(tool.port)
            run = tool.end()
        finally:
            for each in busy:
                each.kill()
        sent = [frame.raw for _, frame in TlogReader(flight)]
        found = compare(sent, [frame.raw for _, frame in TlogReader(own)])
        again = analyze_log(own, load_airframe("paper"))
    told = run.result["telemetry"]["receiver"]
    worst = largest_difference(run.result, again)
    rows = [
        ("busy processes, cores", f"{options.busy}, {os.cpu_count()}", ""),
        ("messages sent", f"{found.sent}", ""),
        ("missing in the recording", f"{found.missing}", f"{dropped}"),
        ("in it, and never sent", f"{found.added}", "0"),
        ("in their order", "yes" if found.in_order else "no", "yes"),
        ("dropped by the system, by its own table", f"{dropped}", ""),
        ("the same, as the session tells", f"{told['kernel_drops']}", f"{dropped}"),
        ("data that waited at most", f"{told['longest_wait']:.2f} s", ""),
        ("too slow for", f"{told['too_slow_seconds']:.1f} s", ""),
        ("recorded and not learnt from", f"{told['not_learnt']}", "0"),
        ("result against that of the recording, in std", f"{worst:.1e}", f"{AGREES:.0e}"),
        ("verdict", str(run.result["verdict"]), ""),
        *rows_of_times(run.times),
    ]
    print(table(rows))
    said = [line for line in run.errors.splitlines() if "too slow" in line or "caught up" in line]
    print("\n".join(islice(said, 6)))
    print(f"load of the machine before: {load:.1f}")
    good = found.missing <= dropped and not found.added and found.in_order and worst <= AGREES
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
