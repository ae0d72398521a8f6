"""What a pilot does with the health of a vehicle, a sentence each."""

import math

from gcs_sysid.health.airframe_guess import GuessedAirframe
from gcs_sysid.health.hover_tuning import TUNING
from gcs_sysid.health.vehicle_health import Health, HealthOptions
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.results.number_format import PLAIN

_AXES = (("forward", "aft"), ("right", "left"))


def advice_of(health: Health, given: HealthOptions, guess: GuessedAirframe) -> tuple[str, ...]:
    """All that is worth doing, the most important first."""
    out: list[str] = []
    conditions = [health.condition, None if health.weakened is None else health.weakened.condition]
    weak = [c.rotor for c in conditions if c is not None and c.verdict == "rotor"]
    for rotor in dict.fromkeys(weak):
        assert rotor is not None
        out.append(f"look at rotor {rotor + 1}: propeller, motor bearing and ESC")
    if health.condition is not None and health.condition.verdict == "unclear":
        out.append(
            "if nothing was moved or loaded since the flight before, --unchanged names the rotor"
        )
    unlike = _unlike_motors(health)
    out += unlike or [*_cg(health, given), *_yaw(health)]
    out += _margins(health)
    if not unlike and health.condition is None and health.available and len(health.rotors) == 4:
        out.append(
            "a weak propeller looks like a CG shift on four rotors in one flight: pass an earlier "
            "flight as --baseline, or fly once more with the load moved"
        )
    if guess.arm_std:
        out.append("give --arm: the CG in mm scales with it")
    if health.scale is None and health.rotor_input is not None and health.available:
        out.append(f"weigh the vehicle and give --mass KG for {health.rotor_input.thrust}")
    if health.through_motors:
        out.append(
            "log rotor speeds (ESC telemetry): from commands, a weak motor looks like a shifted CG"
        )
    return tuple(out)


def _cg(health: Health, given: HealthOptions) -> list[str]:
    if health.cg is None or health.airframe is None:
        return []
    moves = []
    for place, (positive, negative) in zip(health.cg, _AXES, strict=True):
        value, half = place.value, place.half
        assert value is not None
        assert half is not None
        if abs(value) < max(half, TUNING.worth_moving * health.airframe.arm):
            continue
        scale = 1.0
        if given.battery_mass is not None and health.known_mass is not None:
            scale = health.known_mass / given.battery_mass
        way = negative if value > 0.0 else positive
        moves.append(f"{PLAIN.measure(1e3 * scale * abs(value), 1e3 * scale * half, 'mm')} {way}")
    if not moves:
        return []
    if given.battery_mass is not None and health.known_mass is not None:
        return [f"move the battery {' and '.join(moves)}"]
    return [
        f"shift the CG {' and '.join(moves)}. Battery travel = shift × vehicle mass / battery mass "
        "(computed with --mass and --battery-mass)"
    ]


def _yaw(health: Health) -> list[str]:
    """What holds the heading in hover, where that is a lot."""
    share = health.yaw_imbalance
    if share is None or share.value is None or share.std is None:
        return []
    if abs(share.value) - TUNING.sure * share.std < TUNING.much_yaw:
        return []
    more, less = "counter-clockwise", "clockwise"
    if share.value < 0.0:
        more, less = less, more
    return [
        f"to hold the heading the {more} rotors carry {100.0 * abs(share.value):.0f} % of the load "
        f"more than the {less} ones: look for a motor that leans or an arm that is twisted"
    ]


def _unlike_motors(health: Health) -> list[str]:
    """Motors that turn otherwise for their command than the others, by more than chance.

    Their speeds or their commands then do not say what they lift, nor where the CG is.
    """
    out = []
    for i, rotor in enumerate(health.rotors, 1):
        gain = rotor.motor_gain
        if gain is None or gain.value is None or gain.std is None:
            continue
        off = abs(gain.value - 1.0) - TUNING.sure * gain.std
        if off > TUNING.motor_scatter:
            percent = 100.0 * abs(1.0 - gain.value)
            way = "less" if gain.value < 1.0 else "more"
            out.append(f"motor {i} reaches {percent:.0f} % {way} speed squared at its command")
    if not out:
        return []
    return [
        f"{', '.join(out)} than the mean of all: another motor or propeller, a weak motor or ESC, "
        "or its pole count. What the CG and yaw are, and whether to move anything, shows once that "
        "is clear"
    ]


def _margins(health: Health) -> list[str]:
    out = []
    ratio = health.thrust_to_weight
    if (
        ratio is not None
        and ratio.value is not None
        and ratio.value < TUNING.least_thrust_to_weight
    ):
        out.append(
            f"full thrust is {ratio.value:.1f} times the weight: less than "
            f"{TUNING.least_thrust_to_weight:g} leaves little to control with; lighten it"
        )
    for i, rotor in enumerate(health.rotors, 1):
        if rotor.saturated is not None and rotor.saturated > TUNING.much_saturated:
            out.append(
                f"rotor {i} was at full command for {100.0 * rotor.saturated:.1f} % of the flight"
            )
    level = [r.vibration.value for r in health.rotors if r.vibration and r.vibration.value]
    if len(level) == len(health.rotors) and len(level) > 2:
        for i, rotor in enumerate(health.rotors, 1):
            assert rotor.vibration is not None
            assert rotor.vibration.value is not None
            others = sorted(level)[: len(level) - 1]
            usual = math.sqrt(sum(v * v for v in others) / len(others))
            if rotor.vibration.value > max(TUNING.shaking * usual, TUNING.least_shaking):
                out.append(f"rotor {i} shakes at its own frequency: balance its propeller")
    return out


def arrow(health: Health) -> tuple[Estimate, Estimate] | None:
    """What the battery, or whatever moves, should go by; None where the CG is good."""
    if health.cg is None:
        return None
    x, y = health.cg
    if x.value is None or y.value is None:
        return None
    return Estimate(-x.value, x.std, "m"), Estimate(-y.value, y.std, "m")
