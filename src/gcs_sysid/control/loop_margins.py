"""Margins and step responses of the loops around a vehicle in hover.

The loop of an axis is broken at its torque, with the loops of the other axes closed: what a sweep
injected there measures. With H the loops' response to body rates and G the vehicle,

    1 + l_i = 1 / [(1 + H G)^-1]_ii
"""

from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.control.hover_dynamics import HoverDynamics
from gcs_sysid.control.rate_loops import RateLoop

_SECONDS = 16.0
"""s, half the period of the square wave whose response is the step response."""


@dataclass(frozen=True)
class Margins:
    """Of one loop, for N vehicles.

    Attributes:
        crossover: (N,) rad/s, last gain crossover; NaN: the loop has no gain.
        phase: (N,) deg, the least at any crossover; below zero: unstable.
        gain: (N,) dB by which the gain may rise; below zero: unstable.
        reduction: (N,) dB by which it may fall; infinite where it may fall to nothing.
    """

    crossover: Array
    phase: Array
    gain: Array
    reduction: Array

    @property
    def delay(self) -> Array:
        """(N,) s by which the loop may be later."""
        out: Array = np.radians(self.phase) / self.crossover
        return out

    def worst(self) -> tuple[float, float]:
        """Least phase and gain margin (deg, dB) of all."""
        return float(np.min(self.phase)), float(np.min(self.gain))


def frequencies(loop: RateLoop, points: int = 400) -> Array:
    """(w,) rad/s up to just below half the loop rate."""
    # From 0.2 rad/s on: all crossovers lie above.
    return np.geomspace(0.2, 0.98 * np.pi * loop.rate, points)


def open_loops(
    dynamics: HoverDynamics, loop: RateLoop, omega: Array, *, attitude: bool = True
) -> Array:
    """(N, w, 3) loop transfer of each axis, broken at its torque, the other axes closed.

    Args:
        dynamics: of N vehicles.
        loop: around them.
        omega: (w,) rad/s.
        attitude: whether the attitude loop is closed, as in any mode but Acro.
    """
    G = dynamics.response(omega, loop.period)
    rate, angle, _ = loop.controllers(omega)
    H = rate + angle / (1j * omega[:, None]) if attitude else rate
    difference = np.eye(3) + H[None, :, :, None] * G
    own = np.diagonal(np.linalg.inv(difference), axis1=-2, axis2=-1)
    out: Array = 1.0 / own - 1.0
    return out


def margins_of(omega: Array, loops: Array) -> Margins:
    """Margins of (N, w) loop transfers at (w,) rad/s, by interpolation."""
    logs = np.log(omega)
    size = 20.0 * np.log10(np.maximum(np.abs(loops), 1e-12))
    first = np.angle(loops[:, :1])
    # An integrator or two begin at -90 to -270 deg, never above 0.
    first = np.where(first > 1e-6, first - 2.0 * np.pi, first)
    phase = np.degrees(first + np.unwrap(np.angle(loops), axis=1) - np.angle(loops[:, :1]))
    rows = [_of_one(logs, s, p) for s, p in zip(size, phase, strict=True)]
    return Margins(*(np.array(column) for column in zip(*rows, strict=True)))


def _of_one(logs: Array, size: Array, phase: Array) -> tuple[float, float, float, float]:
    at, margin = _crossings(logs, size, phase + 180.0)
    _, above = _crossings(logs, phase + 180.0, size)
    crossover = float(np.exp(at[-1])) if len(at) else np.nan
    stable = not len(margin) or margin.min() > 0.0
    up = -above[above < 0.0]
    down = above[above >= 0.0]
    gain = float(up.min()) if len(up) else np.inf
    # Unstable: how far the gain must fall.
    if not stable:
        gain = -float(down.max()) if len(down) else -np.inf
    reduction = float(down.min()) if stable and len(down) else np.inf
    return crossover, float(margin.min()) if len(margin) else np.inf, gain, reduction


def _crossings(x: Array, level: Array, other: Array) -> tuple[Array, Array]:
    """Where a curve crosses zero: x there, and another curve's values there."""
    i = np.flatnonzero((level[:-1] > 0.0) != (level[1:] > 0.0))
    share = level[i] / (level[i] - level[i + 1])
    return x[i] + share * (x[i + 1] - x[i]), other[i] + share * (other[i + 1] - other[i])


@dataclass(frozen=True)
class StepResponse:
    """Response to a step of the set-point on one axis.

    Attributes:
        t: (k,) s.
        values: (N, k) over the step.
    """

    t: Array
    values: Array

    @property
    def overshoot(self) -> Array:
        """(N,) share of the step by which the peak exceeds it; never below zero."""
        shown = self.values[:, self.t <= 3.0]  # no overshoot comes later
        out: Array = np.maximum(shown.max(axis=1) - 1.0, 0.0)
        return out

    @property
    def rise(self) -> Array:
        """(N,) s from 10 to 90 % of the step."""
        low, high = ((self.values > level).argmax(axis=1) for level in (0.1, 0.9))
        out: Array = self.t[high] - self.t[low]
        return out


def step_response(
    dynamics: HoverDynamics, loop: RateLoop, axis: int, *, of: str = "attitude"
) -> StepResponse:
    """Response of attitude to its set-point, or of the rate to its own with no attitude loop.

    Of a square wave so long that each half settles, by its Fourier series.

    Args:
        dynamics: of N vehicles.
        loop: around them.
        axis: 0 roll, 1 pitch, 2 yaw.
        of: "attitude" or "rate".
    """
    half = round(_SECONDS * loop.rate)
    t = np.arange(half) * loop.period
    wave = np.repeat([1.0, 0.0], half)
    spectrum = np.fft.rfft(wave)
    omega = 2.0 * np.pi * np.fft.rfftfreq(2 * half, loop.period)
    # The even harmonics of a square wave are zero; what is near the Nyquist frequency does not act.
    used = np.flatnonzero(
        (np.abs(spectrum) > 1e-9) & (omega > 0.0) & (omega < 0.9 * np.pi * loop.rate)
    )
    w = omega[used]
    attitude = of == "attitude"
    rate, angle, reference = loop.controllers(w)
    G = dynamics.response(w, loop.period)
    s = 1j * w[:, None]
    H = rate + angle / s if attitude else rate
    closed = np.linalg.inv(np.eye(3) + G * H[None, :, None, :]) @ G
    shape = closed[:, :, axis, axis] * (angle if attitude else reference)[:, axis]
    if attitude:
        shape = shape / s[:, 0]
    out = np.zeros((len(dynamics), len(omega)), complex)
    out[:, used] = shape * spectrum[used]
    out[:, 0] = spectrum[0]
    values = np.fft.irfft(out, 2 * half, axis=1)[:, :half]
    # Each half ends where it settled: the other half's end is the start.
    return StepResponse(t, values)
