"""What a second process brings to `gcs-sysid batch`: `python -m benchmarks.batch`.

Emulated short flights are flown once into a temporary folder; the whole command then analyses them
all with one worker and with two. Wall time of the command, its start included. On a machine that
has other work the figures lie: the share of two processors that was to be had is printed beside.
"""

import os
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

from testbed.study import arguments, children_seconds, in_processes, run

FLIGHT = (
    *("--airframe", "paper", "--mission", "all-axes", "--noise", "paper", "--sigma", "0.002"),
    *("--rate", "20", "--speed", "max"),
)
BAR = 0.6
"""Most time of two workers over that of one."""


def fly(logs: Path, seconds: float, seed: int) -> None:
    """Write one flight."""
    log = logs / f"{seed:04d}.tlog"
    files = ("--seed", str(seed), "--duration", str(seconds), "--tlog", str(log))
    if run(("sim_bridge", *FLIGHT, *files)).status:
        sys.exit(f"the emulator failed for {log}")


def batch(logs: Path, out: Path, workers: int) -> tuple[float, float]:
    """Analyse them all; wall time and processor time, s."""
    words = ["batch", str(logs), "-o", str(out), "--airframe", "paper", "--workers", str(workers)]
    wall, spent = time.perf_counter(), children_seconds()
    done = run(("gcs_sysid", *words))
    if done.status != 0:
        sys.exit(done.said)
    print(done.said.rstrip(), file=sys.stderr)
    return time.perf_counter() - wall, children_seconds() - spent


def main() -> int:
    """Fly, analyze and report; 1 when the bar is missed."""
    parser = arguments(__doc__)
    parser.add_argument("--logs", type=int, default=200, help="how many (default 200)")
    parser.add_argument("--seconds", type=float, default=30.0, help="length of each flight")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        logs = folder / "logs"
        logs.mkdir()
        in_processes(partial(fly, logs, options.seconds), range(options.logs))
        took, cost = {}, {}
        print(f"{options.logs} logs of {options.seconds:g} s, {os.cpu_count()} processors")
        print("| workers | wall, s | processor, s | processors had |\n|---|---|---|---|")
        for workers in (1, 2):
            wall, spent = batch(logs, folder / f"out-{workers}", workers)
            took[workers], cost[workers] = wall, spent
            print(f"| {workers} | {wall:.1f} | {spent:.1f} | {spent / wall:.2f} |", flush=True)
    ratio = took[2] / took[1]
    print(f"\ntwo workers over one: {ratio:.2f} (bar: {BAR})")
    print(f"by processor time, were both processors free: {0.5 * cost[2] / cost[1]:.2f} at best")
    return int(ratio > BAR)


if __name__ == "__main__":
    sys.exit(main())
