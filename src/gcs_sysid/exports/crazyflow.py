"""Parameters of crazyflow and drone-models, as their `params.toml` have them.

One section, for `first_principles`: in crazyflow `dynamics/first_principles/params.toml`, in
drone-models `data/params.toml`. Axes are forward, left, up; speeds are in rpm:

    thrust = rpm2thrust[2] rpm^2,   moments = L mixing_matrix[0:2] thrust
    moment up = mixing_matrix[2] (rpm2torque[2] rpm^2 + prop_inertia Omega')
    Omega' = rotor_dyn_coef[0] (Omega_c - Omega)
"""

import math

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError
from gcs_sysid.exports.exported_vehicle import ExportedVehicle
from gcs_sysid.exports.file_format import FOUR, Format, commented, number
from gcs_sysid.model.parameters import INERTIA

_RPM = 60.0 / (2.0 * math.pi)


def _text(vehicle: ExportedVehicle, head: list[str]) -> str:
    """The parameters as a section of TOML."""
    if not vehicle["motor_lag"] > 0.0:
        raise InputError("crazyflow: it divides by motor_lag: give --set motor_lag=SECONDS")
    places = vehicle.rotors_flu - vehicle.cg_flu
    L = float(np.abs(places[:, :2]).mean())
    spins = np.array([float(rotor.spin) for rotor in vehicle.rotors])
    mixing = np.stack([places[:, 1] / L, -places[:, 0] / L, -spins])
    k_T, k_M = vehicle["k_T"] / _RPM**2, vehicle["k_M"] / _RPM**2
    rate = 1.0 / vehicle["motor_lag"]
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


FORMAT = Format(
    "crazyflow",
    "parameters of crazyflow and drone-models",
    ".toml",
    "crazyflow has",
    needs=("mass", *INERTIA, "cg_x", "cg_y", "k_T", "k_M", "motor_lag", "T_max"),
    uses=("linear_drag", "rotor_inertia"),
    text=_text,
    absent={
        "linear_drag": "without linear_drag there is no drag",
        "rotor_inertia": "without rotor_inertia there is no reaction of the propellers",
    },
    rotors=FOUR,
)
