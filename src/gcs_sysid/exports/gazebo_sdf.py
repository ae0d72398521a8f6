"""SDF for Gazebo: a body, turning rotors, and Gazebo's own multicopter motor model.

Axes are forward, left, up; ixy is the element [x, y] of the inertia matrix. The motor model turns
a link a rotor, and that link must weigh something: it is given a token of the mass, which is taken
from the body, so that the whole has mass, CG and inertia as identified.

The motor model (gz-sim's `MulticopterMotorModel.cc`): thrust = motorConstant Omega^2 along the
rotor's axis, torque = -(+1 ccw, -1 cw) momentConstant thrust about it.
"""

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.exports.exported_vehicle import ExportedVehicle
from gcs_sysid.exports.file_format import (
    Format,
    inertia_elements,
    number,
    numbers,
    xml_comment,
)
from gcs_sysid.model.parameters import INERTIA

_FLAT = 0.6
"""Inertia of a rotor's link about the other axes, over that about its own."""


def _text(vehicle: ExportedVehicle, head: list[str]) -> str:
    """The vehicle as an SDF model, frame of `base_link` at the geometric center."""
    places = vehicle.rotors_flu
    # A rotor's link must weigh something.
    rotor_mass = 1e-3 * vehicle["mass"]
    axial = max(vehicle.get("rotor_inertia") or 0.0, 1e-4 * vehicle["Izz"])
    rotor_inertia = np.diag([_FLAT * axial, _FLAT * axial, axial])
    mass, cg, inertia = _body(vehicle, places, rotor_mass, rotor_inertia)
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


def _body(
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
    matrix: Array = offset @ offset * np.eye(3) - np.outer(offset, offset)
    return matrix


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


def _remarks(vehicle: ExportedVehicle) -> list[str]:
    out = ["rotor links have a token mass, taken from base_link: the total is right"]
    out.append("CG and rotors are at one height: their vertical offset is not observable")
    if vehicle.rotors_differ:
        out.append("each rotor has its own k_T and moment ratio, as identified")
    return [*out, "shapes are visual only, without collision"]


FORMAT = Format(
    "gazebo-sdf",
    "SDF for Gazebo",
    ".sdf",
    "Gazebo's motor model has",
    needs=("mass", *INERTIA, "cg_x", "cg_y", "k_T", "moment_ratio", "rotor_speed_max"),
    uses=("motor_lag", "rotor_inertia"),
    text=_text,
    absent={"motor_lag": "motor_lag is not known: Gazebo's own time constants are used"},
    remarks=_remarks,
)
