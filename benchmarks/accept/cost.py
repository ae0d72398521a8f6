"""Processor time of the commands against the last release, in one run.

Both trees take turns on one log, with the same interpreter and packages; the least of each counts,
and their ratio means the same on any machine. Its error is how far the next least one lies.
"""

import os
import tempfile
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks.accept import trees
from benchmarks.accept.judge import Figure, Study
from testbed import study
from testbed.recordings import KEPT, SHARED, given

_FLY = (
    "sim_bridge", "--airframe", "paper", "--mission", "all-axes", "--noise", "mems", "--rate",
    "250", "--speed", "max", "--force",
)  # fmt: skip
_GIVEN = ("--airframe", "paper", "--json", os.devnull)
_ROUGH = 0.03
"""Least relative error of a ratio: a quiet machine's."""


def _logs(folder: Path, seconds: str) -> Callable[[str], Path]:
    @cache
    def fly(rotor_input: str) -> Path:
        log = folder / f"{rotor_input}.tlog"
        words = ("--rotor-input", rotor_input, "--duration", seconds, "--tlog", str(log))
        study.run((*_FLY, *words))
        return log

    return fly


def _commands(name: str, folder: Path, seconds: str) -> tuple[str, ...]:
    fly = _logs(folder, seconds)
    match name:
        case "start":
            return ("gcs_sysid", "--version")
        case "help":
            return ("gcs_sysid", "--help")
        case "emulator":
            return (*_FLY, "--duration", seconds, "--tlog", str(folder / "out.tlog"))
        case "inspect":
            return ("gcs_sysid", "inspect", str(fly("both")))
        case "health":
            return ("gcs_sysid", "health", str(fly("both")), "--airframe", "paper")
        case "analyze":
            return ("gcs_sysid", "analyze", str(fly("both")), *_GIVEN)
        case "analyze, on commands":
            return ("gcs_sysid", "analyze", str(fly("command")), *_GIVEN)
    log = SHARED / name.removeprefix("analyze ")
    return ("gcs_sysid", "analyze", str(log), *given(log), "--json", os.devnull)


_NAMES = ("start", "help", "emulator", "inspect", "health", "analyze", "analyze, on commands")
_RECORDED = ("px4_quad_two_flights_unchanged.tlog",)


def _units(is_short: bool) -> list[tuple[str, str, int]]:
    if is_short:
        return [(name, "20", 2) for name in ("start", "analyze")]
    recorded = [name for name in _RECORDED if (SHARED / name).exists()]
    return [
        *((name, "60", 3) for name in _NAMES),
        *((f"analyze {name}", "60", 2) for name in recorded),
    ]


@cache
def _release() -> tuple[str, Path]:
    commit = trees.last_release()
    tree = KEPT / f"release-{commit}"
    return commit, tree if tree.exists() else trees.unpack(commit, tree)


def _run(unit: tuple[str, str, int]) -> dict[str, Any] | None:
    name, seconds, turns = unit
    try:
        commit, release = _release()
    except trees.NoHistoryError:
        return None
    with tempfile.TemporaryDirectory() as folder:
        words = _commands(name, Path(folder), seconds)
        both = [(study.run(words, release), study.run(words)) for _ in range(turns)]
    wrong = [done for pair in both for done in pair if done.status not in (0, 1)]
    if wrong:  # 1: the flight allows no answer
        return {"defect": f"{name}: {wrong[0].said.strip()[-200:]}"}
    before, now = (sorted(done.seconds for done in row) for row in zip(*both, strict=True))
    return {"name": name, "release": commit, "before": before, "now": now}


def _figures(outcomes: Sequence[dict[str, Any]]) -> list[Figure]:
    figures = []
    for o in outcomes:
        ratio = o["now"][0] / o["before"][0]
        spread = sum((times[1] / times[0] - 1.0) ** 2 for times in (o["before"], o["now"])) ** 0.5
        error = ratio * max(spread, _ROUGH)
        name = f"processor time over the last release's: {o['name']}"
        figures.append(
            Figure(
                name,
                "low",
                ratio,
                error,
                f"{len(o['now'])} turns against {o['release']}, {o['now'][0]:.2f} s",
            )
        )
    return figures


STUDIES = (Study("cost", _units, _run, _figures, alone=True),)
