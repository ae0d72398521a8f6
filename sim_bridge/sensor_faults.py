"""What real autopilots and links do to those who read them, each to be switched on by its name.

`SensorFaults` says which are set; the parts of the emulator that they concern look there.
"""

import argparse
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from gcs_sysid.argument_types import between, not_negative
from sim_bridge.choices import (
    Kind,
    Span,
    choice_help,
    gather,
    message_number,
    milliseconds,
    moment,
    parse_choice,
    seconds,
    share,
    span,
    two,
    whole,
)


@dataclass(frozen=True)
class SensorFaults:
    """SensorFaults in force; none by default. `KINDS` says what each does; times here are in s."""

    rpm_zero: bool = False
    rpm_dead: int = 0
    rpm_repeats: float = 0.0
    rpm_rad: bool = False
    rpm_command: bool = False
    rpm_signed: bool = False
    rpm_stuck: Span | None = None
    rpm_spikes: float = 0.0
    esc_silent: tuple[int, float] = (0, 0.0)
    quaternion_flips: float = 0.0
    gyro_outliers: float = 0.0
    accelerometer_outliers: float = 0.0
    attitude_outliers: float = 0.0
    imu_frozen: float = 0.0
    imu_nan: Span | None = None
    imu_stuck: Span | None = None
    gyro_average: float = 0.0
    accelerometer_bias: float = 0.0
    thrust_pressure: float = 0.0
    attitude_nan: Span | None = None
    attitude_stuck: Span | None = None
    rotor_late: float = 0.0
    imu_late: float = 0.0
    attitude_late: float = 0.0
    skips: float = 0.0
    disorder: float = 0.0
    wrap_us: float = 0.0
    wrap_ms: float = 0.0
    clock_drift: float = 0.0
    clock_jump: tuple[float, float] = (0.0, 0.0)
    reboot: float = 0.0
    rate_reset: float = 0.0
    never_sent: tuple[int, ...] = ()
    groups_only: bool = False
    active_count: int = 0
    ground: float = 0.0
    flights: int = 1
    forwarded: bool = False
    radio: bool = False


NO_SENSOR_FAULTS = SensorFaults()


def _ppm(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 1e9
    if not abs(value) <= 1e5:
        raise argparse.ArgumentTypeError(f"must be -100000 to 100000 ppm, got {text!r}")
    return value


def _message(text: str) -> tuple[int, ...]:
    return (message_number(text),)


KINDS: dict[str, Kind] = {
    "rpm-zero": Kind("rotor speeds always read 0"),
    "rpm-dead": Kind("the ESC of this motor (from 1) is silent: 0", whole(32), "MOTOR", "1"),
    "rpm-repeats": Kind(
        "share of rotor-speed messages that repeat the last under a new timestamp",
        share,
        "SHARE",
        "0.03",
    ),
    "rpm-rad": Kind("rad/s in the rpm field"),
    "rpm-command": Kind("commanded speeds reported as measured"),
    "rpm-signed": Kind("negative rpm from rotors that turn clockwise"),
    "rpm-stuck": Kind("rotor speeds freeze, duration", span, "FROM:S[:EVERY]"),
    "rpm-spikes": Kind(
        "share of rotor-speed messages with a wild value on one rotor", share, "SHARE", "0.005"
    ),
    "esc-silent": Kind(
        "the ESC of this motor falls silent: 0 from then on",
        two(whole(32), not_negative, "MOTOR:FROM"),
        "MOTOR:FROM",
    ),
    "quaternion-flips": Kind(
        "share of quaternions sent with all signs flipped", share, "SHARE", "0.2"
    ),
    "gyro-outliers": Kind(
        "share of IMU samples with a spike on one gyro axis", share, "SHARE", "0.002"
    ),
    "accelerometer-outliers": Kind(
        "share of IMU samples with a spike on one axis of the accelerometer",
        share,
        "SHARE",
        "0.002",
    ),
    "attitude-outliers": Kind(
        "share of attitudes off by half a radian or more", share, "SHARE", "0.002"
    ),
    "imu-frozen": Kind(
        "share of IMU samples that repeat the last under a new timestamp", share, "SHARE", "0.02"
    ),
    "imu-nan": Kind("gyro and accelerometer read NaN, duration", span, "FROM:S[:EVERY]"),
    "imu-stuck": Kind("gyro and accelerometer freeze, duration", span, "FROM:S[:EVERY]"),
    "gyro-average": Kind(
        "gyro and accelerometer averaged over this time, stamped at the END as PX4 does",
        milliseconds,
        "MS",
        "4",
    ),
    "accelerometer-bias": Kind(
        "accelerometer bias on every axis", between(0.0, 1000.0, "m/s^2"), "M/S2", "0.2"
    ),
    "thrust-pressure": Kind(
        "noise of 1 Pa, and what the barometer reads at full thrust besides",
        between(-1000.0, 1000.0, "Pa"),
        "PA",
        "-150",
    ),
    "attitude-nan": Kind("attitude reads NaN, duration", span, "FROM:S[:EVERY]"),
    "attitude-stuck": Kind("attitude freezes, duration", span, "FROM:S[:EVERY]"),
    "rotor-late": Kind(
        "rotor speeds and commands older than their timestamp", milliseconds, "MS", "10"
    ),
    "imu-late": Kind("gyro and accelerometer older than their timestamp", milliseconds, "MS", "10"),
    "attitude-late": Kind("attitude older than its timestamp", milliseconds, "MS", "10"),
    "skips": Kind(
        "messages never sent, without a gap in the sequence numbers", share, "SHARE", "0.01"
    ),
    "disorder": Kind("share of frames swapped with the next one", share, "SHARE", "0.05"),
    "wrap-us": Kind("32-bit timestamps in us wrap, time after the start", moment, "S", "10"),
    "wrap-ms": Kind(
        "32-bit timestamps in ms wrap, and those in us with them, time after the start",
        moment,
        "S",
        "10",
    ),
    "clock-drift": Kind("the vehicle's clock runs fast", _ppm, "PPM", "8000"),
    "clock-jump": Kind(
        "the vehicle's clock is set ahead or back",
        two(moment, seconds, "FROM:S"),
        "FROM:S",
    ),
    "reboot": Kind("the autopilot restarts, time after the start", moment, "S"),
    "rate-reset": Kind(
        "another ground station resets the rates, time after the start", moment, "S"
    ),
    "never-sent": Kind(
        "requests for this message are acknowledged, but it is never sent; may be repeated",
        _message,
        "MESSAGE",
    ),
    "groups-only": Kind(
        "ArduPilot before 4.0: no SET_MESSAGE_INTERVAL, no HIGHRES_IMU, groups at 50 Hz at most"
    ),
    "active-count": Kind("ACTUATOR_OUTPUT_STATUS counts unused outputs too", whole(32), "N", "16"),
    "ground": Kind("on the ground, disarmed, before and after each flight", moment, "S", "10"),
    "flights": Kind("flights in sequence, with ground time in between", whole(100), "N", "2"),
    "forwarded": Kind("messages of a second vehicle"),
    "radio": Kind("messages of a telemetry radio"),
}
"""Every trap by its name on the command line."""


def parse_sensor_fault(text: str) -> tuple[str, Any]:
    """The field of `SensorFaults` and its value, for NAME or NAME=VALUE.

    Raises:
        argparse.ArgumentTypeError: no such trap, or its value makes no sense.
    """
    return parse_choice(text, KINDS, "trap")


def make_sensor_faults(parsed: Iterable[tuple[str, Any]]) -> SensorFaults:
    """All of them together; messages that are never sent add up."""
    return gather(NO_SENSOR_FAULTS, parsed, frozenset({"never_sent"}))


def sensor_fault_help() -> str:
    """One line a trap, for --help."""
    return choice_help(KINDS)
