"""Theta by name, that of a made-up vehicle near the article's, priors: for tests that fly none."""

import numpy as np

from gcs_sysid.estimation.fit.priors import N_UNKNOWNS, Prior
from gcs_sysid.model import rigid_body as rb

NAMES = (
    *("Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Ixz", "cg_x", "cg_y", "moment_ratio"),
    *("rotational_damping", "rotor_inertia"),
)


def theta_from(*values):
    """(N_THETA,) with these entries, relative, in the order of `NAMES`; others are zero."""
    return rb.theta_of(dict(zip(NAMES, values, strict=True)))


def sizes(*values):
    """(N_THETA,) what errors are measured against: these in the order of `NAMES`, and of others
    what their declaration compares them with.
    """
    theta = theta_from(*values)
    return np.where(np.isin(rb.THETA, NAMES), theta, rb.counterparts(theta, arm=0.35))


THETA = theta_from(80.0, 81.0, 143.0, 6.6, 12.4, -8.1, 0.1, 0.05, 0.03, 20.0, 0.3)

TABLE_1 = {
    "mass": 1.5, "Ixx": 0.0165, "Iyy": 0.0167, "Izz": 0.0294, "Ixy": 0.00135, "Iyz": 0.00254,
    "Ixz": -0.00166, "cg_x": 0.10, "cg_y": 0.05, "k_T": 2.05e-4, "k_M": 6.14e-6,
}  # fmt: skip
"""The article's vehicle, SI."""


def prior_of(known):
    """Independent knowledge about single unknowns.

    Args:
        known: index among the unknowns -> mean and standard deviation.
    """
    mean, information = np.zeros(N_UNKNOWNS), np.zeros((N_UNKNOWNS, N_UNKNOWNS))
    for index, (value, std) in known.items():
        mean[index] = value
        information[index, index] = std**-2.0
    return Prior(mean, information)
