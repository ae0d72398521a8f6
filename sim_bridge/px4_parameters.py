"""The few parameters an emulated PX4 shows."""

import math

from sim_bridge.simulated_vehicle import Vehicle
from sim_bridge.vehicle_parameters import INT32, REAL32, Parameter


def px4_parameters(vehicle: Vehicle, sysid: int) -> list[Parameter]:
    """The parameters, sorted by name as PX4 sends them.

    None of them reveals a true value: neither mass nor inertia nor thrust is in here.
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
    tilt = vehicle.traits.tilt if vehicle.traits is not None else 0.0
    for i, rotor in enumerate(vehicle.rotors):
        if tilt:
            side = rotor.spin * math.sin(tilt) / (math.hypot(rotor.x, rotor.y) or 1.0)
            table[f"CA_ROTOR{i}_AX"] = -side * rotor.y
            table[f"CA_ROTOR{i}_AY"] = side * rotor.x
            table[f"CA_ROTOR{i}_AZ"] = -math.cos(tilt)
        table[f"PWM_MAIN_FUNC{i + 1}"] = 101 + i
        table |= {f"PWM_MAIN_MIN{i + 1}": 1000, f"PWM_MAIN_MAX{i + 1}": 2000}
        table[f"CA_ROTOR{i}_PX"] = rotor.x
        table[f"CA_ROTOR{i}_PY"] = rotor.y
        # PX4's moment ratio: positive for counter-clockwise; the number is its default.
        table[f"CA_ROTOR{i}_KM"] = 0.05 * rotor.spin
    return [
        Parameter(name, value, INT32 if isinstance(value, int) else REAL32, bytewise=True)
        for name, value in sorted(table.items())
    ]
