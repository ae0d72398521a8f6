"""Which rotor telemetry identification would use: a plain judgement by ranges and rates."""

from collections.abc import Sequence

from gcs_sysid.session.inspection.facts import RotorInput, RotorSource
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.vehicles import Vehicle

LEAST_RATE = 15.0
"""Hz below which rotor telemetry tells nothing of how the vehicle turns."""

_ROTORS = {
    mavlink.MAV_TYPE_TRICOPTER: 3,
    mavlink.MAV_TYPE_QUADROTOR: 4,
    mavlink.MAV_TYPE_HEXAROTOR: 6,
    mavlink.MAV_TYPE_OCTOROTOR: 8,
    mavlink.MAV_TYPE_DECAROTOR: 10,
    mavlink.MAV_TYPE_DODECAROTOR: 12,
}


def rotor_count(vehicle: Vehicle | None) -> int | None:
    """How many rotors a vehicle has by its type; None when that does not tell."""
    return None if vehicle is None else _ROTORS.get(vehicle.vehicle_type or -1)


def choose_rotor_input(sources: Sequence[RotorSource], *, flown: bool) -> RotorInput:
    """Choose the soundest source: measured speeds before commands, then the faster.

    Args:
        sources: all that there are.
        flown: whether they were seen in flight; without, only rates can be judged.
    """
    best_first = sorted(sources, key=lambda s: (s.kind == "command", -(s.rate or 0.0)))
    reasons: list[str] = []
    chosen = None
    for source in best_first:
        fault = _fault(source, flown=flown)
        if not fault:
            chosen = source
            break
        reasons.append(f"{source.message}: {fault}")
    if chosen is not None and chosen.kind == "command":
        measured = any(source.kind == "speed" for source in sources)
        what = "no sound rotor speeds" if measured else "no measured rotor speeds"
        reasons.append(f"{what}: {chosen.message}'s commands stand in")
    return RotorInput(chosen, tuple(reasons))


def _fault(source: RotorSource, *, flown: bool) -> str:
    """Why a source cannot be used, in a few words; "" when it can."""
    if source.rate is None or source.rate < LEAST_RATE:
        return f"too slow ({source.rate or 0.0:.1f} Hz)"
    if not flown:
        return ""
    if len(source.rotors) < 3:
        return f"tells of {len(source.rotors)} rotors only"
    dead = source.dead
    new = source.rate * (1.0 - 0.01 * source.repeats_percent)
    if source.kind == "speed" and not dead and new < LEAST_RATE:
        return f"repeats old readings, {new:.0f} new ones a second"
    if len(dead) == len(source.rotors):
        return "all zero in flight" if source.kind == "speed" else "does not change in flight"
    if dead:
        motors = ", ".join(map(str, dead))
        return f"motor {motors} tells nothing while the others turn"
    return ""
