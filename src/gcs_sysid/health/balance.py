"""Balances of force and moment in hover: CG, thrust coefficients, thrust curve, shares.

With T_i = k_T Omega_i^2, or T_max ((1 - c) u_i + c u_i^2), Newton-Euler about the CG (MODEL.md's
signs, rotors at x_i, y_i from the geometric center) reads

    sum T_i x_i / T = cg_x + (Jyy q' + (Jxx - Jzz) r p + ...) / T
    sum T_i y_i / T = cg_y - (Jxx p' + (Jzz - Jyy) q r + ...) / T ,     T = sum T_i
    T cos(tilt) = m (g - v_down')

A hover turns little, so the inertia terms are carried as regressors whose mean is nearly zero: the
CG is the intercept, and unbiased however poorly the inertia is known.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import t as student

from gcs_sysid.arrays import Array, Mask, complete_rows
from gcs_sysid.health.hover import Windows, variations_of_lift
from gcs_sysid.health.tuning import TUNING
from gcs_sysid.intervals import Z95
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.parameters import GRAVITY


@dataclass(frozen=True)
class Quantity:
    """A number with its uncertainty.

    Attributes:
        value: None where the log does not tell it.
        std: standard deviation, all of it.
        unit: SI; "1" for pure numbers.
        std_given: the part of `std` that comes from what was given or assumed, not from the flight.
    """

    value: float | None
    std: float | None
    unit: str
    std_given: float = 0.0

    @property
    def half(self) -> float | None:
        """Half of the 95 % interval."""
        return None if self.std is None else Z95 * self.std

    @property
    def ci95(self) -> tuple[float, float] | None:
        """The 95 % interval (normal); None without a value."""
        if self.value is None or self.std is None:
            return None
        return self.value - Z95 * self.std, self.value + Z95 * self.std

    def as_json(self) -> dict[str, Any]:
        """As result files write it."""
        ci95 = self.ci95
        return {
            "value": self.value,
            "std": self.std,
            "ci95": None if ci95 is None else list(ci95),
            "unit": self.unit,
            "std_given": self.std_given,
        }


@dataclass(frozen=True)
class Fit:
    """A linear fit with standard deviations that hold for residuals that hang together.

    Attributes:
        value: (p,) coefficients.
        covariance: (p, p).
        residual: standard deviation of the residuals, robust.
    """

    value: Array
    covariance: Array
    residual: float


def robust_fit(
    columns: Array,
    y: Array,
    ridge: Array | None = None,
    jitter: Array | None = None,
    projected: Array | None = None,
) -> Fit:
    """Least squares with Huber's weights and Newey-West's covariance.

    The windows overlap by half, and gusts last for seconds: the score's autocovariance counts over
    the lags that a sample of this length can tell (Andrews' rate), with Student's t for as many
    independent stretches as those leave.

    Args:
        columns: (n, p) regressors.
        y: (n,).
        ridge: (p,) prior standard deviations about zero; inf: none.
        jitter: (n, p) draws of the regressors' own noise, whose products are taken off theirs
            (errors in variables, with known noise).
        projected: (n, p) regressors as instruments explain them (two-stage least squares).

    Raises:
        ValueError: fewer rows than columns.
    """
    n, p = columns.shape
    noise = np.zeros_like(columns) if jitter is None else jitter
    told = columns if projected is None else projected
    if n <= p:
        raise ValueError(f"{n} windows do not tell {p} coefficients")
    weight = np.ones(n)
    scale = float(np.std(y)) or 1e-12
    penalty = np.zeros(p) if ridge is None else 1.0 / ridge**2
    value = np.zeros(p)
    for _ in range(12):
        A = _products(told, noise, weight)
        normal = A + scale**2 * np.diag(penalty)
        value = np.linalg.pinv(normal, hermitian=True) @ ((told * weight[:, None]).T @ y)
        residual = y - columns @ value
        scale = max(1.4826 * float(np.median(np.abs(residual - np.median(residual)))), 1e-15)
        weight = 1.0 / np.maximum(np.abs(residual) / (1.345 * scale), 1.0)
    normal = _products(told, noise, weight) + scale**2 * np.diag(penalty)
    bread = np.linalg.pinv(normal, hermitian=True)
    score = told * (weight * residual)[:, None]
    lags = min(max(2, round(2.5 * n ** (1.0 / 3.0))), n - 1)
    meat = score.T @ score
    for lag in range(1, lags + 1):
        cross = score[lag:].T @ score[:-lag]
        meat += (1.0 - lag / (lags + 1.0)) * (cross + cross.T)
    free = max(n / (1.0 + lags) - 1.0, 2.0)
    stretch = float(student.ppf(0.975, free)) / Z95
    # A prior's part of the knowledge is its own variance.
    covariance = bread @ (meat + scale**2 * np.diag(scale**2 * penalty)) @ bread
    return Fit(value, covariance * stretch**2, scale)


def _products(columns: Array, noise: Array, weight: Array) -> Array:
    """(p, p) sums of products of the regressors without those of their noise."""
    out: Array = (columns * weight[:, None]).T @ columns - (noise * weight[:, None]).T @ noise
    return out


@dataclass(frozen=True)
class Curve:
    """The thrust curve, and where it is known from.

    Attributes:
        c: of T/T_max = (1 - c) u + c u^2.
        origin: in words.
    """

    c: Quantity
    origin: str


def thrust_of(windows: Windows, c: float | None) -> Array:
    """(n, rotors) thrust, relative: mean squares of speeds, or of commands by their curve."""
    if c is None:
        return windows.speeds
    return (1.0 - c) * windows.commands + c * windows.squares


def curve_of(
    windows: Windows, given: float | None, own: float | None, autopilot_name: str
) -> Curve:
    """The thrust curve from commands, by speeds where there are any, else by the thrust needed.

    Args:
        windows: all those in flight.
        given: by the airframe file.
        own: the autopilot's own setting, where it tells.
        autopilot_name: of that setting.
    """
    if given is not None:
        return Curve(Quantity(given, 0.0, "1"), "given")
    guess, sigma, origin = 0.5, TUNING.curve_std, "assumed"
    if own is not None and 0.0 < own <= 1.0:
        # Half of the fleet never touched it: it says little more than the usual.
        guess, origin = own, f"{autopilot_name} of the vehicle, assumed to be near"
    told = _by_speeds(windows) if np.isfinite(windows.speeds).any() else _by_lift(windows)
    if told is None:
        return Curve(Quantity(guess, sigma, "1", sigma), origin)
    c, std, by = told
    gain = sigma**2 / (sigma**2 + std**2)
    merged = float(np.clip(guess + gain * (c - guess), 0.0, 1.0))
    return Curve(Quantity(merged, math.sqrt(gain) * std, "1"), by if gain > 0.5 else origin)


def _ratio(fit: Fit) -> tuple[float, float]:
    """The curve c = b / (a + b) of coefficients a, b of u and u^2, and its standard deviation."""
    a, b = fit.value[:2]
    total = a + b
    slope = np.array([-b, a]) / total**2
    return float(b / total), math.sqrt(float(slope @ fit.covariance[:2, :2] @ slope))


def _by_speeds(windows: Windows) -> tuple[float, float, str] | None:
    """Omega_i^2 of every rotor over its command, each rotor with a gain of its own."""
    rotors = windows.speeds.shape[1]
    rows, noises, targets = [], [], []
    t = windows.t - windows.t.mean()
    span = float(np.abs(t).max()) or 1.0
    for i in range(rotors):
        u, uu, w = windows.commands[:, i], windows.squares[:, i], windows.speeds[:, i]
        noise = np.column_stack([windows.jitter[:, i], np.zeros(len(t))])
        there = np.isfinite(u) & np.isfinite(w) & complete_rows(noise)
        if there.sum() < TUNING.fewest_windows or np.std(u[there]) < TUNING.least_throttle_motion:
            return None
        # Each rotor scaled to the thrust of the mean one at its own mean command.
        rows.append(np.column_stack([u, uu, u * t / span])[there])
        noises.append(noise[there])
        targets.append(w[there] / w[there].mean())
    fits = [robust_fit(a, y, None, d) for a, d, y in zip(rows, noises, targets, strict=True)]
    values = np.array([_ratio(fit) for fit in fits])
    weight = 1.0 / values[:, 1] ** 2
    mean = float(weight @ values[:, 0] / weight.sum())
    # Rotors differ in more than noise: their scatter counts.
    scatter = float(weight @ (values[:, 0] - mean) ** 2 / weight.sum() / max(rotors - 1, 1))
    std = math.sqrt(max(1.0 / float(weight.sum()), scatter))
    return mean, math.hypot(std, TUNING.curve_floor), "speeds over commands"


def _by_lift(windows: Windows) -> tuple[float, float, str] | None:
    """Thrust over mass in climbs and descents over the sum of commands, by two estimators.

    A gust that the accelerometer feels makes the autopilot answer: commands and noise hang
    together, and least squares finds too flat a curve, by about the gusts' share of the power. That
    is its bias. Commands of seconds before know nothing of a gust: with them as instruments there
    is none, but few flights climb enough for that. Both are merged by what they are off by. The
    accelerometer tells the thrust, or the velocity does, whichever the commands explain better:
    some velocities are late, some accelerometers have a bias that their filter moves about.
    """
    told = [
        _by_one_lift(windows, lift)
        for lift in (variations_of_lift(windows.lift, windows.force), windows.lift)
    ]
    answers = [answer for answer in told if answer is not None]
    if not answers:
        return None
    _, c, std = min(answers)
    return c, std, "thrust over commands"


def _by_one_lift(windows: Windows, lift: Array) -> tuple[float, float, float] | None:
    """Residual in m/s^2, c and its standard deviation, by one measure of thrust over mass."""
    total, squares = windows.commands.sum(axis=1), windows.squares.sum(axis=1)
    t = windows.t - windows.t.mean()
    span = float(np.abs(t).max()) or 1.0
    sink = np.where(np.isfinite(windows.sink), windows.sink, 0.0)
    columns = np.column_stack([total, squares, total * t / span, sink])
    noise = np.column_stack([windows.jitter.sum(axis=1), np.zeros((len(t), 2))])
    before = [_earlier(windows, total, lag) for lag in TUNING.instrument_lags]
    steady = np.column_stack([np.ones(len(t)), t / span, sink])
    instruments = np.column_stack(
        [steady, *before, _earlier(windows, squares, TUNING.instrument_lags[0])]
    )
    there = complete_rows(np.column_stack([columns, lift, noise])) & _gentle(windows)
    if there.sum() < 2 * TUNING.fewest_windows:
        return None
    if np.std(total[there] / windows.commands.shape[1]) < TUNING.least_throttle_motion:
        return None
    fit = robust_fit(columns[there], lift[there], jitter=noise[there])
    residual = fit.residual
    answers = [_with_gusts(fit, columns[there], lift[there], windows.commands.shape[1])]
    there &= complete_rows(instruments)
    if there.sum() > 3 * TUNING.fewest_windows:
        instruments = instruments[there]
        explained = instruments @ np.linalg.lstsq(instruments, columns[there], rcond=None)[0]
        fit = robust_fit(columns[there], lift[there], projected=explained)
        other = _ratio(fit)
        if other[1] < TUNING.told_by_instruments:
            answers.append(other)
    values, weights = np.array([(c, 1.0 / std**2) for c, std in answers]).T
    merged = float(values @ weights / weights.sum())
    # The same flight twice: the better one alone could be as good.
    std = math.hypot(1.0 / math.sqrt(float(weights.max())), TUNING.curve_floor)
    return residual, merged, std


def _gentle(windows: Windows) -> Mask:
    """(n,) whether it turns so slowly that thrust is that of the mean command; climbs may be."""
    slow = np.abs(windows.rates).max(axis=1) < TUNING.most_rate
    calm = np.abs(windows.turning).max(axis=1) < TUNING.most_turning
    gentle: Mask = np.logical_and.reduce([slow, calm, ~(windows.speed > TUNING.most_speed)])
    return gentle


def _with_gusts(fit: Fit, columns: Array, lift: Array, rotors: int) -> tuple[float, float]:
    """The curve of a fit, its deviation widened by the bias that gusts make.

    White noise of the accelerometer makes none: what overlapping windows of it hang together by is
    taken off the residuals' autocorrelation.
    """
    c, std = _ratio(fit)
    model = columns @ fit.value
    residual = lift - model
    steps = np.clip(residual, -3.0 * fit.residual, 3.0 * fit.residual)
    neighbors = float(np.corrcoef(steps[1:], steps[:-1])[0, 1])
    white, gust = TUNING.white_neighbors
    colored = float(np.clip((neighbors - white) / (gust - white), 0.0, 1.0))
    flat = TUNING.gust_bias * colored * (fit.residual / max(float(np.std(model)), 1e-9)) ** 2
    # Of thrust a u + b u^2, bent by s = b u^2 / T: c = s / (s + (1 - s) u).
    u = float(columns[:, 0].mean()) / rotors
    s = float(np.clip(c * u / (1.0 - c + c * u), 0.0, 1.0)) if 0.0 < c < 1.0 else float(c >= 1.0)
    return c, math.hypot(std, flat * u / (s + (1.0 - s) * u) ** 2)


def _earlier(windows: Windows, values: Array, lag: int) -> Array:
    """(n,) what a value was so many windows before; NaN where that was not in flight."""
    place = np.rint(windows.t / windows.half).astype(int)
    i = np.searchsorted(place, place - lag)
    out: Array = np.where(place[i] == place - lag, values[i], np.nan)
    return out


def lift_of(windows: Windows) -> Array:
    """(n,) m/s^2, thrust over mass: by gravity where attitude is there, else as measured."""
    lift: Array = np.where(np.isfinite(windows.lift), windows.lift, -windows.force[:, 2])
    return lift


@dataclass(frozen=True)
class Center:
    """Where the CG is, by one flight.

    Attributes:
        cg: (2,) m, forward and right of the geometric center.
        covariance: (2, 2) by the flight's own scatter.
        by_wind: (2,) m by which drag has moved the center of thrust from the CG, as far as the
            flight tells; it is in `cg`.
    """

    cg: Array
    covariance: Array
    by_wind: Array


def cg_of(windows: Windows, airframe: Airframe, thrust: Array) -> Center:
    """The CG from the center of thrust in hover.

    Wind drags at rotors and body above the CG and flaps the blades: a moment in proportion to the
    specific force in the rotors' plane, which the accelerometer measures. On a real 18 kg quad it
    moved the center of thrust by 64 mm per m/s^2, 15 mm in a breeze. What is left of it at the mean
    force is told apart: an accelerometer off level by a degree looks like wind, so it stays in the
    CG and in its interval.

    Args:
        windows: of hover, with all of thrust.
        airframe: places of the rotors.
        thrust: (n, rotors), in any unit.
    """
    x, y, _ = airframe.geometry
    total = thrust.sum(axis=1)
    relative = total / total.mean()
    turning = windows.turning / relative[:, None]
    products = windows.products / relative[:, None]
    rates = windows.rates / relative[:, None]
    drag = np.nan_to_num(windows.force[:, :2]) / relative[:, None]
    arm = airframe.arm
    # In meters: an inertia of m L^2 moves the center by L^2/g; damping and products less.
    ridge = np.array([np.inf, arm**2, arm**2, 5.0 * arm**2, TUNING.drag_lever * arm / GRAVITY])
    values, variances, moved = [], [], []
    for place, axis in ((x, 1), (y, 0)):
        mean = float(np.median(drag[:, 1 - axis]))
        columns = np.column_stack(
            [
                np.ones(len(total)),
                turning[:, axis],
                products[:, axis],
                rates[:, axis],
                drag[:, 1 - axis] - mean,
            ]
        )
        fit = robust_fit(columns, thrust @ place / total, ridge)
        values.append(float(fit.value[0]))
        variances.append(float(fit.covariance[0, 0]) + (TUNING.cg_floor * arm) ** 2)
        moved.append(float(fit.value[4]) * mean)
    return Center(np.array(values), np.diag(variances), np.array(moved))


def turns_otherwise(windows: Windows, airframe: Airframe, thrust: Array) -> bool:
    """Whether the vehicle answers other moments than those of these rotors: a wrong motor order.

    Roll and pitch acceleration over the moments of roll, pitch and yaw that the airframe would
    have: where another axis' moment turns it more than its own, and surely, motors are swapped.
    Gusts, which the autopilot answers, weaken an axis' own moment; they make no other one.

    Args:
        windows: in flight, with all of thrust.
        airframe: places of the rotors.
        thrust: (n, rotors), in any unit.
    """
    x, y, spin = airframe.geometry
    total = thrust.sum(axis=1, keepdims=True)
    moments = (thrust / total) @ np.column_stack([-y, x, spin * airframe.arm])
    if len(moments) < 2 * TUNING.fewest_windows:
        return False
    columns = np.column_stack([np.ones(len(moments)), moments - moments.mean(axis=0)])
    for axis in (0, 1):
        fit = robust_fit(columns, windows.turning[:, axis])
        effect = fit.value[1:]
        sure = effect / np.sqrt(np.maximum(np.diag(fit.covariance)[1:], 1e-30))
        others = [i for i in range(2) if i != axis]
        for i in others:
            if abs(effect[i]) > 2.0 * abs(effect[axis]) and abs(sure[i]) > TUNING.sure_of_order:
                return True
        if sure[axis] < -TUNING.sure_of_order:
            return True
    return False


def scatter_of_cg(airframe: Airframe, shares: Array, cg: Array) -> Array:
    """(2, 2) covariance of the CG by what is assumed of rotors: k_T's scatter and their places.

    With k_i = k (1 + e_i) of unknown e_i, cg = sum s_i (1 + e_i) r_i / sum s_i (1 + e_i).

    Args:
        airframe: places of the rotors.
        shares: (rotors,) of thrust.
        cg: (2,) m.
    """
    x, y, _ = airframe.geometry
    moved = shares * (np.array([x, y]) - cg[:, None])  # (2, rotors)
    place = (TUNING.position_std * airframe.arm) ** 2 * float(shares @ shares)
    out: Array = TUNING.rotor_scatter**2 * moved @ moved.T + place * np.eye(2)
    return out


def share_std(shares: Array) -> Array:
    """(rotors,) standard deviation of shares s_i by the assumed scatter of k_T."""
    others = float(shares @ shares) - shares**2
    out: Array = TUNING.rotor_scatter * shares * np.sqrt((1.0 - shares) ** 2 + others)
    return out


def specific_thrust(windows: Windows, thrust: Array) -> tuple[float, float]:
    """Thrust over mass per unit of the sum of thrust, and its standard deviation.

    Args:
        windows: of hover.
        thrust: (n, rotors), in any unit.
    """
    lift = lift_of(windows)
    total = thrust.sum(axis=1)
    fit = robust_fit(total[:, None] / total.mean(), lift)
    value = float(fit.value[0] / total.mean())
    std = math.sqrt(float(fit.covariance[0, 0])) / total.mean()
    floor = TUNING.lift_std
    if not np.isfinite(windows.lift).any():
        floor = TUNING.accelerometer_std / GRAVITY
    elif not np.isfinite(windows.sink).any():
        # Unknown vertical speed at both ends of the hover.
        floor = max(floor, TUNING.unseen_climb / max(windows.seconds, 1.0) / GRAVITY)
    return value, math.hypot(std, floor * value)
