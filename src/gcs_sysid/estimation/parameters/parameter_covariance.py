"""Covariance of the physical parameters.

Entries of theta correlate as in the fit; parameters scaled by thrust share the error of the scale,
and those that depend on given arms or masses share theirs. Standard deviations are those of the
result, with all that widens them; the correlations are of the fit and of these common causes.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit.priors import N_UNKNOWNS
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.parameters.scale import AbsoluteScale
from gcs_sysid.estimation.rows.actuator_dynamics import COORDINATE_NAMES
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.parameters import REGISTRY


def parameter_covariance(
    rotation: RotationFit,
    scale: AbsoluteScale,
    values: Mapping[str, tuple[float, float]],
    given: Mapping[str, Array],
) -> tuple[Sequence[str], Array, Array]:
    """Names, (n, n) covariance and (n, causes) effects of what is given, SI.

    Args:
        rotation: the fit, relative to thrust.
        scale: mass and thrust with relative standard deviations.
        values: name -> value and standard deviation of the result.
        given: name -> (causes,) what one standard deviation of each thing given does to it, see
            `given_errors.given_effects`.

    Returns:
        Names of all that has a standard deviation, their covariance, and (n, causes) the effects
        of what is given, whose products are a part of it.
    """
    names = [name for name, (_, std) in values.items() if std > 0.0]
    thrust = scale.thrust or 1.0
    maps = np.zeros((len(names), N_UNKNOWNS))
    # Of thrust, of mass, and of each thing given.
    causes = max((len(effect) for effect in given.values()), default=0)
    common = np.zeros((len(names), 2 + causes))
    for i, name in enumerate(names):
        p, (value, _) = REGISTRY[name], values[name]
        if p.theta:
            maps[i, rb.THETA.index(p.theta)] = thrust if p.scale == "thrust" else 1.0
        elif name in COORDINATE_NAMES:
            maps[i, rb.N_THETA + COORDINATE_NAMES.index(name)] = 1.0
        if p.scale == "thrust":
            common[i, 0] = value * scale.thrust_share
        elif p.scale == "mass":
            common[i, 1] = value * scale.mass_share
        common[i, 2:] = given.get(name, 0.0)
    fit = maps @ rotation.full_covariance @ maps.T
    stds = np.array([values[name][1] for name in names])
    shared = (common**2).sum(axis=1)
    common *= np.minimum(1.0, stds / np.sqrt(np.maximum(shared, 1e-300)))[:, None]
    # What else widens a parameter (systematic errors, the IMU's alignment) has the correlations of
    # the fit: Izz and k_M, which it can hardly separate, do not separate by adding error.
    rest = np.maximum(stds**2 - shared, 0.0)
    own = np.diag(fit)
    widening = np.sqrt(np.divide(rest, own, out=np.zeros_like(own), where=own > 0.0))
    covariance = fit * np.outer(widening, widening) + common @ common.T
    covariance[np.diag_indices(len(names))] = stds**2
    return names, covariance, common[:, 2:]
