"""From aligned signals to regression rows: products, window, leak.

All signals of both sides pass the same linear filter, so its lag cancels: a smoother
(`gcs_sysid.filters.smoothers`), and for the rotation then perhaps a leaky sum. The leak
integrates both sides again: gyro noise, which differentiation made grow with frequency, becomes
nearly white, which is what least squares weighs best. Where noise of the rotor speeds
dominates, no leak is better; the estimator carries both and takes the more certain one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

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
        out = np.empty((len(H), _FORCE + 1))
        out[:, :4] = rotors
        out[:, 4] = H
        out[:, 5:11] = rigid_body.rate_products(s.rates)
        out[:, 11:14] = s.rates
        out[:, 14:16] = s.rates[:, 1::-1] * H[:, None]  # q H, p H
        out[:, _GYRO] = s.gyro
        out[:, _LIFT] = attitude.down_axis(s.attitude) * rotors[:, _THRUST, None]
        out[:, _VELOCITY] = s.velocity
        out[:, -1] = s.force[:, 2]
        return out


_PIECE = 16
"""Rows that a leaky sum takes at once."""


class LeakySums:
    """Leaky sums of rows, over each run of complete ones; incomplete rows are dropped.

    Args:
        row_time: s between rows.
        memories: s; 0 passes rows as they are.
    """

    def __init__(self, row_time: float, memories: Sequence[float]) -> None:
        decay = np.array([np.exp(-row_time / m) if m > 0.0 else 0.0 for m in memories])
        age = np.arange(_PIECE)[:, None] - np.arange(_PIECE)
        powers = decay[:, None, None] ** np.maximum(age, 0)
        # Shapes (leaks, 1, rows, rows) and (leaks, 1, rows, 1).
        self._weights = np.where(age >= 0, powers, 0.0)[:, None]
        self._carried = (decay[:, None] ** np.arange(1, _PIECE + 1))[:, None, :, None]
        self._sum: Array | None = None

    def restart(self) -> None:
        """Start from nothing; as both sides do so at once, no transient arises."""
        self._sum = None

    def update(self, rows: Array) -> Array:
        """(d, n, width) rows to (leaks, d, at most n, width), those that are complete in all."""
        if np.isfinite(rows.sum()):
            return self._add(rows)
        complete: Mask = np.asarray(np.isfinite(rows).all(axis=(0, 2)))
        out = [np.empty((len(self._weights), len(rows), 0, rows.shape[-1]))]
        for run, there in runs(complete):
            if there:
                out.append(self._add(rows[:, run]))
            else:
                self.restart()
        return np.concatenate(out, axis=2)

    def _add(self, rows: Array) -> Array:
        n = rows.shape[1]
        out = np.empty((len(self._weights), len(rows), n, rows.shape[-1]))
        for start in range(0, n, _PIECE):
            part = rows[:, start : start + _PIECE]
            m = part.shape[1]
            sums = self._weights[:, :, :m, :m] @ part
            if self._sum is not None:
                sums += self._carried[:, :, :m] * self._sum
            self._sum = sums[:, :, -1:]
            out[:, :, start : start + m] = sums
        return out


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
