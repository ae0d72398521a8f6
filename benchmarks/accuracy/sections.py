"""Every study's section of docs/accuracy.md, in the order of the page."""

from collections.abc import Callable

from benchmarks.accuracy.statistics import Data
from benchmarks.accuracy.tables_errors import (
    article_flight,
    coverage,
    efficiency,
    fast,
    noise_sweep,
)
from benchmarks.accuracy.tables_others import chains, filters, whole_path
from benchmarks.accuracy.tables_time import convergence, late
from benchmarks.accuracy.verdicts import Section

SECTIONS: dict[str, tuple[tuple[str, ...], Callable[[Data], Section]]] = {
    "article-flight": (("bounds", "baseline"), article_flight),
    "noise": (("bounds", "baseline", "sweep", "noisiest"), noise_sweep),
    "efficiency": (("bounds", "baseline", "white"), efficiency),
    "fast": (("mems",), fast),
    "coverage": (("baseline", "mems"), coverage),
    "convergence": (("course",), convergence),
    "delay": (("delay",), late),
    "chains": (("chains",), chains),
    "filters": (("filters",), filters),
    "whole-path": (("end-to-end",), whole_path),
}
"""Place in the template to the cases that it needs and what goes there."""


def missing(name: str, data: Data) -> list[str]:
    """Cases that a section needs and that were not run."""
    return [need for need in SECTIONS[name][0] if need not in data]
