"""The scale reference, and other knowledge from before the flight.

IMU and rotor speeds determine everything divided by k_T, and k_T / m; with commands the thrust at
full command, T_max, takes the place of k_T throughout. One more fact makes that absolute: the mass,
k_T or T_max, or a second flight with a known mass added:

    kappa_1 = k_T / m,  kappa_2 = k_T / (m + added)  =>  m = added kappa_2 / (kappa_1 - kappa_2)
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gcs_sysid.estimation.fit.priors import N_UNKNOWNS, Prior
from gcs_sysid.estimation.fit.translation import TranslationFit
from gcs_sysid.estimation.rows.actuator_dynamics import COORDINATE_NAMES
from gcs_sysid.model.airframe import NOT_CANTED, Cant, Known, ScaleReference
from gcs_sysid.model.parameters import REGISTRY, THETA


@dataclass(frozen=True)
class AbsoluteScale:
    """Mass and thrust with relative standard deviations; None: not known.

    Thrust is k_T with rotor speeds, T_max with commands.

    Attributes:
        mass: kg.
        mass_share: relative standard deviation by the flight and priors.
        thrust: N s^2 or N.
        thrust_share: the same.
        mass_given: relative standard deviation by the error of the anchor that was given.
        thrust_given: the same.
    """

    mass: float | None
    mass_share: float
    thrust: float | None
    thrust_share: float
    mass_given: float = 0.0
    thrust_given: float = 0.0

    def of(self, value: float, std: float, doubt: float = 0.0) -> tuple[float, float]:
        """What is relative to thrust, with its standard deviation and a relative doubt, as it is;
        thrust is known.
        """
        assert self.thrust is not None
        spread = math.hypot(std, value * math.hypot(self.thrust_share, doubt))
        return value * self.thrust, self.thrust * spread


def resolve_scale(
    anchor: ScaleReference, translation: TranslationFit | None, known: Mapping[str, Known]
) -> AbsoluteScale:
    """Mass and thrust from the anchor, the flight, and priors on either.

    Args:
        anchor: in force.
        translation: thrust / m of the flight; None while there is none.
        known: priors; those on mass and k_T count here.
    """
    kappa, share = math.nan, math.inf
    if translation is not None and translation.kappa > 0.0:
        kappa, share = translation.kappa, translation.kappa_std / translation.kappa
    if not share < 1.0:
        kappa, share = math.nan, math.inf
    if anchor.kind == "added_mass":
        return _added_mass(anchor, kappa, share)
    own = anchor.std / anchor.value
    other = math.hypot(own, share)
    given = anchor.given
    if anchor.kind == "mass":
        k_T, k_T_share, k_T_given = _combined(anchor.value * kappa, other, given, known.get("k_T"))
        return AbsoluteScale(anchor.value, own, k_T, k_T_share, given, k_T_given)
    mass, mass_share, mass_given = _combined(anchor.value / kappa, other, given, known.get("mass"))
    return AbsoluteScale(mass, mass_share, anchor.value, own, mass_given, given)


def _added_mass(anchor: ScaleReference, kappa: float, share: float) -> AbsoluteScale:
    nothing = AbsoluteScale(None, math.inf, None, math.inf)
    if anchor.loaded is None or not math.isfinite(kappa):
        return nothing
    loaded, loaded_share = anchor.loaded[0], anchor.loaded[1] / anchor.loaded[0]
    apart = kappa - loaded
    if apart <= 0.0:
        return nothing
    own = anchor.std / anchor.value
    # First-order propagation of both flights' errors, which the difference magnifies.
    k_T_share = math.hypot(loaded / apart * share, kappa / apart * loaded_share, own)
    mass_share = math.hypot(kappa / apart * share, kappa / apart * loaded_share, own)
    mass = anchor.value * loaded / apart
    return AbsoluteScale(mass, mass_share, mass * kappa, k_T_share, anchor.given, anchor.given)


def _combined(
    value: float, share: float, given: float, prior: Known | None
) -> tuple[float | None, float, float]:
    """A measured value and a prior on it, weighted by their variances.

    Returns:
        The value, and its relative errors, as measured and from what was given.
    """
    if prior is None:
        return (value, share, given) if math.isfinite(value) else (None, math.inf, 0.0)
    if not math.isfinite(value):
        return prior[0], prior[1] / prior[0], 0.0
    own = math.hypot(share, given) * value
    measured, known = 1.0 / own**2, 1.0 / prior[1] ** 2
    mean = (measured * value + known * prior[0]) / (measured + known)
    off_by = measured / (measured + known) * given * value
    variance = 1.0 / (measured + known) - off_by**2
    return mean, math.sqrt(max(variance, 0.0)) / mean, off_by / mean


_UNKNOWNS = (*THETA, *COORDINATE_NAMES)


def relative_prior(
    known: Mapping[str, Known], scale: AbsoluteScale, cant: Cant = NOT_CANTED
) -> Prior | None:
    """Priors on physical parameters as one on theta, as far as the scale is known.

    Args:
        known: priors.
        scale: with thrust.
        cant: of the rotors.
    """
    mean, information = np.zeros(N_UNKNOWNS), np.zeros(N_UNKNOWNS)
    for name, (value, std) in known.items():
        parameter = REGISTRY[name]
        if parameter.fit == "scale":
            continue
        index = _UNKNOWNS.index(parameter.theta or name)
        if parameter.scale == "thrust":
            if scale.thrust is None:
                continue
            value, std = value / scale.thrust, std / scale.thrust
            std = math.hypot(std, value * scale.thrust_share, value * scale.thrust_given)
        if parameter.theta == "moment_ratio":
            value = cant.shown(value)
        # Two priors on one unknown (k_M and moment_ratio) add up.
        weight = 1.0 / std**2
        total = information[index] + weight
        mean[index] += weight / total * (value - mean[index])
        information[index] = total
    return Prior(mean, np.diag(information)) if information.any() else None
