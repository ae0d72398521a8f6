"""What the regression puts on every signal: averages of one side, derivatives of the other.

A smoother takes blocks of samples and gives rows; both kinds of row come from one linear filter,
so their lag is the same. Samples may be missing (NaN): rows that they would touch are NaN.

**Windows.** For a smooth window psi that vanishes at its ends, integration by parts gives

    integral psi(s) w'(t + s) ds = - integral psi'(s) w(t + s) ds

so that the derivative of a noisy signal need never be formed: the same window averages one
side of an equation and differentiates the other. This is the tracking differentiator's idea
with a finite memory: z1 is the average, z2 the derivative, and both have zero phase.

**Tracking differentiators.** A signal v in, z1 that follows it and z2 that follows v' out:

    z1' = z2
    z2' = -R^2 (|z1 - v|^a sign(z1 - v) + b |z2 / R|^a sign(z2))        usual form
    z2' = -R   (|z1 - v|^a sign(z1 - v) + b |z2 / R|^a sign(z2))        as the article prints it

With a = 1 the usual form is a linear second-order low-pass of bandwidth R and damping b / 2.
Put on every signal of both sides of an equation its lag cancels exactly, which a nonlinear one,
whose lag depends on amplitude, cannot do. As printed, with R = 50000, the damping is b / R^a of
what it should be: next to nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

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
        from scipy.signal import cont2discrete, ss2tf  # takes a while to load

        A, B = np.array([[0.0, 1.0], [-R * R, -R * b]]), np.array([[0.0], [R * R]])
        discrete = cont2discrete((A, B, np.eye(2), np.zeros((2, 1))), dt, method="foh")
        self._numerators, self._denominator = ss2tf(*discrete[:4])
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
            from scipy.signal import lfilter_zi

            at_rest = (lfilter_zi(one, self._denominator) for one in self._numerators)
            first, second = (state[:, None] * v[0] for state in at_rest)
            self._state = first, second
        z1, s1 = lfilter(self._numerators[0], self._denominator, v, self._state[0])
        z2, s2 = lfilter(self._numerators[1], self._denominator, v, self._state[1])
        self._state = (s1, s2)
        return z1, z2


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
            return guess + bell * (correction @ basis)

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


@dataclass(frozen=True)
class Smoothed:
    """Rows of a smoother.

    Attributes:
        average: (rows, m).
        derivative: (rows, m), 1/s.
        late_average: (delays, rows, late), the late signals put right by each delay.
        late_derivative: (delays, rows, late), 1/s.
    """

    average: Array
    derivative: Array
    late_average: Array
    late_derivative: Array


class WindowSmoother:
    """The symmetric window: zero phase, finite memory. The default.

    Args:
        dt: s between samples.
        half: samples on either side of the center.
        delays: s, equally spaced.
    """

    def __init__(self, dt: float, half: int, delays: Sequence[float] = (0.0,)) -> None:
        # Four rows in half a window lose next to nothing.
        self.step = max(1, half // 4)
        self.delays = np.array(delays)
        room = half + int(np.ceil(np.max(np.abs(self.delays)) / dt - 1e-9))
        window = cosine_window(half, dt)
        self._window = window.delayed(0.0, dt, room) if room > half else window
        moved = [window.delayed(d, dt, room) if d else self._window for d in delays]
        self._late_taps = np.stack([w.average for w in moved] + [w.derivative for w in moved]).T
        self.taps = np.stack([self._window.average, self._window.derivative])
        """(2, length) responses of an average and of a derivative, 1/s, to a single sample."""
        self._pending: Array | None = None

    @property
    def late_taps(self) -> Array:
        """(delays, length) response of the late signals' averages to a single sample."""
        return self._late_taps.T[: len(self.delays), ::-1]

    @property
    def late_slopes(self) -> Array:
        """(delays, length) the same of their derivatives, 1/s."""
        return self._late_taps.T[len(self.delays) :, ::-1]

    def restart(self) -> None:
        """What comes next does not join on to what came before."""
        self._pending = None

    def count_after(self, samples: int) -> int:
        """How many rows so many more samples will complete."""
        known = 0 if self._pending is None else len(self._pending)
        return max((known + samples - self._window.length) // self.step + 1, 0)

    def update(self, signals: Array, late: int) -> Smoothed:
        """(n, m) samples to rows; the first `late` signals are taken at every delay too."""
        count = self.count_after(len(signals))
        if self._pending is not None:
            signals = np.concatenate([self._pending, signals])
        self._pending = signals[count * self.step :]
        if count == 0:
            none = np.empty((len(self.delays), 0, late))
            return Smoothed(signals[:0], signals[:0], none, none)
        windows = sliding_window_view(signals, self._window.length, axis=0)[:: self.step]
        if count <= 8:  # copies are multiplied the fastest, where they are not large
            windows = np.swapaxes(np.ascontiguousarray(np.swapaxes(windows, 1, 2)), 1, 2)
        moved = np.moveaxis(windows[:, :late] @ self._late_taps, -1, 0)
        return Smoothed(
            windows @ self._window.average,
            windows @ self._window.derivative,
            moved[: len(self.delays)],
            moved[len(self.delays) :],
        )


DAMPING = 2.0
"""b of the differentiator on both sides: critical."""


class DifferentiatorSmoother:
    """The linear tracking differentiator: z1 averages, z2 differentiates.

    Args:
        dt: s between samples.
        bandwidth: R, rad/s.
    """

    def __init__(self, dt: float, bandwidth: float) -> None:
        self._filter = LinearDifferentiator(dt, bandwidth, DAMPING)
        self.step = max(1, round(0.25 / (bandwidth * dt)))
        self.delays = np.zeros(1)
        impulse = np.zeros((self._filter.settling + 2, 1))
        impulse[1] = 1.0
        response = LinearDifferentiator(dt, bandwidth, DAMPING).update(impulse)
        self.taps = np.stack([z[1:, 0] for z in response])
        """As of `WindowSmoother`."""
        self._next_row = 0
        self._held: Array | None = None
        self._unsettled: Array = np.zeros(0)

    @property
    def late_taps(self) -> Array:
        """(1, length) response of an average to a single sample."""
        return self.taps[:1]

    @property
    def late_slopes(self) -> Array:
        """(1, length) the same of a derivative, 1/s."""
        return self.taps[1:]

    def restart(self) -> None:
        """What comes next does not join on to what came before."""
        self._filter.restart()
        self._held = None

    def count_after(self, samples: int) -> int:
        """How many rows so many more samples will complete."""
        return len(range(self._next_row, samples, self.step))

    def update(self, signals: Array, late: int) -> Smoothed:
        """(n, m) samples to rows."""
        if len(signals) == 0:
            none = np.empty((1, 0, late))
            return Smoothed(signals, signals, none, none)
        if self._held is None:
            self._held = np.zeros(signals.shape[1])
            self._unsettled = np.full(signals.shape[1], self._filter.settling)
        # A missing sample is held over, and spoils the memory until that has settled again.
        index = np.arange(len(signals))[:, None]
        missing = np.isnan(signals)
        last_there = np.maximum.accumulate(np.where(missing, -1, index))
        filled = np.where(
            last_there >= 0, np.take_along_axis(signals, np.maximum(last_there, 0), 0), self._held
        )
        self._held = filled[-1]
        last_missing = np.maximum.accumulate(np.where(missing, index, -1))
        wait = np.where(
            last_missing >= 0,
            self._filter.settling - (index - last_missing),
            self._unsettled - (index + 1),
        )
        self._unsettled = np.maximum(wait[-1], 0)
        z1, z2 = self._filter.update(filled)
        rows = slice(self._next_row, None, self.step)
        self._next_row = (self._next_row - len(signals)) % self.step
        settled = wait <= 0
        average = np.where(settled, z1, np.nan)[rows]
        derivative = np.where(settled, z2, np.nan)[rows]
        return Smoothed(average, derivative, average[None, :, :late], derivative[None, :, :late])


Smoother = WindowSmoother | DifferentiatorSmoother
"""A filter pair that works block by block."""


def leaky(responses: Array, step: int, dt: float, memory: float) -> Array:
    """(k, longer) of (k, length) responses, after a leaky sum over every `step`-th row."""
    if memory == 0.0:
        return responses
    decay = np.exp(-step * dt / memory)
    rows = int(np.ceil(12.0 / -np.log(decay)))
    leak = np.zeros(rows * step)
    leak[::step] = decay ** np.arange(rows)
    return np.stack([np.convolve(response, leak) for response in responses])


def noise_gains(smoother: Smoother, dt: float, memory: float) -> tuple[float, float]:
    """Variance of an average and of a derivative over that of white sample noise, leaky sums."""
    average, derivative = (float(t @ t) for t in leaky(smoother.taps, smoother.step, dt, memory))
    return average, derivative
