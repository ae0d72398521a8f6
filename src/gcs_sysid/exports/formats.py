"""The formats by name."""

from collections.abc import Callable
from dataclasses import dataclass

from gcs_sysid.exports import gazebo_sdf, mjcf, px4_sih, rotorpy, urdf
from gcs_sysid.exports.exported_vehicle import Vehicle


@dataclass(frozen=True)
class Target:
    """One format.

    Attributes:
        write: the vehicle as the file's text.
        notes: what the user should know of this vehicle in this format, after `write`.
    """

    write: Callable[[Vehicle], str]
    notes: Callable[[Vehicle], list[str]]


TARGETS = {
    "px4-sih": Target(px4_sih.write, px4_sih.notes),
    "gazebo-sdf": Target(gazebo_sdf.write, gazebo_sdf.notes),
    "urdf": Target(urdf.write, urdf.notes),
    "mjcf": Target(mjcf.write, mjcf.notes),
    "rotorpy": Target(rotorpy.write, rotorpy.notes),
}
