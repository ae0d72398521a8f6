"""The rotational model carried from each sample to the next, with its derivatives.

Every interval of the grid is integrated on its own, from a given rate at its start (multiple
shooting): no error accumulates, and all intervals are done at once. Rotor speeds between samples
come from a quintic spline. At 20 Hz a cubic one would be wrong by 7e-4 of a 2.7 Hz signal,
(omega dt)^4 / 720, the quintic by 2e-5.
"""

import math
from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.model import rigid_body as rb

_DEGREE = 5
SPLINE_END = 3
"""Samples at either end of a run where the spline is less true; they start no interval."""
_MAX_STEP = 0.0125
"""s. Steps of Runge and Kutta (RK4): the error is (omega h)^4 / 2880, 1e-5 of a 5 Hz signal."""
_REACH = 15
"""Samples after which a spline has forgotten an impulse."""

_COLUMN = {name: i for i, name in enumerate(rb.SIGNALS)}
_N_ROTOR_SIGNALS = 4


@dataclass(frozen=True)
class Transition:
    """From each rate to the next, n - 1 intervals.

    Attributes:
        rates: (n - 1, 3) reached at the end of each interval, rad/s.
        by_rate: (n - 1, 3, 3) their derivative by the rates at its start.
        by_theta: (n - 1, 3, N_THETA) their derivative by theta.
        by_delay: (n - 1, 3) their derivative by the delay of the rotor speeds, rad/s^2.
    """

    rates: Array
    by_rate: Array
    by_theta: Array
    by_delay: Array


class Propagator:
    """Integrates w' = Q(theta) x(w, Omega) over every interval of one gapless run.

    Args:
        geometry: (3, rotors) of the airframe.
        speeds: (n + 2 margin, rotors) rad/s: some more at either end than rates.
        dt: s between samples.
        margin: samples more at either end, SPLINE_END and as many as the delay may reach.
        delay: s, of the speeds' stamps behind the rates'.
        torque: (3, N_SIGNALS) of deviations from the model, see `estimation.fit.deviations`.
    """

    def __init__(
        self,
        geometry: Array,
        speeds: Array,
        dt: float,
        margin: int = SPLINE_END,
        delay: float = 0.0,
        torque: Array | float = 0.0,
    ) -> None:
        self._torque = torque
        steps = _steps(dt)
        self._step = dt / steps
        at, slope = (v[:, margin:-margin] for v in _interpolate(speeds, steps, delay / dt))
        slope = slope / dt
        self._rotors, self._H = rb.rotor_signals(geometry, at)
        self._dH = slope @ geometry[2]

    def __call__(self, theta: Array, rates: Array) -> Transition:
        """Integrate from (n, 3) rates in rad/s; the last of them starts no interval."""
        Q, G = rb.forward_jacobian(theta, self._torque)
        G_flat = G.transpose(1, 0, 2).reshape(-1, rb.N_SIGNALS)
        h = self._step
        # The state: w, then dw/dw0 and dw/dtheta side by side.
        w = rates[:-1]
        W = np.zeros((len(w), 3, 3 + rb.N_THETA))
        W[:, :, :3] = np.eye(3)
        for stage in range(0, len(self._rotors) - 1, 2):
            k1, K1 = self._change(stage, Q, G_flat, w, W)
            k2, K2 = self._change(stage + 1, Q, G_flat, w + 0.5 * h * k1, W + 0.5 * h * K1)
            k3, K3 = self._change(stage + 1, Q, G_flat, w + 0.5 * h * k2, W + 0.5 * h * K2)
            k4, K4 = self._change(stage + 2, Q, G_flat, w + h * k3, W + h * K3)
            w = w + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
            W = W + h / 6.0 * (K1 + 2.0 * (K2 + K3) + K4)
        # d/d(delay) of the integral of Q x over an interval: Q times the change of x in it.
        change = (self._rotors[-1] - self._rotors[0]) @ Q[:, :_N_ROTOR_SIGNALS].T
        change += np.outer(self._dH[-1] - self._dH[0], Q[:, _COLUMN["dH"]])
        return Transition(w, W[:, :, :3], W[:, :, 3:], change)

    def _change(
        self, stage: int, Q: Array, G_flat: Array, w: Array, W: Array
    ) -> tuple[Array, Array]:
        """Derivatives by time of the rates and of their sensitivities."""
        H = self._H[stage]
        x = np.empty((len(w), rb.N_SIGNALS))
        x[:, :_N_ROTOR_SIGNALS] = self._rotors[stage]
        x[:, rb.OF_RATES] = rb.rate_signals(w)
        x[:, _COLUMN["qH"]] = w[:, 1] * H
        x[:, _COLUMN["pH"]] = w[:, 0] * H
        x[:, _COLUMN["dH"]] = self._dH[stage]
        change = _rate_jacobian(Q, w, H) @ W
        change[:, :, 3:] += (x @ G_flat.T).reshape(len(w), 3, rb.N_THETA)
        return x @ Q.T, change


def impulse_weights(dt: float) -> Array:
    """(2 m,) what a unit in one sample adds to each interval's integral, as a share of dt.

    The sample lies between the m-th interval and the next.
    """
    impulse = np.zeros((2 * _REACH + 1, 1))
    impulse[_REACH] = 1.0
    steps = _steps(dt)
    at, _ = _interpolate(impulse, steps)
    simpson = np.tile([2.0, 4.0], steps + 1)[: 2 * steps + 1]
    simpson[[0, -1]] = 1.0
    weights: Array = simpson @ at[..., 0] / (6.0 * steps)
    return weights


def _steps(dt: float) -> int:
    return max(1, math.ceil(dt / _MAX_STEP - 1e-9))


def _interpolate(values: Array, steps: int, shift: float = 0.0) -> tuple[Array, Array]:
    """Values and slopes a sample, (2 steps + 1, n - 1, m): from start to end of each interval.

    Those of `shift` samples later; at the ends, where there are none, the last.
    """
    from scipy.interpolate import make_interp_spline  # takes a while to load

    n = len(values)
    times = np.arange(n - 1)[None, :] + np.linspace(0.0, 1.0, 2 * steps + 1)[:, None]
    times = np.clip(times + shift, 0.0, n - 1.0)
    spline = make_interp_spline(np.arange(n, dtype=float), values, k=_DEGREE)
    return spline(times), spline(times, 1)


def _rate_jacobian(Q: Array, w: Array, H: Array) -> Array:
    """(n, 3, 3) d(Q x)/dw at (n, 3) rates and (n,) H."""
    slopes = rb.rate_slopes(w).reshape(3 * len(w), -1)  # one product of matrices, not n
    by_rate = (slopes @ Q[:, rb.OF_RATES].T).reshape(-1, 3, 3)  # (n, by, of)
    by_rate[:, 0] += H[:, None] * Q[:, _COLUMN["pH"]]
    by_rate[:, 1] += H[:, None] * Q[:, _COLUMN["qH"]]
    return np.ascontiguousarray(by_rate.swapaxes(1, 2))
