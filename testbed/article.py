"""What the article claims ("Parameter Identification for Quadrotor Drones"), and its formulas."""

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.signals.recursions import lfilter

NAMES = ("Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Ixz", "cg_x", "cg_y", "k_T", "k_M")
"""The ten parameters of Table 2, in the order of every array here."""

TABLE_2 = np.array([0.926, 1.090, 1.530, 2.470, 2.040, 0.996, 0.0, 0.0, 0.0, 0.277])
"""Error in %, one run at 20 Hz with noise of 0.02."""

TABLE_3 = {
    0.01: (0.85, 2.10),
    0.02: (1.15, 2.47),
    0.03: (1.50, 3.20),
    0.04: (1.95, 4.05),
    0.05: (2.40, 5.00),
}
"""Noise (called variance there; it is the standard deviation) to average and largest error in %."""

CONVERGENCE = 5.0
"""s, "The RLS algorithm converges within 5 seconds for all parameters"."""


def complementary(y_u: Array, y_x: Array, dt: float, k_p: float) -> Array:
    """The article's filter x' = y_u + k_p (y_x - x) on signals (n,) or (n, m).

    Args:
        y_u: measured rate, unit/s.
        y_x: measured value, unit.
        dt: s between samples.
        k_p: 1/s.
    """
    a = np.exp(-k_p * dt)
    error = np.empty_like(y_x)
    error[0] = 0.0
    # Trapezoid for the rate: the two samples around each step.
    error[1:] = 0.5 * (y_u[1:] + y_u[:-1]) * dt - np.diff(y_x, axis=0)
    filtered, _ = lfilter([1.0], [1.0, -a], error)
    return y_x + filtered


def backward_difference(v: Array, dt: float) -> Array:
    """(n, m) v' by the last two samples; half a sample late."""
    out = np.empty_like(v)
    out[1:] = np.diff(v, axis=0) / dt
    out[:1] = out[1:2]
    return out


def central_difference(v: Array, dt: float) -> Array:
    """(n, m) v' by the neighbors on either side."""
    out: Array = np.gradient(v, dt, axis=0)
    return out
