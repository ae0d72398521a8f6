"""Which messages identification needs of an autopilot, and at which rates they fit a link."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from gcs_sysid.signals.samples import NEEDED_RATE
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frames import SIGNATURE
from gcs_sysid.telemetry.messages import MESSAGE_IDS
from gcs_sysid.telemetry.outgoing import MOST_OF_GROUP

USABLE = 0.92
"""Part of a serial link's bytes to plan with; the rest is for what the vehicle sends unasked."""
SPEEDS = {
    "px4": ("ESC_STATUS",),
    "ardupilot": (
        "ESC_TELEMETRY_1_TO_4",
        "ESC_TELEMETRY_5_TO_8",
        "ESC_TELEMETRY_9_TO_12",
        "ESC_TELEMETRY_13_TO_16",
    ),
}
"""Autopilot -> messages with measured rotor speeds, each for four rotors where there are more."""
COMMANDS = {"px4": "ACTUATOR_OUTPUT_STATUS", "ardupilot": "SERVO_OUTPUT_RAW"}
"""Autopilot -> the message with its actuator outputs."""

IMU = ("HIGHRES_IMU", "RAW_IMU")
"""Messages requested for IMU data; the second for ArduPilot before 4.6, which lacks the first."""


class MessageGroup(NamedTuple):
    """A group of messages as ArduPilot sets their rates together."""

    number: int
    """MAV_DATA_STREAM."""
    size: int
    """Bytes of all that comes with one round of it."""
    most: int
    """Hz; more adds nothing."""


GROUPS = {
    "RAW_IMU": MessageGroup(mavlink.MAV_DATA_STREAM_RAW_SENSORS, 160, MOST_OF_GROUP),
    "SERVO_OUTPUT_RAW": MessageGroup(mavlink.MAV_DATA_STREAM_RC_CHANNELS, 100, MOST_OF_GROUP),
    "ATTITUDE": MessageGroup(mavlink.MAV_DATA_STREAM_EXTRA1, 80, MOST_OF_GROUP),
    "GLOBAL_POSITION_INT": MessageGroup(mavlink.MAV_DATA_STREAM_POSITION, 80, 10),
}
"""Message that is needed -> the group of ArduPilot's that brings it."""
ESC_GROUP = MessageGroup(mavlink.MAV_DATA_STREAM_EXTRA3, 300, MOST_OF_GROUP)
"""The group with ESC_TELEMETRY, which brings much besides."""

LAST_ID_OF_VERSION_1 = 255
ARDUPILOT_LOOP_RATE = 400.0
"""Hz: SCHED_LOOP_RATE of a copter, unless it reports another."""
_ATTITUDE, _POSITION = 100.0, 50.0
"""Hz: more than these adds nothing."""

# Bytes of whole frames in version 2, as recorded from real autopilots: trailing zeros are cut.
_SIZES = {
    "HIGHRES_IMU": 74,
    "RAW_IMU": 41,
    "ATTITUDE": 40,
    "LOCAL_POSITION_NED": 40,
    "EXTENDED_SYS_STATE": 14,
    "ESC_STATUS": 69,
    "ACTUATOR_OUTPUT_STATUS": 88,
    "SERVO_OUTPUT_RAW": 49,
}
_ESC_TELEMETRY_SIZE = 56


def rotor_streams(
    autopilot: str, rotors: int, version: int = 2, outputs: Sequence[int] = ()
) -> tuple[tuple[str, ...], str]:
    """Names of the messages with measured speeds, and of the one with commands.

    Args:
        autopilot: "px4", "ardupilot"; any other is asked as PX4 is.
        rotors: how many the airframe has.
        version: of MAVLink; version 1 has no room for message numbers above 255.
        outputs: that drive its motors, from 0; empty while unknown: the first.
    """
    key = "ardupilot" if autopilot == "ardupilot" else "px4"
    speeds = SPEEDS[key]
    if key == "ardupilot":
        groups = {output // 4 for output in outputs or range(rotors)}
        speeds = tuple(name for i, name in enumerate(speeds) if i in groups)
    if version == 1:
        return tuple(n for n in speeds if MESSAGE_IDS[n] <= LAST_ID_OF_VERSION_1), (
            "SERVO_OUTPUT_RAW"
        )
    return speeds, COMMANDS[key]


def default_rates(rotor_messages: tuple[str, ...], rate: float) -> dict[str, float]:
    """Message name -> Hz to ask for, given the rate of IMU and rotors."""
    return {
        "HIGHRES_IMU": rate,
        **dict.fromkeys(rotor_messages, rate),
        "ATTITUDE": min(rate, _ATTITUDE),
        "LOCAL_POSITION_NED": min(rate, _POSITION),
        "EXTENDED_SYS_STATE": min(rate, 2.0),
    }


def bytes_per_second(rates: Mapping[str, float], rotors: int, signed: bool = False) -> float:
    """Bytes a second that messages at these rates take on the wire."""
    total = 0.0
    for name, hz in rates.items():
        size = _SIZES.get(name, _ESC_TELEMETRY_SIZE) + SIGNATURE * signed
        frames = -(-rotors // 4) if name == "ESC_STATUS" else 1
        total += size * frames * hz
    return total


def fitting_rates(
    rotor_messages: tuple[str, ...],
    rate: float,
    rotors: int,
    capacity: float | None,
    signed: bool = False,
) -> dict[str, float]:
    """`default_rates`, lowered to what a link carries.

    Args:
        rotor_messages: names.
        rate: Hz wished for IMU and rotors.
        rotors: how many the airframe has.
        capacity: bytes a second; None for a link without a known limit.
        signed: whether frames carry a signature.

    Returns:
        Message name -> Hz. IMU and rotors share one rate, of at least 1 Hz.
    """
    rates = default_rates(rotor_messages, rate)
    if capacity is None or bytes_per_second(rates, rotors, signed) <= capacity:
        return rates
    # Attitude and position keep their share of the full rates: they are the cheap part to thin.
    low = int(rate)
    while low > 1:
        rates = default_rates(rotor_messages, float(low))
        rates["ATTITUDE"] = min(max(0.4 * low, 10.0), rates["ATTITUDE"])
        rates["LOCAL_POSITION_NED"] = min(max(0.2 * low, 5.0), rates["LOCAL_POSITION_NED"])
        if bytes_per_second(rates, rotors, signed) <= capacity:
            return rates
        low -= 1
    return default_rates(rotor_messages, 1.0)


def fitting_groups(speeds: str | None, rate: float, capacity: float | None) -> dict[str, float]:
    """Whole Hz to request ArduPilot's groups at, by the message that each is requested for.

    Args:
        speeds: the message with rotor speeds, where the vehicle has any.
        rate: Hz wished for IMU and rotors.
        capacity: bytes a second; None for a link without a known limit.
    """
    groups = GROUPS if speeds is None else {**GROUPS, speeds: ESC_GROUP}
    low = max(round(min(rate, MOST_OF_GROUP)), 1)
    while True:
        rates = {name: float(min(low, group.most)) for name, group in groups.items()}
        total = sum(rates[name] * group.size for name, group in groups.items())
        if low == 1 or capacity is None or total <= capacity:
            return rates
        low -= 1


def interval_us(autopilot: str, hertz: float, loop_rate: float | None = None) -> int:
    """What to ask for in SET_MESSAGE_INTERVAL, us, so that it is sent evenly.

    ArduPilot knows whole milliseconds and sends once a turn of its main loop: asked for 4 ms, a
    loop of 400 Hz alternates between 2.5 and 5 ms. So it is asked for the shortest interval not
    below the one wished for that is a whole number both of milliseconds and of turns.

    Args:
        autopilot: "px4", "ardupilot", ...
        hertz: wished for.
        loop_rate: ArduPilot's SCHED_LOOP_RATE, Hz; None: not known.
    """
    if autopilot != "ardupilot":
        return round(1e6 / hertz)
    loop = loop_rate if loop_rate and 50.0 <= loop_rate <= 10_000.0 else ARDUPILOT_LOOP_RATE
    # ArduPilot sends nothing faster than at 0.8 of its loop rate.
    shortest = max(1e3 / hertz, 1e3 / (0.8 * loop))
    # A loop whose turns fit into no fewer whole ms has no even rate of use.
    for step in range(1, 21):
        if (step * loop) % 1e3 < 1e-6:
            return 1000 * step * math.ceil(shortest / step - 1e-9)
    return 1000 * math.ceil(shortest - 1e-9)


def too_slow(what: str, hertz: float, needed: float = NEEDED_RATE) -> str:
    """The line for a link that cannot carry what identification needs."""
    return (
        f"{what} about {hertz:.0f} Hz of IMU and rotor data; identification needs {needed:.0f} Hz "
        "or more: use a faster link (460800 baud, USB, WiFi) or analyze the vehicle's own log"
    )
