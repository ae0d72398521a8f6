"""The vehicle's clock: wraps, reboots, doubt, and its drift against the wall clock."""

import random

import pytest

from gcs_sysid.telemetry.clock import ClockDrift, VehicleClock

WRAP_US = 2**32
WALL = 1.75e9


def test_microseconds_of_32_bits_go_on_over_two_wraps():
    clock = VehicleClock()
    for second in range(4000, 9000, 5):
        clock.stamp_us64(second * 1_000_000)
        wrapped = second * 1_000_000 % WRAP_US
        assert clock.stamp_us32(wrapped) == pytest.approx(second, abs=1e-6)
    assert clock.reboots == 0


def test_the_sender_of_32_bit_stamps_may_be_ahead_of_the_clock_at_the_wrap():
    clock = VehicleClock()
    wrap = WRAP_US * 1e-6
    clock.stamp_us64(WRAP_US - 1000)
    assert clock.stamp_us32(1000) == pytest.approx(wrap + 1e-3)
    clock.stamp_us64(WRAP_US + 2000)
    assert clock.stamp_us32(WRAP_US - 500) == pytest.approx(wrap - 5e-4)


def test_a_reboot_after_a_wrap_begins_at_zero_again():
    clock = VehicleClock()
    clock.stamp_us64(5000 * 1_000_000)
    for t in (1.0, 1.1):
        clock.stamp_us64(round(t * 1e6))
    assert clock.reboots == 1
    assert clock.stamp_us32(1_200_000) == pytest.approx(1.2)


def test_milliseconds_that_wrap_are_no_reboot():
    clock = VehicleClock()
    for ms in range(2**32 - 3000, 2**32 + 3000, 100):
        assert clock.stamp_ms32(ms % 2**32 or 1) is not None
    assert clock.reboots == 0
    assert clock.now == pytest.approx((2**32 + 2900) * 1e-3)


@pytest.mark.parametrize("ppm", [-25_000.0, -300.0, 0.0, 40.0, 8_000.0])
def test_drift_is_told_through_jitter_and_wrong_stamps(ppm):
    rng = random.Random(4)
    drift = ClockDrift()
    for i in range(40_000):
        vehicle = 10.0 + 0.01 * i
        wall = WALL + vehicle / (1.0 + 1e-6 * ppm) + rng.expovariate(200.0)
        if rng.random() < 0.001:
            wall += rng.uniform(-1e6, 1e6)
        drift.take(vehicle, wall)
    # 5 ms of jitter over 200 s.
    assert drift.ppm == pytest.approx(ppm, abs=10.0)


def test_drift_takes_bounded_memory_and_no_short_stretch():
    drift = ClockDrift()
    drift.take(1.0, WALL)
    drift.take(11.0, WALL + 10.0)
    assert drift.ppm is None
    for i in range(20_000):
        drift.take(11.0 + i, WALL + 10.0 + 0.5 * i)
    assert len(drift._moments) <= drift.MOST
    assert drift.ppm == pytest.approx(1e6, rel=0.01)


def test_drift_begins_anew_on_a_reboot():
    drift = ClockDrift()
    for i in range(100):
        drift.take(1000.0 + 2.0 * i, WALL + i)
    for i in range(100):
        drift.take(1.0 + i, WALL + 200.0 + i)
    assert drift.ppm == pytest.approx(0.0, abs=1.0)


def told(vehicle_of, jitter, seconds):
    """Of moments a second apart, each late by up to `jitter` s."""
    rng = random.Random(5)
    drift = ClockDrift()
    for wall in range(seconds + 1):
        drift.take(10.0 + vehicle_of(wall) - rng.uniform(0.0, jitter), WALL + wall)
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
        drift.take(10.0 + i, WALL)  # a recorder without a clock
    assert drift.bounds is None
