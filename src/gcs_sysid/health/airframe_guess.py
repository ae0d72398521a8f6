"""Where the rotors are, by the airframe file or by the autopilot's own parameters."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import Airframe, Rotor, load_airframe
from gcs_sysid.session.reported_layout import reported_layout
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.vehicles import Vehicle

_ROTORS = {
    mavlink.MAV_TYPE_QUADROTOR: "quad",
    mavlink.MAV_TYPE_HEXAROTOR: "hexa",
    mavlink.MAV_TYPE_OCTOROTOR: "octo",
}
ASSUMED = "assumed"
"""In the words of an origin, after the order of motors."""
_USUAL_ARM = 0.25
"""m, where unknown."""
_UNKNOWN_ARM = 0.5
"""Relative standard deviation of an arm that was not given."""
_REAL = (0.02, 5.0)
"""m: rotors of CA_ROTORn_P* in meters lie between; stock simulators have 1 for all."""


@dataclass(frozen=True)
class GuessedAirframe:
    """An airframe and its origin.

    Attributes:
        airframe: with or without a scale.
        origin: in words.
        arm_std: relative standard deviation of its size.
        relative: whether positions are already those from the CG, as PX4's are meant to be.
        assumed: whether the order of its rotors follows from the vehicle's type alone.
        shown: whether these rotors' moments turn the vehicle, as far as a flight shows.
        explained: share of roll or pitch acceleration, the lesser, that their moments explain over
            tenths of a second; None where too little was flown.
        as_flown: where the motors are by the motion, in words, where that contradicts `airframe`.
    """

    airframe: Airframe
    origin: str
    arm_std: float = 0.0
    relative: bool = False
    assumed: bool = False
    shown: bool = False
    explained: float | None = None
    as_flown: str = ""


def guess_airframe(
    vehicle: Vehicle, parameters: Mapping[str, float], given: Airframe | None, arm: float | None
) -> GuessedAirframe:
    """The airframe given, else one by the log.

    Args:
        vehicle: that flew.
        parameters: its autopilot's.
        given: by the user.
        arm: m, mean distance of the rotors, for one that is not given.

    Raises:
        InputError: the rotor positions are unknown.
    """
    if given is not None:
        return GuessedAirframe(given, f"{given.name}, as given")
    found = _of_px4(parameters) if vehicle.key == "px4" else None
    if found is None:
        found = _by_type(vehicle, parameters)
    if arm is not None:
        layout = found.origin.partition(", its arm")[0]
        origin = f"{layout}, {arm:g} m from the center to a rotor"
        return replace(found, airframe=found.airframe.with_arm(arm), origin=origin, arm_std=0.0)
    return found


def _bare(airframe: Airframe) -> Airframe:
    return replace(airframe, mass=None, k_T=None, T_max=None, priors={})


def _of_px4(parameters: Mapping[str, float]) -> GuessedAirframe | None:
    count = int(parameters.get("CA_ROTOR_COUNT", 0.0))
    if not 4 <= count <= 12:
        return None
    rotors = []
    for i in range(count):
        x, y = (parameters.get(f"CA_ROTOR{i}_P{axis}") for axis in "XY")
        turn = parameters.get(f"CA_ROTOR{i}_KM")
        if x is None or y is None or not turn:
            return None
        rotors.append(Rotor(x, y, 1 if turn > 0.0 else -1))
    airframe = Airframe("CA_ROTOR", tuple(rotors))
    metres = all(_REAL[0] < math.hypot(r.x, r.y) < _REAL[1] for r in rotors)
    unit = all(abs(r.x) in (0.0, 1.0) and abs(r.y) in (0.0, 1.0) for r in rotors)
    if metres and not unit:
        return GuessedAirframe(airframe, "CA_ROTORn_* of the vehicle", 0.0, relative=True)
    return GuessedAirframe(
        airframe.with_arm(_USUAL_ARM),
        f"CA_ROTORn_* of the vehicle, its arm of {_USUAL_ARM:g} m assumed: give --arm",
        _UNKNOWN_ARM,
    )


def _by_type(vehicle: Vehicle, parameters: Mapping[str, float]) -> GuessedAirframe:
    size = f"its arm of {_USUAL_ARM:g} m assumed: give --arm"
    shape = _ROTORS.get(vehicle.vehicle_type or 0)
    reported = reported_layout(vehicle.key, parameters)
    if reported is not None:
        airframe = Airframe("reported", reported.rotors).with_arm(_USUAL_ARM)
        return GuessedAirframe(airframe, f"{reported.by}, {size}", _UNKNOWN_ARM)
    if vehicle.key == "ardupilot" and {"FRAME_CLASS", "FRAME_TYPE"} <= set(parameters):
        raise InputError(
            f"where are the rotors? FRAME_CLASS {parameters['FRAME_CLASS']:.0f} and FRAME_TYPE "
            f"{parameters['FRAME_TYPE']:.0f} are not a known frame: give --airframe FILE.toml "
            "(gcs-sysid airframe new writes one)"
        )
    if shape is None:
        raise InputError(
            "where are the rotors? The log does not hold the frame: give --airframe FILE.toml "
            "(gcs-sysid airframe new writes one)"
        )
    if vehicle.key not in ("px4", "ardupilot"):
        if shape != "quad":
            raise InputError("where are the rotors? Give --airframe FILE.toml")
        airframe = _bare(load_airframe("betaflight-quad-x"))
        origin = f"quad X in Betaflight's order {ASSUMED}"
    else:
        airframe = _bare(load_airframe(f"{vehicle.key}-{shape}-x"))
        origin = f"{shape} X in the autopilot's order {ASSUMED}"
    airframe = airframe.with_arm(_USUAL_ARM)
    return GuessedAirframe(airframe, f"{origin}, {size}", _UNKNOWN_ARM, assumed=True)
