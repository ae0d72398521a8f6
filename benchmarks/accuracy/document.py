"""docs/accuracy.md from the outcomes: the template's prose, and numbers from nowhere else."""

import importlib
import re
from pathlib import Path

from benchmarks.accuracy import figures
from benchmarks.accuracy.tables import SECTIONS, Data

TEMPLATE = Path(__file__).with_name("template.md")


def write(data: Data, docs: Path) -> Path:
    """Write page and figures; a case that was not run is left out, with a line saying so."""
    drawn = figures.draw(data, docs / "accuracy")

    def fill(match: re.Match[str]) -> str:
        name = match[1]
        if name == "run":
            return _run(data)
        if name == "filter-claims":
            return _filter_claims(data)
        if name.startswith("figure "):
            name = name.removeprefix("figure ")
            return f"![{figures.FIGURES[name][1]}](accuracy/{name}.svg)" if name in drawn else ""
        needs, section = SECTIONS[name]
        missing = [need for need in needs if need not in data]
        if missing:
            return f"Not in this run (`--only {missing[0]}`)."
        return "\n".join(section(data)).strip()

    text = re.sub(r"\{\{([a-z -]+)\}\}", fill, TEMPLATE.read_text(encoding="utf-8"))
    page = docs / "accuracy.md"
    page.write_text(re.sub(r"\n{3,}", "\n\n", text).rstrip() + "\n", encoding="utf-8")
    return page


def _run(data: Data) -> str:
    minutes = sum(case["seconds"] for case in data.values()) / 60.0
    workers = max(case.get("workers", 1) for case in data.values())
    return f"This run took {minutes:.0f} min on {workers} cores."


def _filter_claims(data: Data) -> str:
    """The section on filters, where there is one; with as many seeds as the baseline."""
    try:
        claims = importlib.import_module("benchmarks.filter_claims")
    except ModuleNotFoundError as error:
        if error.name != "benchmarks.filter_claims":
            raise
        return ""
    return "\n".join(claims.tables(data.get("baseline", {"seeds": 20})["seeds"]))
