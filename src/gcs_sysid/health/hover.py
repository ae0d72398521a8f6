"""Hover in any log: streams of any rate as means over the same short windows.

Every signal is averaged with one triangular weight, 2 H wide. Of a signal known at its own times
the weighted mean follows from its second integral S,

    mean(t) = (S(t + H) - 2 S(t) + S(t - H)) / H^2,

and the same formula applied to the first integral's integrand gives the mean of a derivative: the
mean angular acceleration is that of the gyro's first integral. Both sides of a balance are thus
filtered alike whatever their rates, as in `signals.smoothers`, down to a few samples a window.
"""

import math
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import pairwise

import numpy as np

from gcs_sysid.arrays import Array, Mask, complete_rows
from gcs_sysid.health.hover_tuning import TUNING
from gcs_sysid.health.log_streams import RotorStream, Streams
from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.signals.records import Stream
from gcs_sysid.signals.recursions import lfilter
from gcs_sysid.signals.rotor_readings import RotorLines


class _Integrals:
    """First and second integral of a sampled signal, straight between its samples."""

    def __init__(self, t: Array, values: Array) -> None:
        self._t = t
        # About the mean, so that no digits are lost in long logs.
        self._mean = values.mean(axis=0)
        # By columns and in place, as a long log is integrated often.
        self._v, self._first = np.zeros((2, *values.shape[::-1])).transpose(0, 2, 1)
        np.subtract(values, self._mean, out=self._v)
        area = self._v[1:] + self._v[:-1]
        area *= 0.5 * np.diff(t)[:, None]
        np.cumsum(area, axis=0, out=self._first[1:])

    @cached_property
    def _second(self) -> Array:
        """(n, width), which slopes do without."""
        second: Array = np.zeros(self._v.shape[::-1]).T
        dt = np.diff(self._t)[:, None]
        step = 2.0 * self._v[:-1]
        step += self._v[1:]
        step *= dt**2
        step /= 6.0
        step += dt * self._first[:-1]
        np.cumsum(step, axis=0, out=second[1:])
        return second

    def _before(self, t: Array) -> tuple[Array, Array, Array]:
        """(n,) the sample before each t; (n, 1) s since then; (n, width) slope from there."""
        i = np.clip(np.searchsorted(self._t, t, side="right") - 1, 0, len(self._t) - 2)
        h = (t - self._t[i])[:, None]
        step = (self._t[i + 1] - self._t[i])[:, None]
        return i, h, (self._v[i + 1] - self._v[i]) / step

    def _first_at(self, t: Array) -> Array:
        """(n, width) first integral, exact between samples."""
        i, h, slope = self._before(t)
        out: Array = self._first[i] + h * self._v[i] + 0.5 * h**2 * slope
        return out

    def _second_at(self, t: Array) -> Array:
        """(n, width) second integral, likewise."""
        i, h, slope = self._before(t)
        out: Array = self._second[i] + h * self._first[i] + 0.5 * h**2 * self._v[i]
        out += h**3 * slope / 6.0
        return out

    def mean(self, t: Array, half: float) -> Array:
        """(n, width) means with a triangle of half width `half` about each t."""
        a, b, c = (self._second_at(t + shift) for shift in (-half, 0.0, half))
        out: Array = (a - 2.0 * b + c) / half**2 + self._mean
        return out

    def slope(self, t: Array, half: float) -> Array:
        """(n, width) means of the derivative with the same triangle."""
        a, b, c = (self._first_at(t + shift) for shift in (-half, 0.0, half))
        out: Array = (a - 2.0 * b + c) / half**2
        return out


@dataclass(frozen=True)
class Windows:
    """Means over windows in flight; NaN where a stream is missing or has a gap.

    Attributes:
        t: (n,) s, their centers.
        half: s, half their width; they follow each other by this much.
        rates: (n, 3) rad/s.
        turning: (n, 3) rad/s^2.
        products: (n, 3) q r, r p, p q in rad^2/s^2.
        force: (n, 3) specific force, m/s^2.
        lift: (n,) m/s^2 of thrust over mass that gravity and vertical acceleration ask for.
        sink: (n,) m/s along body z, down; NaN without velocity.
        speed: (n,) m/s over the ground; NaN without velocity.
        speeds: (n, rotors) mean squares of rotor speeds, rad^2/s^2.
        commands: (n, rotors) means of commands of 0 to 1.
        squares: (n, rotors) means of their squares.
        jitter: (n, rotors, 2) half of the difference between the means of every other sample, of
            commands and squares: its variance is that of the means by sampling alone.
        lag: s, time constant of the rotors, which `commands` and `squares` have passed.
        hovering: (n,) whether the balances of a hover may be drawn.
    """

    t: Array
    half: float
    rates: Array
    turning: Array
    products: Array
    force: Array
    lift: Array
    sink: Array
    speed: Array
    speeds: Array
    commands: Array
    squares: Array
    jitter: Array
    lag: float
    hovering: Mask

    @property
    def seconds(self) -> float:
        """Of hover."""
        return float(np.count_nonzero(self.hovering)) * self.half

    @property
    def idle(self) -> Mask:
        """(n,) whether all commands are zero: rotors that turn then carry nothing."""
        still: Mask = np.logical_and.reduce(self.commands < TUNING.least_throttle_motion, axis=1)
        return still

    def part(self, rows: Mask | slice) -> "Windows":
        """Some of the windows."""
        of_all = ("half", "lag")
        return replace(self, **{n: v[rows] for n, v in vars(self).items() if n not in of_all})

    def starting_at(self, share: float) -> "Windows":
        """Were commands without thrust up to this share of their range, and full as before."""
        left = 1.0 - share
        return replace(
            self,
            commands=(self.commands - share) / left,
            squares=(self.squares - 2.0 * share * self.commands + share**2) / left**2,
            jitter=self.jitter / left,
        )


def windows_of(streams: Streams, rotors: int) -> Windows:
    """Average all streams, of so many rotors, over windows in flight."""
    used = [s.rate for s in (streams.speeds, streams.commands) if s is not None]
    slowest = min([*used, streams.rate(Stream.IMU) or TUNING.enough_rate])
    half = max(TUNING.half_window, TUNING.samples_a_half / slowest)
    flying_t = streams.flight.t
    t = np.arange(half, max(float(flying_t[-1]) - half, 0.0), half) if len(flying_t) else flying_t
    aloft = np.append(0.0, np.cumsum(~streams.flight.flying))
    first, last = (np.searchsorted(flying_t, t + s) for s in (-half, half))
    t = t[streams.flight.at(t - half) & (aloft[last] == aloft[first])]

    imu_t, imu = streams.tracks.get(Stream.IMU, (np.empty(0), np.empty((0, 6))))
    p, q, r = imu[:, 0], imu[:, 1], imu[:, 2]
    inertial = windowed_means(imu_t, np.column_stack([imu, q * r, r * p, p * q]), t, half)
    turning = windowed_means(imu_t, imu[:, :3], t, half, slope=True)
    lift, sink, speed = _vertical(streams, t, half)
    speeds = _rotor_means(streams.speeds, t, half, rotors, power=2)
    force = inertial[:, 3:6]
    lag = _lag_of(streams.commands, t, half, speeds, variations_of_lift(lift, force), sink)
    commands, squares = _command_means(streams.commands, t, half, rotors, lag)
    jitter = 0.5 * np.subtract(
        *(
            np.stack(_command_means(streams.commands, t, half, rotors, lag, slice(k, None, 2)), 2)
            for k in (0, 1)
        )
    )
    hovering = _hovering(inertial[:, :3], turning, lift, force, speed)
    return Windows(
        t,
        half,
        inertial[:, :3],
        turning,
        inertial[:, 6:],
        force,
        lift,
        sink,
        speed,
        speeds,
        commands,
        squares,
        jitter,
        lag,
        hovering,
    )


class Averager:
    """Windowed means of one sampled signal, for as many sets of windows as one likes.

    Args:
        times: (n,) s.
        values: (n,) or (n, width); rows that lack a value do not count.
    """

    def __init__(self, times: Array, values: Array) -> None:
        values = np.ascontiguousarray(values if values.ndim == 2 else values[:, None])
        self._width = values.shape[1]
        if not np.isfinite(values).all():
            there = complete_rows(values)
            times, values = times[there], values[there]
        self._t = times
        self._steps = np.diff(times)
        enough = len(times) >= TUNING.fewest_samples
        self._integrals = _Integrals(times, values) if enough else None

    def means(self, t: Array, half: float, *, slope: bool = False) -> Array:
        """(n, width) means, or slopes, about each t; NaN where the samples have a gap."""
        out = np.full((len(t), self._width), np.nan)
        if self._integrals is None or not len(t):
            return out
        gaps = np.flatnonzero(self._steps > longest_step(self._steps, half))
        times = self._t
        # A gap spoils the windows that overlap it: their ends lie beyond its begin, before its end.
        begun = np.searchsorted(times[gaps], t + half)
        ended = np.searchsorted(times[gaps + 1], t - half)
        whole = (begun == ended) & (t - half >= times[0]) & (t + half <= times[-1])
        if whole.any():
            made = self._integrals.slope if slope else self._integrals.mean
            out[whole] = made(t[whole], half)
        return out


def longest_step(steps: Array, half: float) -> float:
    """S between samples, beyond which windows that overlap it are spoilt."""
    return max(TUNING.longest_gap * half, 2.5 * float(np.median(steps)))


def windowed_means(
    times: Array, values: Array, t: Array, half: float, *, slope: bool = False
) -> Array:
    """(n, width) windowed means, NaN where the samples have a gap."""
    return Averager(times, values).means(t, half, slope=slope)


def _rotor_means(
    stream: RotorStream | None, t: Array, half: float, rotors: int, power: int
) -> Array:
    if stream is None:
        return np.full((len(t), rotors), np.nan)
    if stream.share_times:
        values = np.column_stack([v**power for _, v in stream.samples])
        return windowed_means(stream.samples[0][0], values, t, half)
    return np.hstack([windowed_means(at, v**power, t, half) for at, v in stream.samples])


def variations_of_lift(lift: Array, force: Array) -> Array:
    """(n,) m/s^2, thrust over mass: as the accelerometer has it, level as gravity has it.

    Velocities of a filter are late and smooth; the accelerometer's bias is constant.

    Args:
        lift: (n,) as of `Windows`.
        force: (n, 3) likewise.
    """
    off = lift + force[:, 2]
    there = np.isfinite(off)
    if not there.any():
        return np.where(np.isfinite(lift), lift, -force[:, 2])
    varying: Array = -force[:, 2] + float(np.median(off[there]))
    return varying


def _command_means(
    stream: RotorStream | None,
    t: Array,
    half: float,
    rotors: int,
    lag: float,
    every: slice = slice(None),
) -> tuple[Array, Array]:
    """(n, rotors) means of commands as rotors follow them, and of their squares."""
    if stream is None:
        return np.full((len(t), rotors), np.nan), np.full((len(t), rotors), np.nan)
    groups = [stream.samples] if stream.share_times else [(one,) for one in stream.samples]
    means = []
    for some in groups:
        at, u = _followed(
            some[0][0][every], np.column_stack([v for _, v in some])[every], half, lag
        )
        both = np.stack([u, u**2], axis=2).reshape(len(u), 2 * u.shape[1])
        means.append(windowed_means(at, both, t, half))
    joined = np.hstack(means)
    return joined[:, ::2], joined[:, 1::2]


def _followed(times: Array, commands: Array, half: float, lag: float) -> tuple[Array, Array]:
    """Even times, and there what a rotor does that follows commands with a time constant.

    Thrust is that of what it does: of commands that change within the time constant, averages over
    windows, however late they are taken, vary more than the rotor's speed does. So shifted, the
    curve of a vehicle with 24 inch propellers came out between 0.35 and 0.54 over its flights, and
    0.2 smaller by windows of half a second than by those of four.

    Args:
        times: (n,) s.
        commands: (n, rotors).
        half: s, of the windows: gaps that spoil them stay.
        lag: s.
    """
    if len(times) < 2:
        return times, commands
    steps = np.diff(times)
    step = min(float(np.median(steps)), 1.0 / TUNING.enough_rate)
    grid = np.arange(times[0], times[-1], step)
    u = np.column_stack([np.interp(grid, times, column) for column in commands.T])
    if lag > 0.0:
        kept = math.exp(-step / lag)
        u = u[0] + lfilter([1.0 - kept], [1.0, -kept], u - u[0])[0]
    apart = longest_step(steps, half)
    if float(steps.max()) > apart:
        # By rounding the last of the grid may lie at the last of the times.
        sampled = steps[np.searchsorted(times[:-1], grid, side="right") - 1] <= apart
        grid, u = grid[sampled], u[sampled]
    return grid, u


def _lag_of(
    commands: RotorStream | None, t: Array, half: float, speeds: Array, lift: Array, sink: Array
) -> float:
    """S, time constant with which rotors, or the thrust, follow commands: of the least residual."""
    if commands is None or len(t) < 2 * TUNING.fewest_windows:
        return 0.0
    rotors = speeds.shape[1]
    measured = bool(np.isfinite(speeds).any())
    reported = speeds if measured else lift[:, None]
    drift = (t - t.mean()) / max(float(np.ptp(t)), 1.0)
    climbing = np.nan_to_num(sink)[:, None]
    lags = np.arange(0.0, TUNING.longest_lag + 1e-9, TUNING.lag_step)

    @cache
    def cost(i: int) -> float:
        """Of the residual of all rotors; infinite where nothing can be fitted."""
        u, uu = _command_means(commands, t, half, rotors, float(lags[i]))
        if not measured:
            u, uu = u.sum(axis=1, keepdims=True), uu.sum(axis=1, keepdims=True)
        total = 0.0
        for a, b, y in zip(u.T, uu.T, reported.T, strict=True):
            columns = np.column_stack([a, b, a * drift, climbing])
            there = np.isfinite(columns).all(axis=1) & np.isfinite(y)
            size = float(np.mean(y[there])) ** 2 if there.any() else 0.0
            if there.sum() < 2 * TUNING.fewest_windows or not size:
                return np.inf  # too little, or a sensor that gives nothing
            fit = np.linalg.lstsq(columns[there], y[there], rcond=None)[0]
            total += float(np.mean((y[there] - columns[there] @ fit) ** 2)) / size
        return total

    # It has one valley: every third shows where.
    near = min(range(0, len(lags), 3), key=cost)
    i = min(range(max(near - 2, 0), min(near + 3, len(lags))), key=cost)
    if not 0 < i < len(lags) - 1:
        return 0.0  # none, or at the far end: nothing moves
    left, middle, right = map(cost, (i - 1, i, i + 1))
    if not np.isfinite([left, middle, right]).all():
        return 0.0
    bend = left - 2.0 * middle + right
    return float(lags[i] + (0.5 * TUNING.lag_step * (left - right) / bend if bend > 0.0 else 0.0))


def _vertical(streams: Streams, t: Array, half: float) -> tuple[Array, Array, Array]:
    """Thrust over mass that the vertical momentum balance asks for; sink rate and speed.

    T cos(tilt) = m (g - v_down'), Newton along the vertical: the accelerometer's bias has no part.
    """
    attitude_t, q = streams.tracks.get(Stream.ATTITUDE, (np.empty(0), np.empty((0, 4))))
    # R_33 of (w, x, y, z): the cosine of the tilt.
    cosine = windowed_means(attitude_t, 1.0 - 2.0 * (q[:, 1] ** 2 + q[:, 2] ** 2), t, half)[:, 0]
    velocity_t, v = streams.tracks.get(Stream.VELOCITY, (np.empty(0), np.empty((0, 6))))
    falling = windowed_means(velocity_t, v[:, 2], t, half, slope=True)[:, 0]
    flown = windowed_means(velocity_t, v[:, :3], t, half)
    speed = np.linalg.norm(flown, axis=1)
    reported = np.where(np.isfinite(falling), falling, 0.0)
    return (GRAVITY - reported) / cosine, flown[:, 2] / np.maximum(cosine, 0.5), speed


def _hovering(rates: Array, turning: Array, lift: Array, force: Array, speed: Array) -> Mask:
    with np.errstate(invalid="ignore"):
        calm = (np.abs(rates) < TUNING.most_rate).all(axis=1)
        calm &= (np.abs(turning) < TUNING.most_turning).all(axis=1)
        up = np.where(np.isfinite(lift), lift, -force[:, 2])
        calm &= np.abs(up - GRAVITY) < TUNING.most_lift * GRAVITY
        drift = ~(speed > TUNING.most_speed)
    hovering: Mask = calm & drift
    return hovering


def lines_of(streams: Streams, spin: Array) -> RotorLines:
    """What the IMU shows of the speeds read in flight, by rotors of (rotors,) 1 or -1."""
    lines = RotorLines(spin)
    if streams.speeds is None or not len(streams.flight.t):
        return lines
    (t, imu), dt = streams.tracks[Stream.IMU], 1.0 / streams.rate(Stream.IMU)
    felt = np.where(streams.flight.at(t)[:, None], imu[:, :6], np.nan)
    speeds = np.column_stack([np.interp(t, *rotor) for rotor in streams.speeds.samples])
    ends = np.flatnonzero(np.diff(t) > 2.5 * dt) + 1
    for first, stop in pairwise([0, *ends.tolist(), len(t)]):
        lines.update(dt, felt[first:stop], speeds[first:stop], fresh=True)
    return lines
