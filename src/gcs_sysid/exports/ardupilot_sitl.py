"""ArduPilot SITL's frame as the JSON that `Frame::load_frame_params` reads (`SIM_Frame.cpp`).

Flown by `sim_vehicle.py --model quad:FILE.json`. Its parser drops the text after a #, and that
before the first brace. With u the command between MOT_SPIN_MIN and MOT_SPIN_MAX

    thrust = m g / (n hoverThrOut) ((1 - propExpo) u + propExpo u^2)
    moment = motorN_position x thrust, and about z: motorN_yaw u thrust 0.05 diagonal_size
    w' = moment / moment_inertia - 400 deg/s / refRotRate w

Inertia is diagonal there and rotors have no lag. A rotor's torque goes with u times thrust; its
slope over u in hover is made that of moment_ratio times thrust.
"""

import math

import numpy as np

from gcs_sysid.exports.exported_vehicle import ExportedVehicle, thrust_command
from gcs_sysid.exports.file_format import Format, commented, number
from gcs_sysid.model.parameters import GRAVITY, INERTIA

_TURNING = math.radians(400.0)
_YAW = 0.05


def _text(vehicle: ExportedVehicle, head: list[str]) -> str:
    """The frame as JSON with comments."""
    n = len(vehicle.rotors)
    share = vehicle.hover_load
    c = vehicle.get("thrust_curve")
    curve = 0.65 if c is None else min(max(c, 0.0), 1.0)
    u = thrust_command(share, curve)
    arm = float(np.mean([math.hypot(r.x, r.y) for r in vehicle.rotors]))
    # d(thrust)/du over d(u thrust)/du.
    slope = 1.0 - curve + 2.0 * curve * u
    yaw = vehicle["moment_ratio"] * slope / (share + u * slope) / (_YAW * arm)
    rows: list[tuple[str, str, str]] = [
        ("mass", number(vehicle["mass"]), "kg"),
        ("diagonal_size", number(arm), "m, from the center to each motor"),
        ("num_motors", str(n), ""),
        (
            "moment_inertia",
            "[" + ", ".join(number(vehicle[name]) for name in INERTIA[:3]) + "]",
            "kg m^2",
        ),
        ("hoverThrOut", number(share), "weight over full thrust"),
        ("slew_max", "0", "no limit"),
        ("mdrag_coef", "0", "all drag is in refSpd"),
    ]
    if c is not None:
        rows.append(("propExpo", number(curve), ""))
    damping = vehicle.get("rotational_damping")
    if damping:
        size = 0.5 * (vehicle["Ixx"] + vehicle["Iyy"])
        rows.append(("refRotRate", number(_TURNING * size / damping), "damping"))
    drag = vehicle.get("linear_drag")
    if drag:
        tilt = 15.0  # deg, at which refSpd is held
        speed = vehicle["mass"] * GRAVITY * math.tan(math.radians(tilt)) / drag
        rows += [("refAngle", number(tilt), "deg"), ("refSpd", number(speed), "m/s")]
    for i, rotor in enumerate(vehicle.rotors, 1):
        x, y = rotor.x - vehicle["cg_x"], rotor.y - vehicle["cg_y"]
        rows.append((f"motor{i}_position", f"[{number(x)}, {number(y)}, 0]", "m from the CG"))
        rows.append((f"motor{i}_yaw", number(rotor.spin * yaw), ""))
    text = [f'    "{name}": {value}' for name, value, _ in rows]
    ends = [","] * (len(rows) - 1) + [""]
    body = [
        line + end + (f"  # {words}" if words else "")
        for line, end, (_, _, words) in zip(text, ends, rows, strict=True)
    ]
    plain = commented(head, "#").replace("{", "(").replace("}", ")")
    return plain + "{\n" + "\n".join(body) + "\n}\n"


def _remarks(vehicle: ExportedVehicle) -> list[str]:
    out = []
    if vehicle.get("linear_drag"):
        out.append("SITL's drag goes with speed squared: it is linear_drag at refSpd")
    out.append("inertia is diagonal in SITL: products of inertia are left out")
    out.append(
        "releases of SITL that stop at motorN_position: delete those lines, the rotors are then "
        "on a circle around the CG"
    )
    return out


FORMAT = Format(
    "ardupilot-sitl",
    "frame of ArduPilot's SITL",
    ".json",
    "SITL's frame has",
    needs=("mass", *INERTIA[:3], "cg_x", "cg_y", "T_max", "moment_ratio"),
    uses=("thrust_curve", "rotational_damping", "linear_drag"),
    text=_text,
    absent={
        "thrust_curve": "thrust_curve is not known: SITL's own propExpo is used",
        "linear_drag": "linear_drag is not known: SITL's own refSpd and refAngle are used",
    },
    remarks=_remarks,
)
