import math

import pytest

from benchmarks.accuracy.verdicts import (
    at_least,
    at_most,
    number,
    of,
    table,
    verdict_table,
    within,
)


@pytest.mark.parametrize(
    ("value", "bound", "outcome"),
    [
        (0.9, None, "met"),
        (1.0, None, "met"),
        (1.1, None, "not met"),
        (1.1, 0.8, "not met"),
        (1.6, 1.5, "below the bound"),
        (0.9, 1.5, "met"),
        (math.nan, None, "not met"),
        (math.inf, 0.5, "not met"),
    ],
)
def test_a_bar_that_no_estimator_could_meet_is_called_so(value, bound, outcome):
    assert at_most("error", value, 1.0, bound=bound).outcome == outcome


def test_a_miss_says_the_bound_and_a_success_does_not():
    assert "Cramér-Rao 1.5 % or more" in at_most("error", 1.6, 1.0, bound=1.5).cells()[-1]
    assert at_most("error", 0.9, 1.0, bound=0.5).cells()[-1] == "met"


@pytest.mark.parametrize(("value", "outcome"), [(0.85, "met"), (0.84, "not met")])
def test_least(value, outcome):
    assert at_least("ratio", value, 0.85, "").outcome == outcome


@pytest.mark.parametrize(
    ("value", "outcome"), [(91.9, "not met"), (92.0, "met"), (98.0, "met"), (98.1, "not met")]
)
def test_between(value, outcome):
    assert within("share", value, 92.0, 98.0).outcome == outcome


def test_the_table_counts_outcomes_and_names_a_case_once():
    verdicts = of("a case", 7, [at_most("x", 1.0, 2.0), at_most("y", 3.0, 2.0)])
    verdicts += of("another", 0, [at_most("z", 3.0, 2.0, bound=2.5)])
    text = "\n".join(verdict_table(verdicts))
    assert "1 of 3 met, 1 not met, 1 below" in text
    assert text.count("a case") == 1
    assert "| a case | x | ≤ 2 % | 1 % | 7 | met |" in text
    assert "|  | y | ≤ 2 % | 3 % | 7 | **not met** |" in text


def test_markdown():
    assert table(["a", "b"], [["1", "2"]]) == ["| a | b |", "|---|---|", "| 1 | 2 |", ""]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (math.nan, "–"),
        (math.inf, "never"),
        (0.0, "0"),
        (0.12345, "0.123"),
        (0.000036, "0.00004"),
        (12345.6, "12346"),
    ],
)
def test_numbers_have_three_digits_and_no_exponent(value, text):
    assert number(value) == text
