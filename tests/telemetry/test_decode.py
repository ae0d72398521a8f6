"""Frames become the right records, at the right time on the vehicle's clock."""

import math

import numpy as np
import pytest

from gcs_sysid.signals.records import Record, Stream
from gcs_sysid.telemetry.decode import STATE_IDS, RecordDecoder
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frame_block import FrameBlock
from gcs_sysid.telemetry.track_collector import TrackCollector
from testbed.recordings import in_sequence

ARDUPILOT = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
NAN = float("nan")


class OneByOne:
    """The decoder of blocks, given a block for each frame."""

    def __init__(self):
        self.inner = RecordDecoder()

    def __getattr__(self, name):
        return getattr(self.inner, name)

    def decode(self, frame):
        out = TrackCollector()
        taken = self.inner.decode(FrameBlock.of([frame]), np.ones(1, bool), out)
        if frame.message_id in STATE_IDS:
            now = float(taken.moments.now[-1])
            return self.inner.take_state(frame, now)
        return next(iter(in_sequence(out.block())), None)


@pytest.fixture
def decoder():
    return OneByOne()


def esc(sender, t, rpm, index=0):
    return sender.frame(
        mavlink.MAVLink_esc_status_message(index, round(t * 1e6), rpm, [16.0] * 4, [5.0] * 4)
    )


def servos(sender, t, values, port=0):
    return sender.frame(
        mavlink.MAVLink_servo_output_raw_message(
            round(t * 1e6) % 2**32, port, *values, *[0] * (16 - len(values))
        )
    )


def outputs(sender, t, values, active):
    values = [*values, *[0.0] * (32 - len(values))]
    return sender.frame(
        mavlink.MAVLink_actuator_output_status_message(round(t * 1e6), active, values)
    )


def esc_telemetry(sender, rpm, cls=mavlink.MAVLink_esc_telemetry_1_to_4_message):
    return sender.frame(cls([30] * 4, [1600] * 4, [100] * 4, [0] * 4, rpm, [1] * 4))


def scaled_imu(sender, t, acc, gyro):
    return sender.frame(mavlink.MAVLink_scaled_imu_message(round(t * 1e3), *acc, *gyro, 0, 0, 0))


def raw_imu(sender, t, acc, gyro, imu_id=0):
    return sender.frame(
        mavlink.MAVLink_raw_imu_message(round(t * 1e6), *acc, *gyro, 0, 0, 0, imu_id)
    )


def position(sender, t, velocity):
    return sender.frame(
        mavlink.MAVLink_local_position_ned_message(round(t * 1e3), 1, 2, 3, *velocity)
    )


def global_position(sender, t, velocity_cm):
    return sender.frame(
        mavlink.MAVLink_global_position_int_message(
            round(t * 1e3), 0, 0, 500_000, 12_500, *velocity_cm, 0
        )
    )


def landed(sender, state):
    return sender.frame(mavlink.MAVLink_extended_sys_state_message(0, state))


def test_highres_imu_gives_gyro_then_specific_force(decoder, sender):
    record = decoder.decode(sender.imu(12.5, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0)))
    assert record == Record(Stream.IMU, 12.5, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))


def test_a_second_imu_is_not_mixed_in(decoder, sender):
    assert decoder.decode(sender.imu(1.0, imu_id=1)) is not None
    assert decoder.decode(sender.imu(1.0, imu_id=0)) is None


def test_attitude_is_continuous_through_a_full_turn(decoder, sender):
    last = None
    for i in range(100):
        yaw = math.remainder(i * 0.1, 2 * math.pi)
        q = np.array(decoder.decode(sender.attitude(1.0 + 0.01 * i, yaw=yaw)).values)
        assert last is None or q @ last > 0.99
        last = q


def test_attitude_quaternion_counts_only_while_attitude_is_missing(decoder, sender):
    def quaternion(t):
        # The sign flips freely, as PX4's does.
        return sender.frame(
            mavlink.MAVLink_attitude_quaternion_message(round(t * 1e3), -1.0, 0, 0, 0, 0, 0, 0)
        )

    first = decoder.decode(quaternion(1.0))
    assert first.values == (1.0, 0.0, 0.0, 0.0)
    assert decoder.decode(sender.attitude(1.5)) is not None
    assert decoder.decode(quaternion(2.4)) is None
    assert decoder.decode(quaternion(2.6)) is not None


def test_esc_status_gives_speeds_without_sign_in_motor_order(decoder, sender):
    record = decoder.decode(esc(sender, 2.0, [600, -600, 0, 1200], index=4))
    assert record.stream is Stream.ROTOR_SPEED
    assert record.offset == 4
    np.testing.assert_allclose(record.values, np.array([20, 20, 0, 40]) * math.pi)


def test_actuator_outputs_are_cut_to_those_active(decoder, sender):
    record = decoder.decode(outputs(sender, 2.0, [1100.0, 1200, 1300, 1400, 900, 900], active=6))
    assert record == Record(
        Stream.ROTOR_COMMAND,
        2.0,
        (1100.0, 1200, 1300, 1400, 900, 900),
        source="ACTUATOR_OUTPUT_STATUS",
    )


def test_setpoints_of_the_rate_loop_take_the_latest_time(decoder, sender):
    decoder.decode(sender.imu(2.0))
    frame = sender.frame(
        mavlink.MAVLink_attitude_target_message(1500, 0, [1, 0, 0, 0], 0.5, -0.25, 2.0, 0.5)
    )
    assert decoder.decode(frame) == Record(Stream.RATE_SETPOINT, 2.0, (0.5, -0.25, 2.0))


def test_voltage_is_the_systems_or_where_that_is_missing_the_sum_of_the_cells(decoder, sender):
    def battery(number, *cells):
        cells = [*cells, *[0xFFFF] * (10 - len(cells))]
        return decoder.decode(
            sender.frame(
                mavlink.MAVLink_battery_status_message(number, 0, 1, 20, cells, 0, 0, 0, 50)
            )
        )

    decoder.decode(sender.imu(2.0))
    record = battery(0, 3912, 3871)
    assert (record.stream, record.t, record.values) == (Stream.VOLTAGE, 2.0, (7.783,))
    assert battery(1, 3912) is None
    system = mavlink.MAVLink_sys_status_message(0, 0, 0, 9, 15_432, *[0] * 8)
    assert decoder.decode(sender.frame(system)).values == (15.432,)
    assert battery(0, 3912, 3871) is None


def test_servo_outputs_and_actuator_outputs_are_told_apart(decoder, sender):
    decoder.decode(sender.imu(100.0))
    servo = decoder.decode(servos(sender, 101.0, [1500] * 4))
    assert servo.values == (1500.0,) * 4
    assert servo.source == "SERVO_OUTPUT_RAW"
    assert decoder.decode(servos(sender, 103.0, [1500] * 4, port=1)).offset == 16
    actuator = decoder.decode(outputs(sender, 104.0, [1.0] * 4, active=4))
    assert actuator.source == "ACTUATOR_OUTPUT_STATUS"


def test_servo_outputs_wait_for_a_clock(decoder, sender):
    assert decoder.decode(servos(sender, 5.0, [1500] * 4)) is None
    assert decoder.dropped["no time"] == 1


def test_position_gives_velocity_then_position(decoder, sender):
    frame = sender.frame(mavlink.MAVLink_local_position_ned_message(3000, 1, 2, 3, 4, 5, 6))
    assert decoder.decode(frame) == Record(Stream.VELOCITY, 3.0, (4.0, 5.0, 6.0, 1.0, 2.0, 3.0))


def test_states_without_a_stamp_take_the_latest_time(decoder, sender):
    armed = sender.heartbeat(base_mode=mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
    assert decoder.decode(armed) is None  # no time heard yet
    assert decoder.decode(landed(sender, 2)) is None
    assert decoder.dropped["no time"] == 1
    decoder.decode(sender.imu(7.0))
    assert decoder.decode(armed) == Record(Stream.ARMED, 7.0, (1.0,))
    assert decoder.decode(sender.heartbeat()).values == (0.0,)
    assert decoder.decode(landed(sender, 2)) == Record(Stream.IN_AIR, 7.0, (1.0,))
    assert decoder.decode(landed(sender, 1)).values == (0.0,)
    assert decoder.decode(landed(sender, 3)).values == (1.0,)
    assert decoder.decode(landed(sender, 0)) is None


@pytest.mark.parametrize("value", [NAN, float("inf"), -float("inf")])
def test_values_that_are_not_finite_are_dropped_and_counted(decoder, sender, value):
    assert decoder.decode(sender.imu(1.0, gyro=(value, 0.0, 0.0))) is None
    half = decoder.decode(sender.imu(1.1, acc=(value, 0.0, 0.0))).values
    assert math.isfinite(sum(half[:3]))
    assert all(math.isnan(v) for v in half[3:])
    assert decoder.dropped["accelerometer not finite"] == 1
    assert decoder.decode(sender.attitude(1.2, roll=value)) is None
    assert decoder.decode(outputs(sender, 1.3, [value] * 4, active=4)) is None
    assert decoder.dropped["not finite"] == 3


def test_a_quaternion_of_zeros_is_dropped(decoder, sender):
    frame = sender.frame(mavlink.MAVLink_attitude_quaternion_message(1000, 0, 0, 0, 0, 0, 0, 0))
    assert decoder.decode(frame) is None


@pytest.mark.parametrize(
    ("first", "name"), [(f, f"ESC_TELEMETRY_{f}_TO_{f + 3}") for f in (1, 5, 9, 13, 17, 21, 25, 29)]
)
def test_every_group_of_esc_telemetry_is_read(decoder, sender, first, name):
    decoder.decode(sender.imu(3.0))
    cls = getattr(mavlink, f"MAVLink_{name.lower()}_message")
    record = decoder.decode(esc_telemetry(sender, [600, 0, 65_535, 1200], cls))
    assert (record.stream, record.t, record.offset) == (Stream.ROTOR_SPEED, 3.0, first - 1)
    assert record.source == name
    np.testing.assert_allclose(record.values, np.array([20.0, 0.0, 65_535 / 30.0, 40.0]) * math.pi)


def test_esc_telemetry_takes_the_time_of_the_outputs_sent_with_it(decoder, sender):
    """As ArduPilot sends one step: outputs, ESCs, then the IMU, all with one time."""
    decoder.decode(sender.imu(3.0))
    decoder.decode(servos(sender, 3.0025, [1500] * 4))
    record = decoder.decode(esc_telemetry(sender, [600] * 4))
    assert record.t == pytest.approx(3.0025, abs=1e-9)
    # Outputs that came long ago do not hold the time back.
    decoder.decode(sender.imu(3.5))
    assert decoder.decode(esc_telemetry(sender, [600] * 4)).t == 3.5


def test_rpm_sensors_that_are_not_there_are_left_out(decoder, sender):
    decoder.decode(sender.imu(4.0))

    def rpm(*values):
        return decoder.decode(sender.frame(mavlink.MAVLink_rpm_message(*values)))

    record = rpm(600.0, 1200.0)
    assert (record.t, record.source) == (4.0, "RPM")
    np.testing.assert_allclose(record.values, np.array([20.0, 40.0]) * math.pi)
    assert len(rpm(600.0, -1.0).values) == 1
    assert rpm(-1.0, -1.0) is None


def test_after_a_reboot_old_outputs_do_not_tell_the_time(decoder, sender):
    decoder.decode(sender.imu(500.0))
    decoder.decode(servos(sender, 500.0, [1500] * 4))
    for t in (2.0, 2.004):
        decoder.decode(sender.imu(t))
    assert decoder.decode(esc_telemetry(sender, [600] * 4)).t == pytest.approx(2.004)


def test_scaled_imu_counts_only_while_highres_imu_is_missing(decoder, sender):
    scaled = decoder.decode(scaled_imu(sender, 1.0, (0, 0, -1000), (100, -200, 300)))
    np.testing.assert_allclose(scaled.values, (0.1, -0.2, 0.3, 0.0, 0.0, -9.80665))
    assert decoder.decode(sender.imu(1.5)) is not None
    assert decoder.decode(scaled_imu(sender, 2.4, (0, 0, 0), (0, 0, 0))) is None
    assert decoder.decode(scaled_imu(sender, 2.6, (0, 0, 0), (0, 0, 0))) is not None


def test_raw_imu_is_believed_of_ardupilot_alone(decoder, sender):
    decoder.decode(sender.heartbeat())
    assert decoder.decode(raw_imu(sender, 1.0, (0, 0, -1000), (100, 0, 0))) is None
    decoder.decode(sender.heartbeat(autopilot=ARDUPILOT))
    raw = decoder.decode(raw_imu(sender, 1.1, (0, 0, -1000), (100, 0, 0)))
    np.testing.assert_allclose(raw.values, (0.1, 0.0, 0.0, 0.0, 0.0, -9.80665))
    assert decoder.decode(raw_imu(sender, 1.1, (0, 0, 0), (0, 0, 0), imu_id=1)) is None
    assert decoder.decode(scaled_imu(sender, 1.2, (0, 0, 0), (0, 0, 0))) is None
    assert decoder.decode(raw_imu(sender, 1.3, (0, 0, 0), (0, 0, 0))) is not None


def test_global_position_counts_only_while_local_position_is_missing(decoder, sender):
    record = decoder.decode(global_position(sender, 1.0, (100, -200, 50)))
    assert record.values == (1.0, -2.0, 0.5, 0.0, 0.0, -12.5)
    assert decoder.decode(position(sender, 1.5, (1, 2, 3))) is not None
    assert decoder.decode(global_position(sender, 2.0, (0, 0, 0))) is None
    assert decoder.decode(global_position(sender, 2.6, (0, 0, 0))) is not None


def test_ardupilots_status_tells_flight_when_nothing_better_does(decoder, sender):
    def beat(status, armed=True, autopilot=ARDUPILOT):
        mode = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
        record = decoder.decode(
            sender.heartbeat(autopilot=autopilot, base_mode=mode, system_status=status)
        )
        return record.stream, record.values[0]

    standby, active, critical = (
        mavlink.MAV_STATE_STANDBY,
        mavlink.MAV_STATE_ACTIVE,
        mavlink.MAV_STATE_CRITICAL,
    )
    decoder.decode(sender.imu(1.0))
    assert beat(standby) == (Stream.ARMED, 1.0)
    assert beat(standby) == (Stream.IN_AIR, 0.0)
    assert beat(active) == (Stream.IN_AIR, 1.0)
    assert beat(critical) == (Stream.ARMED, 1.0)  # a failsafe: in the air or not
    assert beat(active, armed=False) == (Stream.ARMED, 0.0)
    assert decoder.decode(landed(sender, 2)).values == (1.0,)
    assert beat(active, armed=False) == (Stream.ARMED, 0.0)
    decoder.decode(sender.imu(6.5))
    assert beat(active, armed=False) == (Stream.IN_AIR, 1.0)
    # PX4's status says armed, not flying.
    assert beat(active, armed=False, autopilot=mavlink.MAV_AUTOPILOT_PX4) == (Stream.ARMED, 0.0)


def parameter(sender, name, value, kind):
    return sender.frame(mavlink.MAVLink_param_value_message(name, value, kind, 1, 0))


@pytest.mark.parametrize("number", [0, 1, 7, -1, 1_310_720, -4_194_305])
def test_px4_sends_the_bytes_of_integers(decoder, sender, number):
    decoder.decode(sender.heartbeat())
    frame = parameter(sender, b"CA_ROTOR_COUNT", 0.0, mavlink.MAV_PARAM_TYPE_INT32)
    # Not through a float: it would not keep the bits of every NaN.
    frame = frame._replace(payload=number.to_bytes(4, "little", signed=True) + frame.payload[4:])
    record = decoder.decode(frame)
    assert record == Record(Stream.PARAMETER, 0.0, (float(number),), source="CA_ROTOR_COUNT")
    assert decoder.states.parameters == {"CA_ROTOR_COUNT": number}


def test_ardupilot_sends_integers_as_numbers(decoder, sender):
    decoder.decode(sender.heartbeat(autopilot=ARDUPILOT))
    decoder.decode(sender.imu(2.0))
    record = decoder.decode(parameter(sender, b"FRAME_CLASS", 2.0, mavlink.MAV_PARAM_TYPE_INT8))
    assert record == Record(Stream.PARAMETER, 2.0, (2.0,), source="FRAME_CLASS")


@pytest.mark.parametrize("autopilot", [ARDUPILOT, mavlink.MAV_AUTOPILOT_PX4])
def test_real_parameters_and_names_of_full_length(decoder, sender, autopilot):
    decoder.decode(sender.heartbeat(autopilot=autopilot))
    kind = mavlink.MAV_PARAM_TYPE_REAL32
    decoder.decode(parameter(sender, b"ABCDEFGHIJKLMNOP", 0.25, kind))
    assert decoder.states.parameters == {"ABCDEFGHIJKLMNOP": 0.25}
    assert decoder.decode(parameter(sender, b"BAD", NAN, kind)) is None
    assert decoder.decode(parameter(sender, b"", 1.0, kind)) is None
    assert decoder.decode(parameter(sender, b"\xff\xfe", 1.0, kind)) is None
