"""RotorPy's parameters of a multirotor, as its `vehicles/*_params.py` have them.

Axes are forward, left, up, places are seen from the CG, and `rotor_directions` is +1 for a rotor
that turns clockwise seen from above: the sign of its torque on the body about the axis up.
"""

import math

from gcs_sysid.errors import InputError
from gcs_sysid.exports.exported_vehicle import ExportedVehicle
from gcs_sysid.exports.file_format import FOUR, Format, commented, number
from gcs_sysid.model.parameters import GRAVITY, INERTIA

"""RotorPy inverts its allocation, which is square for four."""


def _text(vehicle: ExportedVehicle, head: list[str]) -> str:
    """The parameters as a Python module with the dictionary `quad_params`."""
    if not vehicle["motor_lag"] > 0.0:
        raise InputError("rotorpy: RotorPy divides by motor_lag: give --set motor_lag=SECONDS")
    J = vehicle.inertia_flu
    places = vehicle.rotors_flu - vehicle.cg_flu
    hover = math.sqrt(vehicle["mass"] * GRAVITY / (FOUR * vehicle["k_T"]))
    drag = (vehicle.get("linear_drag") or 0.0) / (FOUR * hover)
    directions = ", ".join(str(-rotor.spin) for rotor in vehicle.rotors)
    rows: list[tuple[str, str, str]] = [
        ("mass", number(vehicle["mass"]), "kg"),
        *((n, number(J[a, b]), "kg m^2") for n, (a, b) in _MATRIX.items()),
        ("num_rotors", str(FOUR), "in the autopilot's motor order"),
    ]
    return (
        commented(head, "#")
        + "import numpy as np\n\nquad_params = {\n"
        + "".join(_row(*row) for row in rows)
        + '    "rotor_pos": {  # m from the CG: forward, left, up\n'
        + "".join(
            f'        "r{i}": np.array([{", ".join(map(number, place))}]),\n'
            for i, place in enumerate(places.tolist(), 1)
        )
        + "    },\n"
        + _row("rotor_directions", f"np.array([{directions}])", "+1 clockwise seen from above")
        + _row("rI", "np.array([0.0, 0.0, 0.0])", "m, the IMU; not identified")
        + _row("c_Dx", "0.0", "N/(m/s)^2; not identified, as are c_Dy, c_Dz, k_h and k_flap")
        + "".join(_row(name, "0.0", "") for name in ("c_Dy", "c_Dz", "k_h", "k_flap"))
        + _row("k_eta", number(vehicle["k_T"]), "N/(rad/s)^2")
        + _row("k_m", number(vehicle["k_M"]), "N m/(rad/s)^2")
        + _row("k_d", number(drag), "N/(rad m/s^2), across")
        + _row("k_z", number(drag), "N/(rad m/s^2), along the axis")
        + _row("tau_m", number(vehicle["motor_lag"]), "s")
        + _row("rotor_speed_min", "0.0", "rad/s")
        + _row("rotor_speed_max", number(vehicle["rotor_speed_max"]), "rad/s")
        + _row("motor_noise_std", "0.0", "rad/s")
        + "}\n"
    )


_MATRIX = {
    "Ixx": (0, 0), "Iyy": (1, 1), "Izz": (2, 2), "Ixy": (0, 1), "Iyz": (1, 2), "Ixz": (0, 2),
}  # fmt: skip


def _row(name: str, value: str, comment: str) -> str:
    return f'    "{name}": {value},' + (f"  # {comment}" if comment else "") + "\n"


def _remarks(vehicle: ExportedVehicle) -> list[str]:
    out = []
    if vehicle.get("linear_drag"):
        out.append(
            "RotorPy's drag grows with rotor speed: k_d and k_z make it linear_drag in hover"
        )
    curve = vehicle.get("thrust_curve")
    if curve is not None and vehicle.known["motor_lag"].origin == "identified":
        out.append("tau_m is the lag of the command, used as that of rotor speed")
    return out


FORMAT = Format(
    "rotorpy",
    "parameters of RotorPy",
    ".py",
    "RotorPy has",
    needs=("mass", *INERTIA, "cg_x", "cg_y", "k_T", "k_M", "motor_lag", "rotor_speed_max"),
    uses=("linear_drag",),
    text=_text,
    absent={"linear_drag": "without linear_drag there is no drag (k_d = k_z = 0)"},
    remarks=_remarks,
    rotors=FOUR,
)
