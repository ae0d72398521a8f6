"""The vehicle to be exported: identified parameters, completed by given ones.

Nothing is invented here. A parameter is known because the flight determined it, because it was
given, or because it follows from two that are. Simulators and margins can have an ensemble of such
vehicles too, drawn from the covariance of a result.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Self

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.errors import GcsSysidError, InputError
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.airframe import ANCHORS, Airframe, Rotor
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import GRAVITY, INERTIA, REGISTRY, Sign
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.results.parameter_samples import covariance_of, covariance_root, physical
from gcs_sysid.results.result import Result

UNITS = {name: p.unit for name, p in REGISTRY.items() if p.of_vehicle} | {
    "rotor_speed_max": "rad/s"
}
"""Everything that a vehicle here may know; `rotor_speed_max` is the speed at full command."""

_FOLLOWS = {"k_T": ("k_M",), "k_M": ("moment_ratio",), "moment_ratio": ("k_M",)}
"""Values computed again where one is given in place of the flight's."""
_APART = 0.02
"""Relative difference from which k_T, T_max and rotor_speed_max contradict."""

_FULL_SPEED = ("k_T", "k_M", "T_max", "rotor_speed_max")

FLU = np.diag([1.0, -1.0, -1.0])
"""From forward, right, down to forward, left, up, and back."""


def _sign(name: str) -> Sign:
    return "positive" if name == "rotor_speed_max" else REGISTRY[name].sign


class MissingError(GcsSysidError):
    """The data do not hold what a file cannot do without (exit status 1)."""


@dataclass(frozen=True)
class KnownEstimate(Estimate):
    """A parameter with a value; `std` is None where it is not known.

    Attributes:
        origin: the flight's status ("identified", "weak", "given"), else where it comes from.
    """

    value: float
    origin: str = ""

    @property
    def derived(self) -> bool:
        """Whether it follows from two others, and is computed again where these change."""
        return self.origin.startswith("from ")


@dataclass(frozen=True)
class ExportedVehicle:
    """What is known of a vehicle; axes forward, right, down.

    Attributes:
        name: for the file, made of letters, digits and underscores.
        rotors: in the autopilot's motor order, seen from the geometric center.
        known: parameter name (of `UNITS`) -> value.
        result: that most of it comes from.
    """

    name: str
    rotors: tuple[Rotor, ...]
    known: Mapping[str, KnownEstimate]
    result: Result

    def get(self, name: str) -> float | None:
        """The value of a parameter, None where it is not known.

        What no vehicle has below zero is zero where the flight says less.
        """
        if name not in self.known:
            return None
        value = self.known[name].value
        return max(value, 0.0) if _sign(name) == "not negative" else value

    def __getitem__(self, name: str) -> float:
        """The value of a parameter that is known, after `need`."""
        value = self.get(name)
        if value is None:
            raise KeyError(name)
        return value

    def need(self, target: str, names: Iterable[str]) -> None:
        """Check that these are known.

        Raises:
            MissingError: names all that are not, and what to do.
        """
        missing = [name for name in names if name not in self.known]
        if not missing:
            return
        listed = ", ".join(missing)
        if self.result.scale is None and "mass" in missing:
            raise MissingError(
                f"{target} needs {listed}: the result has no scale; weigh the vehicle and "
                "analyze again with --mass KG"
            )
        # k_T, T_max and rotor_speed_max: two give the third.
        by_full_speed = [name for name in missing if name in _FULL_SPEED]
        if ("k_T" in self.known) == ("T_max" in self.known):
            by_full_speed = []
        rest = [name for name in missing if name not in by_full_speed]
        advice = []
        if rest:
            again = "" if rest == ["motor_lag"] else "fly again so that it does, or "
            advice.append(again + "give " + " ".join(f"--set {name}=VALUE" for name in rest))
        if by_full_speed:
            advice.append("give --set rotor_speed_max=RAD_S, the rotors' speed at full command")
        raise MissingError(
            f"{target} needs {listed}, which this result does not have: {'; '.join(advice)}"
        )

    def check_inertia(self) -> None:
        """Check that a rigid body can have this inertia, as simulators do.

        Raises:
            MissingError: none can.
        """
        if not rb.is_physical(np.array([self[name] for name in INERTIA])):
            raise MissingError(
                "no rigid body has this inertia (one principal moment exceeds the sum of the "
                "others): fly again, or give some of "
                + ", ".join(INERTIA)
                + " with --set NAME=VALUE"
            )

    @property
    def rotors_differ(self) -> bool:
        """Whether the flight determines k_T and k_M of each rotor, and none was given by hand."""
        own = self.result.rotors
        return (
            len(own) == len(self.rotors)
            and all(rotor[name].shown for rotor in own for name in ("k_T", "k_M") if name in rotor)
            and all({"k_T", "k_M"} <= rotor.keys() for rotor in own)
            and all(self.known[n].origin == "identified" for n in ("k_T", "k_M") if n in self.known)
        )

    def rotor_coefficients(self, rotor: int) -> tuple[float, float]:
        """k_T in N s^2 and moment ratio in m of one rotor: its own where rotors differ.

        In a vehicle drawn from the covariance the rotors keep their proportions.
        """
        k_T, ratio = self["k_T"], self["moment_ratio"]
        if not self.rotors_differ:
            return k_T, ratio
        own = [{n: e.value or 0.0 for n, e in r.items()} for r in self.result.rotors]
        mean_T, mean_M = (sum(r[n] for r in own) / len(own) for n in ("k_T", "k_M"))
        share_T, share_M = own[rotor]["k_T"] / mean_T, own[rotor]["k_M"] / mean_M
        return k_T * share_T, ratio * share_M / share_T

    @property
    def hover_speed(self) -> float:
        """Speed of a rotor in hover, rad/s, after `need` of mass and k_T."""
        return math.sqrt(self["mass"] * GRAVITY / (len(self.rotors) * self["k_T"]))

    @property
    def hover_load(self) -> float:
        """Thrust of a rotor in hover over its full thrust, after `need` of mass and T_max."""
        return self["mass"] * GRAVITY / (len(self.rotors) * self["T_max"])

    def hover_command(self, curve: float) -> float:
        """Command of a rotor in hover by a thrust curve, after `need` of mass and T_max."""
        return float(RotorInput.COMMAND.at_load(np.array(self.hover_load), np.array(curve)))

    @property
    def inertia(self) -> Array:
        """(3, 3) matrix about the CG, kg m^2, axes forward, right, down."""
        return rb.inertia_matrix(np.array([self[name] for name in INERTIA]))

    @property
    def inertia_flu(self) -> Array:
        """The same with axes forward, left, up: Ixy and Ixz change sign."""
        return FLU @ self.inertia @ FLU

    def changed(self, payload: float, place: Array, full: float) -> Self:
        """The vehicle with a point mass besides, and another full thrust of its rotors.

        Args:
            payload: kg.
            place: (3,) m forward and right of the geometric center, and below the CG.
            full: thrust at full command over the usual.
        """
        known, mass = dict(self.known), self["mass"]
        cg = np.array([self.get("cg_x") or 0.0, self.get("cg_y") or 0.0, 0.0])
        share, arm = payload / (mass + payload), place - cg
        inertia = rb.inertia_matrix(np.array([self.get(name) or 0.0 for name in INERTIA]))
        # About the CG of both, which is that share of the way.
        inertia = inertia + mass * share * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        elements = inertia[[0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]
        values = dict(zip(INERTIA, elements.tolist(), strict=True))
        values |= dict(zip(("cg_x", "cg_y"), (cg + share * arm)[:2].tolist(), strict=True))
        values |= {"mass": mass + payload, "T_max": full * self["T_max"]}
        for name, value in values.items():
            known[name] = replace(known.get(name, KnownEstimate(0.0, None)), value=value)
        return replace(self, known=known)

    @property
    def cg_flu(self) -> Array:
        """(3,) CG from the geometric center, m, forward, left, up; its height is not observable in
        flight.
        """
        return np.array([self["cg_x"], -self["cg_y"], 0.0])

    @property
    def rotors_flu(self) -> Array:
        """(n, 3) rotors from the geometric center, m, forward, left, up."""
        return np.array([[r.x, -r.y, 0.0] for r in self.rotors])

    @property
    def rotors_flu_from_cg(self) -> Array:
        """The same from the CG."""
        return self.rotors_flu - self.cg_flu


def assemble(
    result: Result,
    airframe: Airframe | None = None,
    given: Mapping[str, float] = MappingProxyType({}),
    name: str | None = None,
) -> ExportedVehicle:
    """Combine what is known of a vehicle.

    Args:
        result: of an identification.
        airframe: its priors and anchor replace what the flight does not determine, its rotors those
            of a result without them.
        given: values by name (of `UNITS`); they come before everything else.
        name: of the vehicle; the airframe's by default.

    Raises:
        InputError: a value makes no sense, the rotors are not known, or they contradict.
    """
    result.need_scale()
    rotors, label = _rotors(result, airframe)
    known = {n: q for n, e in result.estimates.items() if (q := _of_flight(e))}
    known.pop("rotor_delay", None)
    if airframe is not None:
        for n, quantity in _of_airframe(airframe).items():
            known.setdefault(n, quantity)
    for n, value in given.items():
        known[n] = _checked(n, value)
        for dependent in _FOLLOWS.get(n, ()):
            if dependent not in given:
                known.pop(dependent, None)
    complete(known)
    # What is given, or follows from it, comes before hover.
    for n, quantity in _of_hover(result.health or {}, known.get("mass"), len(rotors)).items():
        known.setdefault(n, quantity)
    complete(known)
    _stand_upright(rotors, known)
    return ExportedVehicle(_identifier(name or label), rotors, known, result)


def _of_flight(estimate: Estimate) -> KnownEstimate | None:
    if estimate.value is None or estimate.status in (None, "unobservable"):
        return None
    return KnownEstimate(estimate.value, estimate.std, estimate.unit, origin=estimate.status)


def _of_hover(
    health: Mapping[str, Any], mass: KnownEstimate | None, rotors: int
) -> dict[str, KnownEstimate]:
    """Full thrust and motor lag, which commands beside the speeds show in hover."""
    out = {}
    ratio, lag = health.get("thrust_to_weight"), health.get("motor_lag")
    if mass is not None and isinstance(ratio, dict):
        value, std = ratio.get("value"), ratio.get("std")
        if isinstance(value, float) and isinstance(std, float) and 0.0 < 2.0 * std < value:
            full = value * mass.value * GRAVITY / rotors  # T/W = n T_max / (m g)
            out["T_max"] = KnownEstimate(full, std / value * full, origin="hover")
    if isinstance(lag, float) and lag > 0.0:
        out["motor_lag"] = KnownEstimate(lag, None, origin="hover")
    return out


def _of_airframe(airframe: Airframe) -> dict[str, KnownEstimate]:
    origin = f"airframe {airframe.name}"
    out = {
        name: KnownEstimate(value, std, origin=origin)
        for name, (value, std) in airframe.priors.items()
        if name in UNITS
    }
    for name in ANCHORS:
        value = getattr(airframe, name)
        if value is not None:
            out[name] = KnownEstimate(value, None, origin=origin)
    if airframe.command.thrust_curve is not None:
        out["thrust_curve"] = KnownEstimate(airframe.command.thrust_curve, None, origin=origin)
    return out


def _checked(name: str, value: float) -> KnownEstimate:
    if name not in UNITS:
        raise InputError(f"--set: no parameter {name!r}; known are {', '.join(UNITS)}")
    if not math.isfinite(value):
        raise InputError(f"--set {name}: must be a finite number")
    if _sign(name) == "positive" and value <= 0.0:
        raise InputError(f"--set {name}: must be positive, got {value:g}")
    if _sign(name) == "not negative" and value < 0.0:
        raise InputError(f"--set {name}: must not be negative, got {value:g}")
    return KnownEstimate(value, None, origin="by hand")


def _rotors(result: Result, airframe: Airframe | None) -> tuple[tuple[Rotor, ...], str]:
    own = result.layout
    if own is None:
        if airframe is None:
            raise InputError(
                "the result has no rotor positions: give the --airframe that it was analyzed with"
            )
        return airframe.rotors, airframe.name
    if airframe is not None and not np.array_equal(own.geometry.shape, airframe.geometry.shape):
        raise InputError(
            f"the result is for a vehicle with {len(own.rotors)} rotors, --airframe "
            f"{airframe.name} has {len(airframe.rotors)}"
        )
    if airframe is not None and not np.allclose(own.geometry, airframe.geometry, atol=1e-6):
        raise InputError(
            f"the rotors of --airframe {airframe.name} are not at the positions of the result: "
            "give the airframe (and --arm) that it was analyzed with"
        )
    return own.rotors, own.name


_RULES: tuple[tuple[str, tuple[str, str], Callable[[float, float], float]], ...] = (
    ("k_T", ("T_max", "rotor_speed_max"), lambda thrust, speed: thrust / speed**2),
    ("T_max", ("k_T", "rotor_speed_max"), lambda k_T, speed: k_T * speed**2),
    ("rotor_speed_max", ("T_max", "k_T"), lambda thrust, k_T: math.sqrt(thrust / k_T)),
    ("moment_ratio", ("k_M", "k_T"), lambda k_M, k_T: k_M / k_T),
    ("k_M", ("moment_ratio", "k_T"), lambda ratio, k_T: ratio * k_T),
)
"""A parameter, two others, and how it follows from them."""


def complete(known: dict[str, KnownEstimate]) -> None:
    """Add what follows from two others."""
    for name, of, formula in _RULES:
        if name not in known and all(other in known for other in of):
            first, second = (known[other].value for other in of)
            origin = f"from {' and '.join(of)}"
            known[name] = KnownEstimate(formula(first, second), None, origin=origin)
    if {"k_T", "T_max", "rotor_speed_max"} <= known.keys():
        k_T, full, speed = (known[n].value for n in ("k_T", "T_max", "rotor_speed_max"))
        if abs(k_T * speed**2 / full - 1.0) > _APART:
            raise InputError(
                f"T_max = {full:.4g} N is not k_T times rotor_speed_max squared "
                f"({k_T * speed**2:.4g} N): give one of the two"
            )


def _stand_upright(rotors: tuple[Rotor, ...], known: dict[str, KnownEstimate]) -> None:
    """The drag torque with which upright rotors would turn the vehicle as its canted ones do.

    Formats know upright rotors alone.
    """
    cant = Airframe("canted", rotors).cant
    for name, share in (
        ("moment_ratio", 1.0),
        ("k_M", known["k_T"].value if "k_T" in known else 0),
    ):
        if cant and name in known and share:
            own = known[name]
            known[name] = KnownEstimate(
                own.value + cant * share, own.std, origin=f"{own.origin}, cant added"
            )


def _identifier(name: str) -> str:
    """A name that every format takes."""
    word = "".join(c if c.isascii() and (c.isalnum() or c == "_") else "_" for c in name)
    return word if word and not word[0].isdigit() else f"_{word}"


def drawn_vehicles(vehicle: ExportedVehicle, count: int, seed: int) -> list[ExportedVehicle]:
    """Vehicles drawn from the covariance of one, each a possible rigid body.

    Parameters with an entry in the covariance of the result are drawn together; others by their
    own standard deviation, where they have one. What must be positive is.

    Raises:
        InputError: what was given contradicts itself.
        ValueError: the covariance is no such matrix, or hardly a draw is a rigid body.
    """
    random = np.random.default_rng(seed)
    own = {name: quantity for name, quantity in vehicle.known.items() if not quantity.derived}
    free = [name for name, quantity in own.items() if quantity.std]
    root = covariance_root(_covariance(vehicle, free))
    nominal, places = np.array([q.value for q in own.values()]), [[*own].index(n) for n in free]
    out: list[ExportedVehicle] = []
    for _ in range(50 * max(count, 1)):  # nearly all draws are bodies
        if len(out) == count:
            return out
        drawn = nominal.copy()
        drawn[places] += root @ random.standard_normal(len(free))
        (values,), (good,) = physical(tuple(own), drawn[None])
        if good:
            out.append(_with_values(vehicle, dict(zip(own, values.tolist(), strict=True))))
    if len(out) == count:
        return out
    raise ValueError("the intervals are too wide: hardly any draw from them is a rigid body")


def _covariance(vehicle: ExportedVehicle, names: list[str]) -> Array:
    """(n, n) of all that has a standard deviation."""
    covariance = np.diag([(vehicle.known[name].std or 0.0) ** 2 for name in names])
    if vehicle.result.covariance.get("names"):
        listed, matrix = covariance_of(vehicle.result)
        # A value from elsewhere is uncorrelated with the flight's.
        own = [n for n in names if n in listed and vehicle.known[n].origin in _OF_THE_FLIGHT]
        here, there = [names.index(n) for n in own], [listed.index(n) for n in own]
        covariance[np.ix_(here, here)] = matrix[np.ix_(there, there)]
    return covariance


_OF_THE_FLIGHT = ("identified", "weak", "zero", "given")


def _with_values(vehicle: ExportedVehicle, values: Mapping[str, float]) -> ExportedVehicle:
    """The vehicle with other values, and what follows from them."""
    known = {name: replace(vehicle.known[name], value=value) for name, value in values.items()}
    if {"k_T", "k_M", "moment_ratio"} <= known.keys():
        # Two give the third.
        ratio = known["k_M"].value / known["k_T"].value
        known["moment_ratio"] = replace(known["moment_ratio"], value=ratio)
    if {"k_T", "T_max", "rotor_speed_max"} <= known.keys():
        del known["rotor_speed_max"]
    complete(known)
    return replace(vehicle, known=known)
