import re
from typing import Any

from benchmarks.accuracy import document
from benchmarks.accuracy.sections import SECTIONS

Data = dict[str, Any]


def test_page_begins_with_the_verdicts_and_is_filled_everywhere(data: Data) -> None:
    page = document.page(data)
    assert "{{" not in page
    places = [page.index(text) for text in ("## Acceptance criteria", " met, ", "## The article's")]
    assert places == sorted(places)
    assert "Not in this run" not in page
    assert not re.search(r"(?<![\w.)])/(tmp|home|work|usr)/", page)


def test_every_section_has_a_place() -> None:
    template = document.TEMPLATE.read_text(encoding="utf-8")
    assert [name for name in SECTIONS if f"{{{{{name}}}}}" not in template] == []


def test_page_of_a_partial_run_says_what_is_missing(data: Data) -> None:
    page = document.page({name: data[name] for name in ("mems", "delay")})
    assert "Not in this run (`--only baseline`)." in page
    assert "speeds in whole rpm" in page
