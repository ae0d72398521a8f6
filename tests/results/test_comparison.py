"""Changed, no change seen, cannot tell: one parameter and all of them."""

from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.cli.compare_command import report
from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.results.comparison import compare
from gcs_sysid.results.result_data import Scale
from gcs_sysid.significance import FALSE_ALARM_RATE
from gcs_sysid.web.page_json import comparison_rows
from tests.known_results import estimates, result_of

STD = 0.01
MASS = Scale("mass", 1.5, "kg")
QUAD = load_airframe("px4-quad-x")


def result(source="a.tlog", scale=MASS, airframe=QUAD, statuses=None, **values):
    """Parameters of these values, all with the same standard deviation."""
    found = estimates(values, std=STD, statuses=statuses)
    return result_of(found, source=source, scale=scale, airframe=airframe.as_json())


def test_difference_and_interval():
    found = compare(result(Ixx=1.0), result(Ixx=1.1, source="b")).differences["Ixx"]
    assert found.value == pytest.approx(0.1)
    half = 1.959964 * STD * np.sqrt(2.0)
    assert found.ci95 == pytest.approx((0.1 - half, 0.1 + half))
    assert found.verdict == "changed"
    assert found.p == pytest.approx(1.54e-12, rel=0.01)


def test_one_interval_that_misses_among_many_is_no_change():
    names = ("Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Ixz", "cg_x", "cg_y", "k_T", "k_M")
    before = dict.fromkeys(names, 1.0)
    off = 2.8 * STD * np.sqrt(2.0)
    alone = compare(result(Ixx=1.0), result(Ixx=1.0 + off, source="b"))
    assert alone.verdict == "changed"
    among = compare(result(**before), result(**before | {"Ixx": 1.0 + off}, source="b"))
    found = among.differences["Ixx"]
    assert found.ci95[0] > 0.0
    assert found.p < FALSE_ALARM_RATE < found.p_holm
    assert found.verdict == "no_change_seen"
    assert among.verdict == "no_change_seen"


@pytest.mark.slow
def test_a_vehicle_that_is_the_same_is_rarely_called_changed():
    names = ("Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Ixz", "cg_x", "cg_y", "k_T", "k_M")
    draw = np.random.default_rng(5)
    trials, wrong = 2000, 0
    for _ in range(trials):
        a, b = (dict(zip(names, draw.normal(1.0, STD, 10), strict=True)) for _ in range(2))
        wrong += compare(result(**a), result(**b, source="b")).verdict == "changed"
    assert 0.005 < wrong / trials < 0.015


@pytest.mark.parametrize(
    ("status", "why"), [("unobservable", "unobservable in B"), ("weak", "weak in B")]
)
def test_what_is_not_identified_in_both_cannot_be_told(status, why):
    after = result(Ixx=9.0, Iyy=1.0, statuses={"Ixx": status}, source="b")
    comparison = compare(result(Ixx=1.0, Iyy=1.0), after)
    found = comparison.differences["Ixx"]
    assert (found.verdict, found.why) == ("cannot_tell", why)
    assert comparison.verdict == "no_change_seen"


def test_nothing_in_common_is_no_answer():
    comparison = compare(result(Ixx=1.0), result(Iyy=1.0, source="b"))
    assert comparison.verdict == "cannot_tell"
    assert comparison.differences["Ixx"].why == "not in B"
    assert comparison.differences["Iyy"].why == "not in A"


def test_a_given_mass_is_not_compared():
    given = {"mass": Estimate(1.5, 0.0, "kg", "given")}
    a, b = (replace(r, parameters=r.parameters | given) for r in (result(Ixx=1.0),) * 2)
    found = compare(a, b).differences["mass"]
    assert (found.verdict, found.why) == ("cannot_tell", "given in both")


def test_what_rests_on_a_prior_says_nothing_of_the_vehicle():
    leaning = {"Izz": Estimate(1.0, STD, "kg m^2", "identified", rests_on="prior")}
    a = replace(result(), parameters=leaning)
    found = compare(a, result(Izz=1.0, source="b")).differences["Izz"]
    assert (found.verdict, found.why) == ("cannot_tell", "mostly from a prior in A")


def test_without_a_scale_only_lengths_compare():
    comparison = compare(result(Ixx=1.0, cg_x=0.1, scale=None), result(Ixx=1.0, cg_x=0.9))
    assert comparison.differences["Ixx"].why == "A has no scale"
    assert comparison.differences["cg_x"].verdict == "changed"
    assert any("without a scale" in note for note in comparison.notes)


def test_anchors_are_told():
    def notes(first, second, **after):
        return "\n".join(compare(result(scale=first, k_T=1.0), result(scale=second, **after)).notes)

    assert "scale of both: mass = 1.5 kg" in notes(MASS, MASS, k_T=1.0)
    assert "scale of A: mass = 1.5 kg, of B: mass = 1.8 kg" in notes(
        MASS, Scale("mass", 1.8, "kg"), k_T=1.0
    )
    other = notes(MASS, Scale("k_T", 2e-4, "N s^2"), k_T=1.0)
    assert "scale of A: mass = 1.5 kg, of B: k_T = 0.0002 N s^2" in other
    assert "may come from the scale" in other


def test_a_payload_nobody_weighed_is_suspected():
    """k_T falls by a fifth at the mass given: rotors do not, so the mass must be more."""
    comparison = compare(result(k_T=1.0), result(k_T=0.8, source="b"))
    assert any("is not 1.5 kg but about 1.875 kg" in note for note in comparison.notes)


@pytest.mark.parametrize("values", [(1.0, 0.0), (0.0, 1.0)])
def test_rotors_without_thrust_suggest_no_mass_that_divides_by_it(values):
    before, after = values
    comparison = compare(result(k_T=before), result(k_T=after, source="b"))
    assert comparison.differences["k_T"].verdict == "changed"
    assert not any("about 0 kg" in note or "nan" in note for note in comparison.notes)


def test_other_rotors_are_another_vehicle():
    hexa = result(airframe=load_airframe("px4-hexa-x"), source="b.tlog")
    with pytest.raises(InputError, match=r"a\.tlog has 4 rotors, b\.tlog has 6"):
        compare(result(), hexa)


def test_what_else_differs_is_told():
    wide = result(airframe=QUAD.with_arm(0.3), Ixx=1.0)
    notes = "\n".join(compare(result(Ixx=1.0), wide).notes)
    assert "different rotor positions" in notes
    assert "both come from a.tlog" in notes
    command = replace(
        result(Ixx=1.0, source="b"), rotor_input=RotorInput.COMMAND, vehicle={"sysid": 2}
    )
    notes = "\n".join(compare(result(Ixx=1.0), command).notes)
    assert "rotor speeds, the other commands" in notes
    assert "same vehicle?" in notes
    bare = replace(result(Ixx=1.0, source="b"), airframe={})
    assert "no rotor positions" in "\n".join(compare(result(Ixx=1.0), bare).notes)
    moved = replace(result(source="b"), events=({"t": 9.0, "kind": "payload", "detected": 9.1},))
    assert "B changed in flight" in "\n".join(compare(result(), moved).notes)


def test_what_was_given_is_the_same_in_both():
    """An arm known to 30 % does not hide a change of 10 % that both flights tell."""
    before, after = (result(Ixx=1.0), result(Ixx=1.0 + 10.0 * STD, source="b"))
    narrow = compare(before, after).differences["Ixx"]
    wide = [
        replace(
            r,
            parameters={"Ixx": replace(r.parameters["Ixx"], std=np.hypot(STD, 0.3), std_given=0.3)},
        )
        for r in (before, after)
    ]
    found = compare(*wide).differences["Ixx"]
    assert found.std == pytest.approx(narrow.std)
    assert found.verdict == narrow.verdict == "changed"


def test_a_lag_is_compared_in_milliseconds():
    timing = {"motor_lag": Estimate(0.05, 0.001, "s", "identified")}
    before = replace(result(Ixx=0.5), timing=timing)
    timing = {"motor_lag": Estimate(0.0612, 0.001, "s", "identified")}
    comparison = compare(before, replace(before, timing=timing))
    line = next(line for line in report(comparison).splitlines() if "motor_lag" in line)
    assert line.split() == ["motor_lag", "50.0", "61.2", "11.2", "2.8", "+22", "ms", "≠"]
    row = next(row for row in comparison_rows(comparison)["rows"] if row["name"] == "motor_lag")
    assert (row["before"], row["difference"]) == ("50.0 ± 2.0 ms", "11.2 ± 2.8 ms")
    assert comparison.as_json()["parameters"]["motor_lag"]["unit"] == "s"
