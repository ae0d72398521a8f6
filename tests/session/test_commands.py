"""Whole flights with commands, unsound speeds, or a filtered gyro."""

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.session.chain import Chain, ChainOptions
from gcs_sysid.signals.records import Stream
from tests.feeding import feed

FLIGHT = ("--mission", "all-axes", "--rate", "100", "--duration", "18", "--seed", "3")


@pytest.fixture(scope="module")
def flight(fly):
    """Commands and speeds, 100 Hz, MEMS noise."""
    return fly(*FLIGHT)


@pytest.fixture(scope="module")
def both(flight):
    return flight.records()


def chain_of(records, anchor=None, **options):
    airframe = load_airframe("paper")
    if anchor:
        airframe = airframe.with_anchor(*anchor)
    chain = Chain(airframe, ChainOptions(**options))
    feed(chain, records)
    return chain


def identified(records, anchor=None):
    return chain_of(records, anchor).finish()


def beginning(records):
    return [r for r in records if r.t - records[0].t < 12.0]


def commands_only(records):
    return [r for r in records if r.stream is not Stream.ROTOR_SPEED]


def agree(result, truth, names, status="identified", deviations=4.0):
    for name in names:
        estimate = result.parameters[name]
        assert estimate.status == status, name
        assert abs(estimate.value - truth[name]) < deviations * estimate.std, name


@pytest.fixture(scope="module")
def by_commands(both):
    return identified(commands_only(both))


@pytest.mark.slow
def test_commands_identify(by_commands, flight):
    result = by_commands
    assert result.verdict == "identified"
    assert result.rotor_input == "command"
    agree(result, flight.truth, ("Ixx", "Iyy", "Izz", "cg_x", "cg_y", "T_max", "moment_ratio"))
    assert "k_T" not in result.parameters
    assert "k_M" not in result.parameters
    assert result.parameters["rotor_inertia"].status == "unobservable"
    lag = result.timing["motor_lag"]
    assert lag.value == pytest.approx(flight.truth["motor_lag"], abs=0.004)
    told = result.telemetry["rotor_input"]
    assert told["range"] == [1000.0, 2000.0]
    assert told["range_from"] == "PWM_MAIN_MIN1, PWM_MAIN_MAX1"


@pytest.mark.slow
def test_T_max_as_the_scale_gives_the_mass(by_commands, both, flight):
    result = identified(both, ("T_max", flight.truth["T_max"]))
    assert result.rotor_input == "command"
    assert result.parameters["T_max"].status == "given"
    mass = result.parameters["mass"]
    assert abs(mass.value - flight.truth["mass"]) < 4.0 * mass.std
    # What sets the scale does not move what has none.
    for name in ("cg_x", "moment_ratio", "thrust_curve"):
        before = by_commands.parameters[name]
        assert result.parameters[name].value == pytest.approx(before.value, abs=1e-3 * before.std)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gone", "anchor", "advice"),
    [
        (Stream.ROTOR_SPEED, ("k_T", 2e-4), "--t-max"),
        (Stream.ROTOR_COMMAND, ("T_max", 7.0), "--k-t"),
    ],
)
def test_a_scale_that_the_input_cannot_use_is_refused_with_advice(both, gone, anchor, advice):
    result = identified([r for r in beginning(both) if r.stream is not gone], anchor)
    assert result.verdict == "refused"
    assert any(advice in reason for reason in result.reasons)


@pytest.mark.slow
def test_nothing_is_lost_while_the_input_is_undecided(both):
    records = beginning(both)
    result = identified(records)
    flown = records[-1].t - records[0].t
    # The windows of both ends, and the time that the first second's samples take to come.
    assert result.telemetry["used_seconds"] > flown - 2.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("trap", "kind", "why"),
    [
        pytest.param("rpm-zero", "command", "reads 0 in flight", marks=pytest.mark.thorough),
        pytest.param("rpm-command", "command", "under another name", marks=pytest.mark.thorough),
        pytest.param("rpm-repeats=0.03", "speed", "", marks=pytest.mark.thorough),
        ("rpm-rad", "speed", "rad/s"),
    ],
)
def test_traps_of_rotor_speeds(fly, trap, kind, why):
    flown = fly(*FLIGHT, "--trap", trap)
    result = analyze_log(flown.tlog, load_airframe("paper"))
    told = result.telemetry["rotor_input"]
    assert result.rotor_input == kind
    assert why in told["refused"].get("ESC_STATUS", told["why"])
    agree(result, flown.truth, ("cg_x", "moment_ratio"))
    # Another unit than declared may come of a wrong mass, to which inertia is proportional.
    agree(result, flown.truth, ("Ixx", "Iyy", "Izz"), "weak" if why == "rad/s" else "identified")


@pytest.mark.slow
def test_speeds_that_die_in_flight_give_way_to_commands(both):
    middle = both[len(both) // 2].t
    died = [
        r._replace(values=(0.0,) * 4) if r.stream is Stream.ROTOR_SPEED and r.t > middle else r
        for r in both
        if r.stream is not Stream.PARAMETER
    ]
    chain = chain_of(died)
    result = chain.finish()
    assert result.rotor_input == "command"
    assert any("died in flight" in event.text for event in chain.events)
    assert result.telemetry["used_seconds"] < 20.0
    # Without parameters their range is by convention, and so the scale.
    assert result.verdict == "partial"
    assert any("by convention; give [command]" in reason for reason in result.reasons)
    assert {n for n, e in result.parameters.items() if e.status == "identified"} <= {"moment_ratio"}


@pytest.mark.slow
@pytest.mark.parametrize("cutoff", [pytest.param(20, marks=pytest.mark.thorough), 40])
def test_the_gyros_filter_comes_from_the_parameters(fly, cutoff):
    ardupilot = ("--autopilot", "ardupilot", "--param", f"INS_GYRO_FILTER={cutoff}")
    flown = fly(*FLIGHT, *ardupilot, "--rate", "200", "--duration", "9")
    records = flown.records()
    parameter = next(r for r in records if r.source == "INS_GYRO_FILTER")
    chain = Chain(load_airframe("paper"), ChainOptions())
    chain.rotor_selector.autopilot = "ardupilot"
    feed(chain, records)
    result = chain.finish()
    assert result.telemetry["rotor_input"]["gyro_filter"] == cutoff
    assert not chain.outdated
    for name in ("Ixx", "Iyy"):
        assert result.parameters[name].value == pytest.approx(flown.truth[name], rel=0.02)
    # The same parameter after the flight is too late, and is told so.
    late = Chain(load_airframe("paper"), ChainOptions())
    late.rotor_selector.autopilot = "ardupilot"
    before = (r for r in records[: len(records) // 2] if r != parameter)
    feed(late, (*before, parameter))
    assert late.outdated == (cutoff != 20)


@pytest.mark.thorough
@pytest.mark.slow
def test_a_low_pass_that_is_found_is_in_the_result(fly):
    flown = fly("--mission", "all-axes", "--rate", "200", "--duration", "15", "--seed", "3")
    records = flown.records()
    imu = np.array([r.values for r in records if r.stream is Stream.IMU])
    late = iter(lfilter(*butter(2, 2.0 * 25.0 / 200.0), imu[:, :3], axis=0))
    filtered = [
        r._replace(values=(*next(late), *r.values[3:])) if r.stream is Stream.IMU else r
        for r in records
    ]
    sent, found = (
        identified(some).telemetry["rotor_input"]["gyro_filter_found"]
        for some in (records, filtered)
    )
    assert sent is None
    assert found == pytest.approx(25.0, rel=0.1)


@pytest.mark.slow
def test_the_autopilot_decides_on_the_filter(fly):
    flown = fly("--autopilot", "ardupilot", *FLIGHT[:2], "--duration", "12", "--rate", "50")
    result = analyze_log(flown.tlog, load_airframe("paper"))
    assert result.vehicle["autopilot"] == "ardupilot"
    assert result.telemetry["rotor_input"]["gyro_filter"] == 20.0
