"""What happened to the vehicle: competing explanations of the seconds around an alarm.

Residuals of a reference fit, in means over a twentieth of a second, are explained on four
channels (thrust, roll, pitch, yaw) by generalized least squares:

    e = b + sum c_j z_j + step s(t >= tau) + n

z_j are what moves residuals of an unchanged vehicle, each with a prior on its coefficient:
vertical speed (inflow, drag), forward speed (lift, flapping), an error of the thrust curve (thrust
itself; full throttle), of lag and delay (its derivative), of inertia (torque). n is the sum of white
noise, gyro noise that differentiation colors, and Ornstein-Uhlenbeck processes of several
correlation times, as strong as this flight showed them to be: the variances of differences of
neighboring means (Haar wavelet, Allan 1966) over all of it up to the alarm. A gust, a sagging
battery or a slow model error has its likelihood there.

What steps at tau is, on trial, a mass (thrust over all of kappa, moments by a moved CG), one rotor's
share of thrust and torque, or a disturbance of any force and moment. The vehicle changed when a
mass or a rotor explains the step, its interval excludes zero by a margin, it stays the same from
one part of the time since to the next, and the thrust still answers to the rotors, which on the
ground it does not. Else it was a disturbance.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation.change_kinds import Cause, Disturbance, kind_of
from gcs_sysid.estimation.change_reference import N_X, TOTAL, Reference
from gcs_sysid.model import attitude
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.signals.samples import Samples


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
    """

    frame: float = 0.05
    before: float = 4.0
    ages: tuple[float, ...] = (0.9, 1.4, 1.9, 3.0, 4.5, 6.0)
    sure: tuple[float, ...] = (9.0, 7.0, 6.0, 5.0, 5.0, 5.0)
    search: float = 0.3
    least_mass: float = 0.04
    least_loss: float = 0.05
    agree: float = 0.3
    explained: float = 0.8
    # Priors, one standard deviation.
    curve_error: float = 0.05
    inflow: float = 1.0
    lift: float = 0.05
    lag_error: float = 0.006
    inertia_error: float = 0.1
    flapping: float = 0.02


TUNING = HypothesisTuning()

Verdict = Literal["changed", "disturbance", "undecided"]
_REGRESSED = 40
"""Means of a flight from which it is told how the air moves its residuals."""
_OU_TIMES = (0.15, 0.5, 1.5, 5.0)
"""s, correlation times of disturbances."""
_FORCE_FLOOR, _MOMENT_FLOOR = 0.01, 0.004
"""Disturbances that no flight is free of (1.5 s): share of the weight, and of the moment that it
would make at the rotors' arm."""
_WIDE = 1.0
"""Prior of the mean level: the weight, or the moment that it would make at a rotor's arm."""


@dataclass(frozen=True)
class Judgement:
    """Of one alarm at one time.

    Attributes:
        verdict: "undecided" until more has been seen.
        onset: s, session time of the step.
        cause: what changed, or the disturbance's name.
    """

    verdict: Verdict
    onset: float
    cause: Cause


@dataclass(frozen=True)
class History:
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

    MOST = 4096

    def __init__(self) -> None:
        self._rows: list[Array] = []

    def add(self, rows: list[Array]) -> None:
        """Take rows [y (4), x (N_X), velocity along the body axes (3)], means of a frame."""
        self._rows += rows
        if len(self._rows) > self.MOST:
            del self._rows[: self.MOST // 2]

    def before(self, seconds: float, step: float, reference: Reference) -> History:
        """Of all but the last seconds.

        Args:
            seconds: to leave out.
            step: s, length of a frame.
            reference: that residuals are of.
        """
        count = max(len(self._rows) - int(np.ceil(seconds / step)), 0)
        if not count:
            return History(np.full(4, np.nan), np.empty((0, 4)), step)
        y, x, air = np.split(np.array(self._rows[:count]), [4, 4 + N_X], axis=1)
        matrix = np.nan_to_num(reference.matrix)
        made = x @ matrix.T
        residuals = y - made
        air = np.nan_to_num(air)
        left = np.full_like(residuals, np.nan)
        for c in range(4):
            there = np.isfinite(residuals[:, c])
            if there.sum() < _REGRESSED:
                left[there, c] = residuals[there, c]
                continue
            moved = (air[:, 2], np.sum(air[:, :2] ** 2, axis=1)) if c == 0 else air.T
            columns = np.column_stack([np.ones(count), made[:, c], *moved])[there]
            columns = columns / np.maximum(np.abs(columns).max(axis=0), 1e-12)
            fit = np.linalg.lstsq(columns, residuals[there, c], rcond=1e-6)[0]
            left[there, c] = residuals[there, c] - columns @ fit
        return History(_median(residuals), left, step)


def judge(
    t: Array,
    samples: Samples,
    dt: float,
    reference: Reference,
    history: History,
    onset: float,
    age_index: int,
    tuning: HypothesisTuning = TUNING,
) -> Judgement:
    """Explain what an alarm was raised for.

    Args:
        t: (n,) s, session times of samples around the alarm, gaps marked by NaN samples.
        samples: n of them.
        dt: s between samples.
        reference: the fit before the alarm.
        history: of the flight before it.
        onset: s, session time at which the alarm's sum left zero.
        age_index: which of `tuning.ages` has come.
        tuning: settings.
    """
    window = _Window(t, samples, dt, reference, onset, tuning)
    last = age_index == len(tuning.ages) - 1
    nothing = Cause("passing", None, 0.0, 0.0, 1.0, (0.0, 0.0), 0.0)
    if window.after < 6 or window.at < 10 or not np.isfinite(reference.matrix).any():
        return Judgement("disturbance" if last else "undecided", onset, nothing)
    trial = _Trial(window, reference, history, tuning)
    cause, sure = trial.best(tuning.sure[age_index])
    onset = window.time_of(trial.at)
    if sure:
        return Judgement("changed", onset, cause)
    over = last or trial.is_over()
    return Judgement("disturbance" if over else "undecided", onset, trial.disturbance(cause))


class _Window:
    """Means around an alarm, and what may have moved them.

    Attributes:
        e: (n, 4) residuals.
        y: (n, 4) outputs.
        x: (n, N_X) inputs.
        squares: (n, rotors) sums of O.
        air: (n, 3) velocity along the body axes, less that at the alarm.
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
        means = _means(parts[keep])
        self.index = np.flatnonzero(keep) - ahead
        self.at = int(np.searchsorted(self.index, 0))
        edges = np.cumsum([4, x.shape[1], squares.shape[1]])
        self.y, self.x, self.squares, air = np.split(means, edges, axis=1)
        self.e = self.y - self.x @ np.nan_to_num(reference.matrix).T
        around = air[max(self.at - 4, 0) : self.at + 1]
        self.air = air - (around.mean(axis=0) if len(around) else 0.0)

    @property
    def after(self) -> int:
        """Means after the alarm."""
        return len(self.e) - self.at

    def time_of(self, at: int) -> float:
        """Session time at which a mean begins."""
        return self._onset + float(self.index[at]) * self.step


class _Trial:
    """The hypotheses on one window.

    Attributes:
        at: index of the mean with which the likeliest step begins.
    """

    def __init__(
        self,
        window: _Window,
        reference: Reference,
        history: History,
        tuning: HypothesisTuning,
    ) -> None:
        self._window, self._reference, self._tuning = window, reference, tuning
        self._watched = np.isfinite(reference.matrix).all(axis=1)
        self._thrust = reference.kappa * window.x[:, TOTAL]
        hover = float(np.mean(window.x[: window.at, TOTAL]))
        self._floors = reference.floors(hover)
        self._Q = np.nan_to_num(reference.matrix[1:, : rb.N_SIGNALS])
        self._level = np.nan_to_num(history.level)
        self._moved = self._covariates()
        self._roots = {
            c: self._root(c, _spectrum(window, history, c))
            for c in np.flatnonzero(self._watched)
        }
        self._scale = np.ones(4)
        self.at = self._likeliest()
        self._scale = self._inflation()

    # ---- what is said of the step ------------------------------------------------------------

    def best(self, sure: float) -> tuple[Cause, bool]:
        """The best explanation by a change, and whether it holds.

        Args:
            sure: standard deviations by which its interval must exclude zero.
        """
        window, tuning = self._window, self._tuning
        free = self._fit(self._free(self._since(self.at)))
        mass = self._fit({0: self._mass(self._since(self.at))}) if self._watched[0] else _NOTHING
        moved = self._fit(self._balance(self._since(self.at)))
        losses = [
            self._fit(self._rotor(i, self._since(self.at))) for i in range(window.squares.shape[1])
        ]
        i = int(np.argmax([fit.likelihood for fit in losses]))
        rotor = losses[i]
        penalty = 0.5 * float(np.log(max(window.after, 2)))
        body = mass.likelihood + max(moved.likelihood - 2.0 * penalty, 0.0)
        explained = max(mass.likelihood + moved.likelihood, 1e-9) / max(free.likelihood, 1e-9)
        if self._watched.sum() > 1 and rotor.likelihood > body and rotor.value[0] > 0.0:
            loss, std = float(rotor.value[0]), float(rotor.std[0])
            cause = Cause("rotor_failure", i, loss, std, 1.0, (0.0, 0.0), rotor.likelihood)
            holds = (
                loss >= max(tuning.least_loss, sure * std)
                and rotor.likelihood > tuning.explained * free.likelihood
                and self._stays(lambda since: self._rotor(i, since), loss)
            )
            return cause, holds
        share, std = float(mass.value[0]), float(mass.std[0])
        moves = moved.std.any() and bool(
            (np.abs(moved.value) > np.maximum(_SURE * moved.std, _MIN_CG)).any()
        )
        # Thrust alone cannot tell a heavier vehicle from a weaker rotor.
        kind = kind_of(True, moves, False) if self._watched[1:3].all() else "change"
        shift = (float(moved.value[0]), float(moved.value[1])) if moved.std.any() else (0.0, 0.0)
        ratio = 1.0 / max(1.0 - share, 0.1)
        cause = Cause(kind, None, 0.0, 0.0, ratio, shift, explained)
        holds = (
            abs(share) >= max(tuning.least_mass, sure * std)
            and self._stays(lambda since: {0: self._mass(since)}, share)
            and self._is_new(share)
            and (share > 0.0 or self._flies(share))
        )
        return cause, holds

    def is_over(self) -> bool:
        """Whether nothing is left of the step."""
        fit = self._fit(self._free(self._since(self.at)))
        return bool((np.abs(fit.value) < _SURE * fit.std).all())

    def disturbance(self, cause: Cause) -> Cause:
        """The name of what is no change."""
        return Cause(
            "passing", None, 0.0, 0.0, 1.0, (0.0, 0.0), cause.explained, disturbance=self._name()
        )

    def _name(self) -> Disturbance:
        window, at = self._window, self.at
        thrust = self._thrust
        later, before = slice(at, None), slice(0, at)
        if self._watched[0]:
            if self._stands():
                return "contact"
            most, usual = float(thrust[later].max()), float(np.median(thrust[before]))
            if most > _PUNCH * usual or float(thrust[later].min()) < usual / _PUNCH:
                return "thrust"
            whole = self._fit({0: self._mass(self._since(at))}).likelihood
            if whole > 0.5 * _SURE**2:
                drop = window.air[later, 2]
                if np.abs(drop).max() > _CLIMB:
                    return "climb"
                if np.linalg.norm(window.air[later, :2], axis=1).max() > _SPEED:
                    return "airspeed"
                return "force"
        return "moment" if self._watched[1:].any() else "force"

    # ---- conditions ---------------------------------------------------------------------------

    def _stays(self, columns: "Columns", size: float) -> bool:
        """Whether the parts of the time since agree."""
        n, at = len(self._window.e), self.at
        middle = at + 1 + (n - at) // 2
        parts = (self._since(at, middle), self._since(middle))
        first, second = (columns(part) for part in parts)
        both = self._fit({c: np.column_stack([first[c], second[c]]) for c in first})
        if (both.value * size <= 0.0).any():
            return False
        difference = float(both.value[1] - both.value[0])
        variance = float(both.covariance[0, 0] + both.covariance[1, 1] - 2 * both.covariance[0, 1])
        allowed = max(self._tuning.agree * abs(size), min(2.0 * variance**0.5, abs(size)))
        return abs(difference) < allowed

    def _is_new(self, share: float) -> bool:
        """Whether thrust is off by the step from what it was in all of the flight before."""
        later = slice(self.at + 1, None)
        # What inflow does to thrust while the vehicle sinks is no part of the level.
        off = (self._window.e[later, 0] - self._level[0]) / np.mean(self._thrust[later])
        return float(np.mean(off)) * np.sign(share) > 0.5 * abs(share)

    def _flies(self, share: float) -> bool:
        """Whether specific force answers to the rotors; on the ground it is that of gravity.

        Args:
            share: of thrust over mass that is gone.
        """
        later = slice(self.at + 1, None)
        measured, thrust = self._window.y[later, 0], self._thrust[later]
        if len(thrust) < 4:
            return True
        left = measured + (1.0 - share) * thrust
        # The median, as what hits the ground rings.
        answers = np.median(np.abs(left - np.median(left)))
        stands = np.median(np.abs(measured - np.median(measured)))
        return bool(answers < stands) or not self._stands()

    def _stands(self) -> bool:
        """Whether something carries the vehicle that the rotors alone do not."""
        later = slice(self.at + 1, None)
        off = np.abs(self._window.y[later, 0] + GRAVITY)
        carried = float(np.median(self._thrust[later])) < _CARRIED * GRAVITY
        return carried and float(np.median(off)) < 0.5 * (1.0 - _CARRIED) * GRAVITY

    # ---- fits ---------------------------------------------------------------------------------

    def _since(self, at: int, until: int | None = None) -> Mask:
        mask = np.zeros(len(self._window.e), dtype=bool)
        mask[at:until] = True
        return mask

    def _mass(self, since: Mask) -> Array:
        column: Array = (self._thrust * since)[:, None]
        return column

    def _balance(self, since: Mask) -> dict[int, Array]:
        """A CG moved forward, to the right: the first columns of Q are those of J^-1."""
        total = self._window.x[:, _THRUST] * since
        return {
            c: np.column_stack([-total * self._Q[c - 1, 1], total * self._Q[c - 1, 0]])
            for c in self._roots
            if c
        }

    def _rotor(self, i: int, since: Mask) -> dict[int, Array]:
        """All thrust of one rotor gone."""
        x, y, spin = self._reference.geometry[:, i]
        square = self._window.squares[:, i] * since
        effect = self._Q[:, :4] @ np.array([-y, x, 1.0, spin])
        columns = {c: (-square * effect[c - 1])[:, None] for c in self._roots if c}
        if self._watched[0]:
            columns[0] = (self._reference.kappa * square)[:, None]
        return columns

    def _free(self, since: Mask) -> dict[int, Array]:
        """A step of force and moment of any size, each with an unknown of its own."""
        places = {c: i for i, c in enumerate(self._roots)}
        columns = {}
        for c, i in places.items():
            columns[c] = np.zeros((len(since), len(places)))
            columns[c][:, i] = self._thrust * since if c == 0 else since
        return columns

    def _fit(self, columns: dict[int, Array]) -> "_Fit":
        """Unknowns shared by channels, by generalized least squares."""
        normal = right = None
        for c, column in columns.items():
            root = self._roots[c]
            white = solve_triangular(
                root, np.column_stack([column, self._window.e[:, c]]), lower=True
            )
            white = white / self._scale[c]
            A, y = white[:, :-1], white[:, -1]
            normal = A.T @ A if normal is None else normal + A.T @ A
            right = A.T @ y if right is None else right + A.T @ y
        if normal is None or right is None:
            return _NOTHING
        d = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        inverse = np.linalg.inv(normal / np.outer(d, d) + 1e-9 * np.eye(len(d)))
        covariance = inverse / np.outer(d, d)
        value = covariance @ right
        return _Fit(value, covariance, 0.5 * float(right @ value))

    def _likeliest(self) -> int:
        """Where a free step is likeliest to begin."""
        window = self._window
        reach = round(self._tuning.search / window.step)
        places = [
            i for i in range(len(window.e) - 4) if abs(window.index[i]) <= reach and i >= 4
        ] or [min(window.at, len(window.e) - 1)]
        gains = [self._fit(self._free(self._since(i))).likelihood for i in places]
        return places[int(np.argmax(gains))]

    def _inflation(self) -> Array:
        """(4,) by how much what is left after the step exceeds what the flight showed before."""
        since = self._since(self.at)
        free = self._free(since)
        scale = np.ones(4)
        for i, (c, column) in enumerate(free.items()):
            fit = self._fit({c: column[:, i : i + 1]})
            left = self._window.e[:, c] - column[:, i] * fit.value[0]
            white = solve_triangular(self._roots[c], left, lower=True)[self.at :]
            scale[c] = np.sqrt(max(1.0, float(np.mean(white * white))))
        return scale

    # ---- noise --------------------------------------------------------------------------------

    def _covariates(self) -> dict[int, Array]:
        """Of each channel, (n, k) columns scaled by the standard deviations of their priors."""
        window, tuning, thrust = self._window, self._tuning, self._thrust
        air = window.air
        one = np.ones((len(air), 1))
        rate = _rate(thrust, window)
        usual = float(np.mean(thrust[: max(window.at, 1)]))
        lag, curve = tuning.lag_error, tuning.curve_error
        actuator = self._reference.actuator
        columns: dict[int, Array] = {}
        if self._watched[0]:
            moved = [curve * (thrust - usual), tuning.inflow * air[:, 2]]
            moved += [tuning.lift * np.sum(air[:, :2] ** 2, axis=1)]
            if actuator is not None:
                lag = float(np.hypot(2.0 * lag, actuator.lag_std))
                moved.append(actuator.curve_std * self._by_curve(actuator.curve))
            moved.append(lag * rate)
            columns[0] = np.column_stack([_WIDE * GRAVITY * one, *moved])
        for c in (1, 2, 3):
            if not self._watched[c]:
                continue
            torque = window.x[:, : rb.N_SIGNALS] @ self._Q[c - 1]
            moved = [tuning.inertia_error * torque, lag * _rate(torque, window)]
            moved += [tuning.flapping * _TENTHS * self._floors[c] * air[:, j] for j in range(3)]
            moved += [_WIDE * _TENTHS * self._floors[c] * thrust / max(usual, 1e-9)]
            columns[c] = np.column_stack(moved)
        return columns

    def _by_curve(self, c: float) -> Array:
        """(n,) change of thrust with the curve, kappa such that mean thrust stays."""
        share = self._window.squares
        w = _command_of(share, c)
        slope = (w * w - w).sum(axis=1)
        usual = slice(0, max(self._window.at, 1))
        total = share.sum(axis=1)
        even = slope - total * (slope[usual].mean() / max(total[usual].mean(), 1e-9))
        changed: Array = self._reference.kappa * even
        return changed

    def _root(self, c: int, strength: Array) -> Array:
        """Cholesky factor of a channel's covariance, covariates included."""
        window = self._window
        h = window.step
        lags = np.abs(window.index[:, None] - window.index)
        floor = (_FORCE_FLOOR if c == 0 else _MOMENT_FLOOR * _TENTHS) * self._floors[c]
        noise = strength[0] / h * (lags == 0)
        noise = noise + strength[1] / h**2 * (2.0 * (lags == 0) - 1.0 * (lags == 1))
        added = np.where(np.array(_OU_TIMES) == _FLOOR_TIME, floor**2, 0.0)
        for tau, variance in zip(_OU_TIMES, strength[2:] + added, strict=True):
            noise = noise + variance * _ou(lags, h, tau)
        moved = self._moved[c]
        noise = noise + moved @ moved.T
        # Numbers have a size: what is next to nothing keeps the matrix definite.
        noise += 1e-9 * np.trace(noise) / len(noise) * np.eye(len(noise))
        root: Array = np.linalg.cholesky(noise)
        return root


@dataclass(frozen=True)
class _Fit:
    """Generalized least squares.

    Attributes:
        value: (p,) unknowns.
        covariance: (p, p).
        likelihood: gain of the logarithm over no step.
    """

    value: Array
    covariance: Array
    likelihood: float

    @property
    def std(self) -> Array:
        """(p,) standard deviations."""
        std: Array = np.sqrt(np.diag(self.covariance))
        return std


Columns = Callable[[Mask], dict[int, Array]]
_NOTHING = _Fit(np.zeros(1), np.zeros((1, 1)), 0.0)
_SURE = 3.0
"""Standard deviations that name a cause."""
_MIN_CG = 0.002
"""m, least shift of the CG that is named from a second."""
_CARRIED = 0.8
"""Share of the weight; rotors that make less do not carry a vehicle that does not fall."""
_PUNCH, _CLIMB, _SPEED = 1.5, 0.7, 1.5
"""Thrust over the usual one; m/s of vertical and of horizontal velocity."""
_TENTHS = 10.0
"""`Reference.floors` are moments of a tenth of the arm."""
_FLOOR_TIME = 1.5
_THRUST = rb.SIGNALS.index("thrust")


def _ou(lags: Array, h: float, tau: float) -> Array:
    """Covariance of means over h of an Ornstein-Uhlenbeck process of unit variance."""
    k = tau / h
    lost = 1.0 - np.exp(-1.0 / k)
    same = 2.0 * k * (1.0 - k * lost)
    apart: Array = (k * lost) ** 2 * np.exp(-(np.maximum(lags, 1) - 1) / k)
    return np.where(lags == 0, same, apart)


def _spectrum(window: _Window, history: History, c: int) -> Array:
    """(2 + k,) strengths of white noise (/Hz), of differentiated noise, and variances of the OUs.

    Variances of differences of neighboring means are matched at all scales, by their degrees of
    freedom; where they exceed the match, all is raised to them.
    """
    h = window.step
    found = [
        (m * h, *_haar(window.e[: window.at, c], window.index[: window.at], m)) for m in (1, 2, 4)
    ]
    found += [
        (m * history.step, *_haar(history.left[:, c], np.arange(len(history.left)), m))
        for m in (1, 2, 4, 8, 16)
    ]
    found = [row for row in found if row[2] >= 3 and row[1] > 0.0]
    if not found:
        return np.zeros(2 + len(_OU_TIMES))
    scale, variance, count = (np.array(column) for column in zip(*found, strict=True))
    # Student: a variance from few values is as likely too small as it is uncertain.
    variance = variance * count / np.maximum(count - 2.0, 1.0)
    made = [2.0 / scale, 6.0 / scale**2]
    for tau in _OU_TIMES:
        k = tau / scale
        lost = 1.0 - np.exp(-1.0 / k)
        made.append(4.0 * k * (1.0 - k * lost) - 2.0 * (k * lost) ** 2)
    A = np.column_stack(made) / variance[:, None]
    weight = np.sqrt(np.minimum(count, 40.0))
    size = np.maximum(A.max(axis=0), 1e-300)
    strength = nnls(A / size * weight[:, None], weight)[0] / size
    matched = A @ strength
    sound = count >= 6.0
    short = float(np.max(1.0 / np.maximum(matched[sound], 0.1), initial=1.0))
    raised: Array = strength * short
    return raised


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


def _means(parts: Array) -> Array:
    """(n, w) of (n, size, w), over what is there."""
    there = np.isfinite(parts)
    means: Array = np.where(there, parts, 0.0).sum(axis=1) / np.maximum(there.sum(axis=1), 1)
    return means


def _median(history: Array) -> Array:
    """(4,) of (n, 4); NaN where there is none."""
    return np.array(
        [np.median(h[np.isfinite(h)]) if np.isfinite(h).any() else np.nan for h in history.T]
    )


def _rate(values: Array, window: _Window) -> Array:
    rate: Array = np.gradient(values, window.index * window.step)
    return rate


def _command_of(share: Array, c: float) -> Array:
    """Command of a share of full thrust: (1 - c) w + c w^2 = share."""
    linear = 1.0 - c
    root = np.sqrt(np.maximum(linear * linear + 4.0 * c * share, 0.0))
    command: Array = 2.0 * share / np.maximum(linear + root, 1e-6)
    return command


def _velocity(samples: Samples, dt: float) -> Array:
    """(n, 3) along the body axes: as sent, else of the accelerometer, integrated."""
    turn = attitude.matrices(samples.attitude)
    velocity = samples.velocity
    if not np.isfinite(velocity).all(axis=1).mean() > _VELOCITY_SENT:
        pull = (turn @ np.nan_to_num(samples.force)[..., None])[..., 0] + [0.0, 0.0, GRAVITY]
        velocity = np.cumsum(np.nan_to_num(pull), axis=0) * dt
    body: Array = (velocity[:, None, :] @ turn)[:, 0]
    return body


_VELOCITY_SENT = 0.5
"""Share of samples with a velocity."""
