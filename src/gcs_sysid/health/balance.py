"""Balances of force and moment in hover: CG, thrust coefficients, shares.

With T_i = k_T Omega_i^2, or T_max ((1 - c) u_i + c u_i^2), Newton-Euler about the CG (signs of
docs/method/model.md, rotors at x_i, y_i from the geometric center) reads

    sum T_i x_i / T = cg_x + (Jyy q' + (Jxx - Jzz) r p + ...) / T
    sum T_i y_i / T = cg_y - (Jxx p' + (Jzz - Jyy) q r + ...) / T ,     T = sum T_i
    T cos(tilt) = m (g - v_down')

A hover turns little, so the inertia terms are carried as regressors whose mean is nearly zero: the
CG is the intercept, and unbiased however poorly the inertia is known.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from gcs_sysid.arrays import Array
from gcs_sysid.health.hover import Windows
from gcs_sysid.health.hover_tuning import TUNING
from gcs_sysid.intervals import Z95
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.parameters import GRAVITY

_ROUNDS = 12
"""Reweighted least squares, of Huber's weights."""


@dataclass(frozen=True)
class BalanceFit:
    """A linear fit with standard deviations valid for correlated residuals.

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
) -> BalanceFit:
    """Least squares with Huber's weights and Newey-West's covariance.

    The windows overlap by half, and gusts last for seconds: the score's autocovariance counts over
    the lags that a sample of this length resolves (Andrews' rate), with Student's t for as many
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
    regressors = columns if projected is None else projected
    if n <= p:
        raise ValueError(f"{n} windows do not show {p} coefficients")
    huber = _huber_fit(columns, y, ridge, jitter, regressors)
    value, residual, weight, scale, penalty = huber
    normal = _products(regressors, jitter, weight) + scale**2 * np.diag(penalty)
    bread = _inverse(normal)
    score = regressors * (weight * residual)[:, None]
    lags = min(max(2, round(2.5 * n ** (1.0 / 3.0))), n - 1)
    meat = score.T @ score
    for lag in range(1, lags + 1):
        cross = score[lag:].T @ score[:-lag]
        meat += (1.0 - lag / (lags + 1.0)) * (cross + cross.T)
    free = max(n / (1.0 + lags) - 1.0, 2.0)
    stretch = float(stdtrit(free, 0.975)) / Z95
    # A prior's part of the knowledge is its own variance.
    covariance = bread @ (meat + scale**2 * np.diag(scale**2 * penalty)) @ bread
    return BalanceFit(value, covariance * stretch**2, scale)


def robust_values(columns: Array, targets: Array, ridge: Array) -> Array:
    """(p, k) what `robust_fit` fits to each of k targets, without covariances, which cost more.

    Args:
        columns: (n, p) regressors.
        targets: (n, k), each fitted by itself, all at once.
        ridge: (p,) prior standard deviations about zero; inf: none.
    """
    n, p = columns.shape
    y = np.ascontiguousarray(targets.T)  # (k, n)
    products = (columns[:, :, None] * columns[:, None, :]).reshape(n, p * p)
    weight = np.ones_like(y)
    scale = np.maximum(y.std(axis=1), 1e-12)
    penalty = np.diag(1.0 / ridge**2)
    value = np.zeros((len(y), p))
    middle = ((n - 1) // 2, n // 2)

    def median(values: Array) -> Array:
        ordered = np.partition(values, middle, axis=1)
        half: Array = 0.5 * (ordered[:, middle[0]] + ordered[:, middle[1]])
        return half

    for _ in range(_ROUNDS):
        normal = (weight @ products).reshape(-1, p, p) + scale[:, None, None] ** 2 * penalty
        value = np.linalg.solve(normal, ((weight * y) @ columns)[:, :, None])[:, :, 0]
        residual = y - value @ columns.T
        scale = np.maximum(1.4826 * median(np.abs(residual - median(residual)[:, None])), 1e-15)
        weight = 1.0 / np.maximum(np.abs(residual) / (1.345 * scale[:, None]), 1.0)
    out: Array = value.T
    return out


def _huber_fit(
    columns: Array, y: Array, ridge: Array | None, jitter: Array | None, regressors: Array
) -> tuple[Array, Array, Array, float, Array]:
    """Coefficients (p,), residuals (n,), weights (n,), robust scale and penalty (p,)."""
    p = columns.shape[1]
    weight = np.ones(len(y))
    scale = float(np.std(y)) or 1e-12
    penalty = np.zeros(p) if ridge is None else 1.0 / ridge**2
    value = np.zeros(p)
    residual = y
    for _ in range(_ROUNDS):
        weighted = regressors * weight[:, None]
        normal = _products(regressors, jitter, weight, weighted) + scale**2 * np.diag(penalty)
        value = _inverse(normal) @ (weighted.T @ y)
        residual = y - columns @ value
        scale = max(1.4826 * median_of(np.abs(residual - median_of(residual))), 1e-15)
        weight = 1.0 / np.maximum(np.abs(residual) / (1.345 * scale), 1.0)
    return value, residual, weight, scale, penalty


def _products(
    columns: Array, noise: Array | None, weight: Array, weighted: Array | None = None
) -> Array:
    """(p, p) sums of products of the regressors without those of their noise, if there is any."""
    if weighted is None:
        weighted = columns * weight[:, None]
    out: Array = weighted.T @ columns
    return out if noise is None else out - (noise * weight[:, None]).T @ noise


def _inverse(matrix: Array) -> Array:
    """The pseudo-inverse of a symmetric matrix: `numpy.linalg.pinv` without its overhead."""
    values, vectors = np.linalg.eigh(matrix)
    size = np.abs(values)
    order = np.argsort(size)[::-1]
    size, vectors = size[order], vectors[:, order]
    large = size > 1e-15 * size[0]
    inverse = np.divide(1.0, size, where=large, out=size)
    inverse[~large] = 0.0
    out: Array = (vectors * np.copysign(1.0, values)[order]) @ (inverse[:, None] * vectors.T)
    return out


def median_of(values: Array) -> float:
    """`numpy.median` of (n,) values without its overhead, which is most of it for a hundred."""
    half, odd = divmod(len(values), 2)
    if not len(values) or not np.isfinite(values).all():
        return float(np.median(values))
    if odd:
        middle: float = np.partition(values, half).item(half)
        return middle
    low, high = np.partition(values, (half - 1, half))[half - 1 : half + 1].tolist()
    return float(0.5 * (low + high))


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
        by_wind: (2,) m by which drag has moved the center of thrust from the CG, as far as
            observable; it is in `cg`.
        lever: (2,) m per m/s^2 of specific force, by which drag moves it.
        lever_std: (2,) standard deviations of those.
        force: (2,) m/s^2, the specific force that `cg` is at.
    """

    cg: Array
    covariance: Array
    by_wind: Array
    lever: Array
    lever_std: Array
    force: Array


def cg_of(windows: Windows, airframe: Airframe, thrust: Array) -> Center:
    """The CG from the center of thrust in hover.

    Wind drags at rotors and body above the CG and flaps the blades: a moment in proportion to the
    specific force in the rotors' plane, which the accelerometer measures. On a real 18 kg quad it
    moved the center of thrust by 64 mm per m/s^2, 15 mm in a breeze. The remainder at the mean
    force is reported separately: an accelerometer off level by a degree looks like wind, so it
    stays in the CG and in its interval.

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
    values, variances, levers = [], [], []
    force = np.median(drag, axis=0)
    for place, axis in ((x, 1), (y, 0)):
        columns = np.column_stack(
            [
                np.ones(len(total)),
                turning[:, axis],
                products[:, axis],
                rates[:, axis],
                drag[:, 1 - axis] - force[1 - axis],
            ]
        )
        fit = robust_fit(columns, thrust @ place / total, ridge)
        values.append(float(fit.value[0]))
        variances.append(float(fit.covariance[0, 0]) + (TUNING.cg_floor * arm) ** 2)
        levers.append((float(fit.value[4]), math.sqrt(float(fit.covariance[4, 4]))))
    lever, lever_std = np.array(levers).T
    return Center(np.array(values), np.diag(variances), lever * force, lever, lever_std, force)


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

    Drag and inflow of climbs are regressed out where a vertical speed is logged: they are most of
    what is left of the balance, and last as long as a climb. What the mean climb costs stays in, as
    thermals and a vertical speed that drifts look like one, and widens the interval.

    Args:
        windows: of hover.
        thrust: (n, rotors), in any unit.
    """
    lift = lift_of(windows)
    total = thrust.sum(axis=1)
    sink = np.nan_to_num(windows.sink)
    mean = float(sink.mean())
    columns = np.column_stack([total / total.mean(), sink - mean])
    fit = robust_fit(columns, lift, np.array([np.inf, TUNING.climb_drag]))
    value = float(fit.value[0] / total.mean())
    by_climb = TUNING.wind_share * float(fit.value[1]) * mean
    std = math.hypot(math.sqrt(float(fit.covariance[0, 0])), by_climb) / total.mean()
    floor = TUNING.lift_std
    if not np.isfinite(windows.lift).any():
        floor = TUNING.accelerometer_std / GRAVITY
    elif not np.isfinite(windows.sink).any():
        # Unknown vertical speed at both ends of the hover.
        floor = max(floor, TUNING.unseen_climb / max(windows.seconds, 1.0) / GRAVITY)
    return value, math.hypot(std, floor * value)
