"""One flight, one answer: a .tlog, a .ulg and a .bin of it are identified alike."""

import math

import pytest

from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.session.chain import Chain
from gcs_sysid.signals.records import Record, Stream
from testbed.recordings import block_of

RPM = 2.0 * math.pi / 60.0


@pytest.fixture(scope="module")
def airframe():
    return load_airframe("paper")


def microseconds(record):
    return round(record.t * 1e6)


def as_ulog(log, records):
    log.topic("sensor_combined", ["float[3] gyro_rad", "float[3] accelerometer_m_s2"])
    log.topic("vehicle_attitude", ["float[4] q"])
    log.topic("vehicle_local_position", [f"float {n}" for n in ("x", "y", "z", "vx", "vy", "vz")])
    log.topic("vehicle_land_detected", ["bool landed"])
    log.topic("vehicle_status", ["uint8_t arming_state", "uint8_t nav_state"])
    log.nested("esc_report", ["int32_t esc_rpm"])
    log.topic("esc_status", ["uint8_t esc_count", "esc_report[4] esc"])
    for record in records:
        t, values = record.t, record.values
        match record.stream:
            case Stream.IMU:
                log.row("sensor_combined", t, *values)
            case Stream.ATTITUDE:
                log.row("vehicle_attitude", t, *values)
            case Stream.VELOCITY:
                log.row("vehicle_local_position", t, *values[3:], *values[:3])
            case Stream.ROTOR_SPEED:
                log.row("esc_status", t, 4, *(round(v / RPM) for v in values))
            case Stream.IN_AIR:
                log.row("vehicle_land_detected", t, values[0] == 0.0)
            case Stream.ARMED:
                log.row("vehicle_status", t, 2 if values[0] else 1, 14)
    return log.bytes()


def as_dataflash(log, records):
    log.type("IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    log.type("XKQ", "QBffff", "TimeUS,C,Q1,Q2,Q3,Q4")
    log.type("XKF1", "QBffffff", "TimeUS,C,VN,VE,VD,PN,PE,PD")
    log.type("ESC", "QBff", "TimeUS,Instance,RPM,RawRPM")
    log.type("EV", "QB", "TimeUS,Id")
    flies = None
    for record in records:
        t, values = microseconds(record), record.values
        match record.stream:
            case Stream.IMU:
                log.row("IMU", t, 0, *values)
            case Stream.ATTITUDE:
                log.row("XKQ", t, 0, *values)
            case Stream.VELOCITY:
                log.row("XKF1", t, 0, *values)
            case Stream.ROTOR_SPEED:
                for rotor, speed in enumerate(values):
                    log.row("ESC", t, rotor, speed / RPM, speed / RPM)
            case Stream.IN_AIR if values != flies:
                flies = values
                log.row("EV", t, 28 if values[0] else 18)
    return log.bytes()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ulg", "bin"])
def test_an_onboard_log_gives_what_the_tlog_gives(
    kind, paper_result, paper_records, airframe, ulog_file, dataflash_file, tmp_path
):
    path = tmp_path / f"flight.{kind}"
    if kind == "ulg":
        path.write_bytes(as_ulog(ulog_file, paper_records))
    else:
        path.write_bytes(as_dataflash(dataflash_file, paper_records))
    expected = paper_result
    shares = []
    result = analyze_log(path, airframe, progress=shares.append)
    assert result.verdict == expected.verdict == "identified"
    assert result.vehicle["autopilot"] == ("px4" if kind == "ulg" else "ardupilot")
    for name, parameter in expected.parameters.items():
        if parameter.status == "identified":
            # Stamps of the attitude differ by less than a millisecond, and the kinds of log tell
            # take-off at other instants: up to half a second of flight more or less.
            value = result.parameters[name].value
            assert value == pytest.approx(parameter.value, abs=0.3 * parameter.std), name
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_parameters_are_no_samples():
    airframe = load_airframe("paper")
    chain = Chain(airframe)
    parameter = Record(Stream.PARAMETER, 0.0, (1.0,), source="MOT_SPIN_MIN")
    chain.take(block_of([parameter]))
    assert chain.sampler.recorded is None
    assert chain.sampler.seen == set()
    first, second = (Record(Stream.IMU, t, (0.0,) * 6) for t in (500.0, 501.0))
    chain.take(block_of([first, parameter, second]))
    assert chain.sampler.recorded == 1.0
    assert chain.rotor_selector.parameters == {"MOT_SPIN_MIN": 1.0}
