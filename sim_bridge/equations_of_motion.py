"""Newton-Euler's equations of one vehicle, or of an ensemble, as a function of plain numbers.

See `sim_bridge.dynamics` for the equations and their symbols. They are evaluated four times a
step, which is most of what a flight costs: hence single numbers rather than lists of them, and the
vehicle's parameters bound once.
"""

from collections.abc import Callable

from sim_bridge.simulated_vehicle import Value, Vehicle

Accelerations = Callable[..., tuple[Value, ...]]
"""See `equations_of_motion`."""


def equations_of_motion(vehicle: Vehicle) -> Accelerations:
    """What makes v' + D v/m, q' and w' (m/s^2 NED, 1/s, rad/s^2), ten numbers.

    It takes the quaternion (a, b, c, d; body to world), the body rates (p, q, r; rad/s), and a
    tuple of what does not depend on them: -T/m; F_d/m + g north, east and down; M - h' about the
    body's axes; h_z. Linear drag is the caller's: nothing else depends on the velocity.
    """
    v = vehicle
    Ixx, Iyy, Izz, Ixy, Iyz, Ixz = inertia = v.Ixx, v.Iyy, v.Izz, v.Ixy, v.Iyz, v.Ixz
    Kxx, Kyy, Kzz, Kxy, Kyz, Kxz = invert_symmetric(*inertia)
    d_p, d_q, d_r = v.damping or (v.rotational_damping,) * 3

    def accelerations(
        a: Value,
        b: Value,
        c: Value,
        d: Value,
        p: Value,
        q: Value,
        r: Value,
        load: tuple[Value, ...],
    ) -> tuple[Value, ...]:
        lift, g_x, g_y, g_z, m_x, m_y, m_z, h_z = load
        # Angular momentum l = J w + h, then the torque left to accelerate the body.
        l_x = Ixx * p + Ixy * q + Ixz * r
        l_y = Ixy * p + Iyy * q + Iyz * r
        l_z = Ixz * p + Iyz * q + Izz * r + h_z
        n_x = m_x - (q * l_z - r * l_y) - d_p * p
        n_y = m_y - (r * l_x - p * l_z) - d_q * q
        n_z = m_z - (p * l_y - q * l_x) - d_r * r
        return (
            # Third column of R: where the body z axis points in the world.
            lift * 2.0 * (b * d + a * c) + g_x,
            lift * 2.0 * (c * d - a * b) + g_y,
            lift * (1.0 - 2.0 * (b * b + c * c)) + g_z,
            0.5 * (-b * p - c * q - d * r),
            0.5 * (a * p + c * r - d * q),
            0.5 * (a * q - b * r + d * p),
            0.5 * (a * r + b * q - c * p),
            Kxx * n_x + Kxy * n_y + Kxz * n_z,
            Kxy * n_x + Kyy * n_y + Kyz * n_z,
            Kxz * n_x + Kyz * n_y + Kzz * n_z,
        )

    return accelerations


def invert_symmetric(
    xx: Value, yy: Value, zz: Value, xy: Value, yz: Value, xz: Value
) -> tuple[Value, ...]:
    """Inverse of a symmetric 3 x 3 matrix, elements in the same order (xx, yy, zz, xy, yz, xz)."""
    c_xx = yy * zz - yz * yz
    c_xy = xz * yz - xy * zz
    c_xz = xy * yz - xz * yy
    scale = 1.0 / (xx * c_xx + xy * c_xy + xz * c_xz)
    return (
        c_xx * scale,
        (xx * zz - xz * xz) * scale,
        (xx * yy - xy * xy) * scale,
        c_xy * scale,
        (xy * xz - xx * yz) * scale,
        c_xz * scale,
    )
