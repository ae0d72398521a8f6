"""Does a fit predict held-out data?

The parameters are fitted on a part of the flight and predict the angular acceleration of stretches
in between. Both parts are sums of moments, so no sample is needed again.

**Whiteness.** What is left may be noise, or what the model lacks. Two filters on the same residual
decide: the whitener that was fitted with, and one for which what is slow counts more. Given the
residual's power in the one, noise fixes its power in the other. Neighboring rows of the window
share samples: their residual is to have the color that white gyro noise gets from it.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from gcs_sysid.arrays import Array, Mask, by_parts, runs
from gcs_sysid.estimation.fit.deviations import DeviationChoice
from gcs_sysid.estimation.fit.priors import Prior
from gcs_sysid.estimation.fit.problem import N_X, axis_power, own_power, residual_maker
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.whitened_fit import find_shocks, fit_whitened
from gcs_sysid.estimation.noise.whitening import WhitenedMoments, joined, slower
from gcs_sysid.estimation.rows.actuator_dynamics import ActuatorDynamics

_FREQUENCIES = 4096
SHORTEST_VALIDATED = 4.0
"""s of flight."""
_HELD_OUT = 1.0
"""s: of five such stretches, two are predicted from the others."""


@dataclass(frozen=True)
class Validation:
    """How well a part of a flight predicts the rest, per axis.

    Attributes:
        r_squared: (3,) share of the angular acceleration's power that is predicted.
        theil: (3,) Theil's inequality coefficient, rms error over the sum of the rms values of
            measured and predicted: 0 is perfect, 1 is worthless.
        held_out: (n, 2) stretches that were not fitted, from and to, as shares of the rows.
        whiteness: (3,) power of the residual's leaky sums over what white sensor noise would
            give them, on the rows that were not fitted. 1: white; above: slow disturbances
            (wind, drifting parameters); below: fast ones (vibration, an oscillation above
            about 3 Hz). NaN where there is no second leak.
        whiteness_p: (3,) two-sided probability of a whiteness so far from 1 if the noise is
            white, from its scatter over the batches: below 0.05 one doubts it.
        Q: (3, N_SIGNALS) of w' = Q x, fitted to the others.
        coordinates: (3,) rotor delay (s), motor lag (s) and thrust curve, of the same fit.
    """

    r_squared: Array
    theil: Array
    held_out: Array
    whiteness: Array
    whiteness_p: Array
    Q: Array
    coordinates: Array

    @property
    def fitted_share(self) -> float:
        """Share of the rows that were fitted."""
        return 1.0 - float(np.diff(self.held_out).sum())


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
    variance = np.maximum((apart * apart).sum(axis=0) + lagged, 1e-300) * k / max(k - 1, 1)
    freedom = (k - 1) / 1.5  # of one batch none: p is NaN
    whiteness = summed.sum(axis=0) / np.maximum(expected.sum(axis=0), 1e-300)
    p: Array = 2.0 * stdtr(freedom, -np.abs(total) / np.sqrt(variance))
    return whiteness, p


def predict_held_out(
    data: WhitenedMoments,
    basis: ActuatorDynamics,
    choice: DeviationChoice | None,
    prior: Prior | None,
    whole: RotationFit,
) -> Validation | None:
    """Fit parts of a flight, predict the rest; whiteness of innovations.

    Where the likeliest whiteners are known, the flight is over, and every fifth of it is
    predicted from the other four.

    Args:
        data: moments.
        basis: of the elements.
        choice: of deviations from the model.
        prior: what else is known.
        whole: the fit to all of it, near which those to parts are searched.
    """
    ends = np.cumsum(data.counts) * data.time
    if not len(ends) or ends[-1] < SHORTEST_VALIDATED:
        return None
    # Held out now and then: maneuvers come one after the other, and a part must have its own.
    folds = [(i,) for i in range(5)] if data.is_whole else [(1, 3)]
    found: list[_Fold] = []
    # By how much it has moved: a flight may turn for a second and hover for the rest. By time,
    # where nearly all of that was a crash; by commands that spoils the thrust curve unseen.
    for passed in (np.cumsum(data.motion), *([] if basis.motors else [ends / ends[-1]])):
        stretch = (ends[-1] * passed - 1e-9) // _HELD_OUT % 5
        masks = [np.isin(stretch, held_out) for held_out in folds]
        found = found or [
            fold for mask in masks if (fold := _predicted(data, basis, choice, mask, prior, whole))
        ]
    if not found:
        return None
    whiteness = whiteness_of(
        *(np.concatenate(part) for part in zip(*(f.power for f in found), strict=True))
    )
    measured = np.stack([fold.measured for fold in found])
    share, last = measured / np.maximum(measured.sum(axis=0), 1e-300), found[-1]
    return Validation(
        (share * [fold.r_squared for fold in found]).sum(axis=0),
        (share * [fold.theil for fold in found]).sum(axis=0),
        last.held_out,
        *whiteness,
        last.fit.Q,
        last.fit.coordinates,
    )


@dataclass(frozen=True)
class _Fold:
    """A held-out part of a flight, predicted.

    Attributes:
        rest: (1 or 3, WIDTH, WIDTH) moments of its rows [x, y], as each axis has them, at the
            coordinates of
        fit: to the others.
        held_out: (n, 2) as of `Validation`.
        power: for its whiteness, see `whiteness_of`.
    """

    rest: Array
    fit: RotationFit
    held_out: Array
    power: tuple[Array, Array, NDArray[np.int64]]

    @cached_property
    def measured(self) -> Array:
        """(3,) power of the acceleration measured."""
        return own_power(self.rest)

    @cached_property
    def _predicted(self) -> tuple[Array, Array]:
        """(3,) power of that predicted, and of what it is off by."""
        Q, axes = self.fit.Q, np.arange(3)
        each = np.broadcast_to(self.rest, (3, *self.rest.shape[-2:]))
        predicted = np.einsum("ai,aij,aj->a", Q, each[:, :N_X, :N_X], Q)
        shared = np.einsum("ai,ai->a", Q, each[axes, :N_X, N_X + axes])
        return predicted, np.maximum(self.measured - 2.0 * shared + predicted, 0.0)

    @property
    def r_squared(self) -> Array:
        """(3,) as of `Validation`."""
        return 1.0 - self._predicted[1] / np.maximum(self.measured, 1e-300)

    @property
    def theil(self) -> Array:
        """(3,) likewise."""
        predicted, error = self._predicted
        both = np.sqrt(self.measured) + np.sqrt(predicted)
        return np.sqrt(error) / np.maximum(both, 1e-300)


def _predicted(
    data: WhitenedMoments,
    basis: ActuatorDynamics,
    choice: DeviationChoice | None,
    held_out: Mask,
    prior: Prior | None,
    whole: RotationFit,
) -> _Fold | None:
    """A part of the flight, predicted by a fit to the others."""
    if held_out.all():
        return None
    found = fit_whitened(data, basis, whole, prior, choice=choice, only=~held_out)
    if found is None:
        return None
    fit = found.rotation
    own = data.of_axes(data.places(fit.whiteners))
    P = basis.map_at(fit.coordinates)
    # Collisions and landings are not predicted by anybody.
    shocks = find_shocks(
        residual_maker(fit.Q) @ P, np.diag(fit.residual_covariance), own, data.counts
    )
    kept = held_out & ~shocks
    if not kept.any():
        return None
    batches = data.of_axes(data.judges) if data.judges else own
    rest = P @ batches[kept].sum(axis=0) @ P.T
    ends = np.append(0, np.cumsum(data.counts)) / data.counts.sum()
    spans = np.array([ends[[run.start, run.stop]] for run, out in runs(held_out) if out])
    return _Fold(rest, fit, spans, _slow_power(data, basis, kept, fit))


def _slow_power(
    data: WhitenedMoments, basis: ActuatorDynamics, kept: Mask, fit: RotationFit
) -> tuple[Array, Array, NDArray[np.int64]]:
    """Of the innovations that were not fitted, as `whiteness_of` takes it.

    Were they white, another whitener would make of them

        sigma_b^2 = sigma_a^2 mean over omega of |W_b / W_a|^2 ,

    with W_b one for which what is slow counts more. NaN where there is none.
    """
    # How white is what a fit leaves; of the window's rows not by how it weighed them.
    own_places = data.places(fit.whiteners) if data.of_steps else list(data.judges)
    references = [slower(data.whiteners, i) for i in own_places]
    TP = residual_maker(fit.Q) @ basis.map_at(fit.coordinates)
    omega = np.pi * (np.arange(_FREQUENCIES) + 0.5) / _FREQUENCIES
    if data.gains is not None:
        ratio = data.gains[references] / data.gains[own_places]
        ratio[np.array(references) == own_places] = np.nan
    else:
        ratio = np.array(
            [
                np.mean(data.whiteners[b].power(omega) / data.whiteners[a].power(omega))
                for a, b in zip(own_places, references, strict=True)
            ]
        )
    counts = data.counts[kept]
    own, slow = (
        joined(
            by_parts(lambda some: axis_power(TP, some), data.of_axes(pick))[kept],
            counts,
            data.grouped,
        )
        for pick in (own_places, references)
    )
    counts = joined(counts, counts, data.grouped)
    expected = ratio * own
    if data.gains is not None:
        # What the speeds' noise does not explain is the gyro's.
        known, known_slow = (axis_power(TP, data.noise[pick]) for pick in (own_places, references))
        expected = expected + counts[:, None] * (known_slow - ratio * known)
    return slow, expected, counts
