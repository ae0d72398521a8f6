"""Logs of other people: the first line says what the owner of the vehicle has to know."""

import pytest

from gcs_sysid.health.assessment import health_of_log
from gcs_sysid.health.health_file import document_of
from gcs_sysid.health.vehicle_health import HealthOptions

ANSWERS = {
    "betaflight/hiro-no-accelerometer.bfl": (
        "CANNOT TELL: there is no accelerometer", "set acc_hardware = AUTO"
    ),
    "betaflight/bf2026-inertia-refused.bfl": ("LOOK AT the CG: ", "shift the CG"),
    "other/ground-run-pt1-082.bin": ("CANNOT TELL: never seen in the air", "hover for"),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", ANSWERS)
def test_the_first_line_names_the_cause_and_what_to_do(name, shared_log):
    line, action = ANSWERS[name]
    answer = document_of(health_of_log(shared_log(f"field/{name}"), HealthOptions()))["summary"]
    assert answer["line"].startswith(line)
    assert action in answer["action"]
