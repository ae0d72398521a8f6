"""What is not known of the way from the rotors' stream to their thrust, as nodes of a grid.

Three numbers stand between what is telemetered of a rotor and the thrust that acts while the IMU
measures:

    rotor delay   s, of the rotors' stamps behind the IMU's
    motor lag     s, of first order, where commands are the input; measured speeds have none
    thrust curve  c in T / T_max = (1 - c) w + c w^2 of the lagged command w; speeds have none

The same rows are made at every node of a grid over them. Moments of rows that passed a window
are smooth functions of all three (of the curve they are polynomials of second degree), so between
nodes they are interpolated, with derivatives, and the three are unknowns like any other.
"""

from collections.abc import Sequence
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np

from gcs_sysid.arrays import Array

DELAY, LAG, CURVE = 0, 1, 2
"""Indices of the coordinates."""
N_COORDINATES = 3


_BEND = 0.08
"""s. What a lag tau does to a signal is followed best by polynomials in tau / (tau + bend): eight
nodes are then good to 2e-4 of it up to 20 rad/s, from no lag to 0.135 s."""


class Grid:
    """Nodes over delay, lag and curve; a coordinate with one node is taken as given.

    Args:
        delays: s, rising.
        lags: s, rising.
        curves: rising.
    """

    def __init__(
        self,
        delays: Sequence[float] | Array,
        lags: Sequence[float] = (0.0,),
        curves: Sequence[float] = (1.0,),
    ) -> None:
        self.axes = tuple(np.asarray(axis, dtype=float) for axis in (delays, lags, curves))
        self.free = tuple(i for i in range(N_COORDINATES) if len(self.axes[i]) > 1)
        """The coordinates that are unknown."""
        self.low = np.array([axis[0] for axis in self.axes])
        self.high = np.array([axis[-1] for axis in self.axes])
        self.branches = len(lags) * len(curves)
        """How often the rotors' signals are formed: once for each lag and curve."""
        self.shape = (len(lags), len(curves), len(self.axes[DELAY]))
        self.size = self.branches * self.shape[2]
        """Nodes: a delay's next to each other, then the curve's, then the lag's."""
        self.pairs = tuple(combinations_with_replacement(self.free, 2))
        """Of coordinates, by which `weights` gives second derivatives."""
        delay, lag, curve = self.axes
        self._polynomials = [_Polynomials(delay), _Polynomials(lag, _BEND), _Polynomials(curve)]

    @cached_property
    def nodes(self) -> Array:
        """(size, 3) coordinates of the nodes."""
        lag, curve, delay = np.meshgrid(
            self.axes[LAG], self.axes[CURVE], self.axes[DELAY], indexing="ij"
        )
        return np.stack([delay.ravel(), lag.ravel(), curve.ravel()], axis=1)

    @cached_property
    def middle(self) -> int:
        """The node nearest to no delay, and to the middle of lags and curves."""
        centre = 0.5 * (self.low + self.high)
        centre[DELAY] = 0.0
        span = np.where(self.high > self.low, self.high - self.low, 1.0)
        return int(np.argmin((((self.nodes - centre) / span) ** 2).sum(axis=1)))

    def weights(self, at: Array) -> Array:
        """Weights of the nodes at (K, 3) coordinates.

        Returns:
            (K, 1 + f + pairs, size): of the value, of its first derivatives by the f free
            coordinates, and of its second ones by `pairs`.
        """
        each = [p.weights(at[:, i]) for i, p in enumerate(self._polynomials)]
        if self.free == (DELAY,):
            return each[DELAY]
        orders: list[tuple[int, ...]] = [(0, 0, 0)]
        orders += [_order(i) for i in self.free]
        orders += [_order(i, j) for i, j in self.pairs]
        a, b, c = np.array(orders).T
        K = len(at)
        lag_curve = each[LAG][:, b, :, None] * each[CURVE][:, c, None, :]
        weights: Array = lag_curve[..., None] * each[DELAY][:, a, None, None, :]
        return weights.reshape(K, len(orders), self.size)

    def branch_weights(self, at: Array) -> Array:
        """(branches,) weights of the branches at (3,) coordinates."""
        lag = self._polynomials[LAG].weights(at[LAG : LAG + 1])[0, 0]
        curve = self._polynomials[CURVE].weights(at[CURVE : CURVE + 1])[0, 0]
        return np.outer(lag, curve).ravel()

    def moments_at(self, bank: Array, at: Array) -> Array:
        """(..., W, W) moments at (3,) coordinates, from those of the nodes (..., size, W, W)."""
        moments: Array = np.tensordot(bank, self.weights(at[None])[0, 0], ([-3], [0]))
        return moments


def _order(*coordinates: int) -> tuple[int, ...]:
    """How often each coordinate is differentiated by."""
    return tuple(coordinates.count(i) for i in range(N_COORDINATES))


class _Polynomials:
    """Lagrange's polynomials over the nodes of one axis.

    Args:
        axis: the nodes x.
        bend: of the variable x / (x + bend) that the polynomials are in; infinite: in x itself.
    """

    def __init__(self, axis: Array, bend: float = np.inf) -> None:
        self._bend = bend
        bent = self._bent(axis)[0]
        self._middle = 0.5 * (bent[0] + bent[-1])
        self._half = 0.5 * (bent[-1] - bent[0]) or 1.0
        n = len(axis)
        nodes = (bent - self._middle) / self._half
        # Row k: the part of the weights, and of their derivatives, with the k-th power.
        self._exponents = np.arange(n)
        powers = np.zeros((3, n, n))
        powers[0] = np.linalg.inv(nodes[:, None] ** self._exponents)
        for k in range(2):
            powers[k + 1, :-1] = powers[k, 1:] * self._exponents[1:, None] / self._half
        self._powers = powers.transpose(1, 0, 2).reshape(n, 3 * n)

    def weights(self, x: Array) -> Array:
        """(K, 3, nodes) weights of the nodes at (K,) points, and their two derivatives."""
        u, slope, curvature = self._bent(x)
        scaled = (u[:, None] - self._middle) / self._half
        weights: Array = (scaled**self._exponents @ self._powers).reshape(len(x), 3, -1)
        if np.isfinite(self._bend):
            first, second = weights[:, 1], weights[:, 2]
            weights[:, 2] = second * slope[:, None] ** 2 + first * curvature[:, None]
            weights[:, 1] = first * slope[:, None]
        return weights

    def _bent(self, x: Array) -> tuple[Array, Array, Array]:
        """The polynomials' variable, and its two derivatives."""
        if not np.isfinite(self._bend):
            return x, np.ones_like(x), np.zeros_like(x)
        below = x + self._bend
        return x / below, self._bend / below**2, -2.0 * self._bend / below**3
