"""Emulated flights of the article's vehicle, which change on the way, as estimators take them."""

from dataclasses import replace

import numpy as np

from gcs_sysid.signals.records import Samples
from sim_bridge.vehicle_files import load_vehicle

RATE = 250
DT = 1.0 / RATE
VEHICLE = load_vehicle("paper")
GEOMETRY = np.array([[r.x, r.y, float(r.spin)] for r in VEHICLE.rotors]).T


def with_payload(vehicle):
    """A fifth more of mass, beside the CG."""
    inertia = {n: 1.1 * getattr(vehicle, n) for n in ("Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Ixz")}
    shift = 1.0 + 1.0 / 6.0
    return replace(
        vehicle,
        mass=1.2 * vehicle.mass,
        cg_x=shift * vehicle.cg_x,
        cg_y=shift * vehicle.cg_y,
        **inertia,
    )


def measured(flight, seed=1):
    """What MEMS sensors make of a flight."""
    noisy = flight.with_noise("mems", 0.0, [seed])
    gyro = noisy.gyro[0]
    return Samples(
        gyro=gyro,
        rates=gyro - np.mean(gyro - flight.gyro[0], axis=0),
        speeds=noisy.speeds[0],
        attitude=noisy.quaternion[0],
        force=noisy.specific_force[0],
        velocity=noisy.velocity[0],
    )
