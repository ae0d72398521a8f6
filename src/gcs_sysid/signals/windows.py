"""Symmetric windows that average and differentiate with exactly the same lag.

For a smooth window psi that vanishes at its ends, integration by parts gives

    integral psi(s) w'(t + s) ds = - integral psi'(s) w(t + s) ds

so that the derivative of a noisy signal need never be formed: the same window averages one
side of an equation and differentiates the other. This is the tracking differentiator's idea
with a finite memory: z1 is the average, z2 the derivative, and both have zero phase.
"""

from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array


@dataclass(frozen=True)
class Window:
    """A sampled cos^4 window and its derivative.

    Attributes:
        half: samples on either side of the center.
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

    def delayed(self, delay: float, dt: float, half: int) -> "Window":
        """The window for a signal whose stamps are `delay` s late, on `half` samples a side.

        A sample stamped t shows what was at t - delay, so the window moves the other way. The
        moved weights are corrected so that polynomials up to degree 2 n - 1, n = min(half, 5),
        are averaged and differentiated as exactly as without the delay.

        Raises:
            ValueError: the delay does not fit into `half` samples.
        """
        room = half - self.half
        shift = delay / dt
        if abs(shift) > room + 1e-6:
            raise ValueError(f"a delay of {delay} s needs more than {room} samples of room")
        old = np.arange(-self.half, self.half + 1) / (half + 1)
        new = np.arange(-half, half + 1) / (half + 1)
        s = (np.arange(-half, half + 1) - shift) / (self.half + 1)
        bell = np.where(np.abs(s) < 1.0, np.cos(0.5 * np.pi * np.clip(s, -1.0, 1.0)) ** 2, 0.0)
        powers = np.arange(2 * min(self.half, 5))[:, None]
        # Weights between two samples touch one sample more than the window itself.
        moved = old + shift / (half + 1)

        def fitted(weights: Array, guess: Array) -> Array:
            wanted = (weights * moved**powers).sum(axis=1)
            basis = new**powers
            missing = wanted - basis @ guess
            correction = np.linalg.lstsq((bell * basis) @ basis.T, missing, rcond=1e-12)[0]
            result: Array = guess + bell * (correction @ basis)
            return result

        slope = np.where(np.abs(s) < 1.0, bell * np.sin(np.pi * np.clip(s, -1.0, 1.0)), 0.0)
        slope = slope / (slope @ (new - shift / (half + 1)) * (half + 1) * dt)
        average = fitted(self.average, bell**2 / (bell**2).sum())
        return Window(half, average, fitted(self.derivative, slope))


def cosine_window(half: int, dt: float) -> Window:
    """The cos^4 window of `half` samples of `dt` seconds on either side.

    Sampled, the two sets of weights agree only as far as the window resolves the signal. The
    averaging weights are therefore corrected by an even polynomial so that
    sum derivative_k w(t_k) = sum average_k w'(t_k) holds exactly for polynomials w up to
    degree 2 n with n = min(half, 5).

    Raises:
        ValueError: fewer than two samples on a side, or a step that is not positive.

    Example:
        The derivative of t^2 is that of the average, 2 t, with nothing differentiated:

        >>> window = cosine_window(20, 0.005)
        >>> t = 3.0 + 0.005 * np.arange(-20, 21)
        >>> round(float(window.derivative @ t**2), 9), round(float(window.average @ (2.0 * t)), 9)
        (6.0, 6.0)
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
