"""The few parameters an emulated PX4 shows."""

import struct
from dataclasses import dataclass

from gcs_sysid.telemetry.dialect import mavlink
from sim_bridge.vehicle import Vehicle


@dataclass
class Parameter:
    """One parameter: PX4 knows int32 and float.

    Attributes:
        name: at most 16 characters.
        value: int or float; its type is the parameter's type.
    """

    name: str
    value: int | float

    @property
    def kind(self) -> int:
        """MAV_PARAM_TYPE."""
        whole = isinstance(self.value, int)
        return int(mavlink.MAV_PARAM_TYPE_INT32 if whole else mavlink.MAV_PARAM_TYPE_REAL32)

    @property
    def wire(self) -> float:
        """As PARAM_VALUE's float field: PX4 copies the bytes of an int32 there."""
        if isinstance(self.value, int):
            (wire,) = struct.unpack("<f", struct.pack("<i", self.value))
            return float(wire)
        return self.value

    def set(self, wire: float) -> None:
        """Take a value as PARAM_SET carries it."""
        if isinstance(self.value, int):
            (self.value,) = struct.unpack("<i", struct.pack("<f", wire))
        else:
            self.value = wire


def parameter_table(vehicle: Vehicle, sysid: int) -> list[Parameter]:
    """The parameters, sorted by name as PX4 sends them.

    None of them tells a true value: neither mass nor inertia nor thrust is in here.
    """
    n = len(vehicle.rotors)
    types = {4: 2, 6: 13, 8: 14}
    table: dict[str, int | float] = {
        "BAT1_N_CELLS": 4,
        "CA_AIRFRAME": 0,
        "CA_ROTOR_COUNT": n,
        "COM_RC_IN_MODE": 4,
        "IMU_GYRO_CUTOFF": 0.0,
        "IMU_GYRO_RATEMAX": 1000,
        "MAV_COMP_ID": 1,
        "MAV_PROTO_VER": 2,
        "MAV_SYS_ID": sysid,
        "MAV_TYPE": types.get(n, 43),
        "SYS_AUTOSTART": 6001 if n == 6 else 4001,
        "SYS_HITL": 0,
        "THR_MDL_FAC": 0.0,
    }
    for i, rotor in enumerate(vehicle.rotors):
        table[f"CA_ROTOR{i}_PX"] = rotor.x
        table[f"CA_ROTOR{i}_PY"] = rotor.y
        # PX4's moment ratio: positive for counter-clockwise; the number is its default.
        table[f"CA_ROTOR{i}_KM"] = 0.05 * rotor.spin
    return [Parameter(name, value) for name, value in sorted(table.items())]
