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
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri, stdtrit

from gcs_sysid.arrays import Array, long_run, nonnegative
from gcs_sysid.health.hover import Windows
from gcs_sysid.health.hover_tuning import TUNING
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.estimate import Quantity
from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.significance import FALSE_ALARM_RATE, Z95

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
    between: float | None = None,
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
        between: s between windows, where the numbers are to be those of other flights too.

    Raises:
        ValueError: fewer rows than columns.
    """
    n, p = columns.shape
    regressors = columns if projected is None else projected
    if n <= p:
        raise ValueError(f"{n} windows do not show {p} coefficients")
    penalty = np.zeros(p) if ridge is None else 1.0 / ridge**2
    (value,), (residual,), (weight,), (scale,), (normal,) = _huber_fits(
        columns, y[None], penalty, regressors, jitter
    )
    bread = _inverse(normal)
    score = regressors * (weight * residual)[:, None]
    lags = min(max(2, round(2.5 * n ** (1.0 / 3.0))), n - 1)
    meat = long_run(score, lags)
    free = max(n / (1.0 + lags) - 1.0, 2.0)
    stretch = float(stdtrit(free, 0.975)) / Z95
    # A prior's part of the knowledge is its own variance.
    covariance = bread @ (meat + scale**2 * np.diag(scale**2 * penalty)) @ bread * stretch**2
    # What the fit has taken from so few residuals (MacKinnon and White 1985).
    covariance *= n / max(n - float(np.trace(bread @ (regressors.T @ regressors))), 1.0)
    if between is not None:
        slow = long_memory(n * score @ bread, between)
        grown = np.sqrt(np.maximum(1.0, slow / np.maximum(np.diag(covariance), 1e-30)))
        covariance = covariance * np.outer(grown, grown)
    return BalanceFit(value, covariance, float(scale))


def mean_of(values: Array, half: float) -> Quantity:
    """The mean of (n,) ratios over windows half s apart, for other flights too."""
    fit = robust_fit(np.ones((len(values), 1)), values, between=half)
    return Quantity(float(fit.value[0]), math.sqrt(float(fit.covariance[0, 0])), "1")


def usual_of(values: Array) -> float:
    """The mean of (n,) values, two or more, that outliers hardly move."""
    fit = robust_values(np.ones((len(values), 1)), values[:, None], np.array([np.inf]))
    return float(fit[0, 0])


def pooled(flights: Sequence[Quantity]) -> Quantity:
    """One value of several flights', each with a value: their weighted mean.

    Where they scatter by more than each has by itself, by a ratio (Birge's), the interval is wider
    by that; where chance is no reason, it is that of their scatter (with Student's t for as many
    flights). What was given is the same in all.
    """
    last, n = flights[-1], len(flights)
    value = np.array([one.value for one in flights], dtype=float)
    own = np.array([one.std_data or 0.0 for one in flights])
    if n < 2 or not (own > 0.0).all():
        return last
    weight = 1.0 / own**2
    mean = float(weight @ value / weight.sum())
    birge = float(weight @ (value - mean) ** 2) / (n - 1)
    by_chance = float(chdtri(n - 1, FALSE_ALARM_RATE)) / (n - 1)
    student = float(stdtrit(n - 1, 0.975)) / Z95 if birge > by_chance else 1.0
    more = birge * student**2
    given = float(np.mean([one.std_given for one in flights]))
    std = math.hypot(math.sqrt(max(more, 1.0) / float(weight.sum())), given)
    return replace(last, value=mean, std=std, std_given=given)


def long_memory(series: Array, half: float) -> Array:
    """(p,) variances of the means of series about those of other flights, by their slow scatter.

    Wind, battery and rotors' inflow wander ever slower: means of blocks of a flight do not come
    closer to each other as the blocks grow, as white noise would have it. With a spectrum of
    N + A / f the Allan variance of blocks of m windows is N / m + 2 ln 2 A (Barnes 1971), and the
    mean of a flight of T is off that over all flights by N / n + A ln(apart / T).

    Args:
        series: (n, p) whose means are asked about, at windows that follow each other.
        half: s from one to the next.
    """
    n = len(series)
    sizes = [2**k for k in range(2, n.bit_length()) if n // 2**k >= TUNING.fewest_blocks]
    if not sizes:
        return np.zeros(series.shape[1])
    allan, design, degrees = [], [], []
    for size in sizes:
        count = n // size
        means = series[: count * size].reshape(count, size, -1).mean(axis=1)
        allan.append(0.5 * (np.diff(means, axis=0) ** 2).mean(axis=0))
        design.append([1.0 / size, 2.0 * math.log(2.0)])
        degrees.append(float(count - 1))
    later = math.log(max(TUNING.apart / (n * half), 1.0))
    out = np.empty(series.shape[1])
    for i, variance in enumerate(np.array(allan).T):
        weight = np.sqrt(degrees) / np.maximum(variance, 1e-30)
        white, flicker = nonnegative(np.array(design) * weight[:, None], variance * weight)
        out[i] = white / n + flicker * later
    return out


def robust_values(columns: Array, targets: Array, ridge: Array) -> Array:
    """(p, k) what `robust_fit` fits to each of k targets, without covariances, which cost more.

    Args:
        columns: (n, p) regressors.
        targets: (n, k), each fitted by itself, all at once.
        ridge: (p,) prior standard deviations about zero; inf: none.
    """
    y = np.ascontiguousarray(targets.T)
    out: Array = _huber_fits(columns, y, 1.0 / ridge**2, columns, None)[0].T
    return out


def _huber_fits(
    columns: Array, y: Array, penalty: Array, regressors: Array, jitter: Array | None
) -> tuple[Array, Array, Array, Array, Array]:
    """Of each of (k, n) targets: coefficients (p,), residuals (n,), weights (n,), robust scale, and
    the normal matrix (p, p) with these weights.

    Args:
        columns: (n, p).
        y: (k, n).
        penalty: (p,) over the squared scale.
        regressors: (n, p) as of `robust_fit`.
        jitter: (n, p) likewise.
    """
    n, p = columns.shape
    products = regressors[:, :, None] * regressors[:, None, :]
    if jitter is not None:
        products = products - jitter[:, :, None] * jitter[:, None, :]
    flat, middle = products.reshape(n, p * p), ((n - 1) // 2, n // 2)

    def median(values: Array) -> Array:
        """Without the overhead of `numpy.median`, which is most of it for a hundred."""
        ordered = np.partition(values, middle, axis=1)
        half: Array = 0.5 * (ordered[:, middle[0]] + ordered[:, middle[1]])
        return half[:, None]

    def normal_of(weight: Array, scale: Array) -> Array:
        out: Array = (weight @ flat).reshape(-1, p, p) + scale[:, :, None] ** 2 * np.diag(penalty)
        return out

    weight, scale = np.ones_like(y), np.maximum(y.std(axis=1), 1e-12)[:, None]
    value, residual = np.zeros((len(y), p)), y
    for _ in range(_ROUNDS):
        right = ((weight * y) @ regressors)[:, :, None]
        value = (_inverse(normal_of(weight, scale)) @ right)[:, :, 0]
        residual = y - value @ columns.T
        scale = np.maximum(1.4826 * median(np.abs(residual - median(residual))), 1e-15)
        weight = 1.0 / np.maximum(np.abs(residual) / (1.345 * scale), 1.0)
    return value, residual, weight, scale[:, 0], normal_of(weight, scale)


def _inverse(matrix: Array) -> Array:
    """Pseudo-inverses of (..., p, p) symmetric ones, without `numpy.linalg.pinv`'s overhead."""
    values, vectors = np.linalg.eigh(matrix)
    size = np.abs(values)
    large = size > 1e-15 * size.max(axis=-1, keepdims=True)
    inverse = np.divide(1.0, values, where=large, out=np.zeros_like(values))
    out: Array = (vectors * inverse[..., None, :]) @ np.swapaxes(vectors, -1, -2)
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
        covariance: (2, 2) by the flight's own scatter and its wind.
        level_std: (2,) m, by an accelerometer that is off level: the same in every flight.
        by_wind: (2,) m by which drag may have moved the center of thrust from the CG beyond what
            was taken off; it is in `cg`.
        at_force: (2,) m, the center of thrust at `force`, drag included.
        scatter: (2,) m, standard deviations of that.
        lever: (2,) m per m/s^2 of specific force, by which drag moves it.
        lever_std: (2,) standard deviations of those.
        force: (2,) m/s^2, the mean specific force in the rotors' plane.
        wind_share: of that force, that is the wind's.
    """

    cg: Array
    covariance: Array
    level_std: Array
    by_wind: Array
    at_force: Array
    scatter: Array
    lever: Array
    lever_std: Array
    force: Array
    wind_share: float


def cg_of(windows: Windows, airframe: Airframe, thrust: Array) -> Center:
    """The CG from the center of thrust in hover.

    Wind drags at rotors and body above the CG and flaps the blades: a moment in proportion to the
    specific force in the rotors' plane, which the accelerometer measures. On a real 18 kg quad it
    moved the center of thrust by 64 mm per m/s^2, 15 mm in a breeze. An accelerometer off level by
    a degree looks like wind. Gusts set them apart: they are a known part of a wind's mean, so
    that of the mean force w + b, of variances s_w^2 and s_b^2, the share s_w^2 / (s_w^2 + s_b^2) is
    expected to be wind, and its moment is taken off.

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
        fit = robust_fit(columns, thrust @ place / total, ridge, between=windows.half)
        values.append(float(fit.value[0]))
        variances.append(float(fit.covariance[0, 0]) + (TUNING.cg_floor * arm) ** 2)
        levers.append((float(fit.value[4]), math.sqrt(float(fit.covariance[4, 4]))))
    (lever, lever_std), at_force = np.array(levers).T, np.array(values)
    gusts = math.sqrt(float(windows.force[:, :2].var(axis=0).mean()))
    wind = 0.0 if not math.isfinite(gusts) else gusts / TUNING.turbulence
    off_level = GRAVITY * math.radians(airframe.uncertainty.imu_rotation.amount)
    share = wind**2 / max(wind**2 + off_level**2, 1e-30)
    moved = share * lever * force
    own = np.array(variances) + (share * force * lever_std) ** 2
    return Center(
        at_force - moved,
        np.diag(own + ((1.0 - share) * wind * lever) ** 2),
        share * off_level * np.abs(lever),
        lever * force - moved,
        at_force,
        np.sqrt(variances),
        lever,
        lever_std,
        force,
        share,
    )


def shares_by_wind(airframe: Airframe, center: Center) -> Array:
    """(rotors,) what the wind of the flight adds to the shares, as the mixer answers its moment."""
    x, y, spin = airframe.geometry
    effect = np.vstack([np.ones(len(x)), x, y, spin])
    moved = center.wind_share * center.lever * center.force
    out: Array = np.linalg.pinv(effect)[:, 1:3] @ moved
    return out


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
    given = airframe.uncertainty
    place = given.rotor_position.of(airframe.arm) ** 2 * float(shares @ shares)
    out: Array = given.rotor_thrust.of(1.0) ** 2 * moved @ moved.T + place * np.eye(2)
    return out


def share_std(shares: Array, scatter: float) -> Array:
    """(rotors,) standard deviation of shares s_i by the scatter of rotors' k_T about their mean."""
    others = float(shares @ shares) - shares**2
    out: Array = scatter * shares * np.sqrt((1.0 - shares) ** 2 + others)
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
    ridge = np.array([np.inf, TUNING.climb_drag])
    fit = robust_fit(columns, lift, ridge, between=windows.half)
    value = float(fit.value[0] / total.mean())
    by_climb = TUNING.climb_share * float(fit.value[1]) * mean
    std = math.hypot(math.sqrt(float(fit.covariance[0, 0])), by_climb) / total.mean()
    floor = TUNING.lift_std
    if not np.isfinite(windows.lift).any():
        floor = TUNING.accelerometer_std / GRAVITY
    elif not np.isfinite(windows.sink).any():
        # Unknown vertical speed at both ends of the hover.
        floor = max(floor, TUNING.unseen_climb / max(windows.seconds, 1.0) / GRAVITY)
    return value, math.hypot(std, floor * value)
