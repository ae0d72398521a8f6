"""How the emulated ArduCopter speaks: silent until asked, in whole milliseconds, filtered."""

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, lfilter, lfilter_zi

from gcs_sysid.telemetry.dialect import mavlink
from sim_bridge import ardupilot
from sim_bridge.ardupilot import ArduPilot
from sim_bridge.ardupilot_instruments import LowPass2p
from sim_bridge.missions import MISSIONS
from sim_bridge.sensor_faults import NO_SENSOR_FAULTS, SensorFaults
from sim_bridge.simulation import Simulation
from sim_bridge.vehicle_files import load_vehicle

SET = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
GET = mavlink.MAV_CMD_GET_MESSAGE_INTERVAL
IMU = mavlink.MAVLINK_MSG_ID_HIGHRES_IMU
SERVO = mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW


@pytest.fixture
def make_desk(open_desk: Any) -> Callable[..., Any]:
    def make(
        airframe: str = "ardupilot-quad-x",
        mission: str = "hover",
        noise: str = "none",
        sensor_faults: SensorFaults = NO_SENSOR_FAULTS,
    ) -> Any:
        gusts, sensors = np.random.SeedSequence(0).spawn(2)
        simulation = Simulation(
            load_vehicle(airframe),
            MISSIONS[mission],
            gusts,
            0.0,
            step_us=ardupilot.STEP_US,
            control_steps=ardupilot.LOOP_STEPS,
        )
        return open_desk(simulation, ArduPilot(simulation, noise, 0.02, sensors, sensor_faults))

    return make


@pytest.fixture
def desk(make_desk: Callable[..., Any]) -> Any:
    return make_desk()


def of_type(messages: list[Any], name: str) -> list[Any]:
    return [m for m in messages if m.get_type() == name]


def test_before_a_request_there_is_nothing_but_heartbeat_and_text(desk: Any) -> None:
    start = [desk.parser.decode(bytearray(f)) for f in desk.autopilot.poll(0)]
    assert [m.get_type() for m in start] == ["STATUSTEXT", "STATUSTEXT", "HEARTBEAT"]
    assert "ArduCopter" in start[0].text
    heartbeat = start[2]
    assert heartbeat.autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    assert heartbeat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert desk.counts(3.0) == {"HEARTBEAT": 3}


@pytest.mark.parametrize(
    ("asked_us", "given_us"),
    [(4000, 4000), (4999, 4000), (10_000, 10_000), (2500, 3000), (1, 3000), (9e9, 60_000_000)],
)
def test_intervals_are_whole_milliseconds_and_no_shorter_than_three(
    desk: Any, asked_us: float, given_us: int
) -> None:
    (ack,) = desk.command(SET, IMU, asked_us)
    assert ack.result == mavlink.MAV_RESULT_ACCEPTED
    _, told = desk.command(GET, IMU)
    assert (told.message_id, told.interval_us) == (IMU, given_us)


def test_250_hz_come_as_steps_of_2500_and_5000_us(desk: Any) -> None:
    desk.command(SET, IMU, 4000)
    stamps = [m.time_usec for m in of_type(desk.notice(2.0), "HIGHRES_IMU")]
    assert len(stamps) == 500
    assert Counter(np.diff(stamps).tolist()) == {5000: 299, 2500: 200}


@pytest.mark.parametrize("name", ["ESC_STATUS", "ESC_INFO", "ACTUATOR_OUTPUT_STATUS"])
def test_px4s_messages_are_denied(desk: Any, name: str) -> None:
    msgid = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
    (ack,) = desk.command(SET, msgid, 4000)
    assert ack.result == mavlink.MAV_RESULT_DENIED
    assert desk.command(GET, msgid)[1].interval_us == 0
    assert desk.command(mavlink.MAV_CMD_REQUEST_MESSAGE, msgid)[0].result == (
        mavlink.MAV_RESULT_FAILED
    )


def stream(group: int, rate: int, start: int = 1) -> Any:
    return mavlink.MAVLink_request_data_stream_message(1, 1, group, rate, start)


@pytest.mark.parametrize(
    ("group", "names"),
    [
        ("RAW_SENSORS", {"RAW_IMU", "SCALED_IMU2", "SCALED_PRESSURE"}),
        ("EXTENDED_STATUS", {"SYS_STATUS", "MISSION_CURRENT", "GPS_RAW_INT"}),
        ("RC_CHANNELS", {"SERVO_OUTPUT_RAW", "RC_CHANNELS"}),
        ("POSITION", {"GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"}),
        ("EXTRA1", {"ATTITUDE"}),
        ("EXTRA2", {"VFR_HUD"}),
        ("EXTRA3", {"SYSTEM_TIME", "BATTERY_STATUS", "VIBRATION", "ESC_TELEMETRY_1_TO_4"}),
    ],
)
def test_groups_of_request_data_stream(desk: Any, group: str, names: set[str]) -> None:
    number = getattr(mavlink, f"MAV_DATA_STREAM_{group}")
    assert desk.ask(stream(number, 10)) == []
    counts = desk.counts(2.0)
    del counts["HEARTBEAT"]
    assert counts == dict.fromkeys(names, 20)
    desk.ask(stream(number, 10, start=0))
    assert desk.counts(1.0) == {"HEARTBEAT": 1}


def test_before_4_0_there_are_groups_alone(make_desk: Callable[..., Any]) -> None:
    desk = make_desk(sensor_faults=SensorFaults(groups_only=True))
    assert desk.command(SET, SERVO, 4000)[0].result == mavlink.MAV_RESULT_UNSUPPORTED
    desk.ask(stream(mavlink.MAV_DATA_STREAM_ALL, 250))
    counts = desk.counts(2.0)
    assert counts["SERVO_OUTPUT_RAW"] == counts["RAW_IMU"] == counts["ATTITUDE"] == 100
    assert "HIGHRES_IMU" not in counts


def test_parameters_travel_as_floats_nearest_to_them(desk: Any) -> None:
    listed = of_type(desk.ask(mavlink.MAVLink_param_request_list_message(1, 1)), "PARAM_VALUE")
    assert [m.param_index for m in listed] == list(range(listed[0].param_count))
    by_name = {m.param_id: m for m in listed}
    frame_class = by_name["FRAME_CLASS"]
    assert (frame_class.param_value, frame_class.param_type) == (1.0, mavlink.MAV_PARAM_TYPE_INT8)
    assert by_name["MOT_SPIN_MIN"].param_value == pytest.approx(0.15)
    assert by_name["INS_GYRO_FILTER"].param_value == 20.0
    (read,) = desk.ask(mavlink.MAVLink_param_request_read_message(1, 1, b"FRAME_TYPE", -1))
    assert (read.param_value, read.param_index) == (1.0, 0xFFFF)
    (read,) = desk.ask(mavlink.MAVLink_param_request_read_message(1, 1, b"", 3))
    assert read.param_index == 3
    real = mavlink.MAV_PARAM_TYPE_REAL32
    (told,) = desk.ask(mavlink.MAVLink_param_set_message(1, 1, b"INS_GYRO_FILTER", 40.0, real))
    assert told.param_value == 40.0
    assert desk.ask(mavlink.MAVLink_param_set_message(1, 1, b"NO_SUCH", 1.0, real)) == []


@pytest.mark.parametrize("cutoff", [5.0, 20.0, 80.0])
def test_the_filter_is_a_second_order_butterworth(cutoff: float) -> None:
    signal = np.random.default_rng(0).standard_normal((400, 3)) + 2.0
    mine = LowPass2p(800.0, cutoff)
    b, a = butter(2, cutoff, fs=800.0)
    start = lfilter_zi(b, a)[:, None] * signal[0]
    expected, _ = lfilter(b, a, signal, axis=0, zi=start)
    np.testing.assert_allclose([mine(row) for row in signal.tolist()], expected, atol=1e-9)


def test_the_gyro_is_the_filtered_truth_at_the_time_of_sending(make_desk: Any) -> None:
    desk = make_desk(mission="all-axes")
    desk.command(SET, IMU, 4000)
    truth, sent, at = [], [], []
    for _ in range(4800):
        desk.simulation.step()
        truth.append(desk.simulation.state.rates)
        for frame in desk.autopilot.poll(desk.simulation.tick):
            message = desk.parser.decode(bytearray(frame))
            if message.get_type() == "HIGHRES_IMU":
                sent.append([message.xgyro, message.ygyro, message.zgyro])
                at.append(len(truth) - 1)
                assert message.time_usec == 60_000_000 + desk.simulation.tick * 1250
    b, a = butter(2, 20.0, fs=800.0)
    filtered = lfilter(b, a, truth, axis=0)
    np.testing.assert_allclose(sent, filtered[at], atol=1e-5)
    assert np.abs(np.array(sent) - np.array(truth)[at]).max() > 0.05


def test_rotor_speeds_have_no_stamp_no_sign_and_lag_by_a_reading(make_desk: Any) -> None:
    desk = make_desk(mission="all-axes")
    desk.command(SET, mavlink.MAVLINK_MSG_ID_ESC_TELEMETRY_1_TO_4, 4000)
    desk.notice(3.0)
    truth, sent, at = [], [], []
    for _ in range(2400):
        desk.simulation.step()
        truth.append(list(desk.simulation.state.speeds))
        for frame in desk.autopilot.poll(desk.simulation.tick):
            message = desk.parser.decode(bytearray(frame))
            if message.get_type() == "ESC_TELEMETRY_1_TO_4":
                assert not any("time" in name for name in message.get_fieldnames())
                sent.append(np.array(message.rpm) * np.pi / 30.0)
                at.append(len(truth) - 1)
    t = np.arange(len(truth)) * 1.25e-3
    inside = np.array(at) > 20
    errors = {}
    for delay in (0.0, 0.0025, 0.005, 0.0075):
        late = [np.interp(t - delay, t, column)[at] for column in np.array(truth).T]
        errors[delay] = np.std((np.array(sent).T - late)[:, inside])
    assert min(errors, key=lambda delay: errors[delay]) == 0.005
    assert errors[0.005] < 1.5  # half of the ESC's 14.3 rpm


def test_outputs_begin_at_spin_min(make_desk: Any) -> None:
    for airframe in ("ardupilot-quad-x", "paper"):
        desk = make_desk(airframe)
        desk.command(SET, SERVO, 4000)
        servo = of_type(desk.notice(0.1), "SERVO_OUTPUT_RAW")[-1]
        u = (servo.servo1_raw - 1150.0) / 800.0
        vehicle = desk.simulation.vehicle
        c = vehicle.thrust_curve
        expected = vehicle.k_T * desk.simulation.targets[0] ** 2 / vehicle.T_max
        assert (1.0 - c) * u + c * u * u == pytest.approx(expected, abs=2e-3)
        assert servo.servo5_raw == 0


@pytest.mark.parametrize(("airframe", "groups"), [("hexa", 2), ("octo", 2), ("quad", 1)])
def test_more_rotors_come_in_groups_of_four(make_desk: Any, airframe: str, groups: int) -> None:
    desk = make_desk(f"ardupilot-{airframe}-x")
    desk.command(SET, mavlink.MAVLINK_MSG_ID_ESC_TELEMETRY_1_TO_4, 4000)
    heard = desk.notice(0.1)
    telemetry = [m for m in heard if m.get_type().startswith("ESC_TELEMETRY")][-groups:]
    names = ["ESC_TELEMETRY_1_TO_4", "ESC_TELEMETRY_5_TO_8"][:groups]
    assert [m.get_type() for m in telemetry] == names
    rpm = np.concatenate([m.rpm for m in telemetry])
    speeds = np.array(desk.simulation.state.speeds) * 30.0 / np.pi
    np.testing.assert_allclose(rpm[: len(speeds)], speeds, atol=15.0)
    assert not any(rpm[len(speeds) :])
