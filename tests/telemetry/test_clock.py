"""The vehicle's clock: wraps, reboots, doubt, and its drift against the wall clock."""

import random

import numpy as np
import pytest

from gcs_sysid.telemetry.clock import ClockDrift, Stamp, VehicleClock

WRAP_US = 2**32
WALL = 1.75e9


def test_microseconds_of_32_bits_go_on_over_two_wraps():
    clock = VehicleClock()
    for second in range(4000, 9000, 5):
        clock.stamp(Stamp.US64, second * 1_000_000)
        wrapped = second * 1_000_000 % WRAP_US
        assert clock.stamp(Stamp.US32, wrapped) == pytest.approx(second, abs=1e-6)
    assert clock.reboots == 0


def test_the_sender_of_32_bit_stamps_may_be_ahead_of_the_clock_at_the_wrap():
    clock = VehicleClock()
    wrap = WRAP_US * 1e-6
    clock.stamp(Stamp.US64, WRAP_US - 1000)
    assert clock.stamp(Stamp.US32, 1000) == pytest.approx(wrap + 1e-3)
    clock.stamp(Stamp.US64, WRAP_US + 2000)
    assert clock.stamp(Stamp.US32, WRAP_US - 500) == pytest.approx(wrap - 5e-4)


def test_a_reboot_after_a_wrap_begins_at_zero_again():
    clock = VehicleClock()
    clock.stamp(Stamp.US64, 5000 * 1_000_000)
    for t in (1.0, 1.1):
        clock.stamp(Stamp.US64, round(t * 1e6))
    assert clock.reboots == 1
    assert clock.stamp(Stamp.US32, 1_200_000) == pytest.approx(1.2)


def clock_at(t):
    clock = VehicleClock()
    clock.stamp(Stamp.US64, round(t * 1e6))
    return clock


def test_a_stamp_that_jumps_needs_one_that_agrees():
    """Far ahead or back: refused until the next is near it, by 5 s at most."""
    for first in (500.0, 20.0):
        clock = clock_at(100.0)
        assert clock.stamp(Stamp.US64, round(first * 1e6)) is None
        # Another one as odd, but not of the same clock: it begins the doubt anew.
        assert clock.stamp(Stamp.US64, round((first + 5.1) * 1e6)) is None
        assert clock.now == 100.0
        assert clock.stamp(Stamp.US64, round((first + 0.2) * 1e6)) == pytest.approx(first + 0.2)
        assert clock.now == pytest.approx(first + 0.2)
        assert clock.reboots == (first < 100.0)


def test_a_stamp_of_the_clock_ends_a_doubt():
    clock = clock_at(100.0)
    assert clock.stamp(Stamp.US64, 500_000_000) is None
    assert clock.stamp(Stamp.US64, 100_500_000) == 100.5
    assert clock.stamp(Stamp.US64, 501_000_000) is None
    assert clock.stamp(Stamp.US64, 101_000_000) == 101.0
    assert clock.stamp(Stamp.US64, 502_000_000) is None


def test_no_stamp_is_no_time():
    clock = VehicleClock()
    assert clock.stamp(Stamp.US64, 0) is None
    assert clock.stamp(Stamp.MS32, 0) is None
    assert clock.stamp(Stamp.US32, 5_000_000) is None
    assert (clock.now, clock.reboots) == (None, 0)
    assert clock.stamp(Stamp.MS32, 1) == pytest.approx(1e-3)
    assert clock.now == pytest.approx(1e-3)


def test_unix_time_is_put_on_the_axis_once_the_two_are_told_together():
    clock = clock_at(100.0)
    unix = round(WALL * 1e6)
    assert clock.stamp(Stamp.US64, unix) is None
    clock.system_time(unix, 0)  # no time since boot
    clock.system_time(999_999_999_000_000, 100_500)  # no Unix time: the date was not set yet
    assert clock.unix_minus_boot is None
    clock.system_time(unix, 100_500)
    assert clock.unix_minus_boot == pytest.approx(WALL - 100.5, abs=1e-6)
    assert clock.stamp(Stamp.US64, unix + 250_000) == pytest.approx(100.75, abs=1e-6)
    # GPS corrects Unix time in flight; the axis stays.
    clock.system_time(unix + 30_000_000, 101_000)
    assert clock.unix_minus_boot == pytest.approx(WALL - 100.5, abs=1e-6)
    # After a reboot it is another boot's.
    for t in (1.0, 1.1):
        clock.stamp(Stamp.US64, round(t * 1e6))
    assert clock.unix_minus_boot is None


def test_what_64_bits_hold_is_read_as_such_where_it_is_more():
    later = clock_at(4310.0)
    assert later.stamp(Stamp.US64_OR_32, 9_000_000) == pytest.approx(WRAP_US * 1e-6 + 9.0)
    assert later.stamp(Stamp.US64_OR_32, 1) is None  # 15 s behind, and no stamp drives the clock so
    assert later.stamp(Stamp.US64_OR_32, 0) is None
    assert clock_at(4296.0).stamp(Stamp.US64_OR_32, 0) is None  # no stamp, though the wrap is near
    assert later.stamp(Stamp.US64_OR_32, WRAP_US - 1) is None
    assert later.stamp(Stamp.US64_OR_32, 4311 * 10**6) == pytest.approx(4311.0)
    assert later.now == 4311.0
    # In the third turn too: 2^33 us are 8589.93 s.
    assert clock_at(8600.0).stamp(Stamp.US64_OR_32, 9_000_000) == pytest.approx(
        2 * WRAP_US * 1e-6 + 9.0
    )
    assert VehicleClock().stamp(Stamp.US64_OR_32, 9_000_000) == 9.0


@pytest.mark.parametrize("ppm", [-25_000.0, -300.0, 0.0, 40.0, 8_000.0])
def test_drift_is_told_through_jitter_and_wrong_stamps(ppm):
    rng = random.Random(4)
    drift = ClockDrift()
    for i in range(40_000):
        vehicle = 10.0 + 0.01 * i
        wall = WALL + vehicle / (1.0 + 1e-6 * ppm) + rng.expovariate(200.0)
        if rng.random() < 0.001:
            wall += rng.uniform(-1e6, 1e6)
        drift.add_moment(vehicle, wall)
    # 5 ms of jitter over 200 s.
    assert drift.ppm == pytest.approx(ppm, abs=10.0)


def test_drift_takes_bounded_memory_and_no_short_stretch():
    drift = ClockDrift()
    drift.add_moment(1.0, WALL)
    drift.add_moment(11.0, WALL + 10.0)
    assert drift.ppm is None
    for i in range(20_000):
        drift.add_moment(11.0 + i, WALL + 10.0 + 0.5 * i)
    assert len(drift._moments) <= drift.MOST
    assert drift.ppm == pytest.approx(1e6, rel=0.01)


def test_drift_begins_anew_on_a_reboot():
    drift = ClockDrift()
    for i in range(100):
        drift.add_moment(1000.0 + 2.0 * i, WALL + i)
    for i in range(100):
        drift.add_moment(1.0 + i, WALL + 200.0 + i)
    assert drift.ppm == pytest.approx(0.0, abs=1.0)


def told(vehicle_of, jitter, seconds):
    """Of moments a second apart, each late by up to `jitter` s."""
    rng = random.Random(5)
    drift = ClockDrift()
    for wall in range(seconds + 1):
        drift.add_moment(10.0 + vehicle_of(wall) - rng.uniform(0.0, jitter), WALL + wall)
    return drift.bounds


@pytest.mark.parametrize("ppm", [-20_000.0, 0.0, 8_000.0])
@pytest.mark.parametrize(("jitter", "seconds"), [(0.0, 10), (0.01, 20), (0.05, 60), (0.5, 600)])
def test_bounds_hold_the_drift(ppm, jitter, seconds):
    low, high = told(lambda wall: wall * (1.0 + 1e-6 * ppm), jitter, seconds)
    assert low - 1e-3 <= ppm <= high + 1e-3
    assert high - low < 16e6 * jitter / seconds + 1e-3


UNEVEN = {
    "the receiving clock is set": lambda t: t + 0.5 * (t > 17),
    "it is set in the middle": lambda t: t - 1.0 * (t >= 20),
    "the link falls behind at first": lambda t: t - min(0.03 * t, 0.4),
    "a simulator is held up now and then": lambda t: t - 0.2 * (t // 12),
}


@pytest.mark.parametrize("what", UNEVEN)
def test_what_is_not_even_is_no_drift(what):
    low, high = told(UNEVEN[what], 0.0, 40)
    assert low < 0.0 < high


def test_bounds_of_a_few_moments_are_not_told():
    assert told(lambda wall: wall, 0.0, 9) is None
    drift = ClockDrift()
    for i in range(30):
        drift.add_moment(10.0 + i, WALL)  # a recorder without a clock
    assert drift.bounds is None


def test_blocks_of_moments_are_noted_as_one_by_one():
    rng = np.random.default_rng(6)
    wall = WALL + np.cumsum(rng.uniform(0.0, 0.4, 4000))
    wall[100:140] = wall[99]  # frames that came at once
    vehicle = 10.0 + 1.0001 * (wall - WALL)
    single, blocks = ClockDrift(), ClockDrift()
    for v, w in zip(vehicle.tolist(), wall.tolist(), strict=True):
        single.add_moment(v, w)
    for start, stop in ((0, 1), (1, 1), (1, 90), (90, 2500), (2500, 4000)):
        blocks.add_moments(vehicle[start:stop], wall[start:stop])
    assert blocks._moments == single._moments
    assert blocks.ppm == pytest.approx(100.0, abs=0.1)
    assert blocks.bounds == single.bounds
