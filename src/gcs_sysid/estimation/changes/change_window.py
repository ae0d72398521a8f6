"""The seconds around an alarm, as means, and what moves residuals of an unchanged vehicle.

They may follow its vertical speed (inflow, drag), its forward speed (lift, flapping), an error of
the thrust curve (thrust itself), of lag and delay (its derivative) or of inertia (torque); else
they wander as they did in the flight so far. Variances of differences of neighboring means (Haar
wavelet; D. W. Allan, Statistics of atomic frequency standards, Proceedings of the IEEE 54, 1966)
are matched by white noise, gyro noise that differentiation colors, and Ornstein-Uhlenbeck processes
of several correlation times.
"""

from bisect import bisect_right
from copy import copy
from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array, Mask, nonnegative
from gcs_sysid.estimation.changes.change_reference import N_X, TOTAL, Reference, body_velocity
from gcs_sysid.model import attitude
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.signals.records import Samples

_TENTHS = 10.0
"""`Reference.floors` are moments of a tenth of the arm."""


@dataclass(frozen=True)
class HypothesisTuning:
    """Settings of the decision.

    Attributes:
        frame: s, length of a mean.
        before: s ahead of an alarm that are looked at.
        ages: s after an alarm at which it is looked at; a disturbance at the last if not before.
        sure: standard deviations by which a change's interval must exclude zero at these ages.
        search: s around the alarm in which the step may lie.
        least_mass: least relative change of mass that is claimed.
        least_loss: least share of one rotor's thrust.
        agree: share of the step by which parts of the time since may differ.
        explained: least share of the step-like residual that the change explains.
        by_climb: least relative change of mass that is called at 1 m/s of vertical speed.
        by_thrust: the same where thrust is twice the usual.
        far: vertical speed in m/s, and share by which thrust is off the usual, from which on no
            rotor is called weak.
        calm: vertical speed in m/s, and share by which thrust is off its median since, up to which
            a mean is of calm flight; and s of it on both sides that make up for an alarm in a
            punch-out or a fast climb.
        named: standard deviations that name a cause.
        agreeing: standard deviations of the thrust by which a weaker rotor must show in it, at
            least, and by which it may differ from what the moments show.
        least_cg: m, least shift of the CG that is named from a second.
        carried: share of the weight; rotors that make less do not carry a vehicle that does not
            fall.
        falls: share of g that thrust leaves to gravity in a vehicle that still flies: with less
            for the second that it takes to call a change it would sink at 5 m/s and more.
        punch, speed: thrust over the usual one, and horizontal velocity in m/s, of no calm
            flight.
        regressed: means from which the effect of the air on the residuals is
            estimated.
        ou_times: s, correlation times of disturbances.
        floor_time: s, correlation time of disturbances that no flight is free of, and
        force_floor, moment_floor: their size: share of the weight, and of the moment of a tenth of
            it at the rotors' arm.
        fewest_scales: fewest scales of window means that determine a flight's noise without the
            window's own.
        velocity_sent: share of samples with a velocity.
    """

    frame: float = 0.05
    before: float = 4.0
    ages: tuple[float, ...] = (0.9, 1.4, 1.9, 3.0, 4.5, 6.0)
    sure: tuple[float, ...] = (9.0, 7.0, 6.0, 5.0, 5.0, 5.0)
    search: float = 0.3
    least_mass: float = 0.04
    least_loss: float = 0.04
    agree: float = 0.3
    explained: float = 0.8
    # Priors, one standard deviation.
    curve_error: float = 0.05
    inflow: float = 1.0
    lift: float = 0.05
    lag_error: float = 0.006
    inertia_error: float = 0.1
    flapping: float = 0.02
    # Far from hover a line through the flight so far does not predict thrust.
    by_climb: float = 0.06
    by_thrust: float = 0.1
    far: tuple[float, float] = (2.0, 0.8)
    calm: tuple[float, float, float] = (0.7, 0.2, 2.0)
    named: float = 3.0
    agreeing: float = 2.0
    least_cg: float = 0.002
    carried: float = 0.8
    falls: float = 0.5
    punch: float = 1.5
    speed: float = 1.5
    regressed: int = 40
    ou_times: tuple[float, ...] = (0.15, 0.5, 1.5, 5.0)
    floor_time: float = 1.5
    force_floor: float = 0.01
    moment_floor: float = 0.04
    fewest_scales: int = 3
    velocity_sent: float = 0.5


TUNING = HypothesisTuning()


class AlarmWindow:
    """Means around an alarm, and what may have moved them.

    Args:
        t: (n,) s, session times.
        samples: n of them.
        dt: s between samples.
        reference: of the residuals.
        onset: s, session time of the alarm.
        tuning: how long means are, and how far back they go.

    Attributes:
        e: (n, 4) residuals.
        y: (n, 4) outputs.
        x: (n, N_X) inputs.
        squares: (n, rotors) sums of O.
        air: (n, 3) velocity along the body axes, less that at the alarm.
        climb: (n,) velocity along the body's down axis.
        index: (n,) places in time, in steps after the alarm; a mean may be missing.
        at: index of the first mean after the alarm.
        step: s between means.
    """

    def __init__(
        self,
        t: Array,
        samples: Samples,
        dt: float,
        reference: Reference,
        onset: float,
        tuning: HypothesisTuning,
    ) -> None:
        y, x, squares = reference.rows(samples, dt)
        times, air = t[1 : 1 + len(y)], _velocity(samples, dt)[1 : 1 + len(y)]
        size = max(round(tuning.frame / dt), 2)
        self.step, self._onset = size * dt, onset
        first = int(np.searchsorted(times, onset - 0.5 * dt))
        ahead = min(first // size, round(tuning.before / self.step))
        stop = first + (len(times) - first) // size * size
        table = np.column_stack([y, x, squares, air])[first - ahead * size : stop]
        parts = table.reshape(-1, size, table.shape[1])
        there = np.isfinite(parts[..., : 4 + N_X + squares.shape[1]])
        there[..., :4] |= np.isnan(reference.matrix).any(axis=1)
        keep = 2 * there.all(axis=2).sum(axis=1) > size
        mean = means(parts[keep])
        self.index = np.flatnonzero(keep) - ahead
        self.at = int(np.searchsorted(self.index, 0))
        edges = np.cumsum([4, x.shape[1], squares.shape[1]])
        self.y, self.x, self.squares, air = np.split(mean, edges, axis=1)
        self.e = self.y - self.x @ np.nan_to_num(reference.matrix).T
        around = air[max(self.at - 4, 0) : self.at + 1]
        self.climb = air[:, 2]
        self.air = air - (around.mean(axis=0) if len(around) else 0.0)

    def floors(self, reference: Reference) -> Array:
        """(4,) as of `Reference.floors`, at the thrust before the alarm."""
        return reference.floors(float(np.mean(self.x[: max(self.at, 1), TOTAL])))

    def calm(self) -> "AlarmWindow | None":
        """Without the means of full throttle or fast climbs from a second before the alarm on.

        Those say little of a mass: inflow and an error of the thrust curve move thrust as much.

        Returns:
            None where all are calm, or too few.
        """
        climb, pull, seconds = TUNING.calm
        thrust = self.x[:, TOTAL]
        usual = np.where(self.index < 0, np.median(thrust[: self.at]), np.median(thrust[self.at :]))
        near = self.index * self.step >= -1.0
        kept = ~near | ((np.abs(self.climb) < climb) & (np.abs(thrust - usual) < pull * usual))
        before, since = np.sum(kept[: self.at]), np.sum(kept[self.at :])
        if kept.all() or min(before, since) * self.step < seconds:
            return None
        calm = copy(self)
        for name in ("e", "y", "x", "squares", "air", "climb", "index"):
            setattr(calm, name, getattr(self, name)[kept])
        calm.at = int(before)
        return calm

    @property
    def after(self) -> int:
        """Means after the alarm."""
        return len(self.e) - self.at

    def time_of(self, at: int) -> float:
        """Session time at which a mean begins."""
        return self._onset + float(self.index[at]) * self.step


def covariates(window: AlarmWindow, reference: Reference) -> dict[int, Array]:
    """Of each channel, (n, k) columns scaled by the standard deviations of their priors."""
    air, thrust = window.air, reference.kappa * window.x[:, TOTAL]
    watched = reference.watched
    Q, floors = np.nan_to_num(reference.matrix[1:, : rb.N_SIGNALS]), window.floors(reference)
    one = np.ones((len(air), 1))
    rate = _rate(thrust, window)
    usual = float(np.mean(thrust[: max(window.at, 1)]))
    lag, curve = TUNING.lag_error, TUNING.curve_error
    actuator = reference.actuator
    columns: dict[int, Array] = {}
    if watched[0]:
        moved = [curve * (thrust - usual), TUNING.inflow * air[:, 2]]
        moved += [TUNING.lift * np.sum(air[:, :2] ** 2, axis=1)]
        if actuator is not None:
            lag = float(np.hypot(2.0 * lag, actuator.lag_std))
            moved.append(actuator.curve_std * _by_curve(window, reference, actuator.curve))
        moved.append(lag * rate)
        # The mean level may be off by the weight, or the moment it would make at a rotor's arm.
        columns[0] = np.column_stack([GRAVITY * one, *moved])
    for c in (1, 2, 3):
        if not watched[c]:
            continue
        torque = window.x[:, : rb.N_SIGNALS] @ Q[c - 1]
        moved = [TUNING.inertia_error * torque, lag * _rate(torque, window)]
        moved += [TUNING.flapping * _TENTHS * floors[c] * air[:, j] for j in range(3)]
        moved += [_TENTHS * floors[c] * thrust / max(usual, 1e-9)]
        columns[c] = np.column_stack(moved)
    return columns


def _by_curve(window: AlarmWindow, reference: Reference, c: float) -> Array:
    """(n,) change of thrust with the curve, kappa such that mean thrust stays."""
    share = window.squares
    w = RotorInput.COMMAND.at_load(share, np.array(c))
    slope = (w * w - w).sum(axis=1)
    usual = slice(0, max(window.at, 1))
    total = share.sum(axis=1)
    even = slope - total * (slope[usual].mean() / max(total[usual].mean(), 1e-9))
    return reference.kappa * even


def covariance(window: AlarmWindow, c: int, strength: Array, floor: float) -> Array:
    """(n, n) of a channel's means, without what the covariates move.

    Args:
        window: of the means.
        c: the channel.
        strength: as of `strengths`.
        floor: of the channel, see `AlarmWindow.floors`.
    """
    h = window.step
    lags = np.abs(window.index[:, None] - window.index)
    least = (TUNING.force_floor if c == 0 else TUNING.moment_floor) * floor
    noise = strength[0] / h * (lags == 0)
    noise = noise + strength[1] / h**2 * (2.0 * (lags == 0) - 1.0 * (lags == 1))
    added = np.where(np.array(TUNING.ou_times) == TUNING.floor_time, least**2, 0.0)
    for tau, variance in zip(TUNING.ou_times, strength[2:] + added, strict=True):
        noise = noise + variance * _ou(lags, h, tau)
    return noise


@dataclass(frozen=True)
class ResidualHistory:
    """How residuals wandered before an alarm.

    Attributes:
        level: (4,) medians; NaN where a channel was never there.
        left: (n, 4) what the air's part, thrust and torque leave of means over `step`.
        step: s.
    """

    level: Array
    left: Array
    step: float


class Frames:
    """Means of a flight, from which it is known how its residuals wander.

    Those of long flights are thinned out by forgetting the oldest half.
    """

    MOST = 2048

    def __init__(self) -> None:
        self._times: list[float] = []
        self._rows: list[Array] = []

    def add(self, t: float, row: Array) -> None:
        """Take means [y (4), x (N_X), velocity along the body axes (3)] of the frame from t on."""
        self._times.append(t)
        self._rows.append(row)
        if len(self._rows) > self.MOST:
            del self._rows[: self.MOST // 2], self._times[: self.MOST // 2]

    def before(self, time: float, step: float, reference: Reference) -> ResidualHistory:
        """Of the frames before a time.

        Args:
            time: s, session time.
            step: s, length of a frame.
            reference: that residuals are of.
        """
        count = bisect_right(self._times, time - step)
        if not count:
            return ResidualHistory(np.full(4, np.nan), np.empty((0, 4)), step)
        y, x, air = np.split(np.array(self._rows[:count]), [4, 4 + N_X], axis=1)
        matrix = np.nan_to_num(reference.matrix)
        made = x @ matrix.T
        residuals = y - made
        air = np.nan_to_num(air)
        left = np.full_like(residuals, np.nan)
        for c in range(4):
            there = np.isfinite(residuals[:, c])
            if there.sum() < TUNING.regressed:
                left[there, c] = residuals[there, c]
                continue
            moved = (air[:, 2], np.sum(air[:, :2] ** 2, axis=1)) if c == 0 else air.T
            columns = np.column_stack([np.ones(count), made[:, c], *moved])[there]
            left[there, c] = unexplained(residuals[there, c], columns)
        return ResidualHistory(_median(residuals), left, step)


def unexplained(values: Array, columns: Array) -> Array:
    """(n,) what (n, k) columns leave of (n,) values by least squares."""
    columns = columns / np.maximum(np.abs(columns).max(axis=0), 1e-12)
    return values - columns @ np.linalg.lstsq(columns, values, rcond=1e-6)[0]


def strengths(window: AlarmWindow, history: ResidualHistory, c: int) -> Array:
    """(2 + k,) strengths of white noise (/Hz), of differentiated noise, and variances of the OUs.

    Those of the flight before; where differences of the window's means before the alarm exceed what
    they predict, the excess is white and differentiated noise.
    """
    before = window.e[: window.at, c], window.index[: window.at]
    flight = history.left[:, c], np.arange(len(history.left))
    long = _scales(*flight, history.step, (1, 2, 4, 8, 16))
    short = _scales(*before, window.step, (1, 2, 4))
    if len(long) < TUNING.fewest_scales:
        return _matched(
            np.concatenate([long, short]), np.ones(2 + len(TUNING.ou_times), dtype=bool)
        )
    every = _matched(long, np.ones(2 + len(TUNING.ou_times), dtype=bool))
    if len(short):
        short[:, 1] -= _made(short[:, 0]) @ every
        every = every + _matched(short[short[:, 1] > 0.0], np.arange(len(every)) < 2)
    return every


def _scales(values: Array, index: Array, step: float, sizes: tuple[int, ...]) -> Array:
    """(k, 3) scales in s, variances of differences of means over them, and how many are apart."""
    found = [(m * step, *_haar(values, index, m)) for m in sizes]
    return np.array([row for row in found if row[2] >= 3 and row[1] > 0.0]).reshape(-1, 3)


def _made(scale: Array) -> Array:
    """(k, p) variances of differences of means over (k,) scales, of each noise of unit strength."""
    made = [2.0 / scale, 6.0 / scale**2]
    for tau in TUNING.ou_times:
        k = tau / scale
        lost = 1.0 - np.exp(-1.0 / k)
        made.append(4.0 * k * (1.0 - k * lost) - 2.0 * (k * lost) ** 2)
    return np.column_stack(made)


def _matched(rows: Array, some: Mask) -> Array:
    """(p,) strengths of some noises that match (k, 3) rows of `_scales`, at no scale too weak."""
    strength = np.zeros(len(some))
    if not len(rows):
        return strength
    scale, variance, count = rows.T
    # Student: a variance from few values is as likely too small as it is uncertain.
    variance = variance * count / np.maximum(count - 2.0, 1.0)
    A = _made(scale)[:, some] / variance[:, None]
    weight = np.sqrt(np.minimum(count, 40.0))
    size = np.maximum(A.max(axis=0), 1e-300)
    found = nonnegative(A / size * weight[:, None], weight) / size
    sound = count >= 6.0
    raised = float(np.max(1.0 / np.maximum((A @ found)[sound], 0.1), initial=1.0))
    strength[some] = found * raised
    return strength


def _ou(lags: Array, h: float, tau: float) -> Array:
    """Covariance of means over h of an Ornstein-Uhlenbeck process of unit variance."""
    k = tau / h
    lost = 1.0 - np.exp(-1.0 / k)
    same = 2.0 * k * (1.0 - k * lost)
    apart: Array = (k * lost) ** 2 * np.exp(-(np.maximum(lags, 1) - 1) / k)
    return np.where(lags == 0, same, apart)


def _haar(values: Array, index: Array, m: int) -> tuple[float, int]:
    """Mean square of differences of neighboring means over m values, and how many are apart."""
    if len(values) < 2 * m:
        return 0.0, 0
    sums = np.concatenate([[0.0], np.cumsum(np.nan_to_num(values))])
    gaps = np.concatenate([[0], np.cumsum(~np.isfinite(values))])
    whole = gaps[2 * m :] - gaps[: -2 * m] == 0
    whole &= index[2 * m - 1 :] - index[: len(index) - 2 * m + 1] == 2 * m - 1
    difference = (sums[2 * m :] - 2.0 * sums[m:-m] + sums[: -2 * m])[whole] / m
    if not len(difference):
        return 0.0, 0
    return float(np.mean(difference**2)), len(difference) // (2 * m) + 1


def _median(history: Array) -> Array:
    """(4,) of (n, 4); NaN where there is none."""
    return np.array(
        [np.median(h[np.isfinite(h)]) if np.isfinite(h).any() else np.nan for h in history.T]
    )


def means(parts: Array, least: float = 0.0) -> Array:
    """(n, w) of (n, size, w), over what is there; NaN where that is no more than a share of it."""
    there = np.isfinite(parts)
    count = there.sum(axis=1)
    mean = np.where(there, parts, 0.0).sum(axis=1) / np.maximum(count, 1)
    return np.where(count > least * parts.shape[1], mean, np.nan) if least else mean


def _rate(values: Array, window: AlarmWindow) -> Array:
    return np.gradient(values, window.index * window.step)


def _velocity(samples: Samples, dt: float) -> Array:
    """(n, 3) along the body axes: as sent, else of the accelerometer, integrated."""
    if not np.isfinite(samples.velocity).all(axis=1).mean() > TUNING.velocity_sent:
        turn = attitude.matrices(samples.attitude)
        pull = (turn @ np.nan_to_num(samples.force)[..., None])[..., 0] + [0.0, 0.0, GRAVITY]
        pull[~np.isfinite(samples.force).all(axis=1)] = 0.0
        velocity = np.cumsum(np.nan_to_num(pull), axis=0) * dt
        return np.asarray((velocity[:, None, :] @ turn)[:, 0])
    return body_velocity(samples)
