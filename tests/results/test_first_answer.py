"""The first line of every answer on a log."""

import math

import pytest

from gcs_sysid.judgement.status import READINGS
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.estimate import Objection
from gcs_sysid.results.health_view import first_answer, health_fact, short_facts
from gcs_sysid.significance import Z95
from tests.known_results import result_of
from tests.screen.fake import health

QUANTITY = {"value": 0.25, "std": 0.001, "std_given": 0.0, "unit": "1"}


def document(**changed):
    own = {"airframe": load_airframe("paper").as_json(), "order_contradicted": False}
    return {**health(), **own, "findings": [], **changed}


def test_a_flight_without_findings_is_ok_and_says_what_tells_more():
    answer = first_answer(document(advice=["give --arm"]))
    assert answer.line.startswith("OK: nothing wrong seen in ")
    assert answer.action == "give --arm"


def test_ok_says_within_what_and_is_not_said_where_a_dead_rotor_would_not_show():
    whole = document()
    assert ", CG within " in first_answer(whole).line
    arm = max(abs(rotor["x"]) for rotor in whole["airframe"]["rotors"])
    for share, word in ((0.2, "OK"), (0.3, "CANNOT TELL")):
        wide = {"value": 0.0, "std": share * arm / Z95, "std_given": 0.0, "unit": "m"}
        answer = first_answer(document(cg={"x": wide, "y": {**wide, "std": 0.0}}))
        assert answer.word == word
        assert f"{1e3 * share * arm:.0f} mm" in answer.line


def test_of_an_arm_that_is_assumed_lengths_are_shares():
    guessed = document(arm={"value": 0.25, "std": 0.125})
    guessed["cg"] = {axis: {"value": 0.01, "std": math.hypot(0.005, 0.002), "std_given": 0.0}
                     for axis in "xy"}  # fmt: skip
    shown = dict(short_facts(guessed))["CG"]
    assert shown.startswith("4.0 ± 1.6 % forward, 4.0 ± 1.6 % right of the arm")
    assert "mm" not in first_answer(guessed).line


def test_what_is_found_first_is_to_be_looked_at_and_the_rest_counted():
    weak = {"at": "rotor 3", "what": "5 % less thrust", "do": "look at it"}
    other = {"at": "the CG", "what": "9 mm aft", "do": "shift it"}
    answer = first_answer(document(findings=[weak, weak, other]))
    assert answer.line == "LOOK AT rotor 3: 5 % less thrust (and 1 more)"
    assert answer.action == "look at it"


@pytest.mark.parametrize(
    ("objection", "action"),
    [(Objection("hardly hovers: 2 s; not calm: give up", how="hover for 10 s"), "hover for 10 s"),
     (Objection("no IMU data"), "gcs-sysid inspect shows")],
)  # fmt: skip
def test_a_flight_without_hover_says_why_and_what_to_do(objection, action):
    refused = document(verdict="refused", objections=[objection.as_json()])
    answer = first_answer(refused)
    note = Objection("it holds 4 sessions", verdict="identified", by="link")
    assert first_answer(refused, result_of({}, verdict="refused", objections=(note,))) == answer
    assert answer.line == f"CANNOT TELL: {objection.reason}"
    assert answer.action.startswith(action)


def test_a_wrong_motor_order_is_looked_at():
    wrong = Objection("no", how="give --airframe").as_json()
    told = document(verdict="refused", objections=[wrong], order_contradicted=True)
    assert first_answer(told).line == "LOOK AT the motor order: no"
    odd = result_of({}, objections=(Objection("rotors differ", by=READINGS),))
    assert first_answer(told, odd).line == "LOOK AT the motor order: no"
    assert first_answer(told).action == "give --airframe"


def test_a_number_whose_interval_holds_everything_is_not_shown():
    vain = {"value": -0.67, "std": 0.93, "std_given": 0.0, "unit": "1"}
    assert health_fact(document(drift_per_minute=vain), "drift_per_minute") is None
    small = {"value": -0.05, "std": 0.01, "std_given": 0.0, "unit": "1"}
    assert health_fact(document(drift_per_minute=small), "drift_per_minute") is not None
    assert "thrust drift" not in dict(short_facts(document(drift_per_minute=vain)))
