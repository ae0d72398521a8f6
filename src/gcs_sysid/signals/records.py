"""Telemetry records, what a vehicle measured freed of how it was sent; and aligned samples of them.

Records are the border between the telemetry side (which makes them from MAVLink messages or log
entries) and the session's chain (which knows nothing of MAVLink). `Samples`, on a uniform grid, are
what estimators take. All values are SI, all axes body FRD or world NED, all times the vehicle's own
clock.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from gcs_sysid.arrays import Array, Mask
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


NEEDED_RATE = 50.0
"""Hz of IMU and rotor data below which identification from real flights is not possible."""


@dataclass(frozen=True)
class Samples:
    """Aligned signals on the uniform grid; NaN marks what is missing or must not be used.

    Attributes:
        gyro: (n, 3) as measured, rad/s.
        rates: (n, 3) without bias, rad/s.
        speeds: (n, rotors) rad/s; or commands, 0 to 1, where those are the input.
        attitude: (n, 4) body to world.
        force: (n, 3) specific force, m/s^2.
        velocity: (n, 3) north, east, down, m/s.
        apart: (n, 1) s between the samples of two streams of commands whose mean `speeds` holds;
            NaN where there is one, the default.
        voltage: (n, 1) of the battery, V; NaN where not reported, the default.
        setpoint: (n, 3) rad/s, commanded body rates; NaN where not reported.
    """

    gyro: Array
    rates: Array
    speeds: Array
    attitude: Array
    force: Array
    velocity: Array
    apart: Array = field(default_factory=lambda: np.empty((0, 1)))
    voltage: Array = field(default_factory=lambda: np.empty((0, 1)))
    setpoint: Array = field(default_factory=lambda: np.empty((0, 3)))

    def __post_init__(self) -> None:
        n = len(self.gyro)
        for name, width in (("apart", 1), ("voltage", 1), ("setpoint", 3)):
            if n and not len(getattr(self, name)):
                object.__setattr__(self, name, np.full((n, width), np.nan))

    @property
    def signals(self) -> tuple[Array, ...]:
        """Those that estimates use as they arrive, in order: all but setpoints."""
        return (
            self.gyro, self.rates, self.speeds, self.attitude, self.force, self.velocity,
            self.apart, self.voltage,
        )  # fmt: skip

    def part(self, where: slice | Mask) -> "Samples":
        """Some of the samples."""
        return Samples(*(signal[where] for signal in (*self.signals, self.setpoint)))

    @property
    def gap(self) -> "Samples":
        """One missing sample."""
        every = (*self.signals, self.setpoint)
        return Samples(*(np.full_like(signal[:1], np.nan) for signal in every))

    @staticmethod
    def joined(parts: Sequence["Samples"]) -> "Samples":
        """One block of many, at least one."""
        signals = zip(*((*part.signals, part.setpoint) for part in parts), strict=True)
        return Samples(*(np.concatenate(signal) for signal in signals))
