"""The `dynamics` of l2f's parameters (learning to fly, rl-tools), as JSON.

Axes are forward, left, up. A rotor's state x is 0 to 1 and lags its action; with the coefficients
c of the rotor

    thrust = c[0] + c[1] x + c[2] x^2,   torque = rotor_torque_constants thrust

x is the command where the thrust curve is known, else the rotor's speed over that at full command.
l2f's JSON has no comments, and takes members that it does not know: the origin is in `_comment`.
"""

import json

import numpy as np

from gcs_sysid.exports.exported_vehicle import ExportedVehicle, thrust_command
from gcs_sysid.exports.file_format import FOUR, Format
from gcs_sysid.model.parameters import GRAVITY, INERTIA


def _text(vehicle: ExportedVehicle, head: list[str]) -> str:
    """The dynamics as JSON."""
    J = vehicle.inertia_flu
    full, c = vehicle["T_max"], vehicle.get("thrust_curve")
    c = 1.0 if c is None else c
    dynamics = {
        "rotor_positions": (vehicle.rotors_flu - vehicle.cg_flu).tolist(),
        "rotor_thrust_directions": [[0.0, 0.0, 1.0]] * FOUR,
        "rotor_torque_directions": [[0.0, 0.0, -float(r.spin)] for r in vehicle.rotors],
        "rotor_thrust_coefficients": [[0.0, full * (1.0 - c), full * c]] * FOUR,
        "rotor_torque_constants": [vehicle["moment_ratio"]] * FOUR,
        "rotor_time_constants_rising": [vehicle["motor_lag"]] * FOUR,
        "rotor_time_constants_falling": [vehicle["motor_lag"]] * FOUR,
        "mass": vehicle["mass"],
        "gravity": [0.0, 0.0, -GRAVITY],
        "J": J.tolist(),
        "J_inv": np.linalg.inv(J).tolist(),
        "hovering_throttle_relative": thrust_command(vehicle.hover_load, c),
        "action_limit": {"min": 0.0, "max": 1.0},
    }
    lines = ",\n".join(map(json.dumps, head))
    body = json.dumps({"dynamics": dynamics}, indent=1, allow_nan=False)
    return f'{{"_comment": [\n{lines}\n],' + body.removeprefix("{") + "\n"


def _remarks(_: ExportedVehicle) -> list[str]:
    return ["put `dynamics` in place of that of l2f.parameters_to_json, then parameters_from_json"]


FORMAT = Format(
    "l2f",
    "dynamics of l2f's parameters",
    ".l2f.json",
    "l2f has",
    needs=("mass", *INERTIA, "cg_x", "cg_y", "T_max", "moment_ratio", "motor_lag"),
    uses=("thrust_curve",),
    text=_text,
    absent={
        "thrust_curve": "the thrust curve is not known: actions are rotor speeds over the fastest"
    },
    remarks=_remarks,
    rotors=FOUR,
)
