"""Results word for word and number for number: for changes that are to move no digit.

A case is a command of `gcs-sysid` as a user gives it; its result is what that writes as JSON, its
exit status and what it says on standard error. Results are compared with those of a commit, which
are made once, on the same machine with the same packages, and kept under build/accept; or with a
file that `--store` has written. Numbers are the same within 1e-9 of their standard deviation, of
their own size where they have none.
"""

import json
import math
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from benchmarks.accept import trees
from testbed import study
from testbed.recordings import KEPT, all_logs

TOLERANCE = 1e-9
"""Of a standard deviation; of the value where there is none."""
Results = dict[str, dict[str, Any]]
"""Name of a case -> its `command` and `result`."""

_PAPER = ("--airframe", "paper")
_HEXA = ("--airframe", "px4-hexa-x")
_FLIGHTS: dict[str, tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]] = {
    "speeds": (_PAPER, ("--mission", "all-axes"), _PAPER),
    "commands": (
        _PAPER, ("--mission", "doublets", "--rotor-input", "command", "--rate", "100"), _PAPER,
    ),
    "20 Hz": (
        _PAPER, ("--noise", "paper", "--rate", "20", "--rotor-input", "speed"), _PAPER,
    ),
    "hexa": (_HEXA, ("--mission", "climbs", "--physics", "scatter"), (*_HEXA, "--mass", "2.0")),
    "mass step": (_PAPER, ("--mission", "all-axes", "--mass-step", "30:1.2"), _PAPER),
    "mass step on commands": (
        _PAPER, ("--mission", "doublets", "--mass-step", "30:1.2", "--rotor-input", "command"),
        _PAPER,
    ),
    "ardupilot": (
        ("--airframe", "ardupilot-quad-x"),
        ("--autopilot", "ardupilot", "--mission", "aggressive", "--physics", "lag-of=thrust"),
        ("--airframe", "ardupilot-quad-x", "--mass", "1.5"),
    ),
    "air and battery": (
        _PAPER,
        (
            *("--mission", "gentle", "--physics", "wind", "--physics", "gusts"),
            *("--physics", "battery", "--physics", "rotor-drag", "--rotor-input", "command"),
        ),
        _PAPER,
    ),
    "two flights, faults": (
        _PAPER,
        (
            *("--mission", "acro", "--trap", "flights", "--trap", "ground", "--fault", "loss=0.05"),
            *("--trap", "imu-frozen", "--trap", "rpm-spikes", "--trap", "clock-drift"),
        ),
        _PAPER,
    ),
    "hover": (_PAPER, ("--mission", "hover"), _PAPER),
}  # fmt: skip
"""Emulated flights of a minute: vehicle, how it is flown, and what its user gives."""
_BESIDES: dict[str, tuple[tuple[str, ...], ...]] = {
    "speeds": (
        ("replay", "--headless", "--speed", "max"), ("analyze", "--method", "forward-window"),
        ("analyze", "--method", "forward-td"),
    ),
    "mass step on commands": (("replay", "--headless", "--speed", "max"),),
    "20 Hz": (
        ("analyze", "--offline"), ("analyze", "--method", "article"),
        ("analyze", "--prior", "k_M=6.1e-6+-1e-7"), ("analyze", "--end", "11"),
    ),
}  # fmt: skip
"""More than `analyze` and `inspect`."""
_SHORT = ("speeds", "commands", "20 Hz", "hexa")
_SECONDS = "60"


@dataclass(frozen=True)
class Case:
    """A command.

    Attributes:
        name: of it.
        words: of `gcs-sysid`, with {log} for the flight.
        log: recorded; None: emulated.
        flight: words of `sim-bridge` that fly it otherwise.
        weight: how long it takes, roughly.
    """

    name: str
    words: tuple[str, ...]
    log: Path | None = None
    flight: tuple[str, ...] = ()
    weight: float = 0.0


def cases(short: bool) -> list[Case]:
    """All commands, those that take long first; of the short form, some."""
    found = []
    for name, (vehicle, flown, given) in _FLIGHTS.items():
        if short and name not in _SHORT:
            continue
        flight = (*vehicle, *flown, "--seed", "1", "--duration", _SECONDS, "--speed", "max")
        commands = [("analyze",), ("inspect",), *(() if short else _BESIDES.get(name, ()))]
        for first, *more in commands:
            words = (first, "{log}", *given, *more)
            label = f"flight, {name}: {' '.join((first, *more))}"
            found.append(
                Case(label, words, flight=flight, weight=2e7 if first == "replay" else 5e6)
            )
    for log in all_logs():
        if short and log.name.startswith("shared/"):
            continue
        size = float(log.file.stat().st_size)
        found += [
            Case(
                f"{log.name}: {words[0]}", (words[0], "{log}", *words[1:]), log.file, weight=weight
            )
            for words, weight in (
                (("inspect", *log.table), 0.2 * size),
                (("health", *log.given), 0.2 * size if "field/" in log.name else 0.0),
                (("analyze", *log.given), size * (9.0 if log.file.suffix == ".bbl" else 1.0)),
            )
            if weight
        ]
    return sorted(found, key=lambda case: -case.weight)


def result_of(tree: Path, case: Case) -> dict[str, Any]:
    """What a tree makes of a case."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        log, out = case.log or folder / "flight.tlog", folder / "out.json"
        result: dict[str, Any] = {}
        if case.flight:
            flown = study.run(("sim_bridge", *case.flight, "--tlog", str(log)), tree, folder)
            if flown.status:
                return {"emulator": flown.said}
            result["flight"] = sha256(log.read_bytes()).hexdigest()[:16]
        words = [str(log) if word == "{log}" else word for word in case.words]
        done = study.run(("gcs_sysid", *words, "--json", str(out)), tree, folder)
        told = [json.loads(line) for line in _lines(out)]
        plain = {
            "status": done.status,
            "stderr": done.said.splitlines(),
            "json": told[-1] if told else None,  # snapshots before the last go by the wall clock
        }
        text = json.dumps(plain)
        for path in (str(log), str(log.parent), str(folder)):
            text = text.replace(path, "LOG" if path == str(log) else "FOLDER")
        return result | dict(json.loads(text))


def _lines(out: Path) -> list[str]:
    """One JSON a line: a result is one alone, snapshots are several."""
    if not out.exists():
        return []
    text = out.read_text(encoding="utf-8")
    try:
        json.loads(text)
    except ValueError:
        return text.splitlines()
    return [text]


def results_of(tree: Path, which: Sequence[Case], workers: int, known: Results) -> Results:
    """Results of all cases; those that are known are taken as they are."""
    found: Results = {}

    def run(case: Case) -> None:
        words = [*case.flight, *case.words]
        if known.get(case.name, {}).get("command") == words:
            found[case.name] = known[case.name]
        else:
            found[case.name] = {"command": words, "result": result_of(tree, case)}
        study.say(f"{len(found)}/{len(which)}: {case.name}", always=True)

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(run, which))
    return found


def results_at(commit: str, which: Sequence[Case], workers: int) -> Results:
    """Results of a commit, kept from one run to the next.

    Raises:
        NoHistoryError: there is no such commit.
    """
    file = KEPT / f"equal-{trees.commit_of(commit)}.json"
    known: Results = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    with tempfile.TemporaryDirectory() as name:
        tree = trees.unpack(commit, Path(name) / "tree")
        found = results_of(tree, which, workers, known)
    store(file, known | found)
    return found


def store(file: Path, results: Results) -> None:
    """Write results."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(dict(sorted(results.items()))), encoding="utf-8")


def compare(stored: Results, now: Results, most: int = 12) -> tuple[list[str], int]:
    """Lines on cases that differ, `most` of each, and how many cases these are."""
    lines, different = [], 0
    for name in sorted(now):
        if name not in stored:
            lines.append(f"{name}: not stored")
            different += 1
            continue
        found = list(differences(stored[name]["result"], now[name]["result"]))
        if found:
            different += 1
            lines.append(f"{name}: {len(found)} differences")
            lines += [f"    {line}" for line in found[:most]]
            lines += [f"    and {len(found) - most} more"] if len(found) > most else []
    return lines, different


def differences(before: Any, now: Any, where: str = "", scale: float = 0.0) -> Iterator[str]:
    """Lines on what differs, with the place in the result.

    Args:
        before: of the one result.
        now: of the other.
        where: place so far.
        scale: standard deviation that a number is held against; 0 for its own size.
    """
    if isinstance(before, dict) and isinstance(now, dict):
        if _is_covariance(before) and _is_covariance(now) and before["names"] == now["names"]:
            yield from _of_matrices(before["matrix"], now["matrix"], f"{where}.matrix")
            before, now = ({k: v for k, v in t.items() if k != "matrix"} for t in (before, now))
        std = before.get("std")
        scale = std if isinstance(std, float) and std > 0.0 else 0.0
        for key in sorted(before.keys() | now.keys()):
            place = f"{where}.{key}" if where else key
            if key not in now:
                yield f"{place}: gone (was {_short(before[key])})"
            elif key not in before:
                yield f"{place}: new ({_short(now[key])})"
            else:
                yield from differences(before[key], now[key], place, scale)
    elif isinstance(before, list) and isinstance(now, list):
        if len(before) != len(now):
            yield f"{where}: {len(before)} -> {len(now)} entries"
        for i, pair in enumerate(zip(before, now, strict=False)):
            yield from differences(*pair, f"{where}[{i}]", scale)
    elif _is_number(before) and _is_number(now):
        apart = abs(now - before) / (scale or abs(before) or 1.0)
        if not apart <= TOLERANCE and not (math.isnan(before) and math.isnan(now)):
            of = "std" if scale else "itself"
            yield f"{where}: {before:.12g} -> {now:.12g} ({apart:.2g} of {of})"
    elif before != now:
        yield f"{where}: {_short(before)} -> {_short(now)}"


def _of_matrices(before: Any, now: Any, where: str) -> Iterator[str]:
    """Covariances, each entry against the standard deviations of its row and column."""
    size = [math.sqrt(abs(row[i])) or 1.0 for i, row in enumerate(before)]
    for i, (a, b) in enumerate(zip(before, now, strict=True)):
        for j in range(i + 1):
            yield from differences(a[j], b[j], f"{where}[{i}][{j}]", size[i] * size[j])


def _is_covariance(table: dict[str, Any]) -> bool:
    return table.keys() >= {"names", "matrix"}


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:57]}..."
