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

Both fly a mission (.plan of QGroundControl; MAV_CMD of MAVLink's common.xml), whose places are from
where the simulator begins.
"""

import functools
import math
from collections.abc import Iterable
from itertools import pairwise

import numpy as np

from gcs_sysid.arrays import Array, complete_rows
from gcs_sysid.errors import InputError
from gcs_sysid.exports.exported_vehicle import ExportedVehicle
from gcs_sysid.exports.file_format import Format, commented, number
from gcs_sysid.model.attitude import to_euler
from gcs_sysid.model.parameter_file import parameter_lines
from gcs_sysid.model.parameters import GRAVITY, INERTIA
from gcs_sysid.signals.sampling import SampleBlock
from gcs_sysid.strict_json import json_text

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
    lines = parameter_lines(dict(sorted(values.items())) | whole, {}, ".params")
    return commented([*head, ""], "#") + "\n".join(lines) + "\n"


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
        begins=(47.397742, 8.545594, 489.4),
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
    begins=(-35.363262, 149.165237, 584.0),
)


def mission(blocks: Iterable[SampleBlock], place: tuple[float, float, float], px4: bool) -> str:
    """The way of a log's longest flight as a mission, to be loaded by hand.

    Straight legs at even speed that are nowhere off the way by more than a meter; a leg of less is
    a hover of that long. What the attitude does quickly is not in a mission.

    Args:
        blocks: of the log.
        place: deg north and east, m above the sea, where the simulator begins.
        px4: whether it is PX4's, else ArduPilot's.

    Raises:
        InputError: the log has no velocity in flight.
    """
    rows = [
        np.column_stack([b.t, b.samples.velocity, to_euler(b.samples.attitude)[:, 2]])[b.flying]
        for b in blocks
    ]
    flown = np.concatenate([np.empty((0, 5)), *rows])
    flown = flown[complete_rows(flown)]
    apart = np.flatnonzero(np.diff(flown[:, 0]) > 1.0) + 1
    flown = max(np.split(flown, apart), key=len)
    if len(flown) < 2:
        raise InputError("--along: the log has no flight with velocity and attitude")
    steps = 0.5 * np.diff(flown[:, :1], axis=0) * (flown[1:, 1:4] + flown[:-1, 1:4])
    way = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    t = np.arange(flown[0, 0], flown[-1, 0], 0.5)
    way = np.column_stack([np.interp(t, flown[:, 0], column) for column in way.T])
    heading = np.degrees(np.interp(t, flown[:, 0], np.unwrap(flown[:, 4]))) % 360.0
    ends = _legs(t, way, 1.0)
    items: list[tuple[int, tuple[float | None, ...], Array]] = []
    way[:, 2] -= max(way[:, 2].max() + 2.0, 0.0)  # nothing flies a leg on the ground
    items.append((22, (0.0, 0.0, 0.0, heading[0]), way[0]))
    for first, last in pairwise(ends):
        seconds, length = t[last] - t[first], float(np.linalg.norm(way[last] - way[first]))
        if length < 1.0:
            items.append((19, (seconds, 0.0, 0.0, heading[last]), way[last]))
            continue
        items.append((178, (1.0, length / seconds, -1.0, 0.0), np.zeros(3)))
        items.append((16, (0.0, 1.0, 0.0, heading[last]), way[last]))
    items.append((21, (0.0, 0.0, 0.0, None), way[-1] * [1.0, 1.0, 0.0]))
    # By the sphere of WGS84's equator, within centimeters over a kilometer.
    north = math.degrees(1.0 / 6378137.0)
    east = north / math.cos(math.radians(place[0]))
    listed = []
    for count, (command, parameters, (x, y, z)) in enumerate(items, 1):
        there = (place[0] + north * x, place[1] + east * y, -z) if command != 178 else (0, 0, 0)
        listed.append({
            "type": "SimpleItem", "autoContinue": True, "command": command, "doJumpId": count,
            "frame": 3 if command != 178 else 2, "params": [*parameters, *there],
        })  # fmt: skip
    plan = {
        "fileType": "Plan", "version": 1, "groundStation": "QGroundControl",
        "mission": {
            "version": 2, "firmwareType": 12 if px4 else 3, "vehicleType": 2, "cruiseSpeed": 15,
            "hoverSpeed": 5, "plannedHomePosition": list(place), "items": listed,
        },
        "geoFence": {"circles": [], "polygons": [], "version": 2},
        "rallyPoints": {"points": [], "version": 2},
    }  # fmt: skip
    return json_text(plan, indent=1) + "\n"


def _legs(t: Array, way: Array, off: float) -> list[int]:
    """Where straight legs at even speed end that leave (n, 3) places at t by `off` at most."""
    ends = [0]
    for k in range(1, len(t)):
        part = slice(ends[-1], k + 1)
        share = (t[part] - t[part][0]) / (t[k] - t[part][0])
        leg = way[part][0] + share[:, None] * (way[k] - way[part][0])
        if np.linalg.norm(way[part] - leg, axis=1).max() > off:
            ends.append(k - 1)
    return [*ends, len(t) - 1]
