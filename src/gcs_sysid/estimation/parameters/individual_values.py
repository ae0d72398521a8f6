"""Damping of each axis and coefficients of each rotor, from the means and the deviations.

All are linear in the unknowns [theta, coordinates, deviations], so their covariance is that of the
fit. Where a kind of deviation had no evidence, each has the mean's value.
"""

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit.priors import N_UNKNOWNS, Unknown
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.model import rigid_body as rb


def axis_dampings(fit: RotationFit, bend: float = 0.0) -> tuple[Array, Array]:
    """(3,) of roll, pitch and yaw relative to thrust, and their (3,) standard deviations.

    Args:
        fit: with deviations or none.
        bend: relative change of thrust with the thrust curve, which the standard deviations are
            to include.
    """
    deviating = fit.deviating
    maps = np.zeros((3, N_UNKNOWNS + len(deviating.std)))
    maps[:, rb.DAMPING] = 1.0
    maps[:, N_UNKNOWNS:] = deviating.dampings.T
    return _linear(fit, maps, bend)


def mean_damping(fit: RotationFit, bend: float = 0.0) -> tuple[float, float]:
    """Of roll and pitch, relative to thrust, and its standard deviation; see `axis_dampings`."""
    deviating = fit.deviating
    maps = np.zeros((1, N_UNKNOWNS + len(deviating.std)))
    maps[:, rb.DAMPING] = 1.0
    maps[:, N_UNKNOWNS:] = deviating.dampings[:, :2].mean(axis=1)
    value, std = _linear(fit, maps, bend)
    return float(value[0]), float(std[0])


def rotor_coefficients(fit: RotationFit, rotors: int) -> tuple[Array, Array, Array, Array]:
    """Of each rotor, relative to the mean k_T: thrust and torque, with standard deviations.

    Args:
        fit: with deviations or none.
        rotors: how many there are.

    Returns:
        (rotors,) k_T of each over the mean, its standard deviation, k_M over the mean k_T in m, and
        its standard deviation.
    """
    deviating = fit.deviating
    m = len(deviating.std)
    thrust = np.zeros((rotors, N_UNKNOWNS + m))
    ratio = np.zeros_like(thrust)
    ratio[:, rb.MOMENT_RATIO] = 1.0
    if m:
        thrust[:, N_UNKNOWNS:] = deviating.thrusts.T
        ratio[:, N_UNKNOWNS:] = deviating.ratios.T
    k_T, k_T_std = _linear(fit, thrust)
    return 1.0 + k_T, k_T_std, *_linear(fit, ratio)


def _linear(fit: RotationFit, maps: Array, bend: float = 0.0) -> tuple[Array, Array]:
    """Values of (k, N_UNKNOWNS + m) maps of the unknowns, and standard deviations."""
    unknowns = np.concatenate([fit.unknowns, fit.deviations])
    covariance, values = fit.extended_covariance, maps @ unknowns
    maps = maps.copy()
    # d (x T) / dc = T (dx / dc + x bend)
    maps[:, Unknown.CURVE] += bend * values
    variance = np.einsum("ki,ij,kj->k", maps, covariance, maps)
    return values, np.sqrt(np.maximum(variance, 0.0))
