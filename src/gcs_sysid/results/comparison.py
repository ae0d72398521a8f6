"""Has the vehicle changed? Two results, parameter by parameter.

The difference of two estimates has the variance of both together. One interval in twenty misses
by chance, so many parameters would make a change of nothing: whether any has changed is decided
for all of them together (`significance`).
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from gcs_sysid.errors import InputError
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import REGISTRY
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.results.result import Result
from gcs_sysid.results.result_data import Scale
from gcs_sysid.results.words import Change
from gcs_sysid.significance import FALSE_ALARM_RATE, chance, holm, interval95

SCHEMA = "gcs-sysid/compare/1"

_KNOWN = {name: parameter for name, parameter in REGISTRY.items() if parameter.of_vehicle}


@dataclass(frozen=True)
class Difference:
    """One parameter in both results.

    Attributes:
        name: of the parameter.
        before: in the first result, None where it is not there.
        after: in the second.
        value: after - before; None where either has no value.
        std: of the difference.
        p: probability of a difference as large by chance; None where it is unknown.
        p_holm: the same, corrected for the number of parameters tested (Holm).
        verdict: in one word.
        why: the verdict is no better.
    """

    name: str
    before: Estimate | None
    after: Estimate | None
    value: float | None
    std: float | None
    p: float | None
    p_holm: float | None
    verdict: Change
    why: str = ""

    @property
    def unit(self) -> str:
        """Of A's value, or of both."""
        found = self.before or self.after
        return _KNOWN[self.name].unit if found is None else found.unit

    @property
    def ci95(self) -> tuple[float, float] | None:
        """The 95 % interval of the difference, of this parameter alone."""
        return interval95(self.value, self.std)

    def as_json(self) -> dict[str, Any]:
        """The difference as `--json` writes it."""
        return {
            "before": None if self.before is None else self.before.as_json(),
            "after": None if self.after is None else self.after.as_json(),
            "difference": self.value,
            "ci95": None if self.ci95 is None else list(self.ci95),
            "unit": self.unit,
            "p": self.p,
            "p_holm": self.p_holm,
            "verdict": self.verdict,
            "why": self.why,
        }


@dataclass(frozen=True)
class Comparison:
    """What two results say of one vehicle.

    Attributes:
        before: the first result.
        after: the second.
        differences: by parameter, in the order of tables.
        verdict: of all together.
        notes: what it rests on and what it does not show.
    """

    before: Result
    after: Result
    differences: dict[str, Difference]
    verdict: Change
    notes: tuple[str, ...]

    def named(self, verdict: Change) -> list[str]:
        """Parameters of this verdict."""
        return [name for name, found in self.differences.items() if found.verdict == verdict]

    def as_json(self) -> dict[str, Any]:
        """The comparison as `--json` writes it."""
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            **{
                key: {
                    "source": result.source,
                    "verdict": result.verdict,
                    "vehicle": result.vehicle,
                    "scale": None if result.scale is None else result.scale.as_json(),
                }
                for key, result in (("before", self.before), ("after", self.after))
            },
            "parameters": {name: found.as_json() for name, found in self.differences.items()},
            "notes": list(self.notes),
        }


def comparison_sentences(comparison: Comparison) -> list[str]:
    """Has the vehicle changed, in a sentence or two."""
    changed, same = comparison.named("changed"), comparison.named("no_change_seen")
    by_reason: dict[str, list[str]] = {}
    for name in comparison.named("cannot_tell"):
        by_reason.setdefault(comparison.differences[name].why, []).append(name)
    unknown = "; ".join(f"{', '.join(names)} ({why})" for why, names in by_reason.items())
    if comparison.verdict == "cannot_tell":
        sentences = ["Undetermined: no parameter is identified in both results."]
    elif changed:
        sentences = [f"The vehicle has changed: {', '.join(changed)}."]
    else:
        sentences = [f"No change seen in {', '.join(same)}."]
    return [*sentences, f"Undetermined: {unknown}."] if unknown else sentences


def compare(before: Result, after: Result) -> Comparison:
    """Compare two results.

    Raises:
        InputError: they are of vehicles with another number of rotors.

    Example:
        >>> import gcs_sysid
        >>> first, second = (
        ...     gcs_sysid.analyze("logs/sample.tlog", "paper", start=start, end=start + 20.0)
        ...     for start in (0.0, 20.0)
        ... )
        >>> compare(first, second).verdict
        'no_change_seen'
    """
    notes = [*_rotor_notes(before, after), *_flight_notes(before, after)]
    names = [n for n in _KNOWN if any(n in r.estimates for r in (before, after))]
    found = {name: _difference(name, before, after) for name in names}
    found = _corrected(found)
    notes += _scale_notes(before, after, found)
    changed = any(difference.verdict == "changed" for difference in found.values())
    compared = any(difference.p is not None for difference in found.values())
    verdict: Change = "changed" if changed else "no_change_seen" if compared else "cannot_tell"
    return Comparison(before, after, found, verdict, tuple(notes))


def _difference(name: str, before: Result, after: Result) -> Difference:
    first, second = before.estimates.get(name), after.estimates.get(name)
    values: list[tuple[float, float]] = []
    for estimate, result, which in ((first, before, "A"), (second, after, "B")):
        why = ""
        if estimate is None or estimate.value is None or estimate.std is None:
            why = f"not in {which}"
        elif estimate.status == "unobservable":
            why = f"unobservable in {which}"
        elif first and second and first.unit != second.unit:
            why = f"{which} is in {estimate.unit}"
        elif (
            result.scale is None
            and not result.airframe.get("own_units")
            and _KNOWN[name].scale != "none"
        ):
            why = f"{which} has no scale"
        else:
            # What was given is wrong by as much in both.
            values.append((estimate.value, estimate.std_data or 0.0))
        if why:
            return Difference(name, first, second, None, None, None, None, "cannot_tell", why)
    value = values[1][0] - values[0][0]
    std = math.hypot(values[0][1], values[1][1])
    why = _doubt(first, second) or ("given in both" if std == 0.0 else "")
    if why:
        return Difference(name, first, second, value, std, None, None, "cannot_tell", why)
    p = chance(value, std)
    return Difference(name, first, second, value, std, p, None, "no_change_seen")


def _doubt(first: Estimate | None, second: Estimate | None) -> str:
    """Why a difference says little of the vehicle, empty where it does say something."""
    both = {"A": first, "B": second}
    weak = [which for which, e in both.items() if e is not None and e.status == "weak"]
    if weak:
        return f"weak in {' and '.join(weak)}"
    leaning = [which for which, e in both.items() if e is not None and e.rests_on == "prior"]
    return f"mostly from a prior in {' and '.join(leaning)}" if leaning else ""


def _corrected(found: Mapping[str, Difference]) -> dict[str, Difference]:
    """With verdicts for all together."""
    tested = {name: d.p for name, d in found.items() if d.p is not None}
    out = dict(found)
    for name, p in zip(tested, holm([*tested.values()]), strict=True):
        verdict: Change = "changed" if p < FALSE_ALARM_RATE else "no_change_seen"
        out[name] = replace(found[name], p_holm=p, verdict=verdict)
    return out


def _rotor_notes(before: Result, after: Result) -> Iterable[str]:
    """Whether the rotors are the same.

    Raises:
        InputError: there are more or fewer of them.
    """
    layouts = before.layout, after.layout
    if layouts[0] is None or layouts[1] is None:
        yield "a result has no rotor positions: assumed to be the same"
        return
    first, second = layouts[0].geometry, layouts[1].geometry
    if first.shape != second.shape:
        raise InputError(
            f"{before.source or 'A'} has {first.shape[1]} rotors, {after.source or 'B'} has "
            f"{second.shape[1]}: not the same vehicle"
        )
    if abs(first - second).max() > 1e-6:
        yield (
            "A and B were analyzed with different rotor positions or spins, which may explain "
            "differences of CG, inertia and torque"
        )


def _flight_notes(before: Result, after: Result) -> Iterable[str]:
    if before.source == after.source:
        yield f"both come from {before.source or 'one flight'}: they are not independent"
    if before.vehicle != after.vehicle:
        yield "A and B have different autopilots or system IDs: same vehicle?"
    if before.rotor_input != after.rotor_input:
        yield ("one uses rotor speeds, the other commands: thrust coefficients cannot be compared")
    for which, result in (("A", before), ("B", after)):
        changes = [e for e in result.events if "detected" in e and e.get("kind") != "disturbance"]
        if changes:
            yield f"{which} changed in flight: its parameters are those at the end"


def _scale_notes(before: Result, after: Result, found: Mapping[str, Difference]) -> Iterable[str]:
    first, second = before.scale, after.scale
    if first is None or second is None:
        if not (before.airframe.get("own_units") or after.airframe.get("own_units")):
            yield "without a scale only lengths compare"
        return
    if first.anchor != second.anchor:
        yield (
            f"scale of A: {_anchor(first)}, of B: {_anchor(second)}: a factor common to mass, "
            "inertia and coefficients may come from the scale"
        )
    elif first.value == second.value:
        yield (
            f"scale of both: {_anchor(first)}; if it differed between the flights, mass, inertia "
            "and coefficients are off by one factor"
        )
    else:
        yield f"scale of A: {_anchor(first)}, of B: {_anchor(second)}, as given"
    if first.std == 0.0 or second.std == 0.0:
        yield (
            "intervals do not include errors of what was given (arm, scale, ...): the same in both "
            "flights of one vehicle"
        )
    if first.anchor == second.anchor == "mass":
        yield from _suspicion(second.value, found)


def _suspicion(mass: float, found: Mapping[str, Difference]) -> Iterable[str]:
    """Where thrust changed at given masses, the mass that would leave it as it was."""
    for name in (kind.thrust for kind in RotorInput):
        thrust = found.get(name)
        if thrust is None or thrust.verdict != "changed":
            continue
        before, after = _value(thrust.before), _value(thrust.after)
        if before <= 0.0 or after <= 0.0:
            continue  # no mass makes up for rotors without thrust
        ratio = before / after
        yield (
            f"{name} changed at the given masses: rotors, air or battery changed, or the mass "
            f"of B is not {mass:.4g} kg but about {mass * ratio:.4g} kg"
        )


def _value(estimate: Estimate | None) -> float:
    value = None if estimate is None else estimate.value
    return math.nan if value is None else value


def _anchor(scale: Scale) -> str:
    return f"{scale.anchor} = {scale.value:.6g} {scale.unit}"
