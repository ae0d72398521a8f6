"""What a second process brings to `gcs-sysid batch`: `python -m benchmarks.batch`.

Emulated short flights are flown once into a temporary folder; the whole command then analyses them
all with one worker and with two. Wall time of the command, its start included. On a machine that
has other work the figures lie: the share of two processors that was to be had is printed beside.
"""

import sys
import tempfile
import time
from functools import partial
from pathlib import Path

from testbed.study import arguments, children_seconds, in_processes, markdown, run, sound

FLIGHT = (
    *("--airframe", "paper", "--mission", "all-axes", "--noise", "paper", "--sigma", "0.002"),
    *("--rate", "20", "--speed", "max"),
)
BAR = 0.6
"""Most time of two workers over that of one."""


def fly(logs: Path, seconds: float, seed: int) -> None:
    """Write one flight."""
    files = ("--seed", str(seed), "--duration", str(seconds), "--tlog", f"{logs}/{seed:04d}.tlog")
    sound(run(("sim_bridge", *FLIGHT, *files)))


def main() -> int:
    """Fly, analyze and report; 1 when the bar is missed."""
    parser = arguments(__doc__)
    parser.add_argument("--logs", type=int, default=200, help="how many (default 200)")
    parser.add_argument("--seconds", type=float, default=30.0, help="length of each flight")
    options = parser.parse_args()
    took, cost = [], []
    with tempfile.TemporaryDirectory() as name:
        logs = Path(name) / "logs"
        logs.mkdir()
        in_processes(partial(fly, logs, options.seconds), range(options.logs))
        print(f"{options.logs} logs of {options.seconds:g} s")
        print(*markdown("workers | wall, s | processor, s | processors had"), sep="\n")
        for workers in ("1", "2"):
            words = (str(logs), "-o", f"{name}/out-{workers}", "--airframe", "paper")
            wall, spent = time.perf_counter(), children_seconds()
            sound(run(("gcs_sysid", "batch", *words, "--workers", workers)))
            took.append(time.perf_counter() - wall)
            cost.append(children_seconds() - spent)
            had = cost[-1] / took[-1]
            print(f"| {workers} | {took[-1]:.1f} | {cost[-1]:.1f} | {had:.2f} |", flush=True)
    print(f"\ntwo workers over one: {took[1] / took[0]:.2f} (bar: {BAR})")
    print(f"by processor time, were both processors free: {0.5 * cost[1] / cost[0]:.2f} at best")
    return int(took[1] / took[0] > BAR)


if __name__ == "__main__":
    sys.exit(main())
