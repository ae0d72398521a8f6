"""URDF: one link with the body's inertia, and a frame at every rotor.

Axes are forward, left, up (REP 103). ixy is the element [x, y] of the inertia matrix. URDF has
no place for what rotors do.
"""

from gcs_sysid.exports.exported_vehicle import ExportedVehicle
from gcs_sysid.exports.file_format import (
    Format,
    inertia_attributes,
    numbers,
    xml_comment,
)
from gcs_sysid.model.parameters import INERTIA


def _text(vehicle: ExportedVehicle, head: list[str]) -> str:
    """The vehicle as URDF, frame `base_link` at the geometric center."""
    rotors = "".join(
        f'  <link name="rotor_{i}"/>\n'
        f'  <joint name="rotor_{i}_mount" type="fixed">\n'
        f'    <parent link="base_link"/>\n'
        f'    <child link="rotor_{i}"/>\n'
        f'    <origin xyz="{numbers(place)}" rpy="0 0 0"/>\n'
        f"  </joint>\n"
        for i, place in enumerate(vehicle.rotors_flu, 1)
    )
    return (
        '<?xml version="1.0"?>\n' + xml_comment(head) + f'<robot name="{vehicle.name}">\n'
        '  <link name="base_link">\n'
        "    <inertial>\n"
        f'      <origin xyz="{numbers(vehicle.cg_flu)}" rpy="0 0 0"/>\n'
        f'      <mass value="{numbers([vehicle["mass"]])}"/>\n'
        f"      <inertia {inertia_attributes(vehicle.inertia_flu)}/>\n"
        "    </inertial>\n"
        "  </link>\n" + rotors + "</robot>\n"
    )


def _remarks(_: ExportedVehicle) -> list[str]:
    return ["CG and rotors are at one height: their vertical offset is not observable"]


FORMAT = Format(
    "urdf",
    "URDF",
    ".urdf",
    "URDF has",
    needs=("mass", *INERTIA, "cg_x", "cg_y"),
    text=_text,
    remarks=_remarks,
)
