"""Which messages are needed, and at which rates they fit."""

import pytest

from gcs_sysid.telemetry.messages import MESSAGE_IDS
from gcs_sysid.telemetry.wanted_streams import (
    bytes_per_second,
    default_rates,
    fitting_rates,
    interval_us,
    rotor_streams,
)

PX4 = ("ESC_STATUS", "ACTUATOR_OUTPUT_STATUS")


@pytest.mark.parametrize(
    ("rotors", "groups"), [(3, 1), (4, 1), (6, 2), (8, 2), (12, 3), (16, 4), (20, 4)]
)
def test_ardupilot_reports_speeds_in_groups_of_four(rotors, groups):
    speeds, commands = rotor_streams("ardupilot", rotors)
    assert len(speeds) == groups
    assert commands == "SERVO_OUTPUT_RAW"


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot", "generic", ""])
def test_version_1_is_asked_for_nothing_that_it_cannot_number(autopilot):
    speeds, commands = rotor_streams(autopilot, 8, version=1)
    assert all(MESSAGE_IDS[name] < 256 for name in (*speeds, commands))


@pytest.mark.parametrize("capacity", [700.0, 1200.0, 5184.0, 10368.0, 41472.0, 60000.0])
@pytest.mark.parametrize("rotors", [4, 8])
@pytest.mark.parametrize("signed", [False, True])
def test_what_is_asked_for_fits_and_uses_the_room(capacity, rotors, signed):
    rates = fitting_rates(PX4, 250.0, rotors, capacity, signed)
    used = bytes_per_second(rates, rotors, signed)
    assert used <= capacity
    more = default_rates(PX4, rates["HIGHRES_IMU"] + 3.0)
    assert rates["HIGHRES_IMU"] == 250.0 or bytes_per_second(more, rotors, signed) > capacity


@pytest.mark.parametrize(
    ("autopilot", "hertz", "interval"),
    [
        ("px4", 250.0, 4000),
        ("px4", 300.0, 3333),
        ("ardupilot", 200.0, 5000),
        ("ardupilot", 250.0, 5000),
        ("ardupilot", 300.0, 5000),
        ("ardupilot", 60.0, 20000),
        ("ardupilot", 2.0, 500_000),
        ("ardupilot", 1000.0, 5000),
    ],
)
def test_intervals_suit_the_autopilot(autopilot, hertz, interval):
    assert interval_us(autopilot, hertz) == interval


@pytest.mark.parametrize(
    ("loop", "interval"),
    [
        *((400.0, 5000), (500.0, 4000), (1000.0, 4000), (800.0, 5000)),
        *((250.0, 8000), (200.0, 10_000)),
        *((300.0, 10_000), (333.0, 4000)),  # without an even rate: the next slower one
    ],
)
def test_ardupilot_is_asked_for_whole_turns_of_its_loop(loop, interval):
    assert interval_us("ardupilot", 250.0, loop) == interval
