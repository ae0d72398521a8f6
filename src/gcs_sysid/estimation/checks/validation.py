"""Does a fit predict held-out data?

The parameters are fitted on the first part of the flight and predict the angular acceleration of
the rest. Both parts are sums of moments, so no sample is needed again.

**Whiteness.** Neighboring rows share samples, so their residuals are colored by the window
itself, and a test of the rows for whiteness would always fail. What can be tested is whether the
residual has the color that white noise on the sensors gets from the filters: white gyro noise is
differentiated by the window, white noise of the rotor speeds is averaged. Two filters on the same
residual decide: the rows as they are, and their leaky sums, which weigh low frequencies more. Given
the residual's power in the one, white sensor noise fixes its power in the other. Both are in the
moments already.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from gcs_sysid.arrays import Array, by_parts
from gcs_sysid.estimation.fit.priors import Prior
from gcs_sysid.estimation.fit.problem import N_X, axis_power, residual_maker
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.window_fit import fit_rotation
from gcs_sysid.estimation.rows.actuator_dynamics import ActuatorDynamics

FITTED_SHARE = 0.6
"""Share of the flight that is fitted; the rest is predicted."""
_MIN_BATCHES = 6


@dataclass(frozen=True)
class Validation:
    """How well the first part of a flight predicts the rest, per axis.

    Attributes:
        r_squared: (3,) share of the angular acceleration's power that is predicted.
        theil: (3,) Theil's inequality coefficient, rms error over the sum of the rms values of
            measured and predicted: 0 is perfect, 1 is worthless.
        fitted_share: share of the rows that were fitted.
        whiteness: (3,) power of the residual's leaky sums over what white sensor noise would
            give them, on the rows that were not fitted. 1: white; above: slow disturbances
            (wind, drifting parameters); below: fast ones (vibration, an oscillation above
            about 3 Hz). NaN where no second leak is carried.
        whiteness_p: (3,) two-sided probability of a whiteness so far from 1 if the noise is
            white, from its scatter over the batches: below 0.05 one doubts it.
        theta: (N_THETA,) fitted on the first part.
        coordinates: (3,) rotor delay (s), motor lag (s) and thrust curve, of the same fit.
    """

    r_squared: Array
    theil: Array
    fitted_share: float
    whiteness: Array
    whiteness_p: Array
    theta: Array
    coordinates: Array


def validate(
    batches: Array,
    counts: NDArray[np.int64],
    basis: ActuatorDynamics,
    noise: Array,
    gains: Array,
    prior: Prior | None = None,
) -> Validation | None:
    """Fit the first batches, predict the others.

    Args:
        batches: (k, leaks, width, width), as of `fit_rotation`; the prediction is judged
            on the first leak.
        counts: (k,) rows in each.
        basis: of the elements.
        noise: of the inputs, as of `fit_rotation`.
        gains: (leaks,) 1/s^2, variance of a row's derivative over that of white gyro noise.
        prior: what else is known.

    Returns:
        None while the flight is too short to be divided.
    """
    cut = validation_cut(len(counts))
    if cut is None:
        return None
    fit = fit_rotation(batches[:cut], counts[:cut], basis, noise, prior=prior)
    if fit is None:
        return None
    rest = basis.moments_at(batches[cut:, 0].sum(axis=0), fit.coordinates)
    Q = fit.Q
    return judge_prediction(
        rest, fit, float(counts[:cut].sum() / counts.sum()),
        *_whiteness(batches[cut:], counts[cut:], basis, noise, gains, fit.coordinates, Q),
    )  # fmt: skip


def validation_cut(batches: int) -> int | None:
    """How many of the first batches are fitted; None while a flight is too short to be divided."""
    return None if batches < _MIN_BATCHES else round(FITTED_SHARE * batches)


def judge_prediction(
    rest: Array, fit: RotationFit, fitted_share: float, whiteness: Array, whiteness_p: Array
) -> Validation:
    """Hold a fit against what it has not seen.

    Args:
        rest: (WIDTH, WIDTH) moments of rows [x, y] that were not fitted, at its coordinates; or
            (3, WIDTH, WIDTH) where each axis has its own.
        fit: to the others.
        fitted_share: of the rows.
        whiteness: (3,) of what it leaves.
        whiteness_p: (3,) its p-value.
    """
    Q = fit.Q
    each = np.broadcast_to(rest, (3, *rest.shape[-2:]))
    axes = np.arange(3)
    measured = each[axes, N_X + axes, N_X + axes]
    predicted = np.einsum("ai,aij,aj->a", Q, each[:, :N_X, :N_X], Q)
    shared = np.einsum("ai,ai->a", Q, each[axes, :N_X, N_X + axes])
    error = np.maximum(measured - 2.0 * shared + predicted, 0.0)
    tiny = 1e-300
    return Validation(
        r_squared=1.0 - error / np.maximum(measured, tiny),
        theil=np.sqrt(error) / np.maximum(np.sqrt(measured) + np.sqrt(predicted), tiny),
        fitted_share=fitted_share,
        whiteness=whiteness,
        whiteness_p=whiteness_p,
        theta=fit.theta,
        coordinates=fit.coordinates,
    )


def _whiteness(
    batches: Array,
    counts: NDArray[np.int64],
    basis: ActuatorDynamics,
    noise: Array,
    gains: Array,
    at: Array,
    Q: Array,
) -> tuple[Array, Array]:
    """Whiteness and its p-value, per axis, from the first two leaks: none, and a short one."""
    if len(gains) < 2:
        return np.full(3, np.nan), np.full(3, np.nan)
    T = residual_maker(Q)
    TP = T @ basis.map_at(at)

    # (k, 3) of residuals
    plain, summed = (
        by_parts(lambda some: axis_power(TP, some), batches[:, leak : leak + 1]) for leak in (0, 1)
    )
    of_speeds = axis_power(T, basis.noise_at(noise[:2], at)[:, None])
    ratio = gains[1] / gains[0]
    # Of the plain power, what the speeds' noise does not explain is the gyro's.
    expected = ratio * plain + counts[:, None] * (of_speeds[1] - ratio * of_speeds[0])
    return whiteness_of(summed, expected, counts)


def whiteness_of(summed: Array, expected: Array, counts: NDArray[np.int64]) -> tuple[Array, Array]:
    """Whiteness and its p-value, per axis, from batches of residual power.

    Args:
        summed: (k, 3) of what weighs low frequencies most.
        expected: (k, 3) of the same, if the noise is white.
        counts: (k,) rows in each batch.
    """
    surplus = summed - expected
    total = surplus.sum(axis=0)
    apart = surplus - counts[:, None] * (total / counts.sum())
    k = len(counts)
    # Leaky sums reach over the ends of batches: neighbors count, as in the sandwich.
    lagged = (apart[1:] * apart[:-1]).sum(axis=0)
    variance = np.maximum((apart * apart).sum(axis=0) + lagged, 1e-300) * k / (k - 1)
    freedom = (k - 1) / 1.5
    whiteness = summed.sum(axis=0) / np.maximum(expected.sum(axis=0), 1e-300)
    p: Array = 2.0 * stdtr(freedom, -np.abs(total) / np.sqrt(variance))
    return whiteness, p
