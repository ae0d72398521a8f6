"""docs/accuracy.md from the outcomes: the template's prose, and numbers from nowhere else."""

import re
from pathlib import Path

from benchmarks.accuracy.sections import SECTIONS, missing
from benchmarks.accuracy.statistics import Data
from benchmarks.accuracy.verdicts import Section, table, verdict_table

TEMPLATE = Path(__file__).with_name("template.md")


def page(data: Data) -> str:
    """The page; a case that was not run is left out, with a line saying so."""
    sections = {
        name: Section([], [f"Not in this run (`--only {lacking[0]}`)."]) if lacking else of(data)
        for name, (_, of) in SECTIONS.items()
        for lacking in [missing(name, data)]
    }
    verdicts = [v for section in sections.values() for v in section.verdicts]
    lines = {
        **{name: section.lines for name, section in sections.items()},
        "verdicts": verdict_table(verdicts),
        "run": run_table(data),
    }
    text = TEMPLATE.read_text(encoding="utf-8")
    return re.sub(r"\{\{([a-z-]+)\}\}", lambda m: "\n".join(lines[m[1]]).strip(), text)


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
