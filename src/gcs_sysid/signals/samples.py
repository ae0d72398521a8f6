"""Aligned signals on a uniform grid: what estimators take."""

from dataclasses import dataclass, field

import numpy as np

from gcs_sysid.arrays import Array, Mask

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
