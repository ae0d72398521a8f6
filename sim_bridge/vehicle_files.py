"""Reading a vehicle's true parameters: built-in ones, or an airframe file's [simulation] table."""

import math
import tomllib
from collections.abc import Mapping
from importlib import resources
from typing import Any

import numpy as np

from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import (
    SIMULATION_TABLE,
    Airframe,
    builtin_names,
    parse_airframe,
    read_airframe_table,
)
from gcs_sysid.model.parameters import REGISTRY
from sim_bridge.simulated_vehicle import LAGS, Vehicle, hover_thrusts

_KNOWN = tuple(name for name in REGISTRY if name in Vehicle.__dataclass_fields__)
_REQUIRED = tuple(name for name in _KNOWN if REGISTRY[name].sign == "positive")
_IMU = ("imu_x", "imu_y", "imu_z")


def vehicle_names() -> list[str]:
    """Airframes whose true parameters come with the emulator, sorted."""
    folder = resources.files("sim_bridge") / "vehicles"
    return sorted(f.name[:-5] for f in folder.iterdir() if f.name.endswith(".toml"))


def load_vehicle(name_or_path: str, arm: float | None = None) -> Vehicle:
    """The true vehicle for a built-in airframe, or from an airframe file's [simulation] table.

    Args:
        name_or_path: built-in airframe name or TOML file.
        arm: scale the layout to this mean rotor distance in m.

    Raises:
        InputError: no such airframe, no true parameters for it, or a value makes no sense.
    """
    table, where = read_airframe_table(name_or_path)
    airframe = parse_airframe(table, where)
    if name_or_path in builtin_names():
        if name_or_path not in vehicle_names():
            raise InputError(f"{where}: the emulator has no true parameters for it")
        text = (resources.files("sim_bridge") / "vehicles" / f"{name_or_path}.toml").read_text(
            encoding="utf-8"
        )
        parameters: object = tomllib.loads(text)
        where = f"built-in vehicle {name_or_path!r}"
    elif SIMULATION_TABLE in table:
        parameters = table[SIMULATION_TABLE]
        where = f"{where}: [{SIMULATION_TABLE}]"
    else:
        raise InputError(
            f"{where}: a [{SIMULATION_TABLE}] table with the true parameters is needed to fly it "
            f"({', '.join(_REQUIRED)}, ...)"
        )
    if arm is not None:
        airframe = airframe.with_arm(arm)
    return make_vehicle(airframe, parameters, where)


def make_vehicle(airframe: Airframe, parameters: object, where: str) -> Vehicle:
    """Put an airframe and a table of true parameters together.

    The mass and the thrust curve may come from the airframe when the table leaves them out.

    Raises:
        InputError: a key is unknown or missing, or a value makes no sense.
    """
    if not isinstance(parameters, Mapping):
        raise InputError(f"{where} must be a table")
    values = dict(parameters)
    lag_of = values.pop("lag_of", "speed")
    if lag_of not in LAGS:
        raise InputError(f"{where}: lag_of must be one of {', '.join(LAGS)}, got {lag_of!r}")
    known = {*_KNOWN, *_IMU, "lag_of"}
    for key in values:
        if key not in known:
            raise InputError(f"{where}: unknown key {key!r}; known are {', '.join(sorted(known))}")
    if airframe.mass is not None:
        values.setdefault("mass", airframe.mass)
    if airframe.T_max is not None:
        values.setdefault("T_max", airframe.T_max)
    if airframe.k_T is not None:
        values.setdefault("k_T", airframe.k_T)
    if airframe.command.thrust_curve is not None:
        values.setdefault("thrust_curve", airframe.command.thrust_curve)
    for key in _REQUIRED:
        if key not in values:
            raise InputError(f"{where}: {key} is missing")
    for key, value in values.items():
        _check_value(key, value, f"{where}: {key}")
    numbers: dict[str, Any] = {key: float(value) for key, value in values.items()}
    vehicle = Vehicle(
        name=airframe.name,
        rotors=airframe.rotors,
        command=airframe.command,
        lag_of=lag_of,
        **numbers,
    )
    _check_inertia(vehicle, where)
    check_hover(vehicle, where)
    return vehicle


def _check_value(key: str, value: object, where: str) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{where} must be a number, got {value!r}")
    sign = REGISTRY[key].sign if key in _KNOWN else "any"
    if sign == "positive" and value <= 0:
        raise InputError(f"{where} must be positive, got {value:g}")
    if sign == "not negative" and value < 0:
        raise InputError(f"{where} must not be negative, got {value:g}")
    if key == "thrust_curve" and not 0.0 <= value <= 1.0:
        raise InputError(f"{where} must lie in 0..1, got {value:g}")


def _check_inertia(v: Vehicle, where: str) -> None:
    J = np.array([[v.Ixx, v.Ixy, v.Ixz], [v.Ixy, v.Iyy, v.Iyz], [v.Ixz, v.Iyz, v.Izz]])
    a, b, c = np.linalg.eigvalsh(J)
    # The principal moments of any real body are positive and obey the triangle inequality.
    if a <= 0 or a + b < c:
        raise InputError(
            f"{where}: no body has this inertia matrix (principal moments "
            f"{a:.4g}, {b:.4g}, {c:.4g} kg m^2)"
        )


def check_hover(v: Vehicle, where: str) -> None:
    """See that the rotors can hold the vehicle.

    Raises:
        InputError: one would have to pull downwards, or has too little left to control with.
    """
    shares = hover_thrusts(v)
    if min(shares) <= 0.0:
        raise InputError(f"{where}: the CG is so far out that a rotor would have to push down")
    if max(shares) >= 0.9 * v.T_max:
        raise InputError(
            f"{where}: T_max of {v.T_max:g} N is too little: "
            f"the most loaded rotor needs {max(shares):.3g} N to hover"
        )
