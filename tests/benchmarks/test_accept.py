"""What `make accept` calls different, and what it calls worse."""

import math

import pytest

from benchmarks.accept import __main__ as command
from benchmarks.accept import cost, equal, judge, trees
from benchmarks.accept.judge import Figure, Row, Study, coverage, figure
from testbed import study


@pytest.fixture
def git(monkeypatch):
    """A history with one release."""
    told = {"log": b"abc1234\nold5678\n"}
    monkeypatch.setattr(trees, "git", lambda *words: told[words[0]])
    return told


def test_the_release_is_the_commit_that_dated_its_section(git):
    assert trees.last_release() == "old5678"
    git["log"] = b""
    with pytest.raises(trees.NoHistoryError, match="does not reach back to"):
        trees.last_release()


def estimate(value, std):
    return {"parameters": {"Ixx": {"value": value, "std": std, "status": "identified"}}}


@pytest.mark.parametrize(
    ("before", "now", "says"),
    [
        (estimate(0.0165, 1e-4), estimate(0.0165 + 9e-14, 1e-4), []),
        (estimate(0.0165, 1e-4), estimate(0.0165 + 2e-13, 1e-4), ["parameters.Ixx.value:"]),
        ({"t": [1.0, 2.0]}, {"t": [1.0]}, ["t: 2 -> 1 entries"]),
        ({"verdict": "partial"}, {"verdict": "refused"}, ['verdict: "partial" -> "refused"']),
        ({"a": 1}, {"b": 1}, ["a: gone (was 1)", "b: new (1)"]),
        ({"a": None}, {"a": 1.0}, ["a: null -> 1.0"]),
        ({"a": math.nan}, {"a": math.nan}, []),
    ],
)
def test_a_digit_is_one_of_the_standard_deviation(before, now, says):
    found = list(equal.differences(before, now))
    assert len(found) == len(says)
    assert all(line.startswith(start) for line, start in zip(found, says, strict=True))


def test_a_covariance_is_held_against_its_diagonal():
    def told(cross):
        matrix = [[1.0, cross], [cross, 4.0]]
        return {"covariance": {"names": ["a", "b"], "matrix": matrix, "given": {}}}

    assert not list(equal.differences(told(1e-15), told(1e-11)))
    assert list(equal.differences(told(0.0), told(1e-6)))


@pytest.mark.usefixtures("capsys")
def test_the_shortest_case_is_run_and_compared_with_itself():
    case = equal.Case("version", ("--version",))
    found = equal.results_of(study.PROJECT, [case], 1, {})
    assert found["version"]["result"]["status"] == 0
    assert equal.compare(found, found) == ([], 0)
    other = {"version": {**found["version"], "result": {"status": 1}}}
    lines, different = equal.compare(other, found)
    assert different == 1
    assert lines[0].startswith("version: ")


@pytest.mark.parametrize(
    ("better", "stored", "now", "verdict"),
    [
        ("low", 1.0, 1.15, "same"),
        ("low", 1.0, 1.25, "worse"),
        ("low", 1.0, 0.7, "better"),
        ("high", 1.0, 0.75, "worse"),
        ("never", 0.0, 1.0, "worse"),
        ("never", 2.0, 1.0, "better"),
        ("coverage", 99.6, 95.1, "same"),
        ("coverage", 99.6, 94.0, "worse"),
        ("coverage", 90.0, 90.0, "same"),
        ("low", math.nan, math.nan, "same"),
        ("low", 1.0, math.nan, "worse"),
    ],
)
def test_worse_is_beyond_twice_the_standard_error(better, stored, now, verdict):
    row = Row(Figure("x", better, now, 0.05, ""), Figure("x", better, stored, 0.1, ""))
    assert row.verdict == verdict


def test_the_error_of_a_mean_is_that_of_its_sampling():
    values = [float(i % 5) for i in range(100)]
    found = figure("mean", "low", values, lambda units: sum(units) / len(units))
    assert found.value == 2.0
    assert found.error == pytest.approx(math.sqrt(2.0 / 100.0), rel=0.15)


def test_a_coverage_of_all_is_as_uncertain_as_one_of_95_percent():
    assert coverage("x", [[True] * 10] * 10).error == pytest.approx(math.sqrt(95.0 * 5.0 / 100.0))


def test_what_is_stored_is_what_is_read(tmp_path):
    figures = {
        f.name: f
        for f in (Figure("a, %", "low", 1.25, 0.5, "12"), Figure("b", "never", 0.0, 0.0, "3"))
    }
    judge.store(figures, {}, "abc", tmp_path / "stored.md")
    assert judge.load(tmp_path / "stored.md") == (figures, {})


def _fails(unit):
    raise ValueError(f"no {unit}")


def test_a_unit_that_breaks_is_a_defect(monkeypatch, capsys):
    broken = Study("broken", lambda short: [1], _fails, lambda outcomes: [], alone=True)
    monkeypatch.setattr(command, "STUDIES", (broken,))
    monkeypatch.setattr(judge, "kept_outcomes", lambda *_: None)
    assert command.main(["judge"]) == 1
    assert "defect: broken: 1: ValueError: no 1" in capsys.readouterr().out


def test_without_a_history_nothing_is_compared(monkeypatch, capsys):
    def gone(*_):
        raise trees.NoHistoryError("no git")

    monkeypatch.setattr(trees, "git", gone)
    assert command.main(["equal", "--only", "sample"]) == 0
    assert capsys.readouterr().out == "equal: not compared: no git\n"
    assert cost._run(("start", "1", 2)) is None
