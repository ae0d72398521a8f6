"""Sections from outcomes of which the right verdicts are known."""

from typing import Any

import numpy as np
import pytest

from benchmarks.accuracy.sections import SECTIONS, missing

Data = dict[str, Any]


def verdicts(data: Data, name: str) -> dict[str, str]:
    """Quantity to outcome."""
    return {v.quantity: v.outcome for v in SECTIONS[name][1](data).verdicts}


def worsen(data: Data, case: str, factor: float) -> None:
    """Multiply all errors of a case, claimed deviations left as they are."""

    def walk(node: Any) -> None:
        if isinstance(node, dict):
            for key, value in node.items():
                if key == "error":
                    node[key] = (factor * np.array(value)).tolist()
                else:
                    walk(value)

    for outcome in data[case]["outcomes"]:
        walk(outcome)


@pytest.mark.parametrize("name", SECTIONS)
def test_small_errors_meet_every_bar(data: Data, name: str) -> None:
    section = SECTIONS[name][1](data)
    assert {v.outcome for v in section.verdicts} <= {"met"}
    assert section.lines


@pytest.mark.parametrize(
    ("name", "case"),
    [
        ("article-flight", "baseline"),
        ("noise", "noisiest"),
        ("efficiency", "white"),
        ("fast", "mems"),
        ("coverage", "baseline"),
    ],
)
def test_large_errors_miss_them(data: Data, name: str, case: str) -> None:
    worsen(data, case, 200.0)
    missed = [v for v in SECTIONS[name][1](data).verdicts if v.outcome != "met"]
    assert missed
    assert not any(v.outcome == "below the bound" for v in missed)


@pytest.mark.slow
def test_bars_under_the_bound_are_called_so(data: Data) -> None:
    worsen(data, "baseline", 40.0)
    bounds = data["bounds"]["outcomes"][0]
    bounds["paper 0.02 telemetered"] = [2.0] * 8 + [np.nan, 2.0]
    found = SECTIONS["article-flight"][1](data).verdicts
    telemetered = [v for v in found if "telemetered" in v.quantity]
    assert {v.outcome for v in telemetered} == {"below the bound"}
    assert {v.outcome for v in found if "exact" in v.quantity} == {"not met"}


def test_a_beaten_row_of_table_3_is_lost_by_either_figure(data: Data) -> None:
    for outcome in data["sweep"]["outcomes"]:
        outcome["0.03"]["online exact"]["error"][2] = 3.3  # the article's largest is 3.2
    found = SECTIONS["noise"][1](data).verdicts
    lost = [v for v in found if v.outcome != "met"]
    assert [(v.measured, v.why) for v in lost] == [("4 of 5", "at 0.03")]


def test_wrong_claims_are_counted_by_runs(data: Data) -> None:
    runs = data["course"]["outcomes"]
    for outcome in runs[: len(runs) // 5]:
        outcome["wrong refits"][3] = 1
    found = verdicts(data, "convergence")
    assert [outcome for what, outcome in found.items() if "at any refit" in what] == ["not met"]
    assert [outcome for what, outcome in found.items() if "at the end" in what] == ["met"]


def test_what_a_section_lacks(data: Data) -> None:
    del data["white"], data["bounds"]
    assert missing("efficiency", data) == ["bounds", "white"]
    assert missing("fast", data) == []
