"""What real autopilots and links do to those who read them, each to be switched on by its name.

`Traps` says which are set; the parts of the emulator that they concern look there.
"""

import argparse
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.usage import not_negative, positive


@dataclass(frozen=True)
class Traps:
    """Traps in force; none by default. `KINDS` says what each does; times here are in s."""

    rpm_zero: bool = False
    rpm_dead: int = 0
    rpm_repeats: float = 0.0
    rpm_rad: bool = False
    rpm_command: bool = False
    rpm_signed: bool = False
    quaternion_flips: float = 0.0
    gyro_outliers: float = 0.0
    imu_frozen: float = 0.0
    gyro_average: float = 0.0
    accelerometer_bias: float = 0.0
    rotor_late: float = 0.0
    imu_late: float = 0.0
    attitude_late: float = 0.0
    skips: float = 0.0
    disorder: float = 0.0
    wrap_us: float = 0.0
    wrap_ms: float = 0.0
    clock_drift: float = 0.0
    reboot: float = 0.0
    rate_reset: float = 0.0
    never_sent: tuple[int, ...] = ()
    groups_only: bool = False
    active_count: int = 0
    ground: float = 0.0
    flights: int = 1
    forwarded: bool = False
    radio: bool = False


NO_TRAPS = Traps()


def _share(text: str) -> float:
    value = not_negative(text)
    if value > 1.0:
        raise argparse.ArgumentTypeError(f"must be a share from 0 to 1, got {text!r}")
    return value


def _milliseconds(text: str) -> float:
    value = not_negative(text)
    if value > 1000.0:
        raise argparse.ArgumentTypeError(f"must be 0 to 1000 ms, got {text!r}")
    return 1e-3 * value


def _whole(most: int) -> Callable[[str], int]:
    def parse(text: str) -> int:
        if not text.isdecimal() or not 0 < int(text) <= most:
            raise argparse.ArgumentTypeError(f"must be a whole number 1..{most}, got {text!r}")
        return int(text)

    return parse


def _ppm(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 1e9
    if not abs(value) <= 1e5:
        raise argparse.ArgumentTypeError(f"must be -100000 to 100000 ppm, got {text!r}")
    return value


def message_number(text: str) -> int:
    """The number of a message, from its name in the dialect."""
    number = getattr(mavlink, f"MAVLINK_MSG_ID_{text}", None)
    if not isinstance(number, int):
        raise argparse.ArgumentTypeError(f"no message {text!r} in the dialect")
    return number


def _message(text: str) -> tuple[int, ...]:
    return (message_number(text),)


@dataclass(frozen=True)
class Kind:
    """How a trap is written.

    Attributes:
        says: what it does.
        parse: makes its value of the text after the =; None for a trap without one.
        unit: of the value, as help shows it.
        usual: the text taken when none is given; None when one must be.
    """

    says: str
    parse: Callable[[str], Any] | None = None
    unit: str = ""
    usual: str | None = None


KINDS: dict[str, Kind] = {
    "rpm-zero": Kind("rotor speeds read 0 for ever"),
    "rpm-dead": Kind("the ESC of this motor (from 1) is silent: 0", _whole(32), "MOTOR", "1"),
    "rpm-repeats": Kind(
        "share of rotor-speed messages that repeat the last under a fresh stamp",
        _share,
        "SHARE",
        "0.03",
    ),
    "rpm-rad": Kind("rad/s in the rpm field"),
    "rpm-command": Kind("commanded speeds sold as measured ones"),
    "rpm-signed": Kind("negative rpm from rotors that turn clockwise"),
    "quaternion-flips": Kind(
        "share of quaternions sent with all signs turned", _share, "SHARE", "0.2"
    ),
    "gyro-outliers": Kind(
        "share of IMU samples with a spike on one gyro axis", _share, "SHARE", "0.002"
    ),
    "imu-frozen": Kind(
        "share of IMU samples that repeat the last under a fresh stamp", _share, "SHARE", "0.02"
    ),
    "gyro-average": Kind(
        "gyro and accelerometer averaged over so long, stamped at the END as PX4 does",
        _milliseconds,
        "MS",
        "4",
    ),
    "accelerometer-bias": Kind("accelerometer bias on every axis", not_negative, "M/S2", "0.2"),
    "rotor-late": Kind(
        "rotor speeds and commands older than their stamp", _milliseconds, "MS", "10"
    ),
    "imu-late": Kind("gyro and accelerometer older than their stamp", _milliseconds, "MS", "10"),
    "attitude-late": Kind("attitude older than its stamp", _milliseconds, "MS", "10"),
    "skips": Kind(
        "messages never sent, without a gap in the sequence numbers", _share, "SHARE", "0.01"
    ),
    "disorder": Kind(
        "share of frames sent after the one that follows them", _share, "SHARE", "0.05"
    ),
    "wrap-us": Kind("32-bit stamps in us wrap so long after the start", positive, "S", "10"),
    "wrap-ms": Kind(
        "32-bit stamps in ms wrap so long after the start, and those in us with them",
        positive,
        "S",
        "10",
    ),
    "clock-drift": Kind("the vehicle's clock runs fast by so much", _ppm, "PPM", "8000"),
    "reboot": Kind("the autopilot restarts so long after the start", positive, "S"),
    "rate-reset": Kind(
        "another ground station resets the rates so long after the start", positive, "S"
    ),
    "never-sent": Kind(
        "this message is acknowledged and never comes; may be given again", _message, "MESSAGE"
    ),
    "groups-only": Kind(
        "ArduPilot before 4.0: no SET_MESSAGE_INTERVAL, no HIGHRES_IMU, groups at 50 Hz at most"
    ),
    "active-count": Kind(
        "ACTUATOR_OUTPUT_STATUS counts outputs that drive nothing, too", _whole(32), "N", "16"
    ),
    "ground": Kind("on the ground, disarmed, before and after each flight", positive, "S", "10"),
    "flights": Kind(
        "flights one after the other, with a stay on the ground between", _whole(100), "N", "2"
    ),
    "forwarded": Kind("a second vehicle's messages come along"),
    "radio": Kind("a telemetry radio's messages come along"),
}
"""Every trap by its name on the command line."""


def parse_trap(text: str) -> tuple[str, Any]:
    """The field of `Traps` and its value, for NAME or NAME=VALUE.

    Raises:
        argparse.ArgumentTypeError: no such trap, or its value makes no sense.
    """
    name, equals, value = text.partition("=")
    kind = KINDS.get(name)
    if kind is None:
        raise argparse.ArgumentTypeError(f"no trap {name!r}; there are {', '.join(KINDS)}")
    field = name.replace("-", "_")
    if kind.parse is None:
        if equals:
            raise argparse.ArgumentTypeError(f"{name} takes no value")
        return field, True
    if not equals and kind.usual is None:
        raise argparse.ArgumentTypeError(f"write {name}={kind.unit}")
    try:
        return field, kind.parse(value if equals else kind.usual or "")
    except argparse.ArgumentTypeError as error:
        raise argparse.ArgumentTypeError(f"{name}: {error}") from error


def make_traps(parsed: Iterable[tuple[str, Any]]) -> Traps:
    """All of them together; messages that are never sent add up."""
    traps = NO_TRAPS
    for field, value in parsed:
        if isinstance(value, tuple):
            value = getattr(traps, field) + value
        traps = replace(traps, **{field: value})
    return traps


def trap_help() -> str:
    """One line a trap, for --help."""
    lines = []
    for name, kind in KINDS.items():
        value = f"={kind.unit}" if kind.unit and kind.usual is None else f"[={kind.unit}]"
        usual = f" ({kind.usual})" if kind.usual else ""
        lines.append(f"  {name + value if kind.unit else name:<26} {kind.says}{usual}")
    return "\n".join(lines)
