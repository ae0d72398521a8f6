"""What a person is shown of a vehicle's health, from a health file's content."""

from collections.abc import Mapping
from typing import Any

from gcs_sysid.intervals import Z95
from gcs_sysid.results.number_format import PLAIN, Notation, decimals_for

_WORDS = {
    "yaw_imbalance": ("yaw imbalance", 100.0, "% of the load", ", ccw minus cw"),
    "hover_throttle": ("hover throttle", 100.0, "%", ""),
    "thrust_to_weight": ("full thrust", 1.0, "times the weight", ""),
    "drift_per_minute": ("thrust drift", 100.0, "% a minute", ", for the same command"),
}
"""Name, factor, unit and what one may know besides, by key of the file."""


def half_of(quantity: Mapping[str, Any]) -> float:
    """Half of a quantity's 95 % interval; 0 where it is exact."""
    return Z95 * float(quantity["std"] or 0.0)


def health_fact(
    health: Mapping[str, Any], key: str, notation: Notation = PLAIN, *, whole: bool = False
) -> tuple[str, str] | None:
    """The name of a number and its value with its interval; None where it is not known.

    Args:
        health: the file's content.
        key: of the number in it.
        notation: of numbers.
        whole: whether all is said, where there is room.
    """
    quantity = health[key]
    if quantity is None or quantity["value"] is None:
        return None
    name, factor, unit, besides = _WORDS[key]
    text = notation.measure(factor * quantity["value"], factor * half_of(quantity), unit)
    return name, text + besides * whole


def cg_facts(
    health: Mapping[str, Any], notation: Notation = PLAIN
) -> list[tuple[str, str, str, str]]:
    """Where the center of gravity is, along and across.

    Returns:
        For each: name, distance with its interval, way, and the half interval of rotors that are
        identical, in mm.
    """
    out = []
    for name, axis, ways in (
        ("along", "x", ("forward", "aft")),
        ("across", "y", ("right", "left")),
    ):
        quantity = health["cg"][axis]
        value, std = quantity["value"] or 0.0, quantity["std"] or 0.0
        size = notation.measure(1e3 * abs(value), 1e3 * half_of(quantity), "mm")
        alike = 1e3 * Z95 * max(std**2 - quantity["std_given"] ** 2, 0.0) ** 0.5
        identical = notation.fixed(alike, decimals_for(max(alike, 0.01)))
        out.append((f"CG {name}", size, ways[value < 0.0], f"identical rotors: ± {identical} mm"))
    return out
