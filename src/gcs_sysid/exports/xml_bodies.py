"""Bodies as XML: SDF for Gazebo, URDF, and MJCF for MuJoCo.

Axes are forward, left, up (REP 103), frames at the geometric center; ixy is the element [x, y] of
the inertia matrix.

SDF has a body, turning rotors, and Gazebo's own multicopter motor model (gz-sim's
`MulticopterMotorModel.cc`): thrust = motorConstant Omega^2 along the rotor's axis, torque =
-(+1 ccw, -1 cw) momentConstant thrust about it. It turns a link a rotor, and that link must weigh
something: it is given a token of the mass, which is taken from the body, so that the whole has
mass, CG and inertia as identified.

URDF has one link with the body's inertia, a frame at every rotor, and no place for what rotors do.

MJCF has a free body with one actuator a rotor, whose control is thrust in N. The body floats on
three slides and a ball joint at the CG rather than on one free joint: drag then damps the slides,
and damping the ball, apart and as identified. Positions and velocities are laid out as those of a
free joint.
"""

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.exports.exported_vehicle import ExportedVehicle
from gcs_sysid.exports.file_format import (
    ELEMENTS,
    Format,
    inertia_attributes,
    inertia_elements,
    number,
    numbers,
    xml_comment,
)
from gcs_sysid.model.parameters import INERTIA

_FLAT = 0.6
"""Inertia of a rotor's link about the other axes, over that about its own."""
_ONE_HEIGHT = "CG and rotors are at one height: their vertical offset is not observable"
_SHAPES = "shapes are visual only, without collision"


def _sdf_text(vehicle: ExportedVehicle, head: list[str]) -> str:
    """The vehicle as an SDF model, frame of `base_link` at the geometric center."""
    places = vehicle.rotors_flu
    # A rotor's link must weigh something.
    rotor_mass = 1e-3 * vehicle["mass"]
    axial = max(vehicle.get("rotor_inertia") or 0.0, 1e-4 * vehicle["Izz"])
    rotor_inertia = np.diag([_FLAT * axial, _FLAT * axial, axial])
    mass, cg, inertia = _without_rotors(vehicle, places, rotor_mass, rotor_inertia)
    radius = 0.3 * float(np.linalg.norm(places, axis=1).min())
    links = _link("base_link", np.zeros(3), mass, cg, inertia, _box(radius))
    plugins = ""
    for i, (rotor, place) in enumerate(zip(vehicle.rotors, places, strict=True)):
        shape = f"<cylinder><radius>{number(radius)}</radius><length>0.005</length></cylinder>"
        links += _link(f"rotor_{i}", place, rotor_mass, np.zeros(3), rotor_inertia, shape)
        links += (
            f'    <joint name="rotor_{i}_joint" type="revolute">\n'
            "      <parent>base_link</parent>\n"
            f"      <child>rotor_{i}</child>\n"
            "      <axis>\n        <xyz>0 0 1</xyz>\n"
            "        <limit><lower>-1e16</lower><upper>1e16</upper></limit>\n"
            "      </axis>\n    </joint>\n"
        )
        plugins += _motor(vehicle, i, "ccw" if rotor.spin > 0 else "cw")
    return (
        '<?xml version="1.0"?>\n'
        + xml_comment(head)
        + f'<sdf version="1.9">\n  <model name="{vehicle.name}">\n'
        + links
        + plugins
        + "  </model>\n</sdf>\n"
    )


def _without_rotors(
    vehicle: ExportedVehicle, places: Array, rotor_mass: float, rotor_inertia: Array
) -> tuple[float, Array, Array]:
    """Mass, CG and inertia of what remains without the rotors' links."""
    mass = vehicle["mass"] - len(places) * rotor_mass
    cg = (vehicle["mass"] * vehicle.cg_flu - rotor_mass * places.sum(axis=0)) / mass
    inertia = vehicle.inertia_flu - mass * _steiner(cg - vehicle.cg_flu)
    for place in places:
        inertia = inertia - rotor_inertia - rotor_mass * _steiner(place - vehicle.cg_flu)
    return mass, cg, inertia


def _steiner(offset: Array) -> Array:
    """(3, 3) inertia of a unit mass at an offset."""
    return offset @ offset * np.eye(3) - np.outer(offset, offset)


def _link(name: str, place: Array, mass: float, cg: Array, inertia: Array, shape: str) -> str:
    return (
        f'    <link name="{name}">\n'
        f"      <pose>{numbers(place)} 0 0 0</pose>\n"
        "      <inertial>\n"
        f"        <pose>{numbers(cg)} 0 0 0</pose>\n"
        f"        <mass>{number(mass)}</mass>\n"
        f"        <inertia>{inertia_elements(inertia)}</inertia>\n"
        "      </inertial>\n"
        f'      <visual name="shape"><geometry>{shape}</geometry></visual>\n'
        "    </link>\n"
    )


def _box(size: float) -> str:
    return f"<box><size>{number(2 * size)} {number(size)} {number(0.5 * size)}</size></box>"


def _motor(vehicle: ExportedVehicle, i: int, spin: str) -> str:
    lag = vehicle.get("motor_lag")
    k_T, ratio = vehicle.rotor_coefficients(i)
    settings = {
        "robotNamespace": vehicle.name,
        "jointName": f"rotor_{i}_joint",
        "linkName": f"rotor_{i}",
        "turningDirection": spin,
        **({"timeConstantUp": number(lag), "timeConstantDown": number(lag)} if lag else {}),
        "maxRotVelocity": number(vehicle["rotor_speed_max"]),
        "motorConstant": number(k_T),
        "momentConstant": number(ratio),
        "commandSubTopic": "command/motor_speed",
        "motorNumber": str(i),
        # Not identified in this form; left out, Gazebo would put in its own.
        "rotorDragCoefficient": "0",
        "rollingMomentCoefficient": "0",
        "rotorVelocitySlowdownSim": "10",
        "motorType": "velocity",
    }
    return (
        '    <plugin filename="gz-sim-multicopter-motor-model-system"'
        ' name="gz::sim::systems::MulticopterMotorModel">\n'
        + "".join(f"      <{key}>{value}</{key}>\n" for key, value in settings.items())
        + "    </plugin>\n"
    )


def _sdf_remarks(vehicle: ExportedVehicle) -> list[str]:
    out = ["rotor links have a token mass, taken from base_link: the total is right"]
    out.append(_ONE_HEIGHT)
    if vehicle.rotors_differ:
        out.append("each rotor has its own k_T and moment ratio, as identified")
    return [*out, _SHAPES]


GAZEBO_SDF = Format(
    "gazebo-sdf",
    "SDF for Gazebo",
    ".sdf",
    "Gazebo's motor model has",
    needs=("mass", *INERTIA, "cg_x", "cg_y", "k_T", "moment_ratio", "rotor_speed_max"),
    uses=("motor_lag", "rotor_inertia"),
    text=_sdf_text,
    absent={"motor_lag": "motor_lag is not known: Gazebo's own time constants are used"},
    remarks=_sdf_remarks,
)


def _urdf_text(vehicle: ExportedVehicle, head: list[str]) -> str:
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


URDF = Format(
    "urdf",
    "URDF",
    ".urdf",
    "URDF has",
    needs=("mass", *INERTIA, "cg_x", "cg_y"),
    text=_urdf_text,
    remarks=lambda _: [_ONE_HEIGHT],
)


_ABSENT = {
    "T_max": "without T_max controls have no upper limit",
    "motor_lag": "without motor_lag thrust follows its control instantly",
    "linear_drag": "without linear_drag there is no drag",
    "rotational_damping": "without rotational_damping rotation is undamped",
}


def _mjcf_text(vehicle: ExportedVehicle, head: list[str]) -> str:
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
    size = number(0.3 * float(np.linalg.norm(vehicle.rotors_flu, axis=1).min()))
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


MJCF = Format(
    "mjcf",
    "MJCF of MuJoCo",
    ".xml",
    "this body has",
    needs=("mass", *INERTIA, "cg_x", "cg_y", "moment_ratio"),
    uses=tuple(_ABSENT),
    text=_mjcf_text,
    absent=_ABSENT,
    remarks=lambda _: [_ONE_HEIGHT, _SHAPES],
)
