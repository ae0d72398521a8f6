"""Logs of other people: the first line says what the owner of the vehicle has to know."""

import pytest

from gcs_sysid.health.assessment import ReadLog
from gcs_sysid.health.health_file import document_of
from gcs_sysid.health.vehicle_health import HealthOptions
from gcs_sysid.inspection.inspector import inspect_log
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.session.chain import ChainOptions

ANSWERS = {
    "betaflight/hiro-no-accelerometer.bfl": (
        "CANNOT TELL: there is no accelerometer", "set acc_hardware = AUTO"
    ),
    "betaflight/bf2026-inertia-refused.bfl": ("LOOK AT the CG: ", "shift the CG"),
    "other/ground-run-pt1-082.bin": ("CANNOT TELL: never seen in the air", "hover for"),
}  # fmt: skip


@pytest.mark.slow
def test_without_an_accelerometer_analysis_and_inspection_say_so(shared_log):
    log = shared_log("field/betaflight/hiro-no-accelerometer.bfl")
    airframe = load_airframe("betaflight-quad-x").with_arm(0.11).with_anchor("mass", 0.5)
    result = analyze_log(log, airframe, options=ChainOptions(end=6.0))
    found = inspect_log(log)
    assert (result.verdict, found.verdict, found.obtainable) == ("refused", "no", "nothing")
    for objections in (result.objections, found.objections):
        assert any("there is no accelerometer" in objection.reason for objection in objections)


@pytest.mark.slow
@pytest.mark.parametrize("name", ANSWERS)
def test_the_first_line_names_the_cause_and_what_to_do(name, shared_log):
    line, action = ANSWERS[name]
    answer = document_of(ReadLog(shared_log(f"field/{name}")).health(HealthOptions()))["summary"]
    assert answer["line"].startswith(line)
    assert action in answer["action"]
