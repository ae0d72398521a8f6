"""Tracking differentiators: a signal v in, z1 that follows it and z2 that follows v' out.

    z1' = z2
    z2' = -R^2 (|z1 - v|^a sign(z1 - v) + b |z2 / R|^a sign(z2))        usual form
    z2' = -R   (|z1 - v|^a sign(z1 - v) + b |z2 / R|^a sign(z2))        as the article prints it

With a = 1 the usual form is a linear second-order low-pass of bandwidth R and damping b / 2.
Put on every signal of both sides of an equation its lag cancels exactly, which a nonlinear one,
whose lag depends on amplitude, cannot do. As printed, with R = 50000, the damping is b / R^a of
what it should be: next to nothing.
"""

from typing import Literal

import numpy as np
from scipy.linalg import expm

from gcs_sysid.arrays import Array
from gcs_sysid.signals.recursions import lfilter

ARTICLE_A = 1.75
ARTICLE_B = 5.045
"""b = 3.1 (a - 0.5) + 1.17, as printed."""
ARTICLE_R = 50000.0

DEFAULT_BANDWIDTH = 40.0
"""R in rad/s, for motion up to 3 Hz and noise of 0.02 rad/s: of the least error at 250 Hz and next
to it at 20 Hz (benchmarks/filter_claims.py). Quieter sensors allow 60 to 80."""
DEFAULT_DAMPING = 2.0**0.5
"""b of the flattest gain; up to a quarter of R the lag is then next to constant too."""


class LinearDifferentiator:
    """The linear tracking differentiator, exact for signals that are straight between samples.

    Args:
        dt: s between samples.
        bandwidth: R, rad/s.
        damping: b; 2 is critical.

    Example:
        A ramp of 3 a second, late by 2 / 40 s:

        >>> v = 3.0 * np.arange(0.0, 2.0, 0.01)[:, None]
        >>> z1, z2 = LinearDifferentiator(0.01, bandwidth=40.0, damping=2.0).update(v)
        >>> round(float((z1 - v)[-1, 0]), 6), round(float(z2[-1, 0]), 6)
        (-0.15, 3.0)
    """

    def __init__(
        self, dt: float, bandwidth: float = DEFAULT_BANDWIDTH, damping: float = DEFAULT_DAMPING
    ) -> None:
        R, b = bandwidth, damping
        self.lag = b / R
        """s by which z1 and z2 are late for slow signals."""
        A = np.array([[0.0, 1.0], [-R * R, -R * b]])
        B = np.array([[0.0], [R * R]])
        # First-order hold: the input and its slope are two further states.
        M = np.zeros((4, 4))
        M[:2, :2] = A * dt
        M[:2, 2:3] = B * dt
        M[2, 3] = 1.0
        E = expm(M)
        Ad, now, slope = E[:2, :2], E[:2, 2:3], E[:2, 3:4]
        drive = now + Ad @ slope - slope
        self._denominator = np.poly(Ad)
        # Of both states: C (z - Ad)^-1 B + D over the common denominator, C of one row of eye(2).
        self._numerators = [
            np.poly(Ad - drive @ row[None]) + (slope[i, 0] - 1.0) * self._denominator
            for i, row in enumerate(np.eye(2))
        ]
        # Settled to 1e-4 of a step: (1 + x) exp(-x) at x = 12, x by the slowest mode.
        slowest = 0.5 * R * (b - max(b * b - 4.0, 0.0) ** 0.5)
        self.settling = int(np.ceil(12.0 / (slowest * dt)))
        """Samples from a start until its transient has died away."""
        self._state: tuple[Array, Array] | None = None

    def restart(self) -> None:
        """Forget the past: the next sample starts z1 at its value and z2 at zero."""
        self._state = None

    def update(self, v: Array) -> tuple[Array, Array]:
        """Filter a block.

        Args:
            v: (n, m) signals.

        Returns:
            z1 and z2, each (n, m).
        """
        if len(v) == 0:
            return v, v
        if self._state is None:
            self._state = tuple(  # type: ignore[assignment]
                _steady_state(numerator, self._denominator)[:, None] * v[0]
                for numerator in self._numerators
            )
        assert self._state is not None
        z1, s1 = lfilter(self._numerators[0], self._denominator, v, self._state[0])
        z2, s2 = lfilter(self._numerators[1], self._denominator, v, self._state[1])
        self._state = (s1, s2)
        return z1, z2


def _steady_state(numerator: Array, denominator: Array) -> Array:
    """Filter state at rest under a constant input of one."""
    gain = numerator.sum() / denominator.sum()
    rest = numerator - gain * denominator
    state: Array = np.cumsum(rest[::-1])[::-1][1:]
    return state


def nonlinear_differentiator(
    v: Array,
    dt: float,
    R: float = ARTICLE_R,
    a: float = ARTICLE_A,
    b: float = ARTICLE_B,
    *,
    form: Literal["usual", "printed"] = "usual",
    substeps: int = 20,
    start: tuple[Array, Array] | None = None,
) -> tuple[Array, Array]:
    """The nonlinear tracking differentiator, for study.

    Args:
        v: (n, m) signals.
        dt: s between samples.
        R: speed.
        a: exponent.
        b: damping.
        form: with R^2 (usual) or R (as printed) before the bracket.
        substeps: semi-implicit Euler steps a sample, the input straight between samples.
        start: z1 and z2, each (m,), at the first sample; by default v[0] and zero.

    Returns:
        z1 and z2, each (n, m). Where it diverges the values become huge but stay finite.
    """
    gain = R * R if form == "usual" else R
    h = dt / substeps
    z1, z2 = (v[0].copy(), np.zeros_like(v[0])) if start is None else start
    out1, out2 = np.empty_like(v), np.empty_like(v)
    out1[0], out2[0] = z1, z2
    limit = 1e12
    for k in range(1, len(v)):
        slope = (v[k] - v[k - 1]) / substeps
        for i in range(1, substeps + 1):
            error = z1 - (v[k - 1] + slope * i)
            speed = z2 / R
            force = np.abs(error) ** a * np.sign(error) + b * np.abs(speed) ** a * np.sign(speed)
            z2 = np.clip(z2 - h * gain * force, -limit, limit)
            z1 = np.clip(z1 + h * z2, -limit, limit)
        out1[k], out2[k] = z1, z2
    return out1, out2
