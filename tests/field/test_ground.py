"""Logs of other people: what stands on the ground, on a bench or in a hand does not hover."""

import pytest

from gcs_sysid.health.assessment import ReadLog
from gcs_sysid.health.log_streams import streams_of
from gcs_sysid.health.vehicle_health import HealthOptions
from gcs_sysid.inspection.inspector import inspect_log
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.telemetry.logs import open_log

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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "start"),
    [("greenreaper/LOG00028.BFL", 3.1), ("betaflight/speedybee002.bbl#4", None),
     ("other/px4-auto-takeoff.ulg", 4.4), ("indiflight/LOG00159.BFL", 0.3)],
)  # fmt: skip
def test_all_commands_fly_at_the_same_time(name, start, shared_log):
    file, _, session = name.partition("#")
    path = shared_log(f"field/{file}")
    log = open_log(path.with_name(f"{path.name}#{session}") if session else path)
    airframe = load_airframe("betaflight-quad-x")
    flight = streams_of(log.blocks(), airframe, log.vehicle.key, log.parameters).flight
    if start is None:
        assert not flight.flying.any()
        return
    ((left, landed),) = inspect_log(path, airframe=airframe).flights
    assert left == pytest.approx(start, abs=0.1)
    assert left <= flight.t[flight.flying][0] <= left + 1.1
    assert landed == pytest.approx(flight.t[1:][flight.flying[:-1]][-1], abs=0.1)


@pytest.mark.slow
def test_what_stood_from_the_start_is_in_no_estimate(shared_log):
    log = shared_log("field/betaflight/geprc-on-the-ground.bbl")
    result = analyze_log(log, load_airframe("betaflight-quad-x").with_anchor("mass", 0.2))
    assert result.telemetry["used_seconds"] == 0.0
    assert "never seen in the air" in result.reasons
