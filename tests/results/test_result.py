"""The result file: strict JSON, as the contract says."""

import json
import math

import pytest

from gcs_sysid.model.estimate import Estimate
from gcs_sysid.results.result_view import verdict_sentence
from tests.known_results import result_of


def result(**estimates):
    return result_of(estimates, verdict="partial", reasons=("why",))


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
    rest = {"std_given": 0.0, "ci95": None, "unit": "m", "status": "weak", "objections": []}
    assert table["a"] == {"value": None, "std": 1.0, "std_data": 1.0} | rest
    assert table["b"] == {"value": 1.0, "std": None, "std_data": None} | rest


def test_what_was_given_is_told_apart():
    whole = Estimate(2.0, 0.5, "kg", "identified", std_given=0.4)
    assert whole.std_data == pytest.approx(0.3)
    assert whole.as_json()["std_given"] == 0.4
    assert whole.ci95 == pytest.approx((2.0 - 0.97998199, 2.0 + 0.97998199))
    # A given value shows its interval where it is not exact.
    assert Estimate(1.5, 0.0, "kg", "given").half is None
    assert Estimate(1.5, 0.01, "kg", "given", std_given=0.01).half == pytest.approx(0.01959964)


def test_one_line_and_file(tmp_path):
    r = result(a=Estimate(1.0, 0.1, "m", "weak"))
    assert "\n" not in r.dumps(indent=None)
    r.write(tmp_path / "r.json")
    assert json.loads((tmp_path / "r.json").read_text()) == r.as_json()


def test_the_verdict_gives_a_weak_moment_its_width_and_no_share_of_unknown_ones():
    rough = Estimate(0.016, 1e-3, "kg m^2", "weak")
    wide, sure = Estimate(0.016, 1.0, "kg m^2", "weak"), Estimate(0.0, 1e-5, "kg m^2", "zero")
    said = verdict_sentence(result(Ixx=rough, Iyy=wide, Ixy=sure)).replace("\xa0", " ")
    assert said == "Weak: Ixx (± 12 %) and Iyy."
    known = Estimate(0.016, 1e-5, "kg m^2", "identified")
    assert "products of inertia to within" in verdict_sentence(result(Ixx=known, Ixy=sure))
