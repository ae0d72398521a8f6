"""docs/accuracy.md from outcomes that are known."""

import re
from typing import Any

from benchmarks.accuracy import sections

Data = dict[str, Any]


def test_page_is_filled_everywhere(data: Data) -> None:
    page = sections.page(data)
    assert "{{" not in page
    assert "Not in this run" not in page
    assert not re.search(r"(?<![\w.)])/(tmp|home|work|usr)/", page)


def test_page_of_a_partial_run_says_what_is_missing(data: Data) -> None:
    page = sections.page({name: data[name] for name in ("mems", "delay")})
    assert "Not in this run (`--only baseline`)." in page
    assert "speeds in whole rpm" in page
