"""What a pilot does with the health of a vehicle, a sentence each."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from gcs_sysid.health.health_file import condition_text
from gcs_sysid.health.hover_tuning import TUNING
from gcs_sysid.health.vehicle_health import Finding, Health
from gcs_sysid.judgement.status import OF_THE_DATA, READINGS
from gcs_sysid.model.airframe import USUAL
from gcs_sysid.results.health_view import WAYS, cg_length
from gcs_sysid.results.words import PLAIN, decimals_for
from gcs_sysid.signals.rotor_readings import unlike_load

_BY_BATTERY = (
    "Battery travel = shift × vehicle mass / battery mass (computed with --mass and --battery-mass)"
)
_PARTS = ("propeller and pole count of the ESC", "propeller, motor and ESC")
"""What makes a rotor unlike the others, by its speed and by its command."""


def advised(health: Health) -> Health:
    """The health with what is found in it and all that is worth doing, the most important first."""
    at_full = _at_full_command(health)
    rotors = [*_weak(health), *_unlike_motors(health), *_unlike_loads(health)]
    # Where rotors differ, their loads show neither the CG nor what holds the heading.
    unlike = (
        bool(health.misread)
        or any(found.spoils for found in rotors)
        or any(doubt.by == READINGS for doubt in health.doubts)
    )
    findings = (
        *(
            Finding(
                OF_THE_DATA[doubt.by],
                doubt.reason,
                doubt.how or doubt.reason,
                spoils=doubt.verdict != "identified",
            )
            for doubt in health.doubts
        ),
        *_misread(health),
        *rotors,
        *(() if unlike else (*_cg(health), *_yaw(health))),
        *_margins(health),
        *_pinned(health, at_full),
        *_shaking(health),
    )
    advice = [
        *(found.do for found in findings),
        *_to_know_more(health, unlike=unlike),
        *(f"{name} was {what}" for name, what in at_full.items()),
    ]
    return replace(health, findings=findings, advice=tuple(dict.fromkeys(advice)))


def _misread(health: Health) -> Iterator[Finding]:
    """Rotor streams that are not used, each for a cause and perhaps with what to do."""
    for name, why in health.misread.items():
        what, _, do = why.partition(": ")
        yield Finding("the rotors", f"{name}: {what}", do or f"{name}: {what}")


def _to_know_more(health: Health, *, unlike: bool) -> Iterator[str]:
    """What would say more of a vehicle in which nothing need be wrong."""
    if not health.arm_known:
        yield "give --arm M, from the center to a motor: the CG is in mm then"
    weighed = health.known_mass is not None
    if health.scale is None and health.rotor_input is not None and not weighed:
        yield f"weigh the vehicle and give --mass KG for {health.rotor_input.thrust}"
    if health.condition is None and len(health.rotors) == 4 and not unlike:
        yield (
            "a weak propeller looks like a CG shift on four rotors in one flight: pass an earlier "
            "flight as --baseline, or fly once more with the load moved"
        )
    if health.through_motors:
        yield (
            "log rotor speeds (ESC telemetry): from commands, a weak motor looks like a shifted CG"
        )


def _weak(health: Health) -> Iterator[Finding]:
    """Rotors that have changed since the baseline, or in the flight."""
    weakened = health.weakened
    for condition, since in (
        (health.condition, ""),
        (None if weakened is None else weakened.condition, "in this flight"),
    ):
        if condition is None:
            continue
        if condition.verdict == "rotor" and condition.rotor is not None:
            name = f"rotor {condition.rotor + 1}"
            less = condition_text(condition).removeprefix(f"{name} gives ")
            yield Finding(
                name, less.replace("than before", since or "than before"),
                f"look at {name}: propeller, motor bearing and ESC", spoils=True,
            )  # fmt: skip
        elif condition.verdict == "unclear":
            yield Finding(
                "rotors and load", condition_text(condition),
                "if nothing was moved or loaded since the flight before, --unchanged names the "
                "rotor",
            )  # fmt: skip


def _perhaps_unlike(health: Health) -> tuple[str, str] | None:
    """What else than a CG the loads may show: the rotors that are unlike, and those to look at.

    The balance of a hover has four equations: every load is that of some CG and yaw trim, and of
    one rotor, or those of one side, that lift another amount for their speed or command. Moments
    in flight decide (an analysis), speeds beside commands, and flights before.

    Returns:
        None where that is decided, or nothing is known of them.
    """
    gains = all(rotor.motor_gain is not None for rotor in health.rotors)
    moved = health.condition is not None and health.condition.verdict == "cg"
    shares = [rotor.thrust_share.value for rotor in health.rotors]
    if gains or moved or health.cg_of_hover is not None or None in shares:
        return None
    apart = np.array(shares, dtype=float)
    apart -= np.median(apart)
    large = np.flatnonzero(np.abs(apart) >= 0.5 * np.abs(apart).max())
    if len(large) == 1:
        rotor = f"rotor {large[0] + 1}"
        return f"{rotor} unlike the others", rotor
    # Either side may be the one that is wrong.
    return "the rotors of one side unlike those of the other", "all rotors"


def _cg(health: Health) -> Iterator[Finding]:
    if health.cg is None or health.airframe is None:
        return
    off, moves = [], []
    mass, battery = health.known_mass, health.battery_mass
    scale = 1.0 if battery is None or mass is None else mass / battery
    arm = health.airframe.arm
    for place, ways in zip(health.cg, WAYS.values(), strict=True):
        value, half, unit = cg_length(place.value, place.std, arm, health.arm_std)
        worth, _, _ = cg_length(TUNING.worth_moving * arm, 0.0, arm, health.arm_std)
        if abs(value) < max(half, worth):
            continue
        where, back = ways if value > 0.0 else ways[::-1]
        off.append(f"{abs(value):.{decimals_for(half, most=1)}f} {unit} {where}")
        moves.append(f"{PLAIN.measure(scale * abs(value), scale * half, unit)} {back}")
    if not moves:
        return
    what, do = f"{' and '.join(off)} of the center", f"shift the CG {' and '.join(moves)}"
    if battery is not None and mass is not None:
        do = f"move the battery {' and '.join(moves)}"
    if rotors := _perhaps_unlike(health):
        unlike, where = rotors
        what += f", or {unlike}"
        do = (
            f"hold it at its center: if it tips that way, {do}; if not, look at {where}: "
            f"{_PARTS[health.through_motors]}"
        )
    if battery is None or mass is None:
        do += f". {_BY_BATTERY}"
    yield Finding("the CG", what, do)


def _yaw(health: Health) -> Iterator[Finding]:
    """What holds the heading in hover, where that is a lot."""
    share = health.yaw_imbalance
    if share is None:
        return
    if abs(share.value) - TUNING.sure * share.std < TUNING.much_yaw:
        return
    more, less = "counter-clockwise", "clockwise"
    if share.value < 0.0:
        more, less = less, more
    percent = 100.0 * abs(share.value)
    rotors = _perhaps_unlike(health)
    or_rotors = f", or for what is wrong with {rotors[1]}" if rotors else ""
    yield Finding(
        "the motors' angles",
        f"{more} rotors carry {percent:.0f} % of the load more",
        f"to hold the heading the {more} rotors carry {percent:.0f} % of the load more than the "
        f"{less} ones: look for a motor that leans or an arm that is twisted{or_rotors}",
    )


def _unlike_motors(health: Health) -> list[Finding]:
    """Motors that turn otherwise for their command than the others, by more than chance.

    Their speeds or their commands then do not say what they lift, nor where the CG is.
    """
    off = []
    for i, rotor in enumerate(health.rotors, 1):
        gain = rotor.motor_gain
        if gain is None:
            continue
        if abs(gain.value - 1.0) - TUNING.sure * gain.std > TUNING.motor_scatter:
            percent = 100.0 * abs(1.0 - gain.value)
            way = "less" if gain.value < 1.0 else "more"
            off.append((i, f"reaches {percent:.0f} % {way} speed squared at its command", percent))
    off.sort(key=lambda each: -each[2])  # what is off the most moves the mean
    if not off:
        return []
    named = ", ".join(f"motor {i} {what}" for i, what, _ in off)
    do = (
        f"{named} than the mean of all: another motor or propeller, a weak motor or ESC, "
        "or its pole count. What the CG and yaw are, and whether to move anything, shows once that "
        "is clear"
    )
    return [Finding(f"motor {i}", what, do, spoils=True) for i, what, _ in off]


def _unlike_loads(health: Health) -> Iterator[Finding]:
    """A rotor of six or more that carries what no CG asks of it: CG and yaw are open then."""
    shares = [rotor.thrust_share.value for rotor in health.rotors]
    if health.airframe is None or health.cg_of_hover is not None or None in shares:
        return
    loads = np.array(shares, dtype=float)
    scatter = health.airframe.uncertainty.rotor_thrust.of(1.0) or USUAL.rotor_thrust.of(1.0)
    if health.through_motors:  # which scatter, too
        scatter = math.hypot(scatter, TUNING.motor_scatter)
    likely, over = unlike_load(loads, health.airframe.geometry, scatter)
    if not likely:
        return
    name = "rotor " + " or ".join(str(i + 1) for i in likely)
    by = ("speed", "command")[health.through_motors]
    way = "more" if over > 1.0 else "less"
    what = f"by its {by} carries {100.0 * abs(over - 1.0):.0f} % {way} than balances the others"
    do = (
        f"{name} {what}: look at {_PARTS[health.through_motors]}. What the CG and yaw are, and "
        "whether to move anything, shows once that is clear"
    )
    yield Finding(name, what, do, spoils=True)


def _margins(health: Health) -> Iterator[Finding]:
    ratio = health.thrust_to_weight
    if ratio is None:
        return
    if ratio.value + TUNING.sure * ratio.std < TUNING.least_thrust_to_weight:
        full = f"full thrust is {ratio.value:.1f} times the weight"
        least = f"less than {TUNING.least_thrust_to_weight:g} leaves little to control with"
        yield Finding("the weight", full, f"{full}: {least}; lighten it")


def _at_full_command(health: Health) -> dict[str, str]:
    """Rotors that were at full command, and for how long: mostly how it was flown."""
    return {
        f"rotor {i}": f"at full command for {100.0 * rotor.saturated:.1f} % of the flight"
        for i, rotor in enumerate(health.rotors, 1)
        if rotor.saturated is not None and rotor.saturated > TUNING.much_saturated
    }


def _pinned(health: Health, at_full: Mapping[str, str]) -> Iterator[Finding]:
    """One that is at full command while no other ever is: it does not give what is asked for."""
    if len(at_full) == 1 and sum(bool(rotor.saturated) for rotor in health.rotors) == 1:
        ((name, what),) = at_full.items()
        yield Finding(
            name,
            f"{what}, no other ever",
            f"look at {name}: propeller, motor and ESC",
            spoils=True,
        )


def _shaking(health: Health) -> Iterator[Finding]:
    level = [r.vibration.value for r in health.rotors if r.vibration and r.vibration.value]
    if len(level) != len(health.rotors) or len(level) < 3:
        return
    others = sorted(level)[: len(level) - 1]
    usual = math.sqrt(sum(v * v for v in others) / len(others))
    for i, own in enumerate(level, 1):
        if own > max(TUNING.shaking * usual, TUNING.least_shaking):
            what = "shakes at its own frequency"
            yield Finding(f"rotor {i}", what, f"rotor {i} {what}: balance its propeller")
