"""Simulators in Python that fly four rotors: RotorPy, crazyflow with drone-models, and l2f.

Axes are forward, left, up, places are seen from the CG.

RotorPy's parameters are those of its `vehicles/*_params.py`; `rotor_directions` is +1 for a rotor
that turns clockwise seen from above: the sign of its torque on the body about the axis up. It
inverts its allocation, which is square for four.

Crazyflow's are one section, for `first_principles`: in crazyflow
`dynamics/first_principles/params.toml`, in drone-models `data/params.toml`. Speeds are in rpm:

    thrust = rpm2thrust[2] rpm^2,   moments = L mixing_matrix[0:2] thrust
    moment up = mixing_matrix[2] (rpm2torque[2] rpm^2 + prop_inertia Omega')
    Omega' = rotor_dyn_coef[0] (Omega_c - Omega)

L2f's (learning to fly, rl-tools) are the `dynamics` of its parameters, as JSON. A rotor's state x
is 0 to 1 and lags its action; with the coefficients c of the rotor

    thrust = c[0] + c[1] x + c[2] x^2,   torque = rotor_torque_constants thrust

x is the command where the thrust curve is known, else the rotor's speed over that at full command.
Its JSON has no comments, and takes members that it does not know: the origin is in `_comment`.
"""

import json
import math

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError
from gcs_sysid.exports.exported_vehicle import ExportedVehicle
from gcs_sysid.exports.file_format import Format, commented, number
from gcs_sysid.model.parameters import GRAVITY, INERTIA

_RPM = 60.0 / (2.0 * math.pi)


def _divisor(vehicle: ExportedVehicle, by: str) -> float:
    """The motors' lag, which a simulator divides by."""
    if not vehicle["motor_lag"] > 0.0:
        raise InputError(f"{by} by motor_lag: give --set motor_lag=SECONDS")
    return vehicle["motor_lag"]


def _rotorpy_text(vehicle: ExportedVehicle, head: list[str]) -> str:
    """The parameters as a Python module with the dictionary `quad_params`."""
    lag = _divisor(vehicle, "rotorpy: RotorPy divides")
    J = vehicle.inertia_flu
    places = vehicle.rotors_flu_from_cg
    hover = math.sqrt(vehicle["mass"] * GRAVITY / (len(vehicle.rotors) * vehicle["k_T"]))
    drag = (vehicle.get("linear_drag") or 0.0) / (len(vehicle.rotors) * hover)
    directions = ", ".join(str(-rotor.spin) for rotor in vehicle.rotors)
    rows: list[tuple[str, str, str]] = [
        ("mass", number(vehicle["mass"]), "kg"),
        *((n, number(J[a, b]), "kg m^2") for n, (a, b) in _ROTORPY_MATRIX.items()),
        ("num_rotors", str(len(vehicle.rotors)), "in the autopilot's motor order"),
    ]
    return (
        commented(head, "#")
        + "import numpy as np\n\nquad_params = {\n"
        + "".join(_entry(*row) for row in rows)
        + '    "rotor_pos": {  # m from the CG: forward, left, up\n'
        + "".join(
            f'        "r{i}": np.array([{", ".join(map(number, place))}]),\n'
            for i, place in enumerate(places.tolist(), 1)
        )
        + "    },\n"
        + _entry("rotor_directions", f"np.array([{directions}])", "+1 clockwise seen from above")
        + _entry("rI", "np.array([0.0, 0.0, 0.0])", "m, the IMU; not identified")
        + _entry("c_Dx", "0.0", "N/(m/s)^2; not identified, as are c_Dy, c_Dz, k_h and k_flap")
        + "".join(_entry(name, "0.0", "") for name in ("c_Dy", "c_Dz", "k_h", "k_flap"))
        + _entry("k_eta", number(vehicle["k_T"]), "N/(rad/s)^2")
        + _entry("k_m", number(vehicle["k_M"]), "N m/(rad/s)^2")
        + _entry("k_d", number(drag), "N/(rad m/s^2), across")
        + _entry("k_z", number(drag), "N/(rad m/s^2), along the axis")
        + _entry("tau_m", number(lag), "s")
        + _entry("rotor_speed_min", "0.0", "rad/s")
        + _entry("rotor_speed_max", number(vehicle["rotor_speed_max"]), "rad/s")
        + _entry("motor_noise_std", "0.0", "rad/s")
        + "}\n"
    )


_ROTORPY_MATRIX = {
    "Ixx": (0, 0), "Iyy": (1, 1), "Izz": (2, 2), "Ixy": (0, 1), "Iyz": (1, 2), "Ixz": (0, 2),
}  # fmt: skip


def _entry(name: str, value: str, comment: str) -> str:
    return f'    "{name}": {value},' + (f"  # {comment}" if comment else "") + "\n"


def _rotorpy_remarks(vehicle: ExportedVehicle) -> list[str]:
    out = []
    if vehicle.get("linear_drag"):
        out.append(
            "RotorPy's drag grows with rotor speed: k_d and k_z make it linear_drag in hover"
        )
    curve = vehicle.get("thrust_curve")
    if curve is not None and vehicle.known["motor_lag"].origin == "identified":
        out.append("tau_m is the lag of the command, used as that of rotor speed")
    return out


ROTORPY = Format(
    "rotorpy",
    "parameters of RotorPy",
    ".py",
    "RotorPy has",
    needs=("mass", *INERTIA, "cg_x", "cg_y", "k_T", "k_M", "motor_lag", "rotor_speed_max"),
    uses=("linear_drag",),
    text=_rotorpy_text,
    absent={"linear_drag": "without linear_drag there is no drag (k_d = k_z = 0)"},
    remarks=_rotorpy_remarks,
    rotors=4,
)


def _crazyflow_text(vehicle: ExportedVehicle, head: list[str]) -> str:
    """The parameters as a section of TOML."""
    places = vehicle.rotors_flu_from_cg
    L = float(np.abs(places[:, :2]).mean())
    spins = np.array([float(rotor.spin) for rotor in vehicle.rotors])
    mixing = np.stack([places[:, 1] / L, -places[:, 0] / L, -spins])
    k_T, k_M = vehicle["k_T"] / _RPM**2, vehicle["k_M"] / _RPM**2
    rate = 1.0 / _divisor(vehicle, "crazyflow: it divides")
    drag = vehicle.get("linear_drag") or 0.0
    rows = [
        "gravity_vec = [0.0, 0.0, -9.81]",
        f"mass = {number(vehicle['mass'])}  # kg",
        f"L = {number(L)}  # m",
        f"J = {_matrix(vehicle.inertia_flu)}",
        f"prop_inertia = {number(vehicle.get('rotor_inertia') or 0.0)}  # kg m^2",
        "thrust_min = 0.0  # N per motor",
        f"thrust_max = {number(vehicle['T_max'])}",
        f"rpm2thrust = [0.0, 0.0, {number(k_T)}]",
        f"rpm2torque = [0.0, 0.0, {number(k_M)}]",
        f"thrust2torque = {number(vehicle['k_M'] / vehicle['k_T'])}  # m",
        f"rotor_dyn_coef = [{number(rate)}, 0.0, {number(rate)}, 0.0]",
        f"mixing_matrix = {_matrix(mixing)}",
        f"drag_matrix = {_matrix(-drag * np.eye(3))}",
    ]
    return commented(head, "#") + f"\n[{vehicle.name}]\n" + "\n".join(rows) + "\n"


def _matrix(values: Array) -> str:
    rows = ",\n".join("    [" + ", ".join(map(_real, row)) + "]" for row in values.tolist())
    return f"[\n{rows}\n]"


def _real(value: float) -> str:
    """A number of TOML that is no integer: arrays there want one type."""
    text = number(value)
    return text if any(c in text for c in ".en") else text + ".0"


CRAZYFLOW = Format(
    "crazyflow",
    "parameters of crazyflow and drone-models",
    ".toml",
    "crazyflow has",
    needs=("mass", *INERTIA, "cg_x", "cg_y", "k_T", "k_M", "motor_lag", "T_max"),
    uses=("linear_drag", "rotor_inertia"),
    text=_crazyflow_text,
    absent={
        "linear_drag": "without linear_drag there is no drag",
        "rotor_inertia": "without rotor_inertia there is no reaction of the propellers",
    },
    rotors=4,
)


def _l2f_text(vehicle: ExportedVehicle, head: list[str]) -> str:
    """The dynamics as JSON."""
    J = vehicle.inertia_flu
    full, c = vehicle["T_max"], vehicle.get("thrust_curve")
    c = 1.0 if c is None else c
    dynamics = {
        "rotor_positions": vehicle.rotors_flu_from_cg.tolist(),
        "rotor_thrust_directions": [[0.0, 0.0, 1.0]] * len(vehicle.rotors),
        "rotor_torque_directions": [[0.0, 0.0, -float(r.spin)] for r in vehicle.rotors],
        "rotor_thrust_coefficients": [[0.0, full * (1.0 - c), full * c]] * len(vehicle.rotors),
        "rotor_torque_constants": [vehicle["moment_ratio"]] * len(vehicle.rotors),
        "rotor_time_constants_rising": [vehicle["motor_lag"]] * len(vehicle.rotors),
        "rotor_time_constants_falling": [vehicle["motor_lag"]] * len(vehicle.rotors),
        "mass": vehicle["mass"],
        "gravity": [0.0, 0.0, -GRAVITY],
        "J": J.tolist(),
        "J_inv": np.linalg.inv(J).tolist(),
        "hovering_throttle_relative": vehicle.hover_command(c),
        "action_limit": {"min": 0.0, "max": 1.0},
    }
    lines = ",\n".join(map(json.dumps, head))
    body = json.dumps({"dynamics": dynamics}, indent=1, allow_nan=False)
    return f'{{"_comment": [\n{lines}\n],' + body.removeprefix("{") + "\n"


L2F = Format(
    "l2f",
    "dynamics of l2f's parameters",
    ".l2f.json",
    "l2f has",
    needs=("mass", *INERTIA, "cg_x", "cg_y", "T_max", "moment_ratio", "motor_lag"),
    uses=("thrust_curve",),
    text=_l2f_text,
    absent={
        "thrust_curve": "the thrust curve is not known: actions are rotor speeds over the fastest"
    },
    remarks=lambda _: [
        "put `dynamics` in place of that of l2f.parameters_to_json, then parameters_from_json"
    ],
    rotors=4,
)
