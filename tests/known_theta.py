"""Theta of a made-up vehicle near the article's, for tests that need one and fly none."""

from gcs_sysid.model import rigid_body as rb

THETA = rb.theta_of(
    {
        "Ixx": 80.0,
        "Iyy": 81.0,
        "Izz": 143.0,
        "Ixy": 6.6,
        "Iyz": 12.4,
        "Ixz": -8.1,
        "cg_x": 0.1,
        "cg_y": 0.05,
        "moment_ratio": 0.03,
        "rotational_damping": 20.0,
        "rotor_inertia": 0.3,
    }
)
