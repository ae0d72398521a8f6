"""Vehicles drawn from the covariance of a result, as an ensemble for simulators and margins."""

from dataclasses import replace

import numpy as np

from gcs_sysid.exports.exported_vehicle import ExportedVehicle, KnownEstimate, complete
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.parameters import INERTIA, REGISTRY


def drawn_vehicles(vehicle: ExportedVehicle, count: int, seed: int) -> list[ExportedVehicle]:
    """Vehicles drawn from the covariance of one, each a possible rigid body.

    Parameters with an entry in the covariance of the result are drawn together; others by their
    own standard deviation, where they have one. What must be positive is.

    Args:
        vehicle: the nominal one.
        count: how many.
        seed: of the draws.

    Raises:
        InputError: what was given contradicts itself.
        ValueError: the covariance is no such matrix, or hardly a draw is a rigid body.
    """
    random = np.random.default_rng(seed)
    names, root = _root(vehicle)
    out: list[ExportedVehicle] = []
    for _ in range(50 * max(count, 1)):  # nearly all draws are bodies
        if len(out) == count:
            return out
        shift = dict(zip(names, root @ random.standard_normal(len(names)), strict=True))
        one = _shifted(vehicle, shift)
        if one is not None:
            out.append(one)
    if len(out) == count:
        return out
    raise ValueError("the intervals are too wide: hardly any draw from them is a rigid body")


def _root(vehicle: ExportedVehicle) -> tuple[list[str], np.ndarray]:
    """Names and (n, n) root of the covariance of all that has a standard deviation."""
    known = {
        name: quantity.std
        for name, quantity in vehicle.known.items()
        if quantity.std and not quantity.derived
    }
    names = list(known)
    covariance = np.diag([float(std) ** 2 for std in known.values()])
    table = vehicle.result.covariance
    listed = list(table.get("names", []))
    matrix = np.array(table.get("matrix", []), float).reshape(-1, max(len(listed), 1))
    if len(matrix) != len(listed) or not np.isfinite(matrix).all():
        raise ValueError("the covariance of the result is not a square matrix of numbers")
    # A value from elsewhere is uncorrelated with the flight's.
    own = [n for n in names if n in listed and vehicle.known[n].origin in _OF_THE_FLIGHT]
    if own:
        here, there = [names.index(n) for n in own], [listed.index(n) for n in own]
        covariance[np.ix_(here, here)] = matrix[np.ix_(there, there)]
    if not names:
        return names, np.zeros((0, 0))
    # Units differ by many powers of ten.
    scale = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return names, scale[:, None] * vectors * np.sqrt(values.clip(0.0))


_OF_THE_FLIGHT = ("identified", "weak", "zero", "given")


def _shifted(vehicle: ExportedVehicle, shift: dict[str, float]) -> ExportedVehicle | None:
    """The vehicle with values moved; None where there can be no such thing."""
    known: dict[str, KnownEstimate] = {}
    for name, quantity in vehicle.known.items():
        if quantity.derived:
            continue
        value = quantity.value + shift.get(name, 0.0)
        sign = REGISTRY[name].sign if name in REGISTRY else "positive"
        if sign == "positive" and value <= 0.0:
            return None
        known[name] = replace(quantity, value=max(value, 0.0) if sign == "not negative" else value)
    if {"k_T", "k_M", "moment_ratio"} <= known.keys():
        # Two give the third.
        ratio = known["k_M"].value / known["k_T"].value
        known["moment_ratio"] = replace(known["moment_ratio"], value=ratio)
    if {"k_T", "T_max", "rotor_speed_max"} <= known.keys():
        del known["rotor_speed_max"]
    complete(known)
    if all(n in known for n in INERTIA):
        elements = np.array([known[n].value for n in INERTIA])
        if not rb.is_physical(elements):
            return None
    return replace(vehicle, known=known)
