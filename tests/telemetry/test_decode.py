"""Frames become the right records, at the right time on the vehicle's clock."""

import math

import numpy as np
import pytest

from gcs_sysid.model.attitude import from_euler
from gcs_sysid.records import Record, Stream
from gcs_sysid.telemetry.decode import RecordDecoder
from gcs_sysid.telemetry.dialect import mavlink

NAN = float("nan")
WRAP_US = 2**32 * 1e-6


@pytest.fixture
def decoder():
    return RecordDecoder()


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


def landed(sender, state):
    return sender.frame(mavlink.MAVLink_extended_sys_state_message(0, state))


def test_highres_imu_gives_gyro_then_specific_force(decoder, sender):
    record = decoder.decode(sender.imu(12.5, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0)))
    assert record == Record(Stream.IMU, 12.5, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))


def test_a_second_imu_is_not_mixed_in(decoder, sender):
    assert decoder.decode(sender.imu(1.0, imu_id=1)) is not None
    assert decoder.decode(sender.imu(1.0, imu_id=0)) is None


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (0.3, -0.4, 2.0), (-2.0, 1.2, -3.0)])
def test_quaternions_are_the_euler_rotation_matrix(angles):
    w, x, y, z = from_euler(*angles)
    (sr, sp, sy), (cr, cp, cy) = np.sin(angles), np.cos(angles)
    yaw = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    pitch = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    roll = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    v = np.array([x, y, z])
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation = (w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * cross
    np.testing.assert_allclose(rotation, yaw @ pitch @ roll, atol=1e-12)


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


def test_servo_outputs_and_actuator_outputs_are_told_apart(decoder, sender):
    decoder.decode(sender.imu(100.0))
    servo = decoder.decode(servos(sender, 101.0, [1500] * 4))
    assert servo.values == (1500.0,) * 4
    assert servo.source == "SERVO_OUTPUT_RAW"
    assert decoder.decode(servos(sender, 103.0, [1500] * 4, port=1)) is None
    actuator = decoder.decode(outputs(sender, 104.0, [1.0] * 4, active=4))
    assert actuator.source == "ACTUATOR_OUTPUT_STATUS"


def test_servo_time_goes_on_through_its_wrap(decoder, sender):
    for t in np.arange(WRAP_US - 4.0, WRAP_US + 4.0, 0.25):
        decoder.decode(sender.imu(t))
        record = decoder.decode(servos(sender, t, [1500] * 4))
        if t > WRAP_US - 1.0:
            assert record.t == pytest.approx(t, abs=2e-6)


def test_a_32_bit_millisecond_time_goes_on_through_its_wrap(decoder, sender):
    wrap = 2**32 * 1e-3
    decoder.decode(sender.imu(wrap - 0.5))
    decoder.decode(sender.imu(wrap + 0.5))
    record = decoder.decode(sender.frame(mavlink.MAVLink_attitude_message(1500, 0, 0, 0, 0, 0, 0)))
    assert record.t == pytest.approx(wrap + 1.5, abs=1e-2)


def test_servo_outputs_wait_for_a_clock(decoder, sender):
    assert decoder.decode(servos(sender, 5.0, [1500] * 4)) is None
    assert decoder.dropped["no time"] == 1


def test_position_gives_velocity_then_position(decoder, sender):
    frame = sender.frame(mavlink.MAVLink_local_position_ned_message(3000, 1, 2, 3, 4, 5, 6))
    assert decoder.decode(frame) == Record(Stream.VELOCITY, 3.0, (4.0, 5.0, 6.0, 1.0, 2.0, 3.0))


def test_states_without_a_stamp_take_the_latest_time(decoder, sender):
    armed = sender.heartbeat(base_mode=mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
    assert decoder.decode(armed) is None  # no time heard yet
    decoder.decode(sender.imu(7.0))
    assert decoder.decode(armed) == Record(Stream.ARMED, 7.0, (1.0,))
    assert decoder.decode(sender.heartbeat()).values == (0.0,)
    assert decoder.decode(landed(sender, 2)) == Record(Stream.IN_AIR, 7.0, (1.0,))
    assert decoder.decode(landed(sender, 1)).values == (0.0,)
    assert decoder.decode(landed(sender, 3)).values == (0.0,)
    assert decoder.decode(landed(sender, 0)) is None


@pytest.mark.parametrize("value", [NAN, float("inf"), -float("inf")])
def test_values_that_are_not_finite_are_dropped_and_counted(decoder, sender, value):
    assert decoder.decode(sender.imu(1.0, gyro=(value, 0.0, 0.0))) is None
    assert decoder.decode(sender.imu(1.1, acc=(value, 0.0, 0.0))) is None
    assert decoder.decode(sender.attitude(1.2, roll=value)) is None
    assert decoder.decode(outputs(sender, 1.3, [value] * 4, active=4)) is None
    assert decoder.dropped["not finite"] == 4


def test_a_quaternion_of_zeros_is_dropped(decoder, sender):
    frame = sender.frame(mavlink.MAVLink_attitude_quaternion_message(1000, 0, 0, 0, 0, 0, 0, 0))
    assert decoder.decode(frame) is None


def test_a_reboot_sets_the_clock_back_once_two_stamps_agree(decoder, sender):
    decoder.decode(sender.imu(500.0))
    assert decoder.decode(sender.imu(2.0)) is None
    assert decoder.clock.reboots == 0
    assert decoder.decode(sender.imu(2.004)).t == pytest.approx(2.004)
    assert (decoder.clock.reboots, decoder.clock.now) == (1, pytest.approx(2.004))


@pytest.mark.parametrize("wrong", [3.0, 1e6])
def test_one_wrong_stamp_does_not_move_the_clock(decoder, sender, wrong):
    decoder.decode(sender.imu(500.0))
    assert decoder.decode(sender.imu(wrong)) is None
    assert decoder.decode(sender.imu(500.004)).t == pytest.approx(500.004)
    assert (decoder.clock.reboots, decoder.clock.doubted) == (0, 1)


def test_late_samples_keep_their_own_time(decoder, sender):
    decoder.decode(sender.imu(10.0))
    assert decoder.decode(sender.imu(9.6)).t == pytest.approx(9.6)
    assert decoder.clock.now == 10.0


def test_unix_time_is_put_on_the_clock_by_system_time(decoder, sender):
    unix = 1_750_000_000.0
    assert decoder.decode(sender.imu(unix + 20.0)) is None
    decoder.decode(
        sender.frame(mavlink.MAVLink_system_time_message(round(unix * 1e6) + 20_000_000, 20_000))
    )
    assert decoder.decode(sender.imu(unix + 21.0)).t == pytest.approx(21.0, abs=1e-5)
