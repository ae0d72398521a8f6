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


def rows(data: Data, name: str) -> dict[str, list[str]]:
    """First cell of each row to the others."""
    lines = [line for line in sections.SECTIONS[name][1](data) if line.startswith("| ")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return {first: rest for first, *rest in cells[1:]}


def test_intervals_that_claim_too_little_are_seen_as_such(data: Data) -> None:
    for outcome in data["baseline"]["outcomes"]:
        outcome["online exact"]["error"][0] = 1.0
    shares = rows(data, "coverage")
    assert shares["20 Hz online, exact speeds"][0] == "0"
    assert float(shares["20 Hz online, telemetered speeds"][0]) > 85.0


def test_wrong_claims_are_counted_by_runs(data: Data) -> None:
    runs = data["course"]["outcomes"]
    for outcome in runs[: len(runs) // 5]:
        outcome["wrong refits"][3] = 1
        outcome["any wrong at any refit"] = True
    found = rows(data, "convergence")
    assert found["wrong at any refit, % of runs"] == ["0"] * 3 + ["20"] + ["0"] * 6 + ["20"]
    assert set(found["wrong at the end, % of runs"]) == {"0"}
