"""Control effectiveness: G1 and G2 of INDI for Indiflight and Paparazzi.

    [f_z, p', q', r'] = G1 u + G2 u',   axes forward, right, down

G1 is what a rotor's thrust does to the specific force along z and to the angular accelerations;
G2 what the change of its speed does to yaw, by the rotor's inertia.

Indiflight (`flight/indi.h`, `indi_init.c`): u is a rotor's thrust over its full thrust; G1 in
(m/s^2) * 100 and (rad/s^2) * 10, G2 in (rad/s^2) / (rad/s^2) * 1e5, integers.
Paparazzi (`stabilization_indi.c`; Smeur et al. 2016): u is a command of 0 to 9600, its effect that
around hover, scaled by 1000; G2 is that of the change of u from one period to the next, at 512 Hz.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.exports.exported_vehicle import ExportedVehicle
from gcs_sysid.exports.file_format import Format, commented, number, xml_comment
from gcs_sysid.model.parameters import AXES, INERTIA

_PPRZ, _SCALE, _RATE = 9600.0, 1000.0, 512.0
"""Largest command, INDI_G_SCALING and PERIODIC_FREQUENCY of Paparazzi."""


def g1(vehicle: ExportedVehicle) -> Array:
    """(4, n) effect of each rotor's thrust over its full thrust on f_z, p', q', r'; SI."""
    x = np.array([r.x for r in vehicle.rotors]) - vehicle["cg_x"]
    y = np.array([r.y for r in vehicle.rotors]) - vehicle["cg_y"]
    spin = np.array([float(r.spin) for r in vehicle.rotors])
    moments = np.stack([-y, x, spin * vehicle["moment_ratio"]])
    angular = np.linalg.solve(vehicle.inertia, moments)
    force = np.full((1, len(x)), -1.0 / vehicle["mass"])
    return np.vstack([force, angular]) * vehicle["T_max"]


def g2(vehicle: ExportedVehicle) -> Array:
    """(3, n) effect of each rotor's acceleration in rad/s^2 on p', q', r'; zero if not known."""
    spin = np.array([float(r.spin) for r in vehicle.rotors])
    inertia = vehicle.get("rotor_inertia") or 0.0
    moments = np.stack([0.0 * spin, 0.0 * spin, inertia * spin])
    return np.linalg.solve(vehicle.inertia, moments)


def effect_range(vehicle: ExportedVehicle, drawn: Sequence[ExportedVehicle], low: float) -> Array:
    """(3, 2) least and most that rotors turn drawn vehicles by, over what they do this one.

    INDI holds angular acceleration by what its last command did. With the same filters on both,
    small gain keeps that stable while the true effect is 0 to 2 times the one it is given. `low` is
    the share of the thrust that a low battery leaves.
    """
    nominal = g1(vehicle)[1:]
    along = np.array([(g1(one)[1:] * nominal).sum(axis=1) for one in (vehicle, *drawn)])
    along = along / (nominal**2).sum(axis=1)
    return np.column_stack([low * along.min(axis=0), along.max(axis=0)])


def _indiflight_g1(vehicle: ExportedVehicle) -> Array:
    return g1(vehicle) * [[100.0], [10.0], [10.0], [10.0]]


def _indiflight_text(vehicle: ExportedVehicle, head: list[str]) -> str:
    """Lines for Indiflight's CLI."""
    n = len(vehicle.rotors)
    effect, reaction = _indiflight_g1(vehicle), g2(vehicle) * 1e5
    names = ("fz", *AXES)
    rows = [f"set indi_act_num = {n}"]
    rows += [f"set indi_act_g1_{axis} = {_integers(np.zeros(n))}" for axis in ("fx", "fy")]
    rows += [
        f"set indi_act_g1_{a} = {_integers(row)}" for a, row in zip(names, effect, strict=True)
    ]
    rows += [
        f"set indi_act_g2_{axis} = {_integers(row)}"
        for axis, row in zip(names[1:], reaction, strict=True)
    ]
    lag = np.full(n, 1e3 * vehicle["motor_lag"])
    rows.append(f"set indi_act_time_const_ms = {_integers(lag, 255)}")
    k_T = vehicle.get("k_T")
    if k_T is not None:
        full = math.sqrt(vehicle["T_max"] / k_T)
        for name, speed in (("hover", vehicle.hover_speed), ("max", full)):
            rpm = np.full(n, speed * 60.0 / (2.0 * math.pi))
            rows.append(f"set indi_act_{name}_rpm = {_integers(rpm, 10**6)}")
    c = vehicle.get("thrust_curve")
    if c is not None:
        curve = np.full(n, 100.0 * min(max(c, 0.0), 1.0))
        rows.append(f"set indi_act_nonlinearity = {_integers(curve)}")
    return commented(head, "#") + "\n".join(rows) + "\n"


def _integers(values: Array, most: int = 32767) -> str:
    return ",".join(str(int(v)) for v in np.clip(np.rint(values), -most, most))


def _paparazzi_text(vehicle: ExportedVehicle, head: list[str]) -> str:
    """A section of Paparazzi's airframe file."""
    n = len(vehicle.rotors)
    # Thrust over full thrust per command, around hover.
    c = vehicle.get("thrust_curve") or 0.0
    slope = (1.0 - c + 2.0 * c * vehicle.hover_command(c)) / _PPRZ * _SCALE
    force, *angular = g1(vehicle) * slope
    k_T = vehicle.get("k_T")
    yaw = np.zeros(n)
    if k_T is not None:
        # Omega goes with the root of thrust: dOmega = dT / (2 k_T Omega).
        yaw = g2(vehicle)[2] * vehicle["T_max"] * slope / (2.0 * k_T * vehicle.hover_speed) * _RATE
    rows = [
        *zip(("G1_ROLL", "G1_PITCH", "G1_YAW"), angular, strict=True),
        ("G1_THRUST", force),
        ("G2", yaw),
        ("ACT_FREQ", np.full(n, 1.0 / max(vehicle["motor_lag"], 1e-3))),
    ]
    lines = [
        f'  <define name="{name}" value="{", ".join(map(number, values))}" type="float[]"/>'
        for name, values in rows
    ]
    return (
        xml_comment(head)
        + '<section name="STABILIZATION_ATTITUDE_INDI" prefix="STABILIZATION_INDI_">\n'
        + "\n".join(lines)
        + "\n</section>\n"
    )


def _indiflight_remarks(vehicle: ExportedVehicle) -> list[str]:
    if np.abs(_indiflight_g1(vehicle)).max() > 32767 or np.abs(g2(vehicle)).max() * 1e5 > 32767:
        return ["some values exceed Indiflight's 16 bits and are cut off"]
    return []


INDIFLIGHT_FORMAT = Format(
    "indiflight",
    "effectiveness for Indiflight, lines of its CLI",
    ".txt",
    "INDI has",
    needs=("mass", *INERTIA, "cg_x", "cg_y", "T_max", "moment_ratio", "motor_lag"),
    text=_indiflight_text,
    uses=("k_T", "rotor_inertia", "thrust_curve"),
    absent={
        "rotor_inertia": "rotor_inertia is not known: G2 is zero",
        "k_T": "k_T is not known: rotor speeds are left out",
    },
    remarks=_indiflight_remarks,
)
PAPARAZZI_FORMAT = replace(
    INDIFLIGHT_FORMAT,
    name="paparazzi",
    title="effectiveness for Paparazzi, a section of its airframe file",
    suffix=".paparazzi.xml",
    text=_paparazzi_text,
    remarks=lambda _: [
        f"commands of 0 to {_PPRZ:g} span the range of outputs; G2 is for {_RATE:g} Hz"
    ],
)
