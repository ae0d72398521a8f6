"""Fuzz every reader, and print what came of it.

python -m benchmarks.reliability.fuzz --inputs 1000000
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from testbed.fuzz.drive import has_atheris
from testbed.fuzz.harness import Harness
from testbed.fuzz.harnesses import HARNESSES
from testbed.study import arguments


def shares(harnesses: Sequence[Harness], inputs: int, least: int) -> dict[str, int]:
    """How many inputs each harness gets: by weight, and at least so many."""
    weights = sum(harness.weight for harness in harnesses)
    return {h.name: max(least, round(inputs * h.weight / weights)) for h in harnesses}


def _run(harness: Harness, inputs: int, options: argparse.Namespace) -> dict[str, Any]:
    """One harness in processes of its own; its figures, with those of before where wanted."""
    figures = options.findings / f"{harness.name}.json"
    total = _figures(figures if options.add else None)
    wanted, until = total["inputs"] + inputs, time.monotonic() + options.seconds
    seed, status, log = options.seed, 0, options.findings / f"{harness.name}.log"
    while status == 0 and total["inputs"] < wanted and time.monotonic() < until:
        figures.unlink(missing_ok=True)
        command = [sys.executable, "-m", "testbed.fuzz.drive", harness.name, str(options.findings)]
        command += ["--inputs", str(wanted - total["inputs"]), "--engine", options.engine]
        command += ["--seconds", str(until - time.monotonic()), "--seed", str(seed)]
        with log.open("w") as said:
            status = subprocess.run(command, stdout=said, stderr=said, check=False).returncode
        found = _figures(figures)
        if status != 0 and not found["findings"]:
            found["findings"] = {f"ended with status {status}, see {log}": 1}
        found["inputs"] += total["inputs"]
        found["longest"] = max(found["longest"], total["longest"])
        found["findings"] |= total["findings"]
        total, seed = found, seed + 1
        figures.write_text(json.dumps(total))
    return total


def _figures(path: Path | None) -> dict[str, Any]:
    """Report of a run on a harness; zeros where there was none."""
    if path is None or not path.exists():
        return {"inputs": 0, "longest": 0.0, "findings": {}, "engine": ""}
    found: dict[str, Any] = json.loads(path.read_text())
    return found


def main(argv: Sequence[str] | None = None) -> int:
    """Run them one after the other; 1 when anything was found."""
    parser = arguments(__doc__)
    parser.add_argument("names", nargs="*", metavar="HARNESS", help="default: all of them")
    parser.add_argument("--inputs", type=int, default=1_000_000, help="in all (default 1000000)")
    parser.add_argument("--least", type=int, default=1000, help="of each (default 1000)")
    parser.add_argument("--seconds", type=float, default=3600.0, help="at most, for each")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--engine",
        choices=("atheris", "random"),
        default="atheris" if has_atheris() else "random",
        help="what makes the inputs (default: atheris where it is installed)",
    )
    parser.add_argument(
        "--add", action="store_true", help="to the figures of earlier runs in the folder"
    )
    parser.add_argument(
        "--findings", type=Path, default=Path("build/fuzz"), help="folder for inputs that failed"
    )
    options = parser.parse_args(argv)
    known = {harness.name: harness for harness in HARNESSES}
    unknown = set(options.names) - set(known)
    if unknown:
        parser.error(f"no harness {', '.join(sorted(unknown))}; there are {', '.join(known)}")
    chosen = [known[name] for name in options.names] or list(HARNESSES)
    options.findings.mkdir(parents=True, exist_ok=True)
    table = [("harness", "reads", "engine", "inputs", "longest", "findings")]
    inputs = findings = 0
    began = time.monotonic()
    for name, count in shares(chosen, options.inputs, options.least).items():
        if sys.stderr.isatty():
            print(f"{time.monotonic() - began:6.0f} s  {name} ...", file=sys.stderr)
        told = _run(known[name], count, options)
        kinds = ", ".join(f"{kind} ({n})" for kind, n in told["findings"].items())
        inputs += told["inputs"]
        findings += len(told["findings"])
        row = (name, known[name].reads, told["engine"], f"{told['inputs']:,}".replace(",", " "))
        table.append((*row, f"{told['longest']:.2f} s", kinds or "none"))
    widths = [max(len(row[i]) for row in table) for i in range(len(table[0]))]
    for row in table:
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        print("  ".join(cells).rstrip())
    total = f"{inputs:,}".replace(",", " ")
    print(f"\n{total} inputs, {findings} findings")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
