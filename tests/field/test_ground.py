"""Logs of other people: what stands on the ground, on a bench or in a hand does not hover."""

import pytest

from gcs_sysid.health.assessment import ReadLog
from gcs_sysid.health.vehicle_health import HealthOptions
from gcs_sysid.model.airframe import load_airframe

GROUND = [
    "other/bench-run-pt2-002.bin",
    "other/ground-run-pt1-082.bin",
    "other/idle-on-ground-118.bin",
    "other/groundlink-log_2.bin",
    "betaflight/geprc-on-the-ground.bbl",
    "betaflight/greenreaper06-idle-on-the-ground.bfl",
]
FLIGHTS = {
    "other/inf-now-090.bin": 90.0,
    "other/false-alarm-a-121.bin": 14.0,
    "quiver/00000120.BIN": 20.0,
    "quiver/00000096.BIN": 75.0,
    "betaflight/ar8.BFL": 10.0,
}
"""s of hover at least."""


def health(log):
    airframe = load_airframe("betaflight-quad-x") if "betaflight" in str(log) else None
    return ReadLog(log).health(HealthOptions(airframe, arm=0.1 if airframe else 0.67, mass=1.0))


@pytest.mark.slow
@pytest.mark.parametrize("name", GROUND)
def test_what_never_left_the_ground_has_no_hover(name, shared_log):
    found = health(shared_log(f"field/{name}"))
    assert not found.available
    assert found.cg is None
    assert not found.advice


@pytest.mark.slow
@pytest.mark.parametrize(("name", "seconds"), FLIGHTS.items())
def test_what_flew_keeps_its_hover(name, seconds, shared_log):
    assert health(shared_log(f"field/{name}")).seconds > seconds
