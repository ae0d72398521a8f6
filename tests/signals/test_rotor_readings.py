"""Rotors' readings against their commands, each other, their age and what shakes the IMU."""

import numpy as np
import pytest

from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.signals.rotor_readings import (
    RotorLines,
    held_rotor,
    late_reading,
    moved_columns,
    odd_reading,
    unbalanced_reading,
    unlike_squares,
)

SPIN = np.array([1.0, 1.0, -1.0, -1.0])
T = np.arange(0.0, 2.5, 0.004)


def flown(rotors=4, cg=0.0, seed=1):
    """Commands and speeds of a hover, the first rotor loaded by a CG that is off."""
    rng = np.random.default_rng(seed)
    u = 0.4 + 0.02 * rng.normal(size=(len(T), rotors)).cumsum(axis=0) / 100.0
    u += cg * np.where(np.arange(rotors) % 2, -1.0, 1.0)
    return u, 800.0 * np.sqrt(np.maximum(u, 0.05) / 0.4)


@pytest.mark.parametrize("cg", [0.0, 0.03])
def test_alike_motors_are_not_odd_whatever_the_cg(cg):
    u, omega = flown(cg=cg)
    assert odd_reading(omega, u, SPIN) is None
    # A tumble is no pole count: what lasts for a part of the stretch says nothing of a constant.
    omega[:200, 3] *= np.linspace(0.1, 1.0, 200)
    assert odd_reading(omega, u, SPIN) is None


@pytest.mark.parametrize("rotors", [4, 8])
@pytest.mark.parametrize("ratio", [0.5, 12.0 / 14.0, 14.0 / 12.0, 2.0])
def test_another_pole_count_is_an_odd_reading(ratio, rotors):
    u, omega = flown(rotors, cg=0.02 if rotors == 4 else 0.0)
    omega[:, 2] *= ratio
    found = odd_reading(omega, u, np.tile(SPIN, rotors // 4))
    assert (found.rotor, found.by_command) == (2, True)
    assert found.ratio == pytest.approx(ratio, rel=0.03)
    assert "rotor 3 reads" in found.words


@pytest.mark.parametrize("name", ["px4-quad-x", "px4-hexa-x", "px4-octo-x"])
@pytest.mark.parametrize("ratio", [0.5, 2.0])
def test_without_commands_balance_shows_a_reading_that_is_wrong(name, ratio):
    geometry = load_airframe(name).geometry
    _, omega = flown(rotors=geometry.shape[1])
    # A CG that is off, yaw trim, and a weak propeller are no wrong reading.
    x, y, spin = geometry
    loads = 1.0 + 0.1 * (x - y) / np.hypot(x, y) + 0.05 * spin
    loads[1] *= 1.3
    sound = omega * np.sqrt(loads)
    assert unbalanced_reading(sound, geometry) is None
    sound[:, 2] *= ratio
    found = unbalanced_reading(sound, geometry)
    assert found.rotor == 2
    assert found.ratio == pytest.approx(ratio, rel=0.25)
    assert "balances the others" in found.words


@pytest.mark.parametrize("name", ["px4-quad-x", "px4-hexa-x"])
@pytest.mark.parametrize("offset", [0.28, 0.45])
def test_a_cg_far_off_is_no_wrong_reading(name, offset):
    """Yaw is in balance, which a rotor that reads so little would not leave it."""
    x, y, spin = load_airframe(name).geometry
    effect = np.vstack([np.ones(len(x)), x, y, spin])
    for way in np.linspace(0.0, 2.0 * np.pi, 24):
        place = offset * np.hypot(x, y).mean() * np.array([np.cos(way), np.sin(way)])
        loads = np.linalg.pinv(effect) @ [1.0, *place, 0.0] * len(x)
        _, omega = flown(rotors=len(x))
        assert unbalanced_reading(omega * np.sqrt(loads), np.vstack([x, y, spin])) is None


def columns(values):
    return [(T, column) for column in values.T]


def test_columns_that_change_places_or_come_late_are_found():
    rng = np.random.default_rng(3)
    u = 0.4 + 0.05 * np.sin(2.0 * T[:, None] * (1.0, 2.0, 3.0, 4.0))
    omega = 800.0 * np.sqrt(u / 0.4) + rng.normal(0.0, 5.0, u.shape)
    assert moved_columns(columns(omega), columns(u)) == ""
    assert "rotor 2 follows the command of rotor 4" in moved_columns(
        columns(omega[:, [0, 3, 2, 1]]), columns(u)
    )
    noise = columns(rng.normal(800.0, 5.0, u.shape))
    assert moved_columns(noise, columns(u)) == late_reading(noise, columns(u)) == ""
    read = [(T + 0.04, column) for column in omega.T]
    assert late_reading(read, columns(u)) == ""
    read[1] = T + 0.14, omega[:, 1]
    assert "reads rotor 2 100 ms later" in late_reading(read, columns(u))


def test_a_weak_motor_turns_as_fast_as_it_must():
    """The loop gives it more command for the same speed: its speeds are right."""
    u, omega = flown()
    u[:, 1] *= 1.4
    found = odd_reading(omega, u, SPIN)
    assert (found.rotor, found.by_command) == (1, False)


def test_motors_that_all_differ_are_no_pole_count():
    """None that read otherwise would bring yaw into balance."""
    u, omega = flown(cg=0.02)
    apart = [1.25, 0.9, 1.02, 0.85]
    found = odd_reading(omega * apart, u, np.array([-1.0, 1.0, 1.0, -1.0]))
    assert found is None or not found.by_command
    assert odd_reading(omega * [1.03, 0.98, 1.04, 0.97], u, SPIN) is None
    assert unlike_squares(omega, u) < 0.01 < 0.2 < unlike_squares(omega * apart, u)


def test_too_few_readings_say_nothing():
    for speeds in (np.ones((1, 4)), np.zeros((9, 4))):
        assert odd_reading(speeds, np.ones_like(speeds), SPIN) is None
    assert held_rotor(T[:1], np.ones((1, 4))) is None


def test_a_rotor_that_holds_its_reading_is_found():
    omega = 800.0 + np.random.default_rng(2).normal(size=(len(T), 4)).cumsum(axis=0)
    assert held_rotor(T, omega) is None
    for not_held in (np.round(omega, -1), np.full((len(T), 4), 800.0)):
        assert held_rotor(T, not_held) is None
    omega[100:280, 1] = omega[100, 1]
    assert held_rotor(T, omega) == (1, pytest.approx(180.0 / len(T), rel=0.1))


def shaken(lines=True, alone=False, seed=2):
    """(n, 6) IMU at 500 Hz with a resonance, and (n, 4) speeds of rotors at some 310 Hz."""
    random = np.random.default_rng(seed)
    t = np.arange(0.0, 20.0, 0.002)
    together = 310.0 + 25.0 * np.sin(1.3 * t) + 15.0 * np.sin(3.1 * t + 1.0)
    speeds = 2.0 * np.pi * together[:, None] * (0.96, 1.0, 1.02, 1.05)
    turned = np.cumsum(speeds, axis=0) * 0.002
    imu = random.standard_normal((len(t), 6)) + np.sin(2.0 * np.pi * 180.0 * t)[:, None]
    count = 1 if alone else 4
    imu[:, 3:] += 0.5 * lines * np.cos(turned[:, :count]).sum(axis=1)[:, None]
    return imu, speeds


def factor_of(imu, speeds, parts=1):
    lines = RotorLines(SPIN)
    for rows in np.array_split(np.arange(len(imu)), parts):
        lines.update(0.002, imu[rows], speeds[rows])
    return lines.factor


@pytest.mark.parametrize("factor", [12.0 / 14.0, 14.0 / 12.0, 24.0 / 14.0])
def test_a_pole_count_that_all_have_wrong_is_seen_by_the_imu(factor):
    imu, speeds = shaken()
    assert factor_of(imu, speeds) == 1.0
    assert factor_of(imu, factor * speeds) == pytest.approx(1.0 / factor, rel=0.02)
    assert factor_of(imu, factor * speeds) == factor_of(imu, factor * speeds, parts=170)


def test_lines_are_seen_after_rotors_that_hardly_turned():
    """Of the first sample 64 turns take longer than the flight."""
    imu, speeds = shaken()
    speeds[0] *= 1e-3
    assert factor_of(imu, speeds) == factor_of(imu, speeds, parts=170) == 1.0


def test_no_line_is_seen_where_none_goes_with_the_speeds():
    assert factor_of(*shaken(lines=False)) is None
    imu, speeds = shaken()
    assert factor_of(imu, speeds[::-1]) is None
    assert factor_of(imu, 0.5 * speeds) is None  # what two blades may do
    assert factor_of(imu[::20], speeds[::20]) is None  # at 25 Hz
    imu[:, 0] = np.nan  # on the ground
    assert factor_of(imu, speeds) is None
    assert factor_of(*shaken(alone=True)) in (1.0, None)


@pytest.mark.parametrize(("read", "share"), [(1.0, None), (0.8, 1.0 / 9.0)])
def test_where_it_yaws_thrust_shows_whether_both_spins_lift_alike(read, share):
    """However an arm is twisted: k_T of all was 11 % off, in half widths ten."""
    t = np.arange(0.0, 20.0, 0.004)
    squares = 4e5 * (1.0 + (0.05 + 0.1 * np.sin(2.0 * t[:, None])) * SPIN)
    imu = np.random.default_rng(2).normal(0.0, 0.05, (len(t), 6)) - [0.0, 0.0, 0.0, 0.0, 0.0, 9.81]
    lines = RotorLines(SPIN)
    lines.update(0.004, imu, np.sqrt(squares * np.where(SPIN > 0.0, read, 1.0)))
    assert lines.unlike_spins == (share and pytest.approx(share, rel=0.03))
