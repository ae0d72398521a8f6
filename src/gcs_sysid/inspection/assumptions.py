"""What is assumed of a vehicle whose airframe nobody named."""

import math

from gcs_sysid.model.airframe import Airframe, Rotor
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.vehicles import Vehicle

USUAL = 4
"""Rotors of a vehicle whose type does not tell."""

_ROTORS = {
    mavlink.MAV_TYPE_TRICOPTER: 3,
    mavlink.MAV_TYPE_QUADROTOR: 4,
    mavlink.MAV_TYPE_HEXAROTOR: 6,
    mavlink.MAV_TYPE_OCTOROTOR: 8,
    mavlink.MAV_TYPE_DECAROTOR: 10,
    mavlink.MAV_TYPE_DODECAROTOR: 12,
}


def rotor_count(vehicle: Vehicle | None) -> int | None:
    """How many rotors a vehicle has by its type; None when that does not tell."""
    return None if vehicle is None else _ROTORS.get(vehicle.vehicle_type or -1)


def assumed_airframe(rotors: int) -> Airframe:
    """So many rotors on a circle: enough to judge their telemetry, where no scale is known."""
    angles = [2.0 * math.pi * i / rotors for i in range(rotors)]
    return Airframe(
        "assumed",
        tuple(Rotor(math.cos(a), math.sin(a), 1 - 2 * (i % 2)) for i, a in enumerate(angles)),
    )
