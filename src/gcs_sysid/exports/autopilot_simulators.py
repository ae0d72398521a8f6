"""The autopilots' own simulators: parameters of PX4's SIH, and the frame of ArduPilot's SITL.

SIH's (`simulator_sih/sih.cpp`) come as a file that QGroundControl loads. Its body axes are ours
(forward, right, down), and SIH_IXY is the element [x, y] of the inertia matrix, so nothing changes
its sign:

    J w' = M - SIH_KDW w - w x J w,   m v' = -SIH_T_MAX sum u z - SIH_KDV v + m g
    M = (SIH_L_ROLL SIH_T_MAX ..., SIH_L_PITCH SIH_T_MAX ..., SIH_Q_MAX ...)

with u the output, 0 to 1, behind a lag of SIH_T_TAU. From PX4 1.18 on, u of a hexa is squared, and
its rotors are in the order of PX4's airframe 6001; before, they went round from the front right.

SITL's is the JSON that `Frame::load_frame_params` reads (`SIM_Frame.cpp`), flown by
`sim_vehicle.py --model quad:FILE.json`. Its parser drops the text after a #, and that before the
first brace. With u the command between MOT_SPIN_MIN and MOT_SPIN_MAX

    thrust = m g / (n hoverThrOut) ((1 - propExpo) u + propExpo u^2)
    moment = motorN_position x thrust, and about z: motorN_yaw u thrust 0.05 diagonal_size
    w' = moment / moment_inertia - 400 deg/s / refRotRate w

Inertia is diagonal there and rotors have no lag. A rotor's torque goes with u times thrust; its
slope over u in hover is made that of moment_ratio times thrust.
"""

import functools
import math

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError
from gcs_sysid.exports.exported_vehicle import ExportedVehicle
from gcs_sysid.exports.file_format import Format, commented, number
from gcs_sysid.model.parameter_file import INT32, REAL32
from gcs_sysid.model.parameters import GRAVITY, INERTIA

_SIH_OPTIONAL = {
    "SIH_KDV": "linear_drag",
    "SIH_KDW": "rotational_damping",
    "SIH_T_TAU": "motor_lag",
}
_HALF, _FRONT = 0.5, math.sqrt(3.0) / 2.0
_SIH_LAYOUTS = {
    0: ((1, 1, 1), (-1, -1, 1), (1, -1, -1), (-1, 1, -1)),
    4: (
        (0, 1, -1), (0, -1, 1), (_FRONT, -_HALF, -1),
        (-_FRONT, _HALF, 1), (_FRONT, _HALF, 1), (-_FRONT, -_HALF, -1),
    ),
}  # fmt: skip
"""SIH_VEHICLE_TYPE -> its rotors: x over SIH_L_PITCH, y over SIH_L_ROLL, spin."""
_HEXA, _ROUND = 4, [4, 0, 3, 5, 1, 2]
"""Its type, and these rotors as SIH before 1.18 counts them."""


def _sih_text(old: bool, vehicle: ExportedVehicle, head: list[str]) -> str:
    """The parameters as a .params file, of PX4 before 1.18 or not."""
    kind, roll_arm, pitch_arm, order = _sih_layout(vehicle)
    values = {
        "SIH_MASS": vehicle["mass"],
        **{f"SIH_{name.upper()}": vehicle[name] for name in INERTIA},
        "SIH_T_MAX": vehicle["T_max"],
        "SIH_Q_MAX": vehicle["T_max"] * vehicle["moment_ratio"],
        "SIH_L_ROLL": roll_arm,
        "SIH_L_PITCH": pitch_arm,
    }
    for sih, name in _SIH_OPTIONAL.items():
        value = vehicle.get(name)
        if value is not None:
            values[sih] = value
    values["THR_MDL_FAC"] = float(kind == _HEXA and not old)
    # As SIH counts them: it flies its own rotors, whatever the vehicle's are called.
    for i, at in enumerate(order[_ROUND] if kind == _HEXA and old else order):
        rotor = vehicle.rotors[at]
        values[f"CA_ROTOR{i}_PX"], values[f"CA_ROTOR{i}_PY"] = rotor.x, rotor.y
        values[f"CA_ROTOR{i}_KM"] = rotor.spin * vehicle["moment_ratio"]
    whole = {"SIH_VEHICLE_TYPE": kind, "CA_AIRFRAME": 0, "CA_ROTOR_COUNT": len(vehicle.rotors)}
    # PX4 holds single precision; QGroundControl writes 18 decimals.
    rows = [f"1\t1\t{n}\t{np.float32(v):.18f}\t{REAL32}\n" for n, v in sorted(values.items())]
    rows += [f"1\t1\t{n}\t{v}\t{INT32}\n" for n, v in whole.items()]
    return commented([*head, "", "Vehicle-Id Component-Id Name Value Type"], "#") + "".join(rows)


def _sih_layout(vehicle: ExportedVehicle) -> tuple[int, float, float, Array]:
    """SIH's vehicle type, roll and pitch arm in m, and which rotor is at each of its places."""
    own = np.array([[r.x, r.y, r.spin] for r in vehicle.rotors])
    arm = float(np.hypot(own[:, 0], own[:, 1]).mean())
    for kind, layout in _SIH_LAYOUTS.items():
        unit = np.array(layout, float)
        if len(unit) != len(own):
            continue
        pitch_arm, roll_arm = np.abs(own[:, :2]).max(axis=0) / np.abs(unit[:, :2]).max(axis=0)
        wanted = unit * [pitch_arm, roll_arm, 1.0]
        # A rotor off by more than 2 % of the arm is not flown.
        apart = np.abs(own[:, None] - wanted).max(axis=2)
        if (apart.min(axis=0) < 0.02 * arm).all():
            return kind, float(roll_arm), float(pitch_arm), apart.argmin(axis=0)
    raise InputError(
        "px4-sih: SIH flies a symmetrical quad X (front right turns counter-clockwise) or hexa "
        f"only, not the {len(own)} rotors of this airframe"
    )


def _sih_remarks(old: bool, vehicle: ExportedVehicle) -> list[str]:
    out = []
    squared = len(vehicle.rotors) == len(_ROUND) and not old
    curve = "the square of" if squared else "linear in"
    kept = [f"{sih} ({name})" for sih, name in _SIH_OPTIONAL.items() if vehicle.get(name) is None]
    if kept:
        out.append(f"unknown, left unchanged: {', '.join(kept)}")
    little = 0.05
    if abs((vehicle.get("thrust_curve") or 0.0) - squared) > little:
        out.append(f"SIH's thrust is {curve} the output, this vehicle's is not")
    elif not vehicle.result.rotor_input.motors:
        out.append(f"SIH's thrust is {curve} the output: THR_MDL_FAC is {squared:d} here")
    if squared:
        out.append(
            "rotors are in the order of PX4's airframe 6001: where CA_ROTOR0_PX of your release's "
            "10044_sihsim_hex is not 0, take px4-sih-1.17 with THR_MDL_FAC = 1"
        )
    out.append(
        "CA_ROTORn_PX, PY are from the geometric center, as SIH flies them, and in its order: on "
        "the vehicle itself they count from the CG, and in the order of its motors"
    )
    return out


PX4_SIH, PX4_SIH_1_17 = (
    Format(
        "px4-sih-1.17" if old else "px4-sih",
        f"parameters of the SIH simulator of PX4 {'up to 1.17' if old else '1.18 and later'}",
        ".params",
        "SIH has",
        needs=("mass", *INERTIA, "T_max", "moment_ratio"),
        uses=tuple(_SIH_OPTIONAL.values()),
        text=functools.partial(_sih_text, old),
        remarks=functools.partial(_sih_remarks, old),
    )
    for old in (False, True)
)


_TURNING = math.radians(400.0)
_YAW = 0.05


def _sitl_text(vehicle: ExportedVehicle, head: list[str]) -> str:
    """The frame as JSON with comments."""
    n = len(vehicle.rotors)
    share = vehicle.hover_load
    c = vehicle.get("thrust_curve")
    curve = 0.65 if c is None else min(max(c, 0.0), 1.0)
    u = vehicle.hover_command(curve)
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


def _sitl_remarks(vehicle: ExportedVehicle) -> list[str]:
    squared = "SITL's drag goes with speed squared: it is linear_drag at refSpd"
    return [
        *([squared] if vehicle.get("linear_drag") else []),
        "inertia is diagonal in SITL: products of inertia are left out",
        "releases of SITL that stop at motorN_position: delete those lines, the rotors are then "
        "on a circle around the CG",
    ]


ARDUPILOT_SITL = Format(
    "ardupilot-sitl",
    "frame of ArduPilot's SITL",
    ".json",
    "SITL's frame has",
    needs=("mass", *INERTIA[:3], "cg_x", "cg_y", "T_max", "moment_ratio"),
    uses=("thrust_curve", "rotational_damping", "linear_drag"),
    text=_sitl_text,
    absent={
        "thrust_curve": "thrust_curve is not known: SITL's own propExpo is used",
        "linear_drag": "linear_drag is not known: SITL's own refSpd and refAngle are used",
    },
    remarks=_sitl_remarks,
)
