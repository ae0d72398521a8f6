"""Thrust over mass, and drag over mass, from momentum balance or from the accelerometer.

Momentum balance in world axes, averaged with the same window on both sides:

    v' - g z = -kappa (R z) sum O - delta (v - wind),    kappa = k_T / m, delta = D / m

Gravity is the yardstick: over a flight the mean vertical acceleration is nearly nothing, so
kappa does not suffer from an accelerometer's bias. Where the vehicle sends no velocity, the
accelerometer itself, f = -kappa sum O z + bias, serves as second source; its bias is then part
of the uncertainty.
"""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.uncertainty import sandwich

_MAX_ITERATIONS, _WARM_ITERATIONS = 20, 2
WIDTH = 4
"""Width of a row [thrust direction times sum O, velocity, 1, output], one for each axis."""

ACCELEROMETER_BIAS_STD = 0.05
"""m/s^2, what a calibrated MEMS accelerometer's bias may be when nothing else is known."""

TILT_ERROR_SHARE = 2e-4
"""Relative error of kappa that attitude errors of 0.02 rad rms leave: 1 - mean cosine."""

GAIN_DRIFT = 5e-4
"""Relative change of the gain that half an hour of temperature may bring (5 mm/s^2 of bias)."""

_MIN_ROWS = 50
_MIN_CALIBRATED_ROWS = 12
_ROWS_IN_WINDOW = 3.0
"""Square root of the rows that share a window's noise."""


@dataclass(frozen=True)
class Gain:
    """Of the accelerometer against momentum balance, with its relative standard deviation."""

    value: float
    share: float


@dataclass(frozen=True)
class TranslationFit:
    """Thrust and drag over mass.

    Attributes:
        kappa: k_T / m in N s^2/kg.
        kappa_std: its standard deviation.
        delta: D / m in 1/s; NaN when the source is the accelerometer.
        delta_std: its standard deviation.
        source: what they rest on.
    """

    kappa: float
    kappa_std: float
    delta: float
    delta_std: float
    source: Literal["momentum", "accelerometer"]
    weights: Array = field(default_factory=lambda: np.ones(1))
    """(axes,) inverse residual variances."""


def fit_momentum(
    batches: Array,
    counts: NDArray[np.int64],
    total: Array | None = None,
    start: TranslationFit | None = None,
) -> TranslationFit | None:
    """Fit the momentum balance.

    Args:
        batches: (k, 3, WIDTH, WIDTH) moments of north, east and down rows.
        counts: (k,) rows in each.
        total: their sum, if known.
        start: an earlier fit of this kind that is to follow a growing record.

    Returns:
        The fit, or None with too few rows.
    """
    # Wind in the horizontal is a nuisance; a vertical one would be taken for thrust.
    layout = np.zeros((3, 3, 4))  # unknowns: -kappa, -delta, wind north, wind east
    layout[:, 0, 0] = layout[:, 1, 1] = 1.0
    layout[0, 2, 2] = layout[1, 2, 3] = 1.0
    weight = None if start is None else start.weights
    solution = _weighted_fit(batches, counts, layout, total, weight)
    if solution is None:
        return None
    estimate, covariance, weights = solution
    std = np.sqrt(np.diag(covariance))
    kappa = -float(estimate[0])
    kappa_std = float(np.hypot(std[0], TILT_ERROR_SHARE * kappa))
    return TranslationFit(kappa, kappa_std, -float(estimate[1]), float(std[1]), "momentum", weights)


def accelerometer_gain(
    momentum: TranslationFit | None, accelerometer: TranslationFit | None
) -> Gain | None:
    """How the accelerometer's kappa must be scaled to agree with momentum balance.

    In flight both sides of its bias, b and the mean specific force g, stay the same when the mass
    changes, so one gain holds before and after.
    """
    if momentum is None or accelerometer is None or momentum.source != "momentum":
        return None
    return Gain(
        momentum.kappa / accelerometer.kappa,
        float(np.hypot(momentum.kappa_std / momentum.kappa, GAIN_DRIFT)),
    )


def fit_accelerometer(
    batches: Array, counts: NDArray[np.int64], gain: Gain | None = None
) -> TranslationFit | None:
    """Fit thrust over mass to the accelerometer's z axis alone.

    Args:
        batches: (k, WIDTH, WIDTH) moments of rows [sum O, 0, 1, f_z].
        counts: (k,) rows in each.
        gain: of this accelerometer against momentum balance, where that is known.
    """
    layout = np.zeros((1, 3, 1))
    layout[0, 0, 0] = 1.0
    total = batches.sum(axis=0)
    min_rows = _MIN_ROWS if gain is None else _MIN_CALIBRATED_ROWS
    solution = _weighted_fit(batches[:, None], counts, layout, total[None], min_rows=min_rows)
    if solution is None:
        return None
    estimate, covariance, _ = solution
    if gain is not None:
        kappa = -gain.value * float(estimate[0])
        # A window's worth of neighbouring rows counts once: early on no batches tell that.
        own = _ROWS_IN_WINDOW * np.sqrt(covariance[0, 0]) / abs(estimate[0])
        share = float(np.hypot(own, gain.share))
        return TranslationFit(kappa, share * kappa, np.nan, np.nan, "accelerometer")
    mean_thrust = total[0, 2] / max(total[2, 2], 1e-300)
    bias_std = ACCELEROMETER_BIAS_STD / max(abs(mean_thrust), 1e-300)
    std = float(np.hypot(np.sqrt(covariance[0, 0]), bias_std))
    return TranslationFit(-float(estimate[0]), std, np.nan, np.nan, "accelerometer")


def _weighted_fit(
    batches: Array,
    counts: NDArray[np.int64],
    layout: Array,
    total: Array | None,
    weight: Array | None = None,
    min_rows: int = _MIN_ROWS,
) -> tuple[Array, Array, Array] | None:
    """Least squares over several axes that share unknowns, weighted by each axis' residual.

    Args:
        batches: (k, axes, WIDTH, WIDTH).
        counts: (k,).
        layout: (axes, inputs, unknowns): inputs of an axis as combinations of unknowns.
        total: sum of the batches, if known.
        weight: (axes,) to start from; a step or two then follow.
        min_rows: fewer say nothing.

    Returns:
        Unknowns, their covariance, corrected for coloured residuals, and the axes' weights.
    """
    rows = int(counts.sum())
    if rows < min_rows:
        return None
    if total is None:
        total = batches.sum(axis=0)
    axes, inputs, unknowns = layout.shape
    turned = np.swapaxes(layout, 1, 2)
    normals = turned @ total[:, :inputs, :inputs] @ layout
    rights = (turned @ total[:, :inputs, 3:])[:, :, 0]
    powers = total[:, 3, 3]
    floor = np.maximum(1e-12 * powers / rows, 1e-300)
    flat = normals.reshape(axes, -1)
    ridge = 1e-12 * np.eye(unknowns)
    estimate = np.zeros(unknowns)
    limit, enough = (_MAX_ITERATIONS, 1e-11) if weight is None else (_WARM_ITERATIONS, 1e-6)
    if weight is None:
        weight = np.ones(axes)
    for _ in range(limit):
        normal = (weight @ flat).reshape(unknowns, unknowns)
        d = np.sqrt(np.maximum(np.diagonal(normal), 1e-300))
        updated = np.linalg.solve(normal / (d[:, None] * d) + ridge, weight @ rights / d) / d
        done = (np.abs(updated - estimate) <= enough * np.abs(updated)).all()
        estimate = updated
        variance = (powers - (2.0 * rights - normals @ estimate) @ estimate) / rows
        weight = 1.0 / np.maximum(variance, floor)
        if done:
            break
    made = np.ones((axes, inputs + 1, 1))
    made[:, :inputs, 0] = -layout @ estimate
    residual = (batches[:, :, :inputs] @ made).reshape(len(batches), -1)
    scores = residual @ (weight[:, None, None] * layout).reshape(axes * inputs, unknowns)
    # The weights are in their final state only now.
    normal = (weight @ flat).reshape(unknowns, unknowns)
    scale = d[:, None] * d
    bread = np.linalg.inv(normal / scale + ridge)
    return estimate, sandwich(bread, scores / d) / scale, weight
