"""What the headless lines say, and what they keep to themselves."""

from dataclasses import replace

import pytest

from gcs_sysid.cli.headless import status_line
from gcs_sysid.live.flight_coach import Coach, CoachOptions
from gcs_sysid.live.live_estimate import LiveEstimate, LiveOptions
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.results.result_view import result_table
from gcs_sysid.results.snapshot import LinkState
from tests.screen.fake import advice, link, result, snapshot


def shown(**changes):
    return replace(snapshot(), result=replace(result(), **changes))


def test_what_cannot_be_told_has_no_number():
    line = status_line(shown())
    assert "k_M -" in line
    assert "Ixx 0.01655 ±0.49 %" in line
    row = next(r for r in result_table(result()).splitlines() if r.startswith("k_M"))
    assert row.split() == ["k_M", "-", "-", "-", "N", "m", "s^2", "unobservable"]


def test_a_refusal_says_why():
    line = status_line(shown(verdict="refused", reasons=("no IMU data", "nor anything else")))
    assert line.endswith("(no IMU data)")
    assert "  refused  " in line
    early = replace(shown(verdict="refused", reasons=("no IMU data",)), used_seconds=1.0)
    assert "  waiting  " in status_line(early)
    assert "refused" not in status_line(early)
    assert "  refused  " in status_line(replace(early, link=link(LinkState.ENDED)))
    assert "no IMU data" not in status_line(shown(reasons=("no IMU data",)))


@pytest.fixture
def estimate():
    options = LiveOptions(coach=CoachOptions())
    airframe = load_airframe("paper")
    made = LiveEstimate(airframe, "somewhere", options, None, lambda defect: None)
    yield made
    made.drop()


@pytest.mark.parametrize("state", list(LinkState))
def test_nobody_is_told_to_fly_what_nobody_sees(state, estimate, monkeypatch):
    monkeypatch.setattr(Coach, "think", lambda self: None)
    monkeypatch.setattr(Coach, "look", lambda self: advice())
    estimate.think()
    told = estimate.snapshot(result(), link(state)).advice
    assert (told is not None) is (state is LinkState.CONNECTED)
    assert estimate.advised(result()).as_json()["advice"]["text"] == advice().text


def test_a_wrong_airframe_is_no_reason_to_fly(estimate, monkeypatch):
    monkeypatch.setattr(Coach, "think", lambda self: None)
    monkeypatch.setattr(Coach, "look", lambda self: advice())
    wrong = ("wrong airframe paper: it has 4 rotors, the vehicle 6",)
    monkeypatch.setattr(LiveEstimate, "airframe_problems", property(lambda self: wrong))
    estimate.think()
    said = estimate.snapshot(result(), link())
    assert said.advice is None
    assert "advice" not in estimate.advised(result()).as_json()
    assert [event.text for event in said.events] == list(wrong)
    assert [event.text for event in estimate.snapshot(result(), link()).events] == list(wrong)
