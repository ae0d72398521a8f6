"""Is the vehicle a rigid body? A test of its gyroscopic torque.

Izz and the rotors' torque share one scale, which only the gyroscopic torque w x J w determines;
products of inertia depend on it too. Where a vehicle (or its simulator) does not have that torque,
the fit bends Izz until there is none, explains nearly all of the motion, and is confidently wrong.
So the predicted torque is tested: what multiple of it is present, axis by axis, with everything
that rotors and damping could do left free? A rigid body gives 1.
"""

from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.model import rigid_body as rb

PRODUCTS = [rb.SIGNALS.index(name) for name in ("qr", "rp", "pq", "pp", "qq", "rr")]
"""Columns of the products of rates, which the gyroscopic torque is made of."""
_OTHERS = np.setdiff1d(np.arange(rb.N_SIGNALS), PRODUCTS)
_OFF, _SURE = 0.3, 4.0
"""By how much, and how many standard deviations, a share must be off to count."""
_NONE = 1e-8
"""Share of an axis' acceleration below which gyroscopic torque is negligible."""
_ROUNDING = 1e-30
"""Of the largest input, what the square of one must exceed."""


@dataclass(frozen=True)
class RigidBodyTest:
    """Gyroscopic torque found, over that of the rigid body fitted.

    Attributes:
        share: (3,) per axis; NaN where none is predicted.
        std: (3,) standard deviations, from the scatter over the batches.
    """

    share: Array
    std: Array

    @property
    def contradicted(self) -> bool:
        """Whether it is surely not the rigid body's on some axis."""
        away = np.abs(self.share - 1.0)
        return bool(np.any((away > _OFF) & (away > _SURE * self.std)))


def judge_rigid_body(batches: Array, P: Array, Q: Array) -> RigidBodyTest:
    """Compare the gyroscopic torque in the data with that of the fit.

    Args:
        batches: (k, width, width) moments of rows of elements; or (k, 3, width, width) where each
            axis has its own.
        P: (WIDTH, width) that makes rows [x, y] of these, rotors' signals as fitted.
        Q: (3, N_SIGNALS) of the fit.
    """
    n = rb.N_SIGNALS
    each = (
        batches
        if batches.ndim == 4
        else np.broadcast_to(batches[:, None], (len(batches), 3, *batches.shape[1:]))
    )
    share, std = np.full(3, np.nan), np.full(3, np.nan)
    for axis in range(3):
        own = each[:, axis]
        total = P @ own.sum(axis=0) @ P.T
        predicted, residual = np.zeros(n + 3), np.zeros(n + 3)
        predicted[PRODUCTS] = Q[axis, PRODUCTS]
        residual[:n], residual[n + axis] = -Q[axis], 1.0
        power = predicted @ total @ predicted
        if not power > _NONE * total[n + axis, n + axis]:
            continue
        predicted, residual = (_apart(total, v) for v in (predicted, residual))
        power = float(predicted @ total @ predicted)
        if not power > _NONE**2 * total[n + axis, n + axis]:
            continue
        more = float(predicted @ total @ residual) / power
        # Neighboring batches share slow noise, as in the sandwich of the fit.
        scores = (own @ ((residual - more * predicted) @ P)) @ (predicted @ P)
        meat = float(scores @ scores + 2.0 * (scores[1:] @ scores[:-1]))
        share[axis] = 1.0 + more
        std[axis] = np.sqrt(max(meat, float(scores @ scores))) / power
    return RigidBodyTest(share, std)


def _apart(total: Array, combination: Array) -> Array:
    """A combination of columns without what all the other inputs explain of it."""
    moments = total[np.ix_(_OTHERS, _OTHERS)]
    diagonal = np.diag(moments)
    # Negligible columns are left unchanged: their share of anything is rounding.
    d = np.sqrt(np.where(diagonal > _ROUNDING * diagonal.max(initial=0.0), diagonal, 1.0))
    scaled = np.linalg.pinv(moments / np.outer(d, d), rcond=1e-10, hermitian=True)
    out: Array = combination.copy()
    out[_OTHERS] -= scaled @ (total[_OTHERS] @ combination / d) / d
    return out
