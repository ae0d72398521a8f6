"""Figures beside those that are stored, each with the tolerance that its sampling error leaves.

A study measures outcomes, one a unit (a flight, a log, a cell), in processes of their own; its
figures are statistics of them. The standard error of a figure is that of a bootstrap over the units
(claims of one flight hang together; flights do not). A figure is worse where it lies beyond the
stored one by more than twice the standard error of either, in the direction that is worse. Seeds
and flights are the same at each run, so that unchanged code gives the stored figure itself.
"""

import json
import math
import multiprocessing
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from testbed.study import markdown, say

STORED = Path(__file__).with_name("stored.md")
SIGMAS = 2.0
"""Standard errors by which a figure may be off: one figure in forty that has not changed."""
NOMINAL = 95.0
"""%, of intervals that are to hold."""
_RESAMPLED = 300

Better = Literal["low", "high", "coverage", "never"]
"""Which way a figure is better; `coverage`: as high as it was, or `NOMINAL`; `never`: a count of
what must not happen, without any tolerance."""
_SIGNS = {"low": "<=", "high": ">=", "coverage": ">=", "never": "<="}


@dataclass(frozen=True)
class Figure:
    """What a study comes to.

    Attributes:
        name: of it, with its unit.
        better: direction.
        value: measured.
        error: standard error.
        of: what it is a statistic of.
    """

    name: str
    better: Better
    value: float
    error: float
    of: str


@dataclass(frozen=True)
class Study:
    """What is measured.

    Attributes:
        name: for --only.
        units: what it is measured on: of the short form, or of the whole.
        run: of a unit, in a process of its own; outcomes are what JSON holds.
        figures: of the outcomes.
        details: lines on the outcomes, for --details.
        alone: runs while nothing else does, since it measures time.
    """

    name: str
    units: Callable[[bool], Sequence[Any]]
    run: Callable[[Any], Any]
    figures: Callable[[list[Any]], list[Figure]]
    details: Callable[[list[Any]], list[str]] | None = None
    alone: bool = False


def figure(
    name: str, better: Better, outcomes: Sequence[Any], statistic: Callable[[Sequence[Any]], float],
    of: str = "",
) -> Figure:  # fmt: skip
    """A statistic of outcomes, with its error by a bootstrap over them."""
    value, n = statistic(outcomes), len(outcomes)
    random = np.random.default_rng(0xACCE)
    error = 0.0
    if better != "never" and n > 1:
        drawn = random.integers(0, n, (_RESAMPLED, n))
        values = np.array([statistic([outcomes[i] for i in row]) for row in drawn])
        # A bootstrap of few units is too narrow by this.
        few = math.sqrt(n / (n - 1.0))
        error = few * float(np.nanstd(values)) if np.isfinite(values).any() else math.nan
    return Figure(name, better, float(value), error, of or f"{n}")


def coverage(name: str, outcomes: Sequence[list[bool]]) -> Figure:
    """% of intervals that hold, of units with several each."""
    count = sum(map(len, outcomes))
    found = figure(
        name, "coverage", outcomes,
        lambda units: 100.0 * sum(map(sum, units)) / max(sum(map(len, units)), 1),
        f"{count} in {len(outcomes)}",
    )  # fmt: skip
    # All that hold tell no spread: that of intervals as good as they claim counts then.
    least = math.sqrt(NOMINAL * (100.0 - NOMINAL) / max(count, 1))
    return Figure(name, "coverage", found.value, max(found.error, least), found.of)


def share(name: str, outcomes: Sequence[bool]) -> Figure:
    """% of units of which something is so, with the error by Laplace's rule of succession."""
    n, count = len(outcomes), sum(outcomes)
    p = (count + 1.0) / (n + 2.0)
    error = 100.0 * math.sqrt(p * (1.0 - p) / max(n, 1))
    return Figure(name, "high", 100.0 * count / max(n, 1), error, f"{n}")


@dataclass
class Row:
    """A figure, beside the stored one."""

    now: Figure
    stored: Figure | None

    @property
    def tolerance(self) -> float:
        """How much worse it may be."""
        if self.stored is None or self.now.better == "never":
            return 0.0
        errors = [e for e in (self.stored.error, self.now.error) if math.isfinite(e)]
        return SIGMAS * max(errors, default=0.0)

    @property
    def verdict(self) -> str:
        """`worse`, `better`, `same`, or `new`."""
        if self.stored is None:
            return "new"
        now, then = self.now.value, self.stored.value
        if math.isnan(now) or math.isnan(then):
            return "same" if math.isnan(now) and math.isnan(then) else "worse"
        gain = now - then if self.now.better in ("high", "coverage") else then - now
        if self.now.better == "coverage" and now >= NOMINAL - self.tolerance:
            gain = max(gain, 0.0)
        slack = self.tolerance + 1e-9 * max(abs(now), abs(then))
        return "worse" if gain < -slack else "better" if gain > slack else "same"


@dataclass
class Judged:
    """All figures of a run."""

    rows: list[Row] = field(default_factory=list)
    defects: list[str] = field(default_factory=list)

    @property
    def is_right(self) -> bool:
        """Whether nothing is worse, and nothing broke."""
        return not self.defects and all(row.verdict != "worse" for row in self.rows)

    def table(self) -> list[str]:
        """Each figure beside the stored one."""
        lines = [
            f"{'figure':<58}{'now':>10}{'stored':>10}{'tolerance':>11}  {'':<3}{'':<7} of",
        ]
        for row in self.rows:
            then = "-" if row.stored is None else short(row.stored.value)
            mark = {"worse": "WORSE", "same": "", "better": "better", "new": "new"}[row.verdict]
            tolerance = "none" if row.now.better == "never" else short(row.tolerance)
            lines.append(
                f"{row.now.name:<58}{short(row.now.value):>10}{then:>10}{tolerance:>11}"
                f"  {_SIGNS[row.now.better]:<3}{mark:<7} {row.now.of}"
            )
        return [*lines, *(f"defect: {text}" for text in self.defects)]


def short(value: float) -> str:
    """Four digits."""
    return "-" if math.isnan(value) else f"{value:.4g}"


def measure(studies: Sequence[Study], workers: int, *, is_short: bool) -> dict[str, list[Any]]:
    """Outcomes of studies, by name; a unit that breaks gives {"defect": ...}."""
    found: dict[str, list[Any]] = {}
    tasks = []
    for study in studies:
        units = study.units(is_short)
        found[study.name] = [None] * len(units)
        tasks += [(study, i, unit) for i, unit in enumerate(units)]
    began = time.monotonic()

    def tell(k: int, study: Study, unit: Any) -> None:
        took = f"{time.monotonic() - began:4.0f} s"
        say(f"{took}  {k}/{len(tasks)}  {study.name}: {unit}", always=True)

    together = [task for task in tasks if not task[0].alone]
    context = multiprocessing.get_context("spawn")
    with context.Pool(workers, maxtasksperchild=20) as pool:
        waiting = [(task, pool.apply_async(_outcome, (task[0].run, task[2]))) for task in together]
        for k, ((study, i, unit), done) in enumerate(waiting, 1):
            found[study.name][i] = done.get()
            tell(k, study, unit)
    for k, (study, i, unit) in enumerate((t for t in tasks if t[0].alone), len(together) + 1):
        found[study.name][i] = _outcome(study.run, unit)
        tell(k, study, unit)
    return found


def _outcome(run: Callable[[Any], Any], unit: Any) -> Any:
    try:
        return run(unit)
    except Exception as error:  # noqa: BLE001 - a defect is an outcome here
        trace = traceback.extract_tb(error.__traceback__)[-1]
        return {"defect": f"{unit}: {type(error).__name__}: {error} ({trace.name})"}


def judge(
    studies: Sequence[Study], outcomes: dict[str, list[Any]], stored: dict[str, Figure]
) -> Judged:
    """Figures of studies beside the stored ones."""
    judged = Judged()
    for study in studies:
        sound = []
        for outcome in outcomes[study.name]:
            if isinstance(outcome, dict) and "defect" in outcome:
                judged.defects.append(f"{study.name}: {outcome['defect']}")
            elif outcome is not None:
                sound.append(outcome)
        if sound:
            judged.rows += [Row(now, stored.get(now.name)) for now in study.figures(sound)]
    return judged


# ---- what is stored --------------------------------------------------------------------------

_HEAD = """# Figures that `python -m benchmarks.accept judge` holds a change against

Written by `python -m benchmarks.accept judge --write COMMIT` (and `--short`), of {commit}. An error
is that of a bootstrap over the units, at least that of intervals as good as they claim; a change
may make a figure worse by twice that. `never` has no tolerance: it must not happen at all.
"""


def load(file: Path = STORED) -> tuple[dict[str, Figure], dict[str, Figure]]:
    """Stored figures of the whole and of the short form, by name."""
    found: tuple[dict[str, Figure], dict[str, Figure]] = ({}, {})
    which = 0
    if not file.exists():
        return found
    for line in file.read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            which = int("short" in line)
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("|") and len(cells) == 5 and cells[1] in _SIGNS:
            name, better, value, error, of = cells
            found[which][name] = Figure(name, better, float(value), float(error), of)  # type: ignore[arg-type]
    return found


def store(
    whole: dict[str, Figure], short_form: dict[str, Figure], commit: str, file: Path = STORED
) -> None:
    """Write both."""
    lines = [_HEAD.format(commit=commit)]
    for title, figures in (("The whole", whole), ("The short form", short_form)):
        rows = [
            (f.name, f.better, f"{f.value:.6g}", f"{f.error:.3g}", f.of) for f in figures.values()
        ]
        head = ("figure", "better", "value", "error", "of")
        lines += [f"## {title}", "", *markdown(head, rows), ""]
    file.write_text("\n".join(lines), encoding="utf-8")


def kept_outcomes(file: Path, outcomes: dict[str, list[Any]]) -> None:
    """Write outcomes, for whoever looks closer."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(outcomes), encoding="utf-8")
