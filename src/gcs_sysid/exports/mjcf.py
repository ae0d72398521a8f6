"""MuJoCo's MJCF: a free body with one actuator a rotor, whose control is thrust in N.

Axes are forward, left, up. The body floats on three slides and a ball joint at the CG rather
than on one free joint: drag then damps the slides, and damping the ball, apart and as identified.
Positions and velocities are laid out as those of a free joint.
"""

from gcs_sysid.exports.exported_vehicle import ExportedVehicle
from gcs_sysid.exports.file_format import ELEMENTS, Format, number, numbers, xml_comment
from gcs_sysid.model.parameters import INERTIA

_ABSENT = {
    "T_max": "without T_max controls have no upper limit",
    "motor_lag": "without motor_lag thrust follows its control instantly",
    "linear_drag": "without linear_drag there is no drag",
    "rotational_damping": "without rotational_damping rotation is undamped",
}


def _text(vehicle: ExportedVehicle, head: list[str]) -> str:
    """The vehicle as an MJCF model, body `base` with its frame at the geometric center."""
    inertia = numbers(vehicle.inertia_flu[at] for at in ELEMENTS.values())
    cg = numbers(vehicle.cg_flu)
    drag = _damping(vehicle.get("linear_drag"))
    slides = "".join(
        f'      <joint name="{name}" type="slide" axis="{axis}" pos="{cg}"{drag}/>\n'
        for name, axis in (("x", "1 0 0"), ("y", "0 1 0"), ("z", "0 0 1"))
    )
    full, lag = vehicle.get("T_max"), vehicle.get("motor_lag")
    limits = "" if full is None else f' ctrlrange="0 {number(full)}"'
    filtered = f' dyntype="filterexact" dynprm="{number(lag)}"' if lag else ""
    size = number(0.3 * min(_lengths(vehicle)))
    shapes, sites, actuators = "", "", ""
    for i, (rotor, place) in enumerate(zip(vehicle.rotors, vehicle.rotors_flu, strict=True), 1):
        at = numbers(place)
        shapes += f'      <geom class="shape" type="capsule" size="0.01" fromto="0 0 0 {at}"/>\n'
        shapes += f'      <geom class="shape" type="cylinder" size="{size} 0.003" pos="{at}"/>\n'
        sites += f'      <site name="rotor_{i}" pos="{at}"/>\n'
        # Seen from above, a rotor that turns counter-clockwise turns the body clockwise.
        torque = number(-rotor.spin * vehicle["moment_ratio"])
        actuators += (
            f'    <general name="thrust_{i}" site="rotor_{i}" gear="0 0 1 0 0 {torque}"'
            f"{limits}{filtered}/>\n"
        )
    return (
        xml_comment(head) + f'<mujoco model="{vehicle.name}">\n'
        '  <default>\n    <default class="shape">\n'
        '      <geom contype="0" conaffinity="0" group="1" rgba="0.3 0.3 0.35 1"/>\n'
        "    </default>\n  </default>\n"
        "  <worldbody>\n"
        '    <body name="base">\n'
        f'      <inertial pos="{cg}" mass="{number(vehicle["mass"])}" fullinertia="{inertia}"/>\n'
        + slides
        + f'      <joint name="attitude" type="ball" pos="{cg}"'
        + f"{_damping(vehicle.get('rotational_damping'))}/>\n"
        + shapes
        + sites
        + "    </body>\n  </worldbody>\n  <actuator>\n"
        + actuators
        + "  </actuator>\n</mujoco>\n"
    )


def _damping(value: float | None) -> str:
    return f' damping="{number(value)}"' if value else ""


def _lengths(vehicle: ExportedVehicle) -> list[float]:
    """Distances of the rotors from the geometric center."""
    return [float((place @ place) ** 0.5) for place in vehicle.rotors_flu]


def _remarks(_: ExportedVehicle) -> list[str]:
    return [
        "CG and rotors are at one height: their vertical offset is not observable",
        "shapes are visual only, without collision",
    ]


FORMAT = Format(
    "mjcf",
    "MJCF of MuJoCo",
    ".xml",
    "this body has",
    needs=("mass", *INERTIA, "cg_x", "cg_y", "moment_ratio"),
    uses=tuple(_ABSENT),
    text=_text,
    absent=_ABSENT,
    remarks=_remarks,
)
