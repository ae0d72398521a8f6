"""Wind: a steady one, and Dryden gusts on top that the vehicle is blown through.

Dryden's forms of MIL-F-8785C (3.7.2, low altitude), with T = L / V the time in which one scale
length passes and n unit white noise:

    along the wind      u = sigma_u sqrt(2 T) / (1 + T s) n
    across and upright  v = sigma sqrt(T) (1 + sqrt(3) T s) / (1 + T s)^2 n
    rotation p, q       as u, with sigma_p = 1.9 sigma_w / sqrt(L_w b), L_p = sqrt(L_w b) / 2.6

The autocorrelation of u is sigma^2 exp(-|t|/T), that of v sigma^2 (1 - |t|/2T) exp(-|t|/T). At
height h, in feet,

    L_u = L_v = h / (0.177 + 0.000823 h)^1.2,  L_w = h,  sigma_w = sigma_u (0.177 + 0.000823 h)^0.4.

The vehicle hovers, so V is the speed of the steady wind, LEAST_SPEED at the least (frozen
turbulence, Taylor). b is the vehicle's span; q_g is taken like p_g, the vehicle being as long as it
is wide. The filters are stepped exactly, with the covariance that keeps them stationary.
"""

import math

import numpy as np

from sim_bridge.missions import HEIGHT
from sim_bridge.physics import Physics

FOOT = 0.3048
"""m."""
LEAST_SPEED = 2.0
"""m/s at which gusts pass in a calm."""

_BLOCK = 256

Triple = tuple[float, float, float]


def scale_lengths(height: float) -> tuple[float, float, float]:
    """L_u = L_v and L_w in m, and sigma_w over sigma_u, at this height in m."""
    h = height / FOOT
    base = 0.177 + 0.000823 * h
    return FOOT * h / base**1.2, height, base**0.4


class FirstOrder:
    """A gust component of exponential correlation."""

    def __init__(self, sigma: float, time: float, period: float) -> None:
        self._keep = math.exp(-period / time)
        self._fresh = sigma * math.sqrt(1.0 - self._keep**2)
        self._sigma = sigma
        self._x = 0.0

    def start(self, n: float, _: float) -> None:
        """Begin in the stationary state."""
        self._x = self._sigma * n

    def next(self, n: float, _: float) -> float:
        """The next value."""
        self._x = self._keep * self._x + self._fresh * n
        return self._x


class SecondOrder:
    """A gust component across the flow: sqrt(3) z_1 + (1 - sqrt(3)) z_2, z_2 after z_1."""

    def __init__(self, sigma: float, time: float, period: float) -> None:
        a, h = math.exp(-period / time), period / time
        # var z_1 = sigma^2 / 2, var z_2 = cov = sigma^2 / 4 for the noise that makes var y sigma^2.
        P = sigma * sigma * np.array([[0.5, 0.25], [0.25, 0.25]])
        A = np.array([[a, 0.0], [h * a, a]])
        self._a, self._ha = a, h * a
        self._first = np.linalg.cholesky(P + 1e-30 * np.eye(2)).tolist()
        # The little on the diagonal is for a gust of no strength.
        Q = P - A @ P @ A.T + 1e-15 * (sigma * sigma + 1e-12) * np.eye(2)
        self._fresh = np.linalg.cholesky(Q).tolist()
        self._z = (0.0, 0.0)

    def start(self, n: float, m: float) -> None:
        """Begin in the stationary state."""
        (a, _), (b, c) = self._first
        self._z = a * n, b * n + c * m

    def next(self, n: float, m: float) -> float:
        """The next value."""
        (a, _), (b, c) = self._fresh
        z_1, z_2 = self._z
        self._z = self._a * z_1 + a * n, self._ha * z_1 + self._a * z_2 + b * n + c * m
        return 1.7320508075688772 * self._z[0] - 0.7320508075688772 * self._z[1]


class Wind:
    """The air's motion where the vehicle is.

    Attributes:
        velocity: north, east, down, m/s.
        rates: roll and pitch rate of the air, rad/s.
    """

    def __init__(
        self, physics: Physics, span: float, period: float, seed: np.random.SeedSequence
    ) -> None:
        speed, come_from = physics.wind
        # Wind is named by where it comes from.
        self._along = -math.cos(come_from), -math.sin(come_from)
        self.steady: Triple = speed * self._along[0], speed * self._along[1], 0.0
        self.velocity: Triple = self.steady
        self.rates = (0.0, 0.0)
        sigma = physics.gusts
        self._components: list[FirstOrder | SecondOrder] = []
        if not sigma:
            return
        passing = max(speed, LEAST_SPEED)
        L_u, L_w, ratio = scale_lengths(HEIGHT)
        sigma_w, L_b = ratio * sigma, math.sqrt(L_w * span)
        turn, time = 1.9 * sigma_w / L_b, L_b / 2.6 / passing
        self._components = [
            FirstOrder(sigma, L_u / passing, period),
            SecondOrder(sigma, L_u / passing, period),
            SecondOrder(sigma_w, L_w / passing, period),
            FirstOrder(turn, time, period),
            FirstOrder(turn, time, period),
        ]
        self._random = np.random.default_rng(seed)
        self._ready = iter(self._random.standard_normal((_BLOCK, 10)).tolist())
        drawn = next(self._ready)
        for i, component in enumerate(self._components):
            component.start(drawn[2 * i], drawn[2 * i + 1])
        self.advance()

    def advance(self) -> None:
        """Go on by one period."""
        if not self._components:
            return
        drawn = next(self._ready, None)
        if drawn is None:
            self._ready = iter(self._random.standard_normal((_BLOCK, 10)).tolist())
            drawn = next(self._ready)
        one, two, three, four, five = self._components
        u, v = one.next(drawn[0], drawn[1]), two.next(drawn[2], drawn[3])
        w = three.next(drawn[4], drawn[5])
        c, s = self._along
        north, east, _ = self.steady
        self.velocity = north + c * u - s * v, east + s * u + c * v, w
        self.rates = four.next(drawn[6], drawn[7]), five.next(drawn[8], drawn[9])
