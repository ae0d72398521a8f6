"""Two clocks that drift apart: when it is doubted, and what the doubt costs."""

import struct

import numpy as np
import pytest

from gcs_sysid.judgement.received import clock_doubt
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.session.chain import ChainOptions
from gcs_sysid.signals.rotor_units import is_simulated
from gcs_sysid.telemetry.clock import ClockDrift
from gcs_sysid.telemetry.logs import open_log
from gcs_sysid.telemetry.tlog import TlogReader
from testbed.linked import linked


@pytest.fixture(scope="module")
def airframe():
    return load_airframe("paper")


@pytest.fixture(scope="module")
def received(paper_flight, tmp_path_factory):
    """The article's flight, received by a computer against whose clock the vehicle's is fast."""

    def received(ppm):
        frames = list(TlogReader(paper_flight.tlog))
        first = frames[0][0]
        path = tmp_path_factory.mktemp("drift") / "flight.tlog"
        with open(path, "wb") as file:
            for time_us, frame in frames:
                stamp = first + round((time_us - first) / (1.0 + 1e-6 * ppm))
                file.write(struct.pack(">Q", stamp) + frame.raw)
        return path

    return received


@pytest.fixture(scope="module")
def fast(received, airframe):
    return analyze_log(received(8000.0), airframe)


def comparable(result):
    told = result.as_json()
    del told["source"], told["telemetry"]["clock_drift_ppm"]
    return told


@pytest.mark.slow
def test_what_good_clocks_do_changes_nothing(received, airframe, paper_result):
    result = analyze_log(received(400.0), airframe)
    assert result.telemetry["clock_drift_ppm"] == pytest.approx(400.0, abs=1.0)
    assert comparable(result) == comparable(paper_result)


@pytest.mark.slow
def test_a_clock_that_may_be_wrong_is_told_and_reckoned_with(fast, paper_result):
    undisturbed = paper_result
    assert undisturbed.verdict == "identified"
    assert fast.verdict == "partial"
    reason, _ = fast.reasons  # and that nothing checks the speeds
    assert "0.80 % fast" in reason
    assert fast.telemetry["clock_doubt"] == pytest.approx(0.008, rel=1e-3)
    for name in ("Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Ixz", "k_M"):
        now, before = fast.parameters[name], undisturbed.parameters[name]
        assert now.value == before.value
        assert now.std**2 - before.std**2 == pytest.approx((0.008 * before.value) ** 2, rel=0.01)
    # Those rest on geometry and gravity, which need no clock, or hardly any.
    for name in ("cg_x", "cg_y"):
        assert fast.parameters[name] == undisturbed.parameters[name]
    k_T = fast.parameters["k_T"]
    assert k_T.std < 5e-4 * k_T.value
    assert fast.parameters["mass"] == undisturbed.parameters["mass"]  # given


@pytest.mark.thorough
def test_frame_by_frame_the_doubt_is_that_of_the_recording(received, airframe, fast):
    chain, link = linked(airframe, ChainOptions())
    for time_us, frame in TlogReader(received(8000.0)):
        chain.take(link.gather([frame], time_us * 1e-6))
    chain.take(link.rest())
    live = chain.finish()
    assert (live.verdict, live.reasons) == (fast.verdict, fast.reasons)
    assert live.telemetry["clock_doubt"] == fast.telemetry["clock_doubt"]
    for name, value in live.parameters.items():
        assert value.std == (value.std and pytest.approx(fast.parameters[name].std, rel=1e-4))


def drift_of(ppm, seconds=40):
    drift = ClockDrift()
    for i in range(seconds):
        drift.add_moment(i * (1.0 + 1e-6 * ppm), 1.75e9 + i)
    return drift


@pytest.mark.parametrize(
    ("ppm", "doubted"),
    [
        (100.0, False),
        (-490.0, False),
        (510.0, True),
        (-8000.0, True),
        (29_000.0, True),
        (-100_000.0, False),  # a simulator at 0.9 of real time
        (9e6, False),  # at ten times that
    ],
)
def test_what_no_clock_does_is_no_clock(ppm, doubted):
    doubt = clock_doubt(drift_of(ppm).bounds, {})
    assert (doubt is not None) is doubted
    if doubt is not None:
        assert doubt.share == pytest.approx(1e-6 * ppm)
        assert ("the link lags" in doubt.reason) is (ppm < 0.0)


@pytest.mark.parametrize(
    ("parameters", "simulated"),
    [
        ({}, False),
        ({"SYS_AUTOSTART": 4001.0, "SYS_HITL": 0.0}, False),
        ({"SIM_SPEEDUP": 1.0}, True),
        ({"SIM_BAT_DRAIN": 60.0}, True),
        ({"SIH_MASS": 1.0, "SYS_AUTOSTART": 10040.0}, True),
        ({"SIH_MASS": 1.0, "SYS_AUTOSTART": 1100.0, "SYS_HITL": 2.0}, True),
        ({"SIH_MASS": 1.0, "SYS_AUTOSTART": 4001.0, "SYS_HITL": 0.0}, False),
    ],
)
def test_a_simulator_may_keep_its_own_time(parameters, simulated):
    assert is_simulated(parameters) is simulated
    assert (clock_doubt(drift_of(8000.0).bounds, parameters) is None) is simulated


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "ardupilot-sitl.tlog",
        pytest.param("px4-esc-cg.tlog", marks=pytest.mark.thorough),
        pytest.param("px4-sih-default.tlog", marks=pytest.mark.thorough),
    ],
)
def test_recorded_simulators_are_not_doubted(name, shared_logs):
    log = open_log(shared_logs / name)
    for _ in log.blocks():
        pass
    assert log.drift.bounds is not None
    assert clock_doubt(log.drift.bounds, log.parameters) is None


@pytest.mark.parametrize("ppm", [0.0, 10_000.0, -10_000.0])
@pytest.mark.parametrize("kind", ["ulog", "dataflash"])
def test_gps_time_is_a_second_clock_of_an_autopilots_own_log(ppm, kind, request, tmp_path):
    """Solutions of 5 Hz that arrive late, repeated; without a fix there is no time."""
    rng = np.random.default_rng(1)
    file = request.getfixturevalue(f"{kind}_file")
    path = tmp_path / f"flight{file.SUFFIX}"
    if kind == "ulog":
        file.topic("sensor_combined", ["float[3] gyro_rad", "float[3] accelerometer_m_s2"])
        file.topic("sensor_gps", ["uint64_t time_utc_usec"])
    else:
        file.type("IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
        file.type("GPS", "QBIH", "TimeUS,I,GMS,GWk")
    for i in range(600):
        t = 1.0 + 0.1 * i
        arrives = 1.0 + (t + rng.uniform(0.05, 0.08) - 1.0) * (1.0 + 1e-6 * ppm)
        fixed, gps = i > 20, 0.2 * (i // 2)
        if kind == "ulog":
            file.row("sensor_combined", arrives, 0.0, 0.0, 0.0, 0.0, 0.0, -9.8)
            file.row("sensor_gps", arrives, int(1e6 * (1.7e9 + gps)) if fixed else 0)
        else:
            us = round(1e6 * arrives)
            file.row("IMU", us, 0, 0.0, 0.0, 0.0, 0.0, 0.0, -9.8)
            file.row("GPS", us, 0, 1000 * 86_400 + round(1e3 * gps), 2300 if fixed else 0)
    path.write_bytes(file.bytes())
    log = open_log(path, None)
    assert log.drift.ppm == pytest.approx(ppm, abs=300.0)
    doubt = clock_doubt(log.drift.bounds, {}, by_gps=log.drift.by_gps)
    assert (doubt is None) is (ppm == 0.0)
    if doubt is not None:
        assert doubt.share == pytest.approx(1e-6 * ppm, abs=3e-4)
        assert f"% {'fast' if ppm > 0.0 else 'slow'} against GPS time" in doubt.reason
