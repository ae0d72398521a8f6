"""Kills `gcs-sysid batch` at random moments, and has the same command finish the work.

python -m benchmarks.reliability.batch_kills --kills 20

Each time a batch over a few logs is killed with SIGKILL: so many results are there, drawn at
random, and up to the time of two logs has passed since. Then the same command runs to its end. It
must leave every result that was there as it was, analyze each of the others once, leave a table
equal to that of a batch that nobody killed, and no process, and nothing half written.
"""

import contextlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

from gcs_sysid.fleet.batch import read_table
from testbed.study import arguments, flown

FLIGHT = (
    *("--airframe", "paper", "--mission", "all-axes", "--noise", "paper", "--sigma", "0.002"),
    *("--rate", "20", "--duration", "14", "--seed", "5"),
)
_PATIENCE = 60.0
"""s after which processes of a killed batch count as left over."""
_ENDED = "fleet.parquet"


class Kill(NamedTuple):
    """What came of one.

    Attributes:
        wanted: results that were to be there before.
        before: results that were there when it was dead.
        complaint: what was wrong; empty: nothing.
    """

    wanted: int
    before: int
    complaint: str


def make_logs(folder: Path, count: int) -> None:
    """Logs of different content: a flight, and so many of its last bytes less."""
    data = flown(FLIGHT, folder.parent)[0].read_bytes()
    for number in range(count):
        (folder / f"{number:02d}.tlog").write_bytes(data[: len(data) - 400 * number])


def start(logs: Path, out: Path) -> "subprocess.Popen[str]":
    """The command, in a process group of its own."""
    command = [sys.executable, "-m", "gcs_sysid", "batch", str(logs), "-o", str(out)]
    return subprocess.Popen(
        [*command, "--airframe", "paper", "--workers", "1"], text=True, start_new_session=True,
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


def results(out: Path) -> dict[str, tuple[int, bytes]]:
    """Each result's time of writing and content."""
    found = (out / "results").glob("*.json") if out.exists() else ()
    return {path.name: (path.stat().st_mtime_ns, path.read_bytes()) for path in found}


def table(out: Path) -> list[dict[str, Any]]:
    """The rows, without what depends on the folder."""
    rows = [{**row, "result": Path(row["result"]).name} for row in read_table(out / _ENDED)]
    return sorted(rows, key=lambda row: str(row["path"]))


def left_over(group: int) -> bool:
    """Whether processes of a group are there after a while."""
    until = time.monotonic() + _PATIENCE
    while time.monotonic() < until:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return False
        time.sleep(0.05)
    return True


def kill_and_finish(
    logs: Path, out: Path, wanted: int, wait: float, whole: list[dict[str, Any]]
) -> Kill:
    """One kill, and the run that follows; `whole` is the table of a batch that nobody killed."""
    with start(logs, out) as process:
        while process.poll() is None and len(results(out)) < wanted:
            time.sleep(0.02)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(wait)
        process.send_signal(signal.SIGKILL)
        process.communicate()
    if left_over(process.pid):
        return Kill(wanted, 0, "processes were left over")
    before = results(out)
    with start(logs, out) as process:
        _, err = process.communicate()
    after = results(out)
    count = len(os.listdir(logs))
    complaints = {
        f"exit status {process.returncode}": process.returncode != 0,
        "a result that was there was changed": not before.items() <= after.items(),
        f"not told that {len(before)} were done": bool(before)
        and f"{count} of {count} logs ({len(before)} done before)" not in err,
        f"{len(after)} results of {count} logs": len(after) != count,
        "another table than without a kill": table(out) != whole,
        "files half written": any(p.suffix not in (".json", "") for p in out.glob("results/*")),
    }
    return Kill(wanted, len(before), "; ".join(text for text, bad in complaints.items() if bad))


def main() -> int:
    """Print a row for each kill; 1 when one was not complete."""
    parser = arguments(__doc__)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--logs", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rng = random.Random(options.seed)
    good = 0
    with tempfile.TemporaryDirectory() as folder:
        logs = Path(folder) / "logs"
        logs.mkdir()
        make_logs(logs, options.logs)
        began = time.monotonic()
        with start(logs, Path(folder) / "whole") as process:
            process.communicate()
        each = (time.monotonic() - began) / options.logs
        whole = table(Path(folder) / "whole")
        print(f"{'kill':>4}{'results there':>15}  finished")
        for number in range(options.kills):
            wanted = rng.randrange(options.logs)
            out = Path(folder) / f"out{number}"
            kill = kill_and_finish(logs, out, wanted, rng.uniform(0.0, 2.0 * each), whole)
            good += not kill.complaint
            print(f"{number + 1:>4}{kill.before:>15}  {kill.complaint or 'ok'}", flush=True)
    print(f"\n{good} of {options.kills} complete, without repeats")
    return 0 if good == options.kills else 1


if __name__ == "__main__":
    sys.exit(main())
