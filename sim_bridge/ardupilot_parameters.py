"""The few parameters an emulated ArduCopter shows."""

import math

from gcs_sysid.model.airframe import load_airframe
from sim_bridge.ardupilot_instruments import FILTER_HZ
from sim_bridge.simulated_vehicle import Vehicle
from sim_bridge.vehicle_parameters import INT8, INT16, INT32, REAL32, Parameter

PWM_MIN, PWM_MAX = 1000, 2000
"""us, MOT_PWM_MIN and MOT_PWM_MAX."""

SPIN_MIN, SPIN_MAX = 0.15, 0.95
"""Usual MOT_SPIN_MIN and MOT_SPIN_MAX: where in the PWM range thrust begins and ends."""

_X = {4: "ardupilot-quad-x", 6: "ardupilot-hexa-x", 8: "ardupilot-octo-x"}
_NEAR = math.radians(20.0)
_FRAME_CLASSES = {4: 1, 6: 2, 8: 3}
_MOTOR_1 = 33
"""SERVOn_FUNCTION of the first motor; those from the ninth on are numbered apart."""
_MOTOR_9 = 82


_SCRIPTED = 15
"""FRAME_CLASS of motors that are nowhere usual."""


def _is_x(vehicle: Vehicle) -> bool:
    """Whether the rotors are those of FRAME_TYPE 1, X, in ArduPilot's order."""
    name = _X.get(len(vehicle.rotors))
    if name is None:
        return False
    return all(
        ours.spin == usual.spin
        and abs(math.remainder(math.atan2(ours.y, ours.x) - math.atan2(usual.y, usual.x), math.tau))
        < _NEAR
        for ours, usual in zip(vehicle.rotors, load_airframe(name).rotors, strict=True)
    )


def spin_range(vehicle: Vehicle) -> tuple[float, float]:
    """MOT_SPIN_MIN and MOT_SPIN_MAX: from the airframe where it has a range of its own."""
    span = vehicle.command
    if (span.min, span.max) == (PWM_MIN, PWM_MAX):
        return SPIN_MIN, SPIN_MAX
    scale = PWM_MAX - PWM_MIN
    return (span.min - PWM_MIN) / scale, (span.max - PWM_MIN) / scale


def ardupilot_parameters(vehicle: Vehicle, sysid: int) -> list[Parameter]:
    """The parameters, sorted by name.

    None of them reveals a true value: neither mass nor inertia nor thrust is in here, and
    MOT_THST_EXPO is its default, whatever the vehicle's curve.
    """
    n = len(vehicle.rotors)
    spin_min, spin_max = spin_range(vehicle)
    table: dict[str, tuple[int | float, int]] = {
        "AHRS_EKF_TYPE": (3, INT8),
        "ARMING_CHECK": (1, INT32),
        "ATC_ANG_PIT_P": (4.5, REAL32),
        "ATC_ANG_RLL_P": (4.5, REAL32),
        "ATC_ANG_YAW_P": (4.5, REAL32),
        "BATT_CAPACITY": (3300, INT32),
        "FORMAT_VERSION": (120, INT16),
        "FRAME_CLASS": (_FRAME_CLASSES[n] if _is_x(vehicle) else _SCRIPTED, INT8),
        "FRAME_TYPE": (1, INT8),
        "INS_ACCEL_FILTER": (int(FILTER_HZ), INT16),
        "INS_GYRO_FILTER": (int(FILTER_HZ), INT16),
        "INS_GYRO_RATE": (0, INT8),
        "INS_POS1_X": (0.0, REAL32),
        "INS_POS1_Y": (0.0, REAL32),
        "INS_POS1_Z": (0.0, REAL32),
        "MOT_PWM_MAX": (PWM_MAX, INT16),
        "MOT_PWM_MIN": (PWM_MIN, INT16),
        "MOT_SPIN_ARM": (0.1, REAL32),
        "MOT_SPIN_MAX": (spin_max, REAL32),
        "MOT_SPIN_MIN": (spin_min, REAL32),
        "MOT_THST_EXPO": (0.65, REAL32),
        "SCHED_LOOP_RATE": (400, INT16),
        "SERVO_BLH_POLES": (14, INT8),
        "SYSID_THISMAV": (sysid, INT16),
    }
    for i in range(n):
        function = _MOTOR_1 + i if i < 8 else _MOTOR_9 + i - 8
        table[f"SERVO{i + 1}_FUNCTION"] = (function, INT16)
    return [
        Parameter(name, value, kind, bytewise=False)
        for name, (value, kind) in sorted(table.items())
    ]
