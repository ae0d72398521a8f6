"""The public functions: logs and arrays to the numbers of the chain, and what they refuse."""

import subprocess
import sys
from dataclasses import fields, replace

import numpy as np
import pytest

import gcs_sysid
from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.logs import open_log
from testbed.recordings import columns_of


@pytest.fixture(scope="module")
def signals(paper_flight):
    """The flight as a user's arrays, every stream with its own times."""
    told = columns_of(open_log(paper_flight.tlog))
    t, imu = told[Stream.IMU, ""]
    attitude_t, attitude = told[Stream.ATTITUDE, ""]
    speeds_t, speeds = told[Stream.ROTOR_SPEED, "ESC_STATUS"]
    velocity_t, motion = told[Stream.VELOCITY, ""]
    return gcs_sysid.Signals(
        t=t,
        gyro=imu[:, :3],
        force=imu[:, 3:],
        attitude=attitude,
        speeds=speeds,
        velocity=motion[:, :3],
        position=motion[:, 3:],
        times={"attitude": attitude_t, "speeds": speeds_t, "velocity": velocity_t},
    )


@pytest.fixture(scope="module")
def analyzed(paper_flight):
    return gcs_sysid.analyze(paper_flight.tlog, "paper")


def numbers(result):
    return {name: (e.value, e.std, e.status) for name, e in result.parameters.items()}


@pytest.mark.slow
def test_a_log_gives_the_numbers_of_the_analysis(analyzed, paper_result):
    assert analyzed.as_json() == paper_result.as_json()
    assert analyzed.verdict == "identified"


def test_arrays_give_the_numbers_of_their_log(signals, analyzed):
    result = gcs_sysid.identify(signals, "paper")
    assert result.verdict == "identified"
    assert result.source == "arrays"
    for name, estimate in analyzed.parameters.items():
        told = result.parameters[name]
        assert told.value == pytest.approx(estimate.value, rel=1e-6, abs=1e-4 * estimate.std)
        assert told.std == pytest.approx(estimate.std, rel=1e-3)
        assert told.status == estimate.status


@pytest.mark.slow
def test_rows_without_numbers_are_gaps(signals, analyzed):
    holed = np.array(signals.gyro, copy=True)
    holed[400:440] = np.nan
    result = gcs_sysid.identify(replace(signals, gyro=holed), "paper")
    lost = analyzed.telemetry["used_seconds"] - result.telemetry["used_seconds"]
    assert 2.0 < lost < 4.0
    assert result.parameters["Ixx"].value == pytest.approx(
        analyzed.parameters["Ixx"].value, rel=0.01
    )


def test_flying_is_believed(signals, analyzed):
    t = np.asarray(signals.t)
    first_half = (t < t[0] + 30.0).astype(float)
    result = gcs_sysid.identify(replace(signals, flying=first_half), "paper")
    assert 25.0 < result.telemetry["used_seconds"] < 30.5


@pytest.mark.slow
def test_commands_serve_instead_of_speeds(signals, paper_flight):
    t, outputs = columns_of(open_log(paper_flight.tlog))[
        Stream.ROTOR_COMMAND, "ACTUATOR_OUTPUT_STATUS"
    ]
    given = replace(
        signals,
        speeds=None,
        commands=np.clip((outputs - 1000.0) / 1000.0, 0.0, 1.0),
        times={**signals.times, "commands": t},
    )
    result = gcs_sysid.identify(given, "paper")
    assert result.rotor_input == "command"
    assert result.parameters["T_max"].value > 0.0
    assert result.parameters["Ixx"].value == pytest.approx(paper_flight.truth["Ixx"], rel=0.1)


def test_scale_arm_and_priors_reach_the_airframe():
    airframe = gcs_sysid.load_airframe(
        "px4-quad-x", arm=0.3, mass=2.0, priors={"k_M": (6e-6, 1e-7)}
    )
    assert airframe.anchor() == ("mass", 2.0)
    assert airframe.arm == pytest.approx(0.3)
    assert airframe.priors == {"k_M": (6e-6, 1e-7)}
    assert gcs_sysid.load_airframe(airframe, k_T=1e-5).anchor() == ("k_T", 1e-5)
    measured = gcs_sysid.load_airframe("paper", mass="1.5+-0.03", arm="0.3")
    assert measured.anchor() == ("mass", 1.5)
    assert measured.arm == pytest.approx(0.3)
    assert measured.uncertainty.scale_share("mass", 1.5) == pytest.approx(0.02)


def test_a_result_comes_back_from_its_file(analyzed, tmp_path):
    analyzed.write(tmp_path / "result.json")
    back = gcs_sysid.read_result(tmp_path / "result.json")
    assert numbers(back) == numbers(analyzed)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"gyro": np.zeros((5, 3))}, r"gyro: must have the shape \(\d+, 3\), not \(5, 3\)"),
        ({"gyro": [["a", "b", "c"]]}, "gyro: not an array of numbers"),
        ({"speeds": None}, "give speeds or commands"),
        ({"velocity": None}, "position needs velocity"),
        ({"times": {"gyro": [0.0, 1.0]}}, "no separate times for gyro"),
        ({"times": {"attitude": [1.0, 0.0]}}, "times of attitude: must be increasing times"),
    ],
)
def test_arrays_that_do_not_fit_are_refused_in_one_line(signals, change, says):
    times = {**signals.times, **change.pop("times", {})} if "times" in change else signals.times
    with pytest.raises(gcs_sysid.InputError, match=says) as refused:
        gcs_sysid.identify(replace(signals, **change, times=times), "paper")
    assert "\n" not in str(refused.value)


def test_rotations_that_are_none_are_refused(signals):
    euler = np.zeros_like(signals.attitude)
    with pytest.raises(gcs_sysid.InputError, match="row 0 is not a unit quaternion"):
        gcs_sysid.identify(replace(signals, attitude=euler), "paper")


@pytest.mark.parametrize(
    ("name", "known", "says"),
    [
        ("paper", {"mass": "heavy"}, "mass must be a number, got 'heavy'"),
        ("px4-quad-x", {}, "nothing sets the scale"),
        ("px4-quad-x", {"mass": 1.0, "k_T": 1e-5}, "one scale only, not mass and k_T"),
        ("px4-quad-x", {"mass": -1.0}, "mass must be a positive number"),
        ("no-such", {"mass": 1.0}, "no airframe 'no-such'"),
    ],
)
def test_airframes_that_cannot_be_used_are_refused(name, known, says):
    with pytest.raises(gcs_sysid.InputError, match=says):
        gcs_sysid.load_airframe(name, **known)


def test_a_misspelt_keyword_is_told():
    with pytest.raises(TypeError, match="'weight'"):
        gcs_sysid.analyze("flight.tlog", "paper", weight=1.5)


def test_every_field_of_signals_is_described():
    for field in fields(gcs_sysid.Signals):
        assert f"{field.name}: " in gcs_sysid.Signals.__doc__


@pytest.mark.slow
def test_the_package_alone_loads_no_numpy():
    code = (
        "import sys, gcs_sysid; "
        "assert set(gcs_sysid.__all__) <= set(dir(gcs_sysid)); "
        "assert 'numpy' not in sys.modules; "
        "gcs_sysid.analyze; "
        "print(*sorted({'numpy', 'textual', 'pymavlink'} & set(sys.modules)))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["numpy"]
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = gcs_sysid.nothing


@pytest.mark.slow
def test_what_is_given_widens_every_interval_and_is_told_apart(paper_flight, analyzed):
    """Arms 3 % too long and a mass 5 % too large, given so: the truth is within the intervals."""
    long = 1.03 * gcs_sysid.load_airframe("paper").arm
    uncertainty = {"arm": "3%", "mass": "5%", "imu_rotation": 1.0}
    told = gcs_sysid.analyze(
        paper_flight.tlog, "paper", arm=long, mass=1.05 * 1.5, uncertainty=uncertainty
    )
    exact = gcs_sysid.analyze(paper_flight.tlog, "paper", arm=long, mass=1.05 * 1.5)
    for name, factor in (("Ixx", 1.03 * 1.05), ("cg_x", 1.03), ("k_T", 1.05), ("k_M", 1.03 * 1.05)):
        right, wide = analyzed.parameters[name], told.parameters[name]
        assert exact.parameters[name].value == pytest.approx(factor * right.value, rel=2e-4), name
        assert not exact.parameters[name].std_given
        low, high = wide.ci95
        assert low < right.value < high, name
        assert wide.std_given == pytest.approx(
            abs(wide.value) * {"Ixx": 0.05831, "k_M": 0.05831, "cg_x": 0.03, "k_T": 0.05}[name],
            rel=1e-3,
        )
        assert wide.std == pytest.approx(np.hypot(wide.std_data, wide.std_given))
    mass = told.parameters["mass"]
    assert (mass.status, mass.std) == ("given", pytest.approx(0.05 * 1.575))
    turned = told.telemetry["imu_rotation"]
    assert np.all(np.abs(turned["value"]) < 2.0 * np.array(turned["std"]))
    assert told.verdict == "partial"
    assert any("given values limit" in reason for reason in told.reasons)
