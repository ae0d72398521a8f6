"""Files that were made to harm: what each command that reads them takes until it is done with them.

python -m benchmarks.reliability.hostile

Processor time and memory are those beyond the same command's on an empty file of that kind, so
without what the program itself takes. Each has to be read, or refused in a line, with 1 s and
200 MB.
"""

import re
import sys
import tempfile
from pathlib import Path

from testbed.hostile_logs import FILES
from testbed.study import Done, arguments, run

SECONDS, MEGABYTES = 1.0, 200.0
COMMANDS = {
    ".toml": ["airframe", "check", "{file}"],
    ".json": ["compare", "{file}", "{file}"],
}
"""What reads a file of a kind; of logs: `inspect`."""


def cost_of(path: Path) -> Done:
    """Have the program read a file."""
    words = COMMANDS.get(path.suffix, ["inspect", "{file}"])
    return run(("gcs_sysid", *(word.format(file=path) for word in words)))


def main() -> int:
    """Print a row for each; 1 when one is beyond a bar, or refused otherwise than in a line."""
    arguments(__doc__).parse_args()
    bad = 0
    print(f"{'kind':<7}{'what':<38}{'MB':>7}{'exit':>6}{'s':>7}{'MB more':>9}  said")
    with tempfile.TemporaryDirectory() as folder:
        empty: dict[str, Done] = {}
        for (suffix, name), make in FILES.items():
            if suffix not in empty:
                path = Path(folder) / f"empty{suffix}"
                path.write_bytes(b"")
                empty[suffix] = cost_of(path)
            path = Path(folder) / f"hostile{suffix}"
            path.write_bytes(make())
            cost = cost_of(path)
            seconds = max(cost.seconds - empty[suffix].seconds, 0.0)
            more = max(1e-6 * (cost.peak - empty[suffix].peak), 0.0)
            line = (cost.told + cost.said).strip().replace(str(path), path.name)
            good = cost.status in (0, 1, 2) and "internal error" not in line
            good &= cost.status < 2 or ("\n" not in line and len(line) < 400)
            good &= seconds <= SECONDS and more <= MEGABYTES
            bad += not good
            said = (
                re.sub(r"^gcs-sysid: error: ", "", line.split("\n")[0]) if cost.status else "read"
            )
            print(
                f"{suffix:<7}{name:<38}{path.stat().st_size / 1e6:>7.2f}{cost.status:>6}"
                f"{seconds:>7.2f}{more:>9.0f}  {'' if good else 'BEYOND: '}{said[:70]}",
                flush=True,
            )
    print(f"\n{len(FILES)} files, {bad} beyond the bars")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
