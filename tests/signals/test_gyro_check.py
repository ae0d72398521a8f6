"""The gyro against the attitude: scale, unit, axes."""

import numpy as np
import pytest

from gcs_sysid.judgement.imu_faults import gyro_fault, misread_axes
from gcs_sysid.model import attitude
from gcs_sysid.signals.imu_checks import GyroCheck

RATE = 100.0
T = np.arange(0.0, 40.0, 1.0 / RATE)
RNG = np.random.default_rng(7)


def motion():
    """Body rates of a pilot's doublets, and the attitude that follows from them."""
    rates = np.stack(
        [0.8 * np.sin(2.1 * T + k) * np.cos(0.7 * T * (k + 1)) for k in range(3)], axis=1
    )
    turns = attitude.from_rotation_vector(0.5 * (rates[1:] + rates[:-1]) / RATE)
    q = [np.array([1.0, 0.0, 0.0, 0.0])]
    for turn in turns:
        q.append(attitude.multiply(q[-1], turn))
    return rates, np.array(q)


RATES, Q = motion()


def checked(gyro, q=Q, *, noise=0.02, block=10**6):
    gyro = gyro + noise * RNG.normal(size=gyro.shape)
    check = GyroCheck()
    for i in range(0, len(T), block):
        k = slice(i, i + block)
        check.update(T[k], gyro[k], q[k])
    return check.result()


def test_a_sound_gyro_reads_what_the_attitude_turns():
    late = np.roll(Q, 2, axis=0)
    late[:2] = Q[0]
    found = checked(RATES + np.array([0.02, -0.01, 0.0]), late)
    np.testing.assert_allclose(found.gain, np.eye(3), atol=0.02)
    np.testing.assert_allclose(found.bias, [0.02, -0.01, 0.0], atol=0.004)
    assert not misread_axes(found).any()
    assert gyro_fault(found) is None


@pytest.mark.parametrize(
    ("scale", "words"),
    [
        (0.5, "the gyro reads 0.50 of what the attitude turns"),
        (0.93, "the gyro reads 0.93 of what"),
        (180.0 / np.pi, "57.3 times what the attitude turns: it is in deg/s"),
        ([0.5, 1.0, 1.0], "roll axis reads 0.50 of what"),
        ([1.0, 0.0, 1.0], "pitch axis reads nothing of what"),
        ([1.0, -1.0, 1.0], "pitch axis reads -1.00 of what"),
    ],
)
def test_a_wrong_scale_is_named(scale, words):
    assert words in gyro_fault(checked(RATES * scale))[0]


@pytest.mark.parametrize(
    ("roll", "pitch", "yaw", "named"),
    [
        (0, 0, 90, "YAW_90"),
        (0, 0, 45, "YAW_45"),
        (0, 0, 180, "YAW_180"),
        (180, 0, 270, "ROLL_180_YAW_270"),
        (0, 90, 0, "PITCH_90"),
        (0, 0, 47, "YAW_45"),
    ],
)
def test_a_board_whose_rotation_is_not_applied_is_named_with_it(roll, pitch, yaw, named):
    euler = attitude.from_euler(*np.radians([roll, pitch, yaw]))
    of_vehicle = attitude.matrices(np.array(euler)[None])[0]
    reason, how = gyro_fault(checked(RATES @ of_vehicle))
    assert f"is turned by {named.lower().replace('_', ' ')} deg against" in reason
    assert f"AHRS_ORIENTATION: {named};" in how


def test_axes_that_no_mounting_makes_are_read_wrong():
    """Two exchanged, which is a mirror."""
    assert "reads nothing" in gyro_fault(checked(RATES[:, [1, 0, 2]]))[0]


def test_noise_of_the_attitude_is_no_scale():
    noisy = Q + 0.01 * RNG.normal(size=Q.shape)
    found = checked(RATES, noisy / np.linalg.norm(noisy, axis=1, keepdims=True))
    assert not misread_axes(found).any()


def test_a_vehicle_that_hardly_turns_says_nothing():
    still = np.tile(Q[:1], (len(T), 1))
    assert gyro_fault(checked(0.0 * RATES, still)) is None


def test_a_slow_attitude_counts_where_it_was_reported():
    """Straight lines between eight reports a second cut a shake of 2 Hz by a seventh."""
    rates = 1.2 * np.sin(4.0 * np.pi * T)[:, None] * np.array([1.0, 0.0, 0.0])
    angle = 1.2 / (4.0 * np.pi) * (1.0 - np.cos(4.0 * np.pi * T))
    q = attitude.from_rotation_vector(angle[:, None] * np.array([1.0, 0.0, 0.0]))
    own = np.arange(len(T)) % 12 == 0
    reported = np.column_stack([np.interp(T, T[own], column) for column in q[own].T])
    for of, gain in ((own, 1.0), (None, 1.15)):
        check = GyroCheck()
        check.update(T, rates, reported, own=of)
        assert check.result().gain[0, 0] == pytest.approx(gain, abs=0.02)


def test_jumps_of_the_attitude_are_no_scale():
    q = Q.copy()
    for at in (1500, 2500):
        q[at:] = attitude.multiply(np.array(attitude.from_euler(0.0, 0.0, 0.4)), q[at:])
    assert gyro_fault(checked(RATES, q)) is None


def test_gaps_are_no_turns():
    q = Q.copy()
    q[1500:1600] = np.nan
    q[1600:] = attitude.multiply(np.array([0.0, 0.0, 0.0, 1.0]), q[1600:])
    np.testing.assert_allclose(np.diag(checked(RATES, q).gain), 1.0, atol=0.02)


def test_too_little_flight_is_no_finding():
    check = GyroCheck()
    check.update(T[:200], RATES[:200], Q[:200])
    assert check.result() is None


def test_noise_of_an_attitude_that_hardly_turns_is_no_dead_gyro():
    noisy = np.tile(Q[:1], (len(T), 1)) + 0.02 * np.random.default_rng(3).normal(size=Q.shape)
    found = checked(0.01 * RATES, noisy / np.linalg.norm(noisy, axis=1, keepdims=True))
    assert gyro_fault(found) is None
