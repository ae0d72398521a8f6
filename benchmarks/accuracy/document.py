"""docs/accuracy.md from the outcomes: the template's prose, and numbers from nowhere else."""

import re
from pathlib import Path

from benchmarks.accuracy import figures
from benchmarks.accuracy.sections import SECTIONS, missing
from benchmarks.accuracy.statistics import Data
from benchmarks.accuracy.verdicts import Section, table, verdict_table

TEMPLATE = Path(__file__).with_name("template.md")


def write(data: Data, docs: Path) -> Path:
    """Write page and figures; returns the page."""
    drawn = figures.draw(data, docs / "accuracy")
    path = docs / "accuracy.md"
    path.write_text(page(data, drawn), encoding="utf-8", newline="\n")
    return path


def page(data: Data, drawn: set[str]) -> str:
    """The page; a case that was not run is left out, with a line saying so.

    Args:
        data: outcomes.
        drawn: figures that there are.
    """
    sections = {
        name: Section([], [f"Not in this run (`--only {lacking[0]}`)."]) if lacking else of(data)
        for name, (_, of) in SECTIONS.items()
        for lacking in [missing(name, data)]
    }

    def fill(match: re.Match[str]) -> str:
        name = match[1]
        if name == "verdicts":
            lines = verdict_table([v for section in sections.values() for v in section.verdicts])
        elif name == "run":
            lines = run_table(data)
        elif name.startswith("figure "):
            name = name.removeprefix("figure ")
            lines = [f"![{figures.FIGURES[name][1]}](accuracy/{name}.svg)"] if name in drawn else []
        else:
            lines = sections[name].lines
        return "\n".join(lines).strip()

    text = re.sub(r"\{\{([a-z -]+)\}\}", fill, TEMPLATE.read_text(encoding="utf-8"))
    return re.sub(r"\n{3,}", "\n\n", text).rstrip() + "\n"


def run_table(data: Data) -> list[str]:
    """What each case cost."""
    rows = [
        [
            f"`{name}`",
            "–" if name == "bounds" else str(case["seeds"]),
            f"{case['prepared']:.0f}",
            f"{case['each'] * len(case['outcomes']):.0f}",
            f"{case['seconds']:.0f}",
        ]
        for name, case in data.items()
    ]
    minutes = sum(case["seconds"] for case in data.values()) / 60.0
    workers = max((case["workers"] for case in data.values()), default=0)
    return [
        f"Seeds run from 1 to the number given. The run took {minutes:.0f} min on {workers} cores.",
        "",
        *table(["case", "seeds", "setup, core s", "run, core s", "elapsed, s"], rows),
    ]
