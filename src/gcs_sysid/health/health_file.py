"""Health as a file, and a change of the rotors in words."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from gcs_sysid.errors import InputError
from gcs_sysid.files import read_text
from gcs_sysid.health.autopilot_parameters import proposed
from gcs_sysid.health.rotor_condition import Condition, Load
from gcs_sysid.health.vehicle_health import Baseline, Health
from gcs_sysid.judgement.status import hover_verdict
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.results.health_view import first_answer, off_words
from gcs_sysid.results.words import PLAIN
from gcs_sysid.strict_json import parse_json

SCHEMA = "gcs-sysid-health/1"


def document_of(health: Health) -> dict[str, Any]:
    """The health file's content."""

    def plain(quantity: Estimate | None) -> dict[str, Any] | None:
        return None if quantity is None else quantity.as_json()

    out: dict[str, Any] = {
        "schema": SCHEMA,
        "source": health.source,
        "vehicle": dict(health.vehicle),
        "verdict": hover_verdict(health.objections, hovers=health.available),
        "reasons": list(health.reasons),
        "objections": [objection.as_json() for objection in health.objections],
        "seconds_of_hover": health.seconds,
        "rotor_input": health.rotor_input,
        "rotor_source": health.rotor_source or None,
        "cg": None if health.cg is None else {"x": plain(health.cg[0]), "y": plain(health.cg[1])},
        **(
            {}
            if health.cg_of_hover is None
            else {"cg_by_hover": dict(zip("xy", map(plain, health.cg_of_hover), strict=True))}
        ),
        "cg_by_wind": (
            None if health.by_wind is None else dict(zip("xy", health.by_wind, strict=True))
        ),
        "rotors": [rotor.as_json() for rotor in health.rotors],
        "yaw_imbalance": plain(health.yaw_imbalance),
        "hover_throttle": plain(health.hover_throttle),
        "hover_thrust": plain(health.hover_thrust),
        "thrust_to_weight": plain(health.thrust_to_weight),
        "thrust_curve": None if health.curve is None else plain(health.curve.c),
        "drift_per_minute": plain(health.drift),
        "motor_lag": health.motor_lag,
        "condition": None if health.condition is None else health.condition.as_json(),
        "not_compared": health.apart or None,
        "weakened": None if health.weakened is None else health.weakened.as_json(),
        "stretches_watched": health.watched,
        "load": None if health.load is None else health.load.as_json(),
        "airframe": None if health.airframe is None else health.airframe.as_json(),
        "arm": (
            None
            if health.airframe is None
            else {"value": health.airframe.arm, "std": health.arm_std, "unit": "m"}
        ),
        "autopilot_parameters": {
            one.name: {**one.quantity.as_json(), "now": one.now, "note": one.note}
            for one in proposed([health])
            if one.quantity is not None
        },
        "assumptions": list(health.assumptions),
        "order_contradicted": health.contradicted,
        "findings": [asdict(found) for found in health.findings],
        "advice": list(health.advice),
    }
    if health.scale is not None:
        out[health.scale[0]] = plain(health.scale[1])
    if health.mass is not None:
        out["mass"] = plain(health.mass)
    return {**out, "summary": first_answer(out).as_json()}


def read_baseline(path: Path) -> Baseline:
    """An earlier flight's health file, or a result that has one under `health`.

    Raises:
        InputError: it cannot be read, or holds no health.
    """
    table = parse_json(read_text(path, "the baseline"), str(path))
    table = table.get("health", table) if isinstance(table, dict) else table
    try:
        if table["schema"] != SCHEMA:
            raise ValueError
        cg = table.get("cg_by_hover") or table["cg"]
        return Baseline(
            str(table["source"]),
            Load.of_json(table["load"]),
            (float(cg["x"]["value"]), float(cg["y"]["value"])),
        )
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise InputError(
            f"{path}: not a health file; write one with gcs-sysid health LOG --json"
        ) from error


def condition_text(condition: Condition) -> str:
    """What became of the rotors, in words."""
    if condition.verdict == "unchanged":
        return "rotors and CG as in the flight before"
    if condition.verdict == "rotor" and condition.rotor is not None and condition.loss is not None:
        loss = PLAIN.measure(
            100.0 * condition.loss.value, 100.0 * (condition.loss.half or 0.0), "%"
        )
        return f"rotor {condition.rotor + 1} gives {loss} less thrust than before"
    if condition.verdict == "all":
        change = 100.0 * float(condition.changes.mean())
        return f"all rotors do {change:+.1f} % for the same thrust: air, battery or payload"
    moved = off_words(*condition.moved)
    if condition.verdict == "cg":
        return f"the CG moved by {moved}"
    which = (
        "a weak rotor" if condition.suspect is None else f"rotor {condition.suspect + 1} is weak"
    )
    return (
        f"something changed: {which}, or the CG moved by {moved}; these data cannot separate them"
    )
