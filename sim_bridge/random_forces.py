"""Unmodeled force and moment: Ornstein-Uhlenbeck noise on each axis.

    x' = -x / tau + sigma sqrt(2 / tau) n,   M = J x,   F = m x

with n unit white noise, so that x is stationary with standard deviation sigma and correlation
exp(-|t| / tau) (Uhlenbeck and Ornstein, Physical Review 36, 1930). Stepped exactly, once a control
period. One draw serves a whole ensemble: its vehicles fly in the same weather.
"""

import math

import numpy as np

from gcs_sysid.signals.recursions import lfilter
from sim_bridge.physics import Physics

_BLOCK = 1024


class RandomForces:
    """Angular (rad/s^2) and linear (m/s^2, body axes) acceleration, unmodeled."""

    def __init__(self, physics: Physics, period: float, seed: np.random.SeedSequence) -> None:
        self._random = np.random.default_rng(seed)
        turn, turn_time = physics.ou_moment
        push, push_time = physics.ou_force
        self.turns, self.pushes = turn > 0.0, push > 0.0
        self._parts = [(turn, math.exp(-period / turn_time)), (push, math.exp(-period / push_time))]
        self._last = [sigma * self._random.standard_normal(3) for sigma, _ in self._parts]
        self._ready = iter(self._block())

    def _block(self) -> list[list[float]]:
        columns = []
        for i, (sigma, keep) in enumerate(self._parts):
            fresh = sigma * math.sqrt(1.0 - keep * keep)
            drawn = fresh * self._random.standard_normal((_BLOCK, 3))
            out, _ = lfilter([1.0], [1.0, -keep], drawn, (keep * self._last[i])[None, :])
            self._last[i] = out[-1]
            columns.append(out)
        rows: list[list[float]] = np.hstack(columns).tolist()
        return rows

    def next(self) -> list[float]:
        """Three of rotation, then three of translation."""
        row = next(self._ready, None)
        if row is None:
            self._ready = iter(self._block())
            row = next(self._ready)
        return row
