"""The result file: strict JSON, as the contract says."""

import json
import math

import pytest

from gcs_sysid.results.result import Estimate, Result, Scale


def result(**estimates):
    return Result("partial", ("why",), "log", {}, Scale("mass", 1.5, "kg"), "speed", estimates)


def test_interval_is_the_normal_95_percent():
    low, high = Estimate(2.0, 0.1, "kg", "identified").ci95
    assert (low, high) == pytest.approx((2.0 - 0.1959964, 2.0 + 0.1959964))
    assert Estimate(1.5, 0.0, "kg", "given").ci95 == (1.5, 1.5)
    assert Estimate(None, None, "kg", "unobservable").ci95 is None
    assert Estimate(1.0, None, "kg", "unobservable").ci95 is None


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_json_is_strict_whatever_the_numbers(bad):
    text = result(a=Estimate(bad, 1.0, "m", "weak"), b=Estimate(1.0, bad, "m", "weak")).dumps()
    table = json.loads(text, parse_constant=pytest.fail)["parameters"]
    assert table["a"] == {"value": None, "std": 1.0, "ci95": None, "unit": "m", "status": "weak"}
    assert table["b"] == {"value": 1.0, "std": None, "ci95": None, "unit": "m", "status": "weak"}


def test_one_line_and_file(tmp_path):
    r = result(a=Estimate(1.0, 0.1, "m", "weak"))
    assert "\n" not in r.dumps(indent=None)
    r.write(tmp_path / "r.json")
    assert json.loads((tmp_path / "r.json").read_text()) == r.as_json()
