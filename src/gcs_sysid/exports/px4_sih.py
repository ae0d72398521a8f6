"""PX4's simulator in hardware (SIH): its parameters, as QGroundControl loads them.

SIH's body axes are ours (forward, right, down), and SIH_IXY is the element [x, y] of the inertia
matrix, so nothing changes its sign:

    J w' = M - SIH_KDW w - w x J w,   m v' = -SIH_T_MAX sum u z - SIH_KDV v + m g
    M = (SIH_L_ROLL SIH_T_MAX ..., SIH_L_PITCH SIH_T_MAX ..., SIH_Q_MAX ...)

with u the output, 0 to 1, behind a lag of SIH_T_TAU. (PX4's `simulator_sih/sih.cpp`.)
"""

import math

import numpy as np

from gcs_sysid.errors import InputError
from gcs_sysid.exports.exported_vehicle import ExportedVehicle
from gcs_sysid.exports.file_format import Format, commented
from gcs_sysid.model.parameter_file import INT32, REAL32
from gcs_sysid.model.parameters import INERTIA

OPTIONAL = {
    "SIH_KDV": "linear_drag",
    "SIH_KDW": "rotational_damping",
    "SIH_T_TAU": "motor_lag",
}
_HALF, _FRONT = 0.5, math.sqrt(3.0) / 2.0
_LAYOUTS = {
    0: ((1, 1, 1), (-1, -1, 1), (1, -1, -1), (-1, 1, -1)),
    4: (
        (_FRONT, _HALF, 1), (0, 1, -1), (-_FRONT, _HALF, 1),
        (-_FRONT, -_HALF, -1), (0, -1, 1), (_FRONT, -_HALF, -1),
    ),
}  # fmt: skip
"""SIH_VEHICLE_TYPE -> its rotors: x over SIH_L_PITCH, y over SIH_L_ROLL, spin."""


def _text(vehicle: ExportedVehicle, head: list[str]) -> str:
    """The parameters as a .params file."""
    kind, roll_arm, pitch_arm = _layout(vehicle)
    values = {
        "SIH_MASS": vehicle["mass"],
        **{f"SIH_{name.upper()}": vehicle[name] for name in INERTIA},
        "SIH_T_MAX": vehicle["T_max"],
        "SIH_Q_MAX": vehicle["T_max"] * vehicle["moment_ratio"],
        "SIH_L_ROLL": roll_arm,
        "SIH_L_PITCH": pitch_arm,
    }
    for sih, name in OPTIONAL.items():
        value = vehicle.get(name)
        if value is not None:
            values[sih] = value
    values |= _allocation(vehicle)
    whole = {"SIH_VEHICLE_TYPE": kind, "CA_AIRFRAME": 0, "CA_ROTOR_COUNT": len(vehicle.rotors)}
    # PX4 holds single precision; QGroundControl writes 18 decimals.
    rows = [f"1\t1\t{n}\t{np.float32(v):.18f}\t{REAL32}\n" for n, v in sorted(values.items())]
    rows += [f"1\t1\t{n}\t{v}\t{INT32}\n" for n, v in whole.items()]
    return commented([*head, "", "Vehicle-Id Component-Id Name Value Type"], "#") + "".join(rows)


def _allocation(vehicle: ExportedVehicle) -> dict[str, float]:
    """CA_*: the rotors as PX4's control allocation has them, from the center as SIH flies them."""
    out: dict[str, float] = {"THR_MDL_FAC": 0.0}
    for i, rotor in enumerate(vehicle.rotors):
        out[f"CA_ROTOR{i}_PX"], out[f"CA_ROTOR{i}_PY"] = rotor.x, rotor.y
        out[f"CA_ROTOR{i}_KM"] = rotor.spin * vehicle["moment_ratio"]
    return out


def _layout(vehicle: ExportedVehicle) -> tuple[int, float, float]:
    """SIH's vehicle type, roll and pitch arm in m."""
    own = np.array([[r.x, r.y, r.spin] for r in vehicle.rotors])
    arm = float(np.hypot(own[:, 0], own[:, 1]).mean())
    for kind, layout in _LAYOUTS.items():
        unit = np.array(layout, float)
        if len(unit) != len(own):
            continue
        pitch_arm, roll_arm = np.abs(own[:, :2]).max(axis=0) / np.abs(unit[:, :2]).max(axis=0)
        wanted = unit * [pitch_arm, roll_arm, 1.0]
        # The order of motors is SIH's own. A rotor off by more than 2 % of the arm is not flown.
        apart = np.abs(own[:, None] - wanted).max(axis=2)
        if (apart.min(axis=0) < 0.02 * arm).all():
            return kind, float(roll_arm), float(pitch_arm)
    raise InputError(
        "px4-sih: SIH flies a symmetrical quad X (front right turns counter-clockwise) or hexa "
        f"only, not the {len(own)} rotors of this airframe"
    )


def _remarks(vehicle: ExportedVehicle) -> list[str]:
    out = []
    kept = [f"{sih} ({name})" for sih, name in OPTIONAL.items() if vehicle.get(name) is None]
    if kept:
        out.append(f"unknown, left unchanged: {', '.join(kept)}")
    little = 0.05
    if abs(vehicle.get("thrust_curve") or 0.0) > little:
        out.append("SIH's thrust is linear in the output, this vehicle's is not")
    elif not vehicle.result.rotor_input.motors:
        out.append("SIH's thrust is linear in the output: THR_MDL_FAC is 0 here")
    out.append(
        "CA_ROTORn_PX, PY are from the geometric center, as SIH flies them: on the vehicle itself "
        "they count from the CG"
    )
    return out


FORMAT = Format(
    "px4-sih",
    "parameters of PX4's SIH simulator",
    ".params",
    "SIH has",
    needs=("mass", *INERTIA, "T_max", "moment_ratio"),
    uses=tuple(OPTIONAL.values()),
    text=_text,
    remarks=_remarks,
)
