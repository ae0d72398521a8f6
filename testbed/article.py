"""What the article claims ("Parameter Identification for Quadrotor Drones")."""

import numpy as np

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
