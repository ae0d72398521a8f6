"""Complementary filter: slow truth from a reference attitude, fast truth from the gyro.

The article's filter for one angle, x' = y_u + k_p (y_x - x), is kept, but applied to the small
rotation e between the estimate and the reference, taken in world axes:

    estimate = exp(e) reference,     e' = R (gyro - bias) - w_reference - k_p e

In world axes the rotation of the vehicle does not couple the three components, so each is a
first-order linear filter and a block of samples is one call. The attitude may be any: there is
no Euler angle in it. What remains of e on average is the gyro's bias, which an integrator finds.
"""

import numpy as np
from scipy.signal import lfilter

from gcs_sysid.arrays import Array
from gcs_sysid.model import attitude

DEFAULT_K_P = 0.7
"""1/s. Slow noise of the reference wants it lower, noise and drift of the gyro higher; what either
way costs is measured in benchmarks/filter_claims.py."""
BIAS_INTERVAL = 0.1
"""s between renewals of the bias."""
DEFAULT_K_I = 0.05
"""1/s^2 for the gyro bias: settles in about 15 s (until then bias / k_p stands in the attitude).
With 0.1 the bias's own noise, which goes into the rates, already spoils estimates in hover."""


def complementary(y_u: Array, y_x: Array, dt: float, k_p: float) -> Array:
    """The article's filter x' = y_u + k_p (y_x - x) on signals (n,) or (n, m).

    Args:
        y_u: measured rate, unit/s.
        y_x: measured value, unit.
        dt: s between samples.
        k_p: 1/s.
    """
    a = np.exp(-k_p * dt)
    error = np.empty_like(y_x)
    error[0] = 0.0
    # Trapezoid for the rate: the two samples around each step.
    error[1:] = 0.5 * (y_u[1:] + y_u[:-1]) * dt - np.diff(y_x, axis=0)
    filtered: Array = lfilter([1.0], [1.0, -a], error, axis=0)
    return y_x + filtered


class ComplementaryFilter:
    """Attitude and gyro bias from gyro and a reference attitude, block by block.

    Args:
        dt: s between samples.
        k_p: 1/s, crossover between reference and gyro.
        k_i: 1/s^2, bias integrator; 0 leaves the bias at zero.
    """

    def __init__(self, dt: float, k_p: float = DEFAULT_K_P, k_i: float = DEFAULT_K_I) -> None:
        self.dt = dt
        self.k_p = k_p
        self.k_i = k_i
        self.bias = np.zeros(3)
        """Gyro bias, rad/s, body axes, as known after the last sample."""
        self.biases = np.zeros((0, 3))
        """(n, 3) the bias that was taken off each sample of the last block."""
        self._error = np.zeros(3)
        self._error_sum = np.zeros(3)
        self._bias_samples = max(1, round(BIAS_INTERVAL / dt))
        self._until_bias = self._bias_samples
        self._last_reference: Array | None = None
        self._last_rates = np.zeros(3)

    def restart(self) -> None:
        """Forget the attitude (after a gap); the bias is kept."""
        self._last_reference = None
        self._error = np.zeros(3)

    def update(self, rates: Array, reference: Array) -> Array:
        """Filter a block; how samples are grouped in blocks does not matter.

        Args:
            rates: (n, 3) gyro, rad/s.
            reference: (n, 4) unit quaternions from the autopilot, at the same instants.

        Returns:
            (n, 4) filtered attitude.
        """
        out = np.empty_like(reference)
        self.biases = np.empty_like(rates)
        done = 0
        while done < len(rates):
            # The bias is renewed after a fixed number of samples, not at the ends of blocks.
            part = slice(done, min(len(rates), done + self._until_bias))
            self.biases[part] = self.bias
            error = self._follow(rates[part], reference[part])
            out[part] = attitude.multiply(attitude.from_rotation_vector(error), reference[part])
            in_body = attitude.rotate(attitude.conjugate(reference[part]), error)
            self._error_sum += in_body.sum(axis=0)
            self._until_bias -= len(error)
            done = part.stop
            if self._until_bias == 0:
                self.bias = self.bias + self.k_i * self.dt * self._error_sum
                self._error_sum = np.zeros(3)
                self._until_bias = self._bias_samples
        return out

    def _follow(self, rates: Array, reference: Array) -> Array:
        """(n, 3) rotation from reference to estimate, world axes, with the bias as it is."""
        starts = self._last_reference is None
        if self._last_reference is None:
            self._last_reference = reference[0]
            self._last_rates = rates[0]
        before = np.vstack([self._last_reference, reference])
        unbiased = np.vstack([self._last_rates, rates]) - self.bias
        middle = 0.5 * (unbiased[1:] + unbiased[:-1])
        same_sign = np.where(np.sum(before[1:] * before[:-1], axis=-1, keepdims=True) < 0, -1, 1)
        halfway = before[:-1] + same_sign * before[1:]
        halfway /= np.linalg.norm(halfway, axis=-1, keepdims=True)
        turned = attitude.rotate(halfway, middle) * self.dt
        moved = attitude.to_rotation_vector(
            attitude.multiply(before[1:], attitude.conjugate(before[:-1]))
        )
        if starts:
            turned[0] = 0.0  # no time has passed before the first sample
        a = np.exp(-self.k_p * self.dt)
        error: Array
        error, _ = lfilter([1.0], [1.0, -a], turned - moved, axis=0, zi=(a * self._error)[None, :])
        self._error = error[-1]
        self._last_reference = reference[-1]
        self._last_rates = rates[-1]
        return error
