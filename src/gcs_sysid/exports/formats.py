"""The formats by name."""

from collections.abc import Callable
from dataclasses import dataclass

from gcs_sysid.exports import (
    ardupilot_sitl,
    crazyflow,
    gazebo_sdf,
    indi_effectiveness,
    l2f,
    mjcf,
    px4_sih,
    rotorpy,
    urdf,
)
from gcs_sysid.exports.exported_vehicle import Vehicle
from gcs_sysid.exports.header import Format


@dataclass(frozen=True)
class Target:
    """One format.

    Attributes:
        form: what it takes.
        write: the vehicle as the file's text.
        notes: what the user should know of this vehicle in this format, after `write`.
    """

    form: Format
    write: Callable[[Vehicle], str]
    notes: Callable[[Vehicle], list[str]]


TARGETS = {
    module.FORMAT.name: Target(module.FORMAT, module.write, module.notes)
    for module in (px4_sih, gazebo_sdf, urdf, mjcf, rotorpy, ardupilot_sitl, crazyflow, l2f)
} | {
    "indiflight": Target(
        indi_effectiveness.INDIFLIGHT_FORMAT,
        indi_effectiveness.indiflight_text,
        indi_effectiveness.indiflight_notes,
    ),
    "paparazzi": Target(
        indi_effectiveness.PAPARAZZI_FORMAT,
        indi_effectiveness.paparazzi_text,
        indi_effectiveness.paparazzi_notes,
    ),
}
