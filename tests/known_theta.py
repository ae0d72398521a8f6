"""Theta by name, and that of a made-up vehicle near the article's, for tests that fly none."""

from gcs_sysid.model import rigid_body as rb

NAMES = (
    *("Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Ixz", "cg_x", "cg_y", "moment_ratio"),
    *("rotational_damping", "rotor_inertia"),
)


def theta_from(*values, others=0.0):
    """(N_THETA,) with these entries, relative, in the order of `NAMES`; a further entry of theta
    that some day is declared is `others`.
    """
    return rb.theta_of(dict.fromkeys(rb.THETA, others) | dict(zip(NAMES, values, strict=True)))


THETA = theta_from(80.0, 81.0, 143.0, 6.6, 12.4, -8.1, 0.1, 0.05, 0.03, 20.0, 0.3)
