"""Plans on paper, and the emulator that flies them."""

import json
import math
import xml.etree.ElementTree as ET

import pytest

from gcs_sysid.cli.plan_command import plan_svg, plan_text
from gcs_sysid.coach.choice import HOVER, PAUSE, make_plan, shares
from gcs_sysid.coach.information import prior_vehicle
from gcs_sysid.coach.manoeuvre_library import Limits
from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import ScaleReference, load_airframe
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.results.summary import values_of
from sim_bridge.swings import read_plan


def plan_for(name, target=0.02, limits=None, rotor_input=RotorInput.SPEED):
    airframe = load_airframe(name)
    anchor = ScaleReference("mass", airframe.mass or 1.0)
    airframe = airframe.with_anchor("mass", anchor.value)

    def judge(fit):
        return shares(
            values_of(fit, anchor, airframe.arm, {}, rotor_input), airframe.arm, rotor_input
        )

    known = prior_vehicle(airframe, rotor_input)
    return make_plan(name, known, judge, target, limits or Limits())


@pytest.mark.parametrize("name", ["paper", "px4-sih", "px4-hexa-x", "ardupilot-octo-x"])
def test_a_plan_reaches_its_target(name):
    plan = plan_for(name)
    assert plan.enough
    assert all(share <= 0.02 for share in plan.expected.values())
    at = HOVER
    for step in plan.steps:
        assert step.start == at
        at += step.manoeuvre.seconds + PAUSE
    assert plan.seconds == at - PAUSE


def test_a_finer_target_and_tighter_limits_take_longer():
    usual = plan_for("paper")
    assert plan_for("paper", 0.01).seconds > usual.seconds
    gentle = Limits(math.radians(10.0), math.radians(60.0), 0.5)
    assert plan_for("paper", 0.02, gentle).seconds > usual.seconds


@pytest.mark.slow
def test_commands_have_a_plan_too():
    plan = plan_for("px4-sih", rotor_input=RotorInput.COMMAND)
    assert plan.steps
    assert "T_max" in plan.expected
    assert "k_M" not in plan.expected


def test_limits_that_allow_nothing_make_no_plan():
    plan = plan_for("paper", limits=Limits(math.radians(5.0), math.radians(20.0), 0.1))
    assert not plan.enough
    assert plan.steps == ()
    assert "not enough" in plan_text(plan)


def test_pictures():
    plan = plan_for("paper", 0.01)
    text = plan_text(plan)
    assert "█" in text
    assert all(f"{step.start:4.0f} s" in text for step in plan.steps)
    plan_text(plan, unicode=False).encode("ascii")
    drawing = ET.fromstring(plan_svg(plan))
    lanes = drawing.findall("{http://www.w3.org/2000/svg}polyline")
    used = {
        axis for s in plan.steps for axis in ("roll", "pitch", "yaw") if getattr(s.manoeuvre, axis)
    }
    assert len(lanes) == len(used)


def test_the_emulator_reads_what_is_planned(tmp_path):
    plan = plan_for("paper", 0.01)
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(plan.as_json()), encoding="utf-8")
    mission = read_plan(path)
    assert mission.duration == pytest.approx(plan.seconds, abs=PAUSE)
    for step in plan.steps:
        half = step.start + 0.5 * step.manoeuvre.seconds
        reference = mission.reference(half)
        assert any(abs(rate) > 0.05 for rate in (*reference.rate, *reference.angular_acceleration))
    assert mission.reference(2.0).rate == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("content", "why"),
    [
        ("{", "not JSON"),
        ("[]", "it has no maneuvers"),
        ('{"manoeuvres": [7]}', "maneuver 1: must be an object"),
        ('{"manoeuvres": [{"roll_deg": "x"}]}', "roll_deg must be a number"),
        ('{"manoeuvres": [{"roll_deg": 90}]}', "roll_deg must lie in 0..60, got 90"),
    ],
)
def test_what_is_no_plan(content, why, tmp_path):
    path = tmp_path / "plan.json"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match=why.replace(".", r"\.")):
        read_plan(path)
