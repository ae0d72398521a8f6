"""Symmetric windows that average and differentiate with exactly the same lag.

For a smooth window psi that vanishes at its ends, integration by parts gives

    integral psi(s) w'(t + s) ds = - integral psi'(s) w(t + s) ds

so that the derivative of a noisy signal need never be formed: the same window averages one
side of an equation and differentiates the other. This is the tracking differentiator's idea
with a finite memory: z1 is the average, z2 the derivative, and both have zero phase.
"""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from gcs_sysid.arrays import Array


@dataclass(frozen=True)
class Window:
    """A sampled cos^4 window and its derivative.

    Attributes:
        half: samples on either side of the centre.
        average: (2 half + 1,) weights that sum to one.
        derivative: (2 half + 1,) weights in 1/s.
    """

    half: int
    average: Array
    derivative: Array

    @property
    def length(self) -> int:
        """Samples the window spans."""
        return 2 * self.half + 1

    def apply(self, signals: Array, step: int = 1, *, derivative: bool = False) -> Array:
        """Slide along axis 0: (n, m) samples to ((n - length) // step + 1, m) values."""
        taps = self.derivative if derivative else self.average
        return sliding_window_view(signals, self.length, axis=0)[::step] @ taps


def cosine_window(half: int, dt: float) -> Window:
    """The cos^4 window of `half` samples of `dt` seconds on either side.

    Sampled, the two sets of weights agree only as far as the window resolves the signal. The
    averaging weights are therefore corrected by an even polynomial so that
    sum derivative_k w(t_k) = sum average_k w'(t_k) holds exactly for polynomials w up to
    degree 2 n with n = min(half, 5).

    Raises:
        ValueError: fewer than two samples on a side, or a step that is not positive.
    """
    if half < 2 or not dt > 0:
        raise ValueError(f"a window needs half >= 2 and dt > 0, got {half} and {dt}")
    s = np.arange(-half, half + 1) / (half + 1)
    psi = np.cos(0.5 * np.pi * s) ** 4
    derivative = np.cos(0.5 * np.pi * s) ** 3 * np.sin(0.5 * np.pi * s)
    derivative /= derivative @ s
    even = s ** (2 * np.arange(min(half, 5))[:, None])
    odd_moments = (derivative * s * even).sum(axis=1)
    wanted = odd_moments / np.arange(1, 2 * len(even), 2)
    correction = np.linalg.solve((psi * even) @ even.T, wanted)
    return Window(half, psi * (correction @ even), derivative / ((half + 1) * dt))
