"""Flights of unmodified autopilots, with true parameters beside them."""

from functools import cache
from pathlib import Path

import pytest

from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.session.chain import ChainOptions
from testbed.recordings import airframe_of, truth_of

LOGS = Path(__file__).resolve().parents[3] / "shared" / "logs"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not LOGS.is_dir(), reason="no ../shared/logs beside the project"),
]


ENOUGH = {
    "px4-esc-cg.tlog": ChainOptions(end=120.0),
    "ardupilot-sitl.tlog": ChainOptions(end=110.0),
}
"""As much of a log as reaches the bars."""


@cache
def analyzed(log, anchor="mass"):
    path = LOGS / log
    airframe = airframe_of(path).with_anchor(anchor, truth_of(path)[anchor])
    return analyze_log(path, airframe, options=ENOUGH.get(log, ChainOptions()))


SIH = {  # relative
    "Ixx": 0.02, "Iyy": 0.02, "Izz": 0.03, "moment_ratio": 0.03, "rotational_damping": 0.10,
    "linear_drag": 0.20,
}  # fmt: skip
PRODUCTS = {"Ixy": 1e-4, "Iyz": 1e-4, "Ixz": 1e-4}
CASES = [
    ("px4-sih-default.tlog", "command", {**SIH, "T_max": 0.02}, {**PRODUCTS, "thrust_curve": 0.1}),
    ("px4-esc-cg.tlog", "speed", {**SIH, "k_T": 0.01}, {**PRODUCTS, "cg_x": 5e-4, "cg_y": 5e-4}),
    (
        "ardupilot-sitl.tlog",
        "speed",
        {"Ixx": 0.02, "Iyy": 0.02, "k_T": 0.01},
        {"cg_x": 5e-4, "cg_y": 5e-4},
    ),
]


# Whole recorded flights take longest; `make accept` has them all, and the short form some.
MORE_CASES = (
    pytest.param(*CASES[1], marks=pytest.mark.thorough),
    pytest.param(*CASES[0], marks=pytest.mark.thorough),
    pytest.param("px4-sih-default.ulg", *CASES[0][1:], marks=pytest.mark.thorough),
    pytest.param("ardupilot-sitl.bin", *CASES[2][1:], marks=pytest.mark.thorough),
)


@pytest.mark.parametrize(("log", "kind", "relative", "absolute"), [CASES[2], *MORE_CASES])
def test_recorded_flights_reach_the_bars(log, kind, relative, absolute):
    result, truth = analyzed(log), truth_of(LOGS / log)
    assert result.rotor_input == kind
    for name, bar in relative.items():
        assert result.parameters[name].value == pytest.approx(truth[name], rel=bar), name
    for name, bar in absolute.items():
        assert result.parameters[name].value == pytest.approx(truth[name], abs=bar), name
    known = {n: e for n, e in result.parameters.items() if truth.get(n) is not None and e.std}
    held = [n for n, e in known.items() if abs(e.value - truth[n]) <= 1.96 * e.std]
    assert len(held) >= 0.75 * len(known), sorted(known.keys() - held)
    if kind == "command":
        assert result.timing["motor_lag"].value == pytest.approx(truth["motor_lag"], abs=0.004)


@pytest.mark.thorough
@pytest.mark.parametrize("log", ["px4-esc-cg.tlog", "px4-sih-default.tlog"])
def test_a_known_thrust_gives_the_mass(log):
    result = analyzed(log, "k_T" if "esc" in log else "T_max")
    assert result.parameters["mass"].value == pytest.approx(truth_of(LOGS / log)["mass"], rel=0.02)


def test_a_simulator_without_gyroscopic_torque_is_no_rigid_body():
    result = analyzed("ardupilot-sitl.tlog")
    assert result.verdict == "partial"
    assert any("rigid body" in reason for reason in result.reasons)
    for name in ("Izz", "k_M", "moment_ratio", "Ixy", "Iyz", "Ixz"):
        assert result.parameters[name].status == "unobservable", name
    assert result.parameters["Ixx"].status == "identified"


@pytest.mark.thorough
def test_a_filtered_gyro_of_a_real_quad_on_commands_tells_its_inertia():
    """A Crazyflie; 1.66e-5 kg m^2 in the literature, 1.47e-5 by plain least squares.

    In disturbed air the thrust curve is as uncertain as before the flight, and inertia with it.
    """
    log = LOGS / "real" / "crazyflie_log15.tlog"
    result = analyze_log(log, load_airframe(str(LOGS / "real" / "crazyflie.toml")))
    for name in ("Ixx", "Iyy"):
        assert result.parameters[name].value == pytest.approx(1.6e-5, rel=0.15), name
        assert result.parameters[name].status == "weak", name
    for axis in ("roll", "pitch"):
        assert result.validation["r_squared"][axis] > 0.95
    lag, late = result.timing["motor_lag"], result.timing["rotor_delay"]
    # The gyro is late by what its sensor filters; least squares put all in the lag.
    assert lag.value - late.value == pytest.approx(0.07, abs=0.015)
    assert result.parameters["Izz"].status in ("weak", "unobservable")


def test_slow_logs_are_refused_with_reasons():
    airframe = load_airframe("ardupilot-quad-x").with_anchor("mass", 1.5)
    result = analyze_log(LOGS / "public" / "real-quad-mavlink1.tlog", airframe)
    assert result.verdict == "refused"
    assert any("too slow to follow the rotors" in reason for reason in result.reasons)


@pytest.mark.thorough
def test_a_change_in_flight_on_commands_is_found(shared_log):
    log = shared_log("px4_quad_masschange_CRASH.tlog")
    result = analyze_log(log, load_airframe(str(log.with_suffix(".toml"))))
    assert result.rotor_input == "command"
    (segment,) = result.segments
    (change,) = (e for e in result.events if e["kind"] != "disturbance")
    # 1.15 to 1.4 kg at 83.2 s; no landing after it changes the vehicle again.
    assert change["kind"] == "mass_change"
    assert segment["end"] == pytest.approx(83.2, abs=0.6)
    assert change["decided"] < 83.2 + 2.5
    assert result.parameters["mass"].value == pytest.approx(1.4, rel=0.03)
    for axis, true in (("Ixx", 0.019), ("Iyy", 0.0255), ("Izz", 0.037)):
        assert result.parameters[axis].value == pytest.approx(true, rel=0.03)


@pytest.mark.parametrize(
    ("name", "airframe"),
    [
        ("real/LOG00264", "real/cinerat"),  # a landing in the log
        pytest.param("real/LOG00281", "real/cinerat", marks=pytest.mark.thorough),  # full throttle
        pytest.param("foreign/aclimb_0", "foreign/aclimb_0", marks=pytest.mark.thorough),  # a climb
        pytest.param("foreign/rp1_4", "foreign/rp1_4", marks=pytest.mark.thorough),  # aerodynamics
    ],
)
def test_what_changes_no_vehicle_cuts_no_flight(name, airframe):
    log = LOGS / f"{name}.tlog"
    if not log.exists():
        pytest.skip("not among the logs")
    result = analyze_log(log, load_airframe(str(LOGS / f"{airframe}.toml")))
    assert result.segments == ()
    assert {event["kind"] for event in result.events} <= {"disturbance"}
    # Take-off, and what touches the ground, is not used.
    flown = {"real/LOG00264": 3.5, "real/LOG00281": 40.0}.get(name, 63.0)
    assert result.telemetry["used_seconds"] > flown
