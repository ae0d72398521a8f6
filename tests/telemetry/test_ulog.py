"""PX4's own logs give the records that a link would have given."""

import math
import time
import tracemalloc

import numpy as np
import pytest

from gcs_sysid.signals.motor_order import AS_SENT
from gcs_sysid.signals.records import Record, Stream
from gcs_sysid.telemetry import ulog_format
from gcs_sysid.telemetry.logs import open_log
from gcs_sysid.telemetry.ulog import read_ulog
from testbed.recordings import columns_of

NAN = float("nan")


@pytest.fixture
def flight(ulog_file):
    """A third of a second at 250 Hz, with everything that is read."""
    log = ulog_file
    log.parameter("THR_MDL_FAC", 0.3)
    log.parameter("MAV_SYS_ID", 7)
    log.topic(
        "sensor_combined",
        ["float[3] gyro_rad", "float[3] accelerometer_m_s2", "uint32_t gyro_integral_dt"],
    )
    log.topic("estimator_sensor_bias", ["float[3] gyro_bias", "float[3] accel_bias"])
    log.topic("vehicle_attitude", ["float[4] q"])
    log.topic("vehicle_rates_setpoint", ["float roll", "float pitch", "float yaw"])
    log.topic("vehicle_local_position", [f"float {n}" for n in ("x", "y", "z", "vx", "vy", "vz")])
    log.topic("actuator_motors", ["float[12] control"])
    log.topic("actuator_outputs", ["uint32_t noutputs", "float[16] output"])
    log.topic("actuator_outputs", ["uint32_t noutputs", "float[16] output"], multi_id=1)
    log.topic("vehicle_land_detected", ["bool landed"])
    log.topic(
        "vehicle_status",
        ["uint8_t arming_state", "uint8_t nav_state", "uint8_t system_id", "uint8_t system_type"],
    )
    log.row("vehicle_status", 2.0, 2, 17, 7, 13)
    log.row("vehicle_land_detected", 2.0, True)
    log.row("estimator_sensor_bias", 2.1, 0.5, 0.0, 0.0, 0.0, 0.0, 1.0)
    for i in range(80):
        t = 2.0 + 0.004 * i
        log.row("sensor_combined", t, 1.0, 2.0, 3.0, 0.0, 0.0, -9.0, 4000)
        sign = -1.0 if i % 3 else 1.0
        log.row(
            "vehicle_attitude", t + 1e-3, sign * math.cos(i / 100), sign * math.sin(i / 100), 0, 0
        )
        log.row("vehicle_rates_setpoint", t, 0.1, -0.2, 0.3)
        log.row("actuator_motors", t, 0.5, 0.0, 1.0, NAN, *[NAN] * 8)
        if i % 20 == 0:
            log.row("actuator_outputs", t, 4, *[1500.0] * 4, *[0.0] * 12)
            log.row("actuator_outputs", t, 2, *[1600.0] * 2, *[0.0] * 14, multi_id=1)
            log.row("vehicle_local_position", t, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    log.row("vehicle_land_detected", 2.15, False)
    log.row("vehicle_status", 2.2, 2, 14, 7, 13)
    log.parameter("MC_ROLLRATE_P", 0.2, t=2.3)
    log.dropout(120)
    return log


def test_the_imu_is_less_the_estimators_bias_as_on_the_link(path, of):
    records = of(open_log(path), Stream.IMU)
    assert len(records) == 80
    assert records[0] == Record(Stream.IMU, 2.0, (1.0, 2.0, 3.0, 0.0, 0.0, -9.0))
    assert records[-1].values == (0.5, 2.0, 3.0, 0.0, 0.0, -10.0)


def test_setpoints_of_the_rate_loop_are_read(path, of):
    setpoints = of(open_log(path), Stream.RATE_SETPOINT)
    assert len(setpoints) == 80
    assert setpoints[0].values == pytest.approx((0.1, -0.2, 0.3))


def test_commands_undo_the_thrust_curve_and_keep_their_sources_apart(path, of):
    motors = of(open_log(path), Stream.ROTOR_COMMAND, "actuator_motors")[0].values
    assert len(motors) == 3  # the fourth never came
    u = np.array(motors)
    np.testing.assert_allclose(0.7 * u + 0.3 * u**2, [0.5, 0.0, 1.0], atol=1e-7)
    assert of(open_log(path), Stream.ROTOR_COMMAND, "actuator_outputs")[0].values == (1500.0,) * 4
    second = of(open_log(path), Stream.ROTOR_COMMAND, "actuator_outputs_1")
    assert second[0].values == (1600.0,) * 2


def test_attitude_is_continuous_and_velocity_comes_before_position(path, of):
    q = np.array([r.values for r in of(open_log(path), Stream.ATTITUDE)])
    assert (np.sum(q[1:] * q[:-1], axis=1) > 0.99).all()
    assert q[0, 0] > 0.0
    velocity = of(open_log(path), Stream.VELOCITY)[0]
    assert velocity.values == (4.0, 5.0, 6.0, 1.0, 2.0, 3.0)


def test_taking_off_by_itself_is_flying(path, of):
    log = open_log(path)
    states = [(r.t, r.values[0]) for r in of(log, Stream.IN_AIR)]
    assert states == [(2.0, 0.0), (2.15, 1.0)]
    assert {r.values for r in of(open_log(path), Stream.ARMED)} == {(1.0,)}


def test_vehicle_parameters_and_dropouts_are_told(path, of):
    log = open_log(path)
    assert str(log.vehicle) == "PX4 hexarotor 7:1"
    assert log.vehicle.key == "px4"
    assert log.parameters["THR_MDL_FAC"] == pytest.approx(0.3)
    changed = of(log, Stream.PARAMETER, "MC_ROLLRATE_P")
    assert [r.values[0] for r in changed] == [pytest.approx(0.2)]
    told = log.as_dict()
    assert told["messages"]["sensor_combined"]["count"] == 80
    assert told["dropouts"] == {"count": 1, "seconds": pytest.approx(0.12)}
    assert log.share_read == 1.0


def test_escs_are_put_in_motor_order(tmp_path, ulog_file, of):
    log = ulog_file
    log.nested("esc_report", ["float esc_current", "int32_t esc_rpm", "uint8_t actuator_function"])
    log.topic("esc_status", ["uint8_t esc_count", "esc_report[2] esc"])
    log.row("esc_status", 3.0, 2, 1.5, -600, 102, 2.5, 1200, 101)
    log.topic("vehicle_air_data", ["float baro_pressure_pa"])
    log.row("vehicle_air_data", 3.0, 95000.0)
    path = tmp_path / "escs.ulg"
    path.write_bytes(log.bytes())
    (record,) = of(open_log(path), Stream.ROTOR_SPEED, "esc_status")
    np.testing.assert_allclose(record.values, np.array([40.0, 20.0]) * math.pi)
    extras = read_ulog(path).extras
    assert extras["motor currents"][1].tolist() == [[2.5, 1.5]]
    assert extras["pressure"][1].tolist() == [[95000.0]]


@pytest.mark.parametrize("count", [NAN, math.inf, -3.0, 0.0])
def test_counts_that_are_none_give_no_rotors(tmp_path, ulog_file, of, count):
    log = ulog_file
    log.topic("sensor_combined", ["float[3] gyro_rad", "float[3] accelerometer_m_s2"])
    log.topic("actuator_outputs", ["float noutputs", "float[4] output"])
    log.nested("esc_report", ["int32_t esc_rpm", "float actuator_function"])
    log.topic("esc_status", ["float esc_count", "esc_report[2] esc"])
    log.topic("vehicle_status", ["float system_id", "float arming_state"])
    log.row("sensor_combined", 3.0, *[0.0] * 6)
    log.row("actuator_outputs", 3.0, count, *[1500.0] * 4)
    log.row("esc_status", 3.0, count, 600, count, 600, count)
    log.row("vehicle_status", 3.0, count, 2.0)
    path = tmp_path / "counts.ulg"
    path.write_bytes(log.bytes())
    assert of(open_log(path), Stream.ROTOR_COMMAND, "actuator_outputs") == []
    (speeds,) = of(open_log(path), Stream.ROTOR_SPEED, AS_SENT)
    assert len(speeds.values) == 2
    assert len(of(open_log(path), Stream.ARMED)) == 1


def test_what_is_not_read_takes_no_memory(tmp_path, ulog_file, monkeypatch):
    log = ulog_file
    log.topic("sensor_combined", ["float[3] gyro_rad", "float[100] other"])
    log.topic("other", ["float[100] other"])
    log.topic("vehicle_attitude", ["float[4] q"])
    log.row("vehicle_attitude", 3.0, 1.0, 0.0, 0.0, 0.0)
    start = len(log.bytes())
    for i in range(100):
        log.row("sensor_combined", 3.0 + 0.01 * i, *[0.0] * 103)
        log.row("other", 3.0 + 0.01 * i, *[0.0] * 100)
    path = tmp_path / "long.ulg"
    path.write_bytes(log.bytes() + log.bytes()[start:] * 150)
    monkeypatch.setattr(ulog_format.UlogFile, "_WINDOW", 2**17)
    read_ulog(path)  # what is imported and kept takes its memory
    tracemalloc.start()
    recording = read_ulog(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert recording.counts["sensor_combined"] == 15_100
    assert peak < path.stat().st_size / 3


@pytest.mark.slow
def test_one_flight_recorded_both_ways_gives_the_same_records(shared_logs):
    ways = [
        columns_of(open_log(shared_logs / f"px4-sih-default.{suffix}"))
        for suffix in ("tlog", "ulg")
    ]

    def both(stream, sources=("", ""), decimals=6):
        (t, tlog), (t_onboard, onboard) = (
            way[stream, source] for way, source in zip(ways, sources, strict=True)
        )
        stamps = (np.round(times, decimals) for times in (t, t_onboard))
        _, i, j = np.intersect1d(*stamps, return_indices=True)
        return tlog[i], onboard[j]

    tlog, onboard = both(Stream.IMU)
    assert len(tlog) > 39_000
    np.testing.assert_allclose(tlog[:, :3], onboard[:, :3], atol=3e-4)
    assert np.std(tlog[:, :3] - onboard[:, :3], axis=0).max() < 1e-5
    assert np.std(tlog[:, 3:] - onboard[:, 3:], axis=0).max() < 3e-4
    # Commands of one step bear the same stamp; SERVO_OUTPUT_RAW has whole microseconds.
    tlog, onboard = both(Stream.ROTOR_COMMAND, ("SERVO_OUTPUT_RAW", "actuator_motors"))
    flies = tlog[:, 0] > 1000
    assert flies.sum() > 38_000
    np.testing.assert_allclose((tlog[flies, :4] - 1000.0) / 1000.0, onboard[flies], atol=0.501e-3)
    tlog, onboard = both(Stream.ATTITUDE, decimals=3)
    assert len(tlog) > 15_000
    assert np.abs(np.sum(tlog * onboard, axis=1)).min() > 1.0 - 1e-5
    tlog, onboard = both(Stream.VELOCITY, decimals=3)
    assert len(tlog) > 7_000
    np.testing.assert_allclose(tlog, onboard)
    states = (way[Stream.IN_AIR, ""] for way in ways)
    tlog, onboard = (t[in_air[:, 0] == 1.0] for t, in_air in states)
    for end in (min, max):
        assert end(tlog) == pytest.approx(end(onboard), abs=0.6)


def test_zeros_at_the_end_as_a_power_cut_leaves_them_cost_no_time(tmp_path, path):
    padded = tmp_path / "padded.ulg"
    padded.write_bytes(path.read_bytes())
    with open(padded, "ab") as file:
        file.truncate(file.tell() + 2**28)
    begin = time.process_time()
    recording = read_ulog(padded)
    assert time.process_time() - begin < 5.0
    assert recording.counts == read_ulog(path).counts


@pytest.mark.parametrize(
    ("names", "fields"),
    [
        (("vehicle_angular_velocity", "vehicle_acceleration"), ["float[3] xyz"]),
        (("sensor_gyro", "sensor_accel"), ["float x", "float y", "float z"]),
    ],
)
def test_gyro_and_accelerometer_of_their_own_topics_make_the_imu(
    tmp_path, ulog_file, of, names, fields
):
    for name in names:
        ulog_file.topic(name, fields)
    for i in range(50):
        ulog_file.row(names[0], 2.0 + 0.004 * i, 0.1, 0.2, 0.3)
        ulog_file.row(names[1], 2.002 + 0.004 * i, 0.0, 0.0, -9.0 - i)
    path = tmp_path / "a.ulg"
    path.write_bytes(ulog_file.bytes())
    records = of(open_log(path), Stream.IMU)
    assert len(records) == 50
    assert records[2].values == pytest.approx((0.1, 0.2, 0.3, 0.0, 0.0, -10.5))
