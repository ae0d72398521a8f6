import re
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("matplotlib", reason="figures need it (the bench extra)")

from benchmarks.accuracy import document, figures
from benchmarks.accuracy.sections import SECTIONS

Data = dict[str, Any]


def test_page_begins_with_the_verdicts_and_is_filled_everywhere(data: Data) -> None:
    page = document.page(data, set(figures.FIGURES))
    assert "{{" not in page
    places = [page.index(text) for text in ("## Acceptance criteria", " met, ", "## The article's")]
    assert places == sorted(places)
    assert "Not in this run" not in page
    for name in figures.FIGURES:
        assert f"(accuracy/{name}.svg)" in page
    assert not re.search(r"(?<![\w.)])/(tmp|home|work|usr)/", page)


def test_every_section_has_a_place() -> None:
    template = document.TEMPLATE.read_text(encoding="utf-8")
    assert [name for name in SECTIONS if f"{{{{{name}}}}}" not in template] == []


def test_page_of_a_partial_run_says_what_is_missing(data: Data) -> None:
    kept = {name: data[name] for name in ("mems", "delay")}
    page = document.page(kept, set())
    assert "Not in this run (`--only baseline`)." in page
    assert "speeds in whole rpm" in page
    assert "accuracy/" not in page.replace("benchmarks/accuracy/", "")


@pytest.mark.slow
def test_figures_come_out_the_same_twice(data: Data, tmp_path: Path) -> None:
    first, second = tmp_path / "a", tmp_path / "b"
    assert figures.draw(data, first) == set(figures.FIGURES)
    # One is enough for the second time, each takes seconds.
    assert figures.draw({"course": data["course"]}, second) == {"convergence"}
    svg = (first / "convergence.svg").read_bytes()
    assert svg == (second / "convergence.svg").read_bytes()
    assert b"<svg" in svg


def test_page_is_written(data: Data, tmp_path: Path) -> None:
    path = document.write({"delay": data["delay"]}, tmp_path)
    assert path == tmp_path / "accuracy.md"
    assert b"\r" not in path.read_bytes()
