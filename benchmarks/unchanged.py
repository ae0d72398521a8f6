"""Whether a change of the code left the numbers as they were.

    python -m benchmarks.unchanged write BEFORE.json LOG ...
    python -m benchmarks.unchanged compare BEFORE.json LOG ...

`write` analyses the logs and keeps every result; `compare` analyses them again and prints what
differs: numbers by more than 1e-9 of their standard deviation, and any other word or count. A
folder stands for the logs in it. A log's airframe is the .toml of its name, else what its
.truth.json says, else `paper` (the emulator's). Exit status 1 where anything differs.
"""

import argparse
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.recorded import SUFFIXES, airframe_of, truth_of
from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import Airframe, load_airframe
from gcs_sysid.session.analysis import analyze_log

TOLERANCE = 1e-9
"""Of a standard deviation; of the value where there is none."""
_FAMILIES = {"LOG00": "cinerat", "crazyflie": "crazyflie"}
"""Logs that share an airframe file, by how their names begin."""


def logs_in(paths: list[Path]) -> list[Path]:
    """The logs themselves, sorted; folders are looked through with all below them."""
    found = [
        log
        for path in paths
        for log in ([path] if path.is_file() else path.rglob("*"))
        if log.suffix in SUFFIXES
    ]
    return sorted(found)


def airframe_for(log: Path) -> Airframe:
    """The airframe that a log is analyzed with."""
    shared = [name for begin, name in _FAMILIES.items() if log.name.startswith(begin)]
    if shared and "_cmd" in log.stem:
        shared = [f"{shared[0]}_cmd"]
    for name in (log.stem, *shared):
        if (file := log.with_name(f"{name}.toml")).exists():
            return load_airframe(str(file))
    truth = log.with_suffix(".truth.json")
    if truth.exists() and "cg_m" in json.loads(truth.read_text()):
        return airframe_of(log).with_anchor("mass", truth_of(log)["mass"])
    airframe = load_airframe("paper")
    return airframe if airframe.anchor() else airframe.with_anchor("mass", 1.5)


def result_of(log: Path) -> dict[str, Any]:
    """The result as a user gets it, without where the file lies; an error as its words."""
    try:
        out: dict[str, Any] = analyze_log(log, airframe_for(log)).as_json()
    except InputError as error:
        return {"error": str(error).replace(str(log), log.name)}
    text = json.dumps(out).replace(str(log), log.name)
    return json.loads(text)  # type: ignore[no-any-return]


def differences(before: Any, now: Any, where: str = "", scale: float = 0.0) -> Iterator[str]:
    """Lines on what differs, with the place in the result.

    Args:
        before: of the one result.
        now: of the other.
        where: place so far.
        scale: standard deviation that a number is held against; 0 for its own size.
    """
    if isinstance(before, dict) and isinstance(now, dict):
        std = before.get("std")
        scale = std if isinstance(std, float) and std > 0.0 else 0.0
        for key in sorted(before.keys() | now.keys()):
            place = f"{where}.{key}" if where else key
            if key not in before or key not in now:
                yield f"{place}: only {'before' if key in before else 'now'}"
            else:
                yield from differences(before[key], now[key], place, scale)
    elif isinstance(before, list) and isinstance(now, list):
        if len(before) != len(now):
            yield f"{where}: {len(before)} -> {len(now)} entries"
        for i, pair in enumerate(zip(before, now, strict=False)):
            yield from differences(*pair, f"{where}[{i}]", scale)
    elif isinstance(before, float) and isinstance(now, int | float):
        apart = abs(now - before) / (scale or abs(before) or 1.0)
        if not apart <= TOLERANCE and not (math.isnan(before) and math.isnan(now)):
            yield f"{where}: {before:.12g} -> {now:.12g} ({apart:.2g})"
    elif before != now:
        yield f"{where}: {before!r} -> {now!r}"


def main() -> None:
    """Write or compare."""
    parser = argparse.ArgumentParser(description=__doc__, prog="python -m benchmarks.unchanged")
    parser.add_argument("do", choices=("write", "compare"))
    parser.add_argument("file", type=Path)
    parser.add_argument("logs", type=Path, nargs="+", metavar="LOG")
    options = parser.parse_args()
    logs = logs_in(options.logs)
    if not logs:
        sys.exit("no log there")
    before = {} if options.do == "write" else json.loads(options.file.read_text())
    results, different = {}, 0
    for log in logs:
        results[log.name] = now = result_of(log)
        if options.do == "write":
            print(f"{log.name}: {now.get('verdict', 'error')}", flush=True)
        elif log.name not in before:
            print(f"{log.name}: not in {options.file}", flush=True)
        else:
            lines = list(differences(before[log.name], now))
            different += len(lines)
            print(f"{log.name}: {len(lines) or 'no'} differences", *lines, sep="\n  ", flush=True)
    if options.do == "write":
        options.file.write_text(json.dumps(results, indent=1))
    else:
        print(f"{len(logs)} logs, {different} differences")
        sys.exit(different > 0)


if __name__ == "__main__":
    main()
