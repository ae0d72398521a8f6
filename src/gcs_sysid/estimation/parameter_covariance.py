"""Covariance of physical parameters: how what is estimated hangs together.

Values of theta hang together as the fit has them; all that is multiplied with thrust shares the
error of the scale, and all that rests on given arms or masses shares theirs. Standard deviations
are those of the result, with all that widens them; the correlations are of these common causes.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.actuator_dynamics import COORDINATE_NAMES
from gcs_sysid.estimation.priors import N_UNKNOWNS
from gcs_sysid.estimation.rotation import RotationFit
from gcs_sysid.estimation.scale import Scale
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.parameters import REGISTRY


def parameter_covariance(
    rotation: RotationFit,
    scale: Scale,
    values: Mapping[str, tuple[float, float]],
    given: Mapping[str, float],
) -> tuple[Sequence[str], Array]:
    """Names and (n, n) covariance, SI.

    Args:
        rotation: the fit, relative to thrust.
        scale: mass and thrust with relative standard deviations.
        values: name -> value and standard deviation of the result.
        given: name -> the part of it that comes from what was given.
    """
    names = [name for name, (_, std) in values.items() if std > 0.0]
    thrust = scale.thrust or 1.0
    maps = np.zeros((len(names), N_UNKNOWNS))
    # Of thrust, of mass, and of what is given.
    common = np.zeros((len(names), 3))
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
        common[i, 2] = np.copysign(given.get(name, 0.0), value)
    covariance = maps @ rotation.full_covariance @ maps.T + common @ common.T
    own = np.diag(covariance)
    stds = np.array([values[name][1] for name in names])
    # What else widens a parameter is its own.
    less = np.where(own > stds**2, stds / np.sqrt(np.maximum(own, 1e-300)), 1.0)
    covariance *= np.outer(less, less)
    covariance[np.diag_indices(len(names))] = stds**2
    return names, covariance
