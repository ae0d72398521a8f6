"""Complementary filter: slow truth from a reference attitude, fast truth from the gyro.

The article's filter for one angle, x' = y_u + k_p (y_x - x), is kept, but applied to the small
rotation e between the estimate and the reference, taken in world axes:

    estimate = exp(e) reference,     e' = R (gyro - bias) - w_reference - k_p e

In world axes the rotation of the vehicle does not couple the three components, so each is a
first-order linear filter and a block of samples is one call. The attitude may be any: there is
no Euler angle in it. What remains of e on average is the gyro's bias, which an integrator finds. It
settles within some k_p / k_i, and the attitude would be off by bias / k_p until then: at first the
bias is the mean of what the gyro turns beyond the reference.
"""

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.model import attitude

DEFAULT_K_P = 0.7
"""1/s. Slow noise of the reference wants it lower, noise and drift of the gyro higher; what either
way costs is measured in benchmarks/filter_claims.py."""
DEFAULT_K_I = 0.05
"""1/s^2 for the gyro bias, once it is known. With 0.1 the bias's own noise, which goes into the
rates, already spoils estimates in hover."""


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
        self._turned_sum, self._seen = np.zeros(3), 0
        self._known = self.bias
        # Ten times a second.
        self._bias_samples = max(1, round(0.1 / dt))
        self._until_bias = self._bias_samples
        self._last_reference: Array | None = None
        self._last_rates = np.zeros((2, 3))
        # Remainder of each sample's innovation after a while, and of the error before.
        age = np.arange(self._bias_samples)[:, None] - np.arange(self._bias_samples)
        self._memory = np.where(age >= 0, np.exp(-k_p * dt * np.maximum(age, 0)), 0.0)
        self._faded = np.exp(-k_p * dt * np.arange(1, self._bias_samples + 1))[:, None]

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
        self.biases = np.empty_like(rates)
        if len(rates) == 0:
            return np.empty_like(reference)
        if not self._seen:
            self._known = self.bias
        turned, per_bias, to_world = self._turns(rates, reference)
        errors = np.empty_like(rates)
        done = 0
        while done < len(rates):
            # The bias is renewed after a fixed number of samples, not at the ends of blocks.
            part = slice(done, min(len(rates), done + self._until_bias))
            n = part.stop - done
            self.biases[part] = self.bias
            turn = turned[part] - per_bias[part] @ self.bias
            error = self._memory[:n, :n] @ turn + self._faded[:n] * self._error
            errors[part] = error
            self._error = error[-1]
            # Back in body axes: a row times a rotation is its inverse on the column.
            both = np.stack([error, turned[part]], axis=1) @ to_world[part]
            self._error_sum += both[:, 0].sum(axis=0)
            self._turned_sum += both[:, 1].sum(axis=0)
            self._seen += n
            self._until_bias -= n
            done = part.stop
            if self._until_bias == 0:
                self._renew_bias()
        return attitude.multiply(attitude.from_rotation_vector(errors), reference)

    def _renew_bias(self) -> None:
        """By the integrator; before that settles, by all that the gyro turned too far."""
        seconds = self.dt * self._seen
        if seconds * self.k_i >= self.k_p:
            self.bias = self.bias + self.k_i * self.dt * self._error_sum
        elif self.k_i:
            # The reference's noise at both ends counts, over that time, so that the mean's weight
            # grows with the square of it. After the filter's memory that is as of what was known.
            before = self.k_p**-2
            turned = self._turned_sum * seconds + self._known * before
            self.bias = turned / (seconds**2 + before)
        self._error_sum = np.zeros(3)
        self._until_bias = self._bias_samples

    def _turns(self, rates: Array, reference: Array) -> tuple[Array, Array, Array]:
        """How far the gyro turned beyond the reference at each sample, in world axes.

        Returns:
            (n, 3) rad with the bias still in it, (n, 3, 3) what a bias adds to it, and
            (n, 3, 3) matrices of the reference.
        """
        starts = self._last_reference is None
        if self._last_reference is None:
            self._last_reference = reference[0]
            self._last_rates = rates[[0, 0]]
        before = np.concatenate([self._last_reference[None], reference])
        measured = np.concatenate([self._last_rates, rates])
        self._last_reference = reference[-1]
        self._last_rates = measured[-2:]
        # The mean between two samples, by the parabola through them and the one before: at 20 Hz
        # a straight line loses per cents of a fast turn, which shows in k_T.
        mean = (5.0 * measured[2:] + 8.0 * measured[1:-1] - measured[:-2]) / 12.0
        same_sign = np.where((before[1:] * before[:-1]).sum(axis=1, keepdims=True) < 0.0, -1.0, 1.0)
        halfway = before[:-1] + same_sign * before[1:]
        halfway /= np.sqrt((halfway * halfway).sum(axis=1, keepdims=True))
        both = attitude.matrices(np.concatenate([halfway, reference]))
        per_rate, to_world = both[: len(rates)] * self.dt, both[len(rates) :]
        moved = attitude.to_rotation_vector(
            attitude.multiply(before[1:], attitude.conjugate(before[:-1]))
        )
        if starts:
            per_rate[0] = 0.0  # no time has passed before the first sample
        return (per_rate @ mean[..., None])[..., 0] - moved, per_rate, to_world
