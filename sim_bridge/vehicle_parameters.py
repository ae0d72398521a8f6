"""Parameters of an emulated autopilot, and the two ways in which PARAM_VALUE carries them."""

import struct
from dataclasses import dataclass

from gcs_sysid.telemetry.dialect import mavlink

REAL32: int = mavlink.MAV_PARAM_TYPE_REAL32
INT8: int = mavlink.MAV_PARAM_TYPE_INT8
INT16: int = mavlink.MAV_PARAM_TYPE_INT16
INT32: int = mavlink.MAV_PARAM_TYPE_INT32


@dataclass
class Parameter:
    """One parameter.

    Attributes:
        name: at most 16 characters.
        value: int or float, as its kind has it.
        kind: MAV_PARAM_TYPE.
        bytewise: whether whole numbers travel as their bytes in the float field (PX4) or as the
            float nearest to them (ArduPilot).
    """

    name: str
    value: int | float
    kind: int
    bytewise: bool

    @property
    def wire(self) -> float:
        """As PARAM_VALUE's float field."""
        return self.encoded(self.value)

    def encoded(self, value: float) -> float:
        """A value of this parameter as the float field of PARAM_VALUE and PARAM_SET."""
        if self.kind == REAL32 or not self.bytewise:
            return float(value)
        (wire,) = struct.unpack("<f", struct.pack("<i", round(value)))
        return float(wire)

    def set(self, wire: float) -> None:
        """Take a value as PARAM_SET carries it."""
        if self.kind == REAL32:
            self.value = wire
        elif self.bytewise:
            (self.value,) = struct.unpack("<i", struct.pack("<f", wire))
        elif abs(wire) < 2**31:  # not for NaN either
            self.value = round(wire)
