"""What an IMU that is rotated against the body does to a row [x, y]."""

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.rows.actuator_dynamics import WIDTH
from gcs_sysid.model import rigid_body as rb

N_X, _AXES = rb.N_SIGNALS, 3
_COLUMN = {name: i for i, name in enumerate(rb.SIGNALS)}
_RATES = [_COLUMN[name] for name in "pqr"]
_MOMENTUM = [_COLUMN["pH"], _COLUMN["qH"]]
_PAIRS = [(1, 2), (2, 0), (0, 1), (0, 0), (1, 1), (2, 2)]
_PRODUCT = {frozenset(pair): _COLUMN["qr"] + i for i, pair in enumerate(_PAIRS)}
"""Column of the product of two rates."""
_CROSS = np.array(
    [[[0, 0, 0], [0, 0, 1], [0, -1, 0]], [[0, 0, -1], [0, 0, 0], [1, 0, 0]],
     [[0, 1, 0], [-1, 0, 0], [0, 0, 0]]], float
)  # fmt: skip
"""Body rates as read by an IMU rotated about each axis, to first order: w - turn x w."""


def turned(R: Array) -> Array:
    """(WIDTH, WIDTH) what becomes of a row where rates are R times what they were, (3, 3)."""
    out = np.eye(WIDTH)
    out[np.ix_(_RATES, _RATES)] = out[N_X:, N_X:] = R
    for i, j in _PAIRS:
        own = out[_PRODUCT[frozenset((i, j))]]
        own[:] = 0.0
        for k in range(_AXES):
            for m in range(_AXES):
                own[_PRODUCT[frozenset((k, m))]] += R[i, k] * R[j, m]
    # r H is not among the signals; rotors' angular momentum is small.
    out[np.ix_(_MOMENTUM, _MOMENTUM)] = R[:2, :2]
    return out


def rotation_of(turns: Array) -> Array:
    """(3, 3) of (3,) rad about roll, pitch and yaw, by Cayley's transform."""
    K = np.tensordot(turns, _CROSS, 1)
    R: Array = np.linalg.solve(np.eye(_AXES) + 0.5 * K, np.eye(_AXES) - 0.5 * K)
    return R


# The map is of second order in R, so that this difference is its derivative.
PER_TURN = np.stack([0.5 * (turned(np.eye(_AXES) + E) - turned(np.eye(_AXES) - E)) for E in _CROSS])
"""(3, WIDTH, WIDTH) what a rad about each axis does to a row, to first order."""


def missed_by(L: Array, Q: Array) -> Array:
    """(..., 3, N_X) D of residual = D x, where rows are off by (..., WIDTH, WIDTH) L.

    x = (1 + L) x_true, w' = (1 + E) w'_true, E the part of L for w':  D = E Q - Q L
    """
    missed: Array = L[..., N_X:, N_X:] @ Q - Q @ L[..., :N_X, :N_X]
    return missed
