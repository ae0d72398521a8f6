"""URDF: one link with the body's inertia, and a frame at every rotor.

Axes are forward, left, up (REP 103). ixy is the element [x, y] of the inertia matrix. URDF has
no place for what rotors do.
"""

from gcs_sysid.exports.exported_vehicle import INERTIA, Vehicle
from gcs_sysid.exports.header import provenance, unplaced_note, weak_note, xml_comment
from gcs_sysid.exports.xml import inertia_attributes, numbers

TITLE = "URDF"
NEEDS = ("mass", *INERTIA, "cg_x", "cg_y")
_NO_PLACE = (
    "k_T", "k_M", "T_max", "moment_ratio", "rotational_damping", "rotor_inertia", "linear_drag",
    "motor_lag",
)  # fmt: skip


def notes(vehicle: Vehicle) -> list[str]:
    """What the user should know."""
    return [
        *weak_note(vehicle, NEEDS),
        *unplaced_note(vehicle, _NO_PLACE, "URDF has"),
        "CG and rotors are drawn at one height: no flight tells the difference",
    ]


def write(vehicle: Vehicle) -> str:
    """The vehicle as URDF, frame `base_link` at the geometric centre.

    Raises:
        MissingError: a parameter that URDF cannot do without is not known.
    """
    vehicle.need("urdf", NEEDS)
    vehicle.check_inertia()
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
        '<?xml version="1.0"?>\n'
        + xml_comment(provenance(vehicle, TITLE, notes(vehicle)))
        + f'<robot name="{vehicle.name}">\n'
        '  <link name="base_link">\n'
        "    <inertial>\n"
        f'      <origin xyz="{numbers(vehicle.cg_flu)}" rpy="0 0 0"/>\n'
        f'      <mass value="{numbers([vehicle["mass"]])}"/>\n'
        f"      <inertia {inertia_attributes(vehicle.inertia_flu)}/>\n"
        "    </inertial>\n"
        "  </link>\n" + rotors + "</robot>\n"
    )
