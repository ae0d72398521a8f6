"""Telemetry records: what a vehicle measured, freed of how it was sent.

This is the border between the telemetry side (which makes records from MAVLink
messages or log entries) and the session's chain (which knows nothing of MAVLink).
All values are SI, all axes body FRD or world NED, all times the vehicle's own clock.
"""

from enum import StrEnum
from typing import NamedTuple

from gcs_sysid.model.rotor_input import RotorInput


class Stream(StrEnum):
    """The kinds of record, each with the layout of its `values`."""

    IMU = "imu"
    """gyro x, y, z (rad/s), specific force x, y, z (m/s^2)."""
    ATTITUDE = "attitude"
    """unit quaternion w, x, y, z, body to world."""
    ROTOR_SPEED = "rotor_speed"
    """measured speed of each rotor (rad/s), in the autopilot's motor order from `offset` on."""
    ROTOR_COMMAND = "rotor_command"
    """actuator outputs in the autopilot's own unit, in motor order from `offset` on."""
    VELOCITY = "velocity"
    """north, east, down velocity (m/s), then north, east, down position (m)."""
    RATE_SETPOINT = "rate_setpoint"
    """roll, pitch and yaw rate (rad/s) that the autopilot asks of its rate loop."""
    IN_AIR = "in_air"
    """1.0 while the autopilot says that it flies, else 0.0."""
    ARMED = "armed"
    """1.0 while armed, else 0.0 (from HEARTBEAT, stamped with the last time received)."""
    VOLTAGE = "voltage"
    """of the battery under load (V)."""
    PARAMETER = "parameter"
    """value of the autopilot's parameter that `source` names; a fact, not a sample: its time is
    that of reception (0.0 before any clock), and it is not put on a time base."""


ROTOR_STREAMS = {
    Stream.ROTOR_SPEED: RotorInput.SPEED, Stream.ROTOR_COMMAND: RotorInput.COMMAND,
}  # fmt: skip
"""Streams of the rotors, and what they hold."""


class Record(NamedTuple):
    """One sample of one stream.

    Attributes:
        stream: what the values are.
        t: time in seconds on the vehicle's clock.
        values: the numbers, laid out as `Stream` says.
        offset: index of the first rotor that `values` holds (rotor streams only).
        source: rotor streams: name of the message that it comes from, since sources of one
            kind differ in unit, delay and soundness, and are never mixed. Parameters: their
            name. Else empty.
    """

    stream: Stream
    t: float
    values: tuple[float, ...]
    offset: int = 0
    source: str = ""
