"""From aligned signals to regression rows: products, window, leak.

All signals of both sides pass the same linear filter, so its lag cancels: a smoother
(`gcs_sysid.filters.smoothers`), and for the rotation then perhaps a leaky sum. The leak
integrates both sides again: gyro noise, which differentiation made grow with frequency, becomes
nearly white, which is what least squares weighs best. Where noise of the rotor speeds
dominates, no leak is better; the estimator carries both and takes the more certain one.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.signal import lfilter

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation import translation
from gcs_sysid.filters.smoothers import Smoother
from gcs_sysid.model import attitude, rigid_body
from gcs_sysid.model.parameters import GRAVITY


@dataclass(frozen=True)
class Samples:
    """Aligned signals on the uniform grid; NaN marks what is missing or must not be used.

    Attributes:
        gyro: (n, 3) as measured, rad/s.
        rates: (n, 3) without bias, rad/s.
        speeds: (n, rotors) rad/s.
        attitude: (n, 4) body to world.
        force: (n, 3) specific force, m/s^2.
        velocity: (n, 3) north, east, down, m/s.
    """

    gyro: Array
    rates: Array
    speeds: Array
    attitude: Array
    force: Array
    velocity: Array


@dataclass(frozen=True)
class Rows:
    """Regression rows, NaN where a window held a sample that must not be used.

    Attributes:
        rotation: (delays, n, rotation.WIDTH).
        momentum: (n, 3, translation.WIDTH), one for each world axis.
        accelerometer: (n, translation.WIDTH).
    """

    rotation: Array
    momentum: Array
    accelerometer: Array


class RowMaker:
    """Makes rows of samples, block by block, as if all samples had come at once.

    Args:
        geometry: (3, rotors) of the airframe.
        smoother: the filter on both sides.
    """

    def __init__(self, geometry: Array, smoother: Smoother) -> None:
        self._geometry = geometry
        self._smoother = smoother

    def restart(self) -> None:
        """Forget what a gap separates from the next samples."""
        self._smoother.restart()

    def update(self, samples: Samples) -> Rows:
        """The rows that these samples complete."""
        rows = self._smoother.update(self._signals(samples), _LATE)
        n, delays = len(rows.average), len(self._smoother.delays)
        rotation = np.empty((delays, n, rigid_body.N_SIGNALS + 3))
        rotation[:, :, :_H] = rows.average[:, _INPUTS]
        rotation[:, :, :4] = rows.late_average[:, :, :4]
        rotation[:, :, _H] = rows.late_derivative[:, :, 4]
        rotation[:, :, _H + 1 :] = rows.derivative[:, _GYRO]
        momentum = np.empty((n, 3, translation.WIDTH))
        momentum[:, :, 0] = rows.average[:, _LIFT]
        momentum[:, :, 1] = rows.average[:, _VELOCITY]
        momentum[:, :, 2] = 1.0
        momentum[:, :, 3] = rows.derivative[:, _VELOCITY]
        momentum[:, 2, 3] -= GRAVITY
        accelerometer = np.ones((n, translation.WIDTH))
        accelerometer[:, 0] = rows.average[:, _THRUST]
        accelerometer[:, 1] = 0.0
        accelerometer[:, 3] = rows.average[:, _FORCE]
        return Rows(rotation, momentum, accelerometer)

    def _signals(self, s: Samples) -> Array:
        rotors, H = rigid_body.rotor_signals(self._geometry, s.speeds)
        p, q = s.rates[:, 0], s.rates[:, 1]
        down = attitude.rotate(s.attitude, np.array([0.0, 0.0, 1.0]))
        return np.column_stack(
            [
                rotors,
                H,
                rigid_body.rate_products(s.rates),
                s.rates,
                q * H,
                p * H,
                s.gyro,
                down * rotors[:, 2:3],
                s.velocity,
                s.force[:, 2],
            ]
        )


class LeakySum:
    """Leaky sums of rows, over each run of complete ones; incomplete rows are dropped.

    Args:
        row_time: s between rows.
        memory: s; 0 passes rows as they are.
    """

    def __init__(self, row_time: float, memory: float) -> None:
        self._decay = float(np.exp(-row_time / memory)) if memory > 0.0 else 0.0
        self._sum: Array | None = None

    def restart(self) -> None:
        """Start from nothing; as both sides do so at once, no transient arises."""
        self._sum = None

    def update(self, rows: Array) -> Array:
        """(..., n, width) rows to at most as many; a row counts only if complete in all."""
        others = tuple(i for i in range(rows.ndim) if i != rows.ndim - 2)
        complete: Mask = np.asarray(np.isfinite(rows).all(axis=others))
        out = []
        for run, there in runs(complete):
            if not there:
                self.restart()
                continue
            part = rows[..., run, :]
            if self._decay:
                start = np.zeros_like(part[..., :1, :]) if self._sum is None else self._sum
                part, _ = lfilter([1.0], [1.0, -self._decay], part, axis=-2, zi=self._decay * start)
                self._sum = part[..., -1:, :]
            out.append(part)
        return np.concatenate(out, axis=-2) if out else rows[..., :0, :]


def complete_rows(values: Array) -> Mask:
    """(n,) whether nothing is missing in each row of (n, width) values."""
    mask: Mask = np.asarray(np.isfinite(values).all(axis=1))
    return mask


def runs(mask: Mask) -> list[tuple[slice, bool]]:
    """The slices of a mask within which it does not change, with its value there."""
    edges = [0, *(np.flatnonzero(np.diff(mask.astype(np.int8))) + 1), len(mask)]
    return [(slice(a, b), bool(mask[a])) for a, b in pairwise(edges) if b > a]


# Columns of the signals that the smoother takes: first those of the rotors, which may be late.
_LATE = 5  # roll, pitch, thrust, yaw, H
_THRUST = 2
_H = rigid_body.SIGNALS.index("dH")  # in a row, the last input; H itself is no input
_INPUTS = np.r_[0:4, 5 : _H + 1]
_GYRO = slice(_H + 1, _H + 4)
_LIFT = slice(_H + 4, _H + 7)
_VELOCITY = slice(_H + 7, _H + 10)
_FORCE = _H + 10
