"""Health in words: one number format, and values of its file."""

import json
from dataclasses import replace

import pytest

from gcs_sysid.cli.health_command import health_text
from gcs_sysid.health.advice import advised
from gcs_sysid.health.assessment import beside_analysis
from gcs_sysid.health.health_file import document_of, read_baseline
from gcs_sysid.health.rotor_condition import Condition
from gcs_sysid.health.vehicle_health import Health, RotorHealth
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.estimate import Estimate, Objection, Quantity
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.screen.panels import health_lines
from tests.known_results import result_of
from tests.screen.fake import health as health_document

AFT = Estimate(-0.1, 0.0067 / 1.96, "m", std_given=0.0067 / 1.96)
CENTERED = Estimate(0.0, 0.001, "m")
HEALTH = Health(
    "a.tlog", airframe=load_airframe("paper"), rotor_input=RotorInput.SPEED, cg=(AFT, CENTERED),
)  # fmt: skip


def loaded(*shares, gain=None):
    """Rotors that carry these shares."""
    own = None if gain is None else Estimate(gain, 0.002, "1")
    alike = Quantity(1.0, 0.03, "1")
    return tuple(
        RotorHealth(Quantity(share, 0.001, "1"), alike, own, None, None, None) for share in shares
    )


SIDES = "the rotors of one side unlike those of the other"


@pytest.mark.parametrize(
    ("shares", "unlike", "where"),
    [
        ((0.2, 0.3, 0.2, 0.3), SIDES, "all rotors"),
        ((0.26, 0.27, 0.2, 0.27), "rotor 3 unlike the others", "rotor 3"),
        ((0.24, 0.23, 0.3, 0.23), "rotor 3 unlike the others", "rotor 3"),
    ],
)
def test_loads_that_unlike_rotors_explain_as_well_as_a_cg_name_both(shares, unlike, where):
    """Four loads have no more to say than a CG, the yaw trim and their sum."""
    found = advised(replace(HEALTH, rotors=loaded(*shares))).findings[0]
    assert found.what == f"100.0 mm aft of the center, or {unlike}"
    assert "if it tips that way, shift the CG 100.0 ± 6.7 mm forward; if not, look at " in found.do
    assert f"look at {where}: propeller and pole count" in found.do


def test_the_motor_that_is_off_the_most_comes_first_and_the_weight_where_it_is_surely_much():
    rotors = tuple(loaded(0.25, gain=gain)[0] for gain in (1.24, 1.22, 1.23, 0.31))
    for std, named in ((0.09, False), (0.03, True)):
        ratio = Estimate(1.57, std, "1")
        found = advised(replace(HEALTH, rotors=rotors, thrust_to_weight=ratio)).findings
        assert (found[0].at, "the weight" in {one.at for one in found}) == ("motor 4", named)


@pytest.mark.parametrize(("speed", "way"), [(0.86, "less"), (1.17, "more")])
def test_a_rotor_of_six_that_no_cg_explains_is_named_in_place_of_a_cg(speed, way):
    airframe = load_airframe("px4-hexa-x").with_arm(0.25)
    x, y, _ = airframe.geometry
    loads = 1.0 + 0.3 * x - 0.2 * y
    shifted = advised(replace(HEALTH, airframe=airframe, rotors=loaded(*loads / loads.sum())))
    assert shifted.findings[0].at == "the CG"
    loads[2] *= speed**2
    found = advised(replace(HEALTH, airframe=airframe, rotors=loaded(*loads / loads.sum())))
    (finding,) = found.findings
    assert finding.at == "rotor 3"
    assert f"% {way} than balances the others" in finding.what
    assert not any("shift" in text for text in found.advice)


IDENTIFIED = {
    "cg_x": replace(AFT, status="identified"), "cg_y": replace(CENTERED, status="identified")
}  # fmt: skip
"""By an analysis."""


def test_a_cg_that_an_analysis_only_guesses_decides_nothing():
    by_hover = (replace(AFT, std=0.01), replace(CENTERED, std=0.01))
    hovered = replace(HEALTH, cg=by_hover, rotors=loaded(0.2, 0.3, 0.2, 0.3))
    weak = {name: replace(e, status="weak") for name, e in IDENTIFIED.items()}
    shown = beside_analysis(hovered, result_of(weak, verdict="partial"))
    assert SIDES in shown.findings[0].what


def test_a_change_that_an_analysis_found_comes_first():
    drift = Estimate(-0.06, 0.01, "1", "identified")
    shown = beside_analysis(replace(HEALTH, drift=drift), result_of({}, segments=({"end": 80.8},)))
    summary = document_of(shown)["summary"]
    assert (summary["word"], shown.findings[0].what) == ("LOOK AT", "the vehicle changed at 81 s")
    assert shown.drift is None


@pytest.mark.parametrize(("status", "std"), [("identified", 3e-8), ("weak", 2e-6)])
def test_beside_an_analysis_there_is_one_k_T(status, std):
    found = {"k_T": Estimate(1.1e-5, std, "N s^2", status)}
    unit = "14 poles assumed"  # and by the analysis not, whose lines confirm them
    scale = "k_T", Quantity(1e-5, 1e-8, "N s^2")
    hovered = replace(HEALTH, scale=scale, assumptions=("airframe", unit), unit=unit)
    for verdict in ("partial", "refused"):
        shown = beside_analysis(hovered, result_of(found, verdict=verdict))
        assert (shown.scale[1].value, shown.scale[1].std) == (1.1e-5, std)
        assert shown.assumptions == ("airframe",)
    unseen = {"k_T": Estimate(None, None, "N s^2", "unobservable")}
    assert beside_analysis(hovered, result_of(unseen)).scale == hovered.scale


def test_speeds_beside_commands_or_moments_decide_between_cg_and_rotors():
    alike = replace(HEALTH, rotors=loaded(0.2, 0.3, 0.2, 0.3, gain=1.0))
    by_hover = (replace(AFT, std=0.01), replace(CENTERED, std=0.01))
    hovered = replace(HEALTH, cg=by_hover, rotors=loaded(0.2, 0.3, 0.2, 0.3))
    result = result_of(IDENTIFIED)
    for health in (advised(alike), beside_analysis(hovered, result)):
        assert health.findings[0].do.startswith("shift the CG 100.0 ± 6.7 mm forward. ")


def test_where_rotors_are_unlike_neither_cg_nor_yaw_is_anything_to_act_on():
    by_hover = Objection("one spin lifts less", by="readings")
    trimmed = replace(HEALTH, yaw_imbalance=Estimate(-0.1, 0.002, "1"), doubts=(by_hover,))
    loss = Estimate(0.2, 0.004, "1")
    weak = Condition("rotor", 1, loss, 20.0, (0.0, 0.0), None, ())
    differ = Objection("rotors differ, rotor 3 by +23 %", how="check it", by="readings")
    better = {"cg_x": AFT, "cg_y": CENTERED}
    result = replace(result_of(better, verdict="partial"), objections=(differ,))
    assert beside_analysis(trimmed, result).doubts == (differ,)
    for health in (
        beside_analysis(trimmed, result),
        advised(replace(trimmed, condition=weak)),
        advised(replace(trimmed, misread={"ESC_STATUS": "rotor 3 reads 0.5: check the ESC"})),
    ):
        assert {found.at for found in health.findings} <= {"the rotors", "rotor 2"}
        assert not any("shift" in text or "heading" in text for text in health.advice)


def test_beside_an_analysis_rotors_carry_by_their_own_coefficients():
    """As they do on four that carry alike, of which one is read a tenth too fast."""
    squares = (1.0, 1.0, 1.21, 1.0)
    read = loaded(*(square / sum(squares) for square in squares))
    health = replace(HEALTH, rotors=read, yaw_imbalance=Quantity(-0.05, 0.002, "1"))
    k_T = [{"k_T": Estimate(1e-5 / square, 1e-8, "N s^2", "identified")} for square in squares]
    differ = Objection("rotors differ, rotor 3 by -17 %", by="readings")
    result = replace(result_of({}), objections=(differ,), rotors=tuple(k_T))
    shown = beside_analysis(health, result)
    for rotor in shown.rotors:
        assert rotor.thrust_share.value == pytest.approx(0.25)
        assert rotor.thrust_share.std < 0.002
    assert abs(shown.yaw_imbalance.value) < 2.0 * shown.yaw_imbalance.std


def test_battery_travel_is_computed_with_both_masses():
    health = replace(HEALTH, battery_mass=HEALTH.known_mass / 2.0)
    assert "move the battery 200 ± 13 mm forward" in advised(health).advice


def test_battery_travel_is_that_of_the_better_cg_of_an_analysis():
    by_hover = (replace(AFT, std=0.01), replace(CENTERED, std=0.01))
    health = replace(HEALTH, cg=by_hover, battery_mass=HEALTH.known_mass / 2.0)
    result = result_of(IDENTIFIED)
    assert "move the battery 200 ± 13 mm forward" not in advised(health).advice
    assert "move the battery 200 ± 13 mm forward" in beside_analysis(health, result).advice


@pytest.mark.parametrize(("share", "more"), [(-0.098, "clockwise"), (0.15, "counter-clockwise")])
def test_a_large_yaw_imbalance_is_worth_a_look_at_the_motors(share, more):
    health = replace(HEALTH, yaw_imbalance=Estimate(share, 0.002, "1"))
    told = advised(health).advice
    assert any(f"the {more} rotors carry {100.0 * abs(share):.0f} %" in text for text in told)
    for small, std in ((0.035, 0.002), (0.1, 0.03)):
        health = replace(HEALTH, yaw_imbalance=Estimate(small, std, "1"))
        told = advised(health).advice
        assert not any("hold the heading" in text for text in told)


def test_text_and_panel_say_which_rotors_their_interval_assumes():
    note = "± includes unequal rotors (3 %)"
    rotors = loaded(0.25, 0.25, 0.25, 0.25)
    assert note not in health_text(replace(HEALTH, rotors=rotors))  # the article's are alike
    differ = Quantity(1.0, 0.0, "1").off_by(given=0.03)
    rotors = tuple(replace(rotor, efficiency=differ) for rotor in rotors)
    assert note in health_text(replace(HEALTH, rotors=rotors))
    panel = "\n".join(
        "".join(part for part, _ in line) for line in health_lines(health_document(), 76)
    )
    assert note in panel
    assert "identical rotors: ± 1.8 mm" in panel


def test_what_the_wind_adds_to_the_cg_has_a_plain_name():
    windy = health_text(replace(HEALTH, by_wind=(0.004, 0.0)))
    assert "\n  wind contribution " in windy
    assert "wind" not in health_text(replace(HEALTH, by_wind=(0.001, 0.0)))


@pytest.mark.parametrize(
    ("health", "verdict"), [(HEALTH, "available"), (Health("a.tlog"), "refused")]
)
def test_the_verdict_of_a_health_file(health, verdict):
    assert document_of(health)["verdict"] == verdict


@pytest.mark.parametrize("verdict", ["available", "told"])
def test_files_of_earlier_versions_are_read(verdict, tmp_path):
    document = {
        "schema": "gcs-sysid-health/1", "source": "a.tlog", "verdict": verdict,
        "cg": {"x": {"value": 0.01}, "y": {"value": 0.0}},
        "load": {
            "kind": "speed", "thrust_curve": None, "value": [1.0] * 4, "seconds": 30.0,
            "covariance": [[1e-6 * (i == j) for j in range(4)] for i in range(4)],
        },
    }  # fmt: skip
    path = tmp_path / "before.json"
    path.write_text(json.dumps(document))
    assert read_baseline(path).cg == (0.01, 0.0)
    shown = health_lines({**health_document(), "verdict": verdict}, 76)
    assert any("CG along" in part for line in shown for part, _ in line)
