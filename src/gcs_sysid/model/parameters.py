"""Names, units and meaning of every parameter that can be identified.

The order here is the order of tables, screens and files.
"""

from dataclasses import dataclass

GRAVITY = 9.80665
"""Standard gravity in m/s^2."""


@dataclass(frozen=True)
class Parameter:
    """One physical parameter: its name in results, symbol in text, SI unit and meaning."""

    name: str
    symbol: str
    unit: str
    meaning: str


PARAMETERS: dict[str, Parameter] = {
    p.name: p
    for p in (
        Parameter("mass", "m", "kg", "mass of the whole vehicle"),
        Parameter("Ixx", "Ixx", "kg m^2", "moment of inertia about the body x axis"),
        Parameter("Iyy", "Iyy", "kg m^2", "moment of inertia about the body y axis"),
        Parameter("Izz", "Izz", "kg m^2", "moment of inertia about the body z axis"),
        Parameter("Ixy", "Ixy", "kg m^2", "inertia matrix element [x, y]"),
        Parameter("Iyz", "Iyz", "kg m^2", "inertia matrix element [y, z]"),
        Parameter("Ixz", "Ixz", "kg m^2", "inertia matrix element [x, z]"),
        Parameter("cg_x", "α", "m", "CG from the geometric centre, forward"),
        Parameter("cg_y", "β", "m", "CG from the geometric centre, to the right"),
        Parameter("k_T", "k_T", "N s^2", "thrust of a rotor over its speed squared"),
        Parameter("k_M", "k_M", "N m s^2", "torque of a rotor over its speed squared"),
        Parameter("T_max", "T_max", "N", "thrust of a rotor at full command"),
        Parameter("thrust_curve", "c", "1", "T/T_max = (1-c) u + c u^2"),
        Parameter("moment_ratio", "k_M/k_T", "m", "rotor torque over rotor thrust"),
        Parameter("rotational_damping", "d", "N m s", "damping torque over body rate"),
        Parameter("rotor_inertia", "J_r", "kg m^2", "inertia of one rotor about its axis"),
        Parameter("linear_drag", "D", "N s/m", "drag force over velocity"),
    )
}
"""Every parameter of a result, by name (units and names as in the result's JSON)."""

TIMING: dict[str, Parameter] = {
    p.name: p
    for p in (
        Parameter("rotor_delay", "τ_r", "s", "rotor stream behind the IMU stream"),
        Parameter("motor_lag", "τ_m", "s", "first-order lag from command to rotor speed"),
    )
}
"""Timing values of a result, by name."""
