"""Prediction of held-out stretches of a flight from fits to the rest, by whitened rows."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.arrays import Array, Mask, by_parts
from gcs_sysid.estimation.checks.validation import Validation, judge_prediction, whiteness_of
from gcs_sysid.estimation.fit.deviations import DeviationChoice
from gcs_sysid.estimation.fit.priors import Prior
from gcs_sysid.estimation.fit.problem import axis_power, residual_maker
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.shocks import find_shocks
from gcs_sysid.estimation.fit.whitened_fit import fit_whitened
from gcs_sysid.estimation.noise.whitened_moments import WhitenedMoments, grouped
from gcs_sysid.estimation.noise.whitening import slower
from gcs_sysid.estimation.rows.actuator_dynamics import ActuatorDynamics

_FREQUENCIES = 4096
SHORTEST_VALIDATED = 4.0
"""s of flight."""
_HELD_OUT = 1.0
"""s: of five such stretches, two are predicted from the others."""


def predict_held_out(
    data: WhitenedMoments,
    basis: ActuatorDynamics,
    choice: DeviationChoice | None,
    prior: Prior | None,
    start: RotationFit | None = None,
) -> Validation | None:
    """Fit parts of a flight, predict the rest; whiteness of innovations.

    Where the likeliest whiteners are known, the flight is over, and every fifth of it is
    predicted from the other four.

    Args:
        data: moments.
        basis: of the elements.
        choice: of deviations from the model.
        prior: what else is known.
        start: of the fits; None: from the data alone.
    """
    ends = np.cumsum(data.counts) * data.time
    if not len(ends) or ends[-1] < SHORTEST_VALIDATED:
        return None
    # Held out now and then: maneuvers come one after the other, and a part must have its own.
    # By how much it has moved: a flight may turn for a second and hover for the rest.
    stretch = (ends[-1] * np.cumsum(data.motion) - 1e-9) // _HELD_OUT % 5
    folds = [(i,) for i in range(5)] if data.judges else [(1, 3)]
    found = [
        fold
        for held_out in folds
        if (fold := _predicted(data, basis, choice, np.isin(stretch, held_out), prior, start))
    ]
    if not found:
        return None
    whiteness = whiteness_of(
        *(np.concatenate(part) for part in zip(*(f.power for f in found), strict=True))
    )
    if len(found) == 1:
        return replace(found[0].validation, whiteness=whiteness[0], whiteness_p=whiteness[1])
    measured = np.stack([fold.measured for fold in found])
    share = measured / np.maximum(measured.sum(axis=0), 1e-300)
    return replace(
        found[-1].validation,
        r_squared=(share * [fold.validation.r_squared for fold in found]).sum(axis=0),
        theil=(share * [fold.validation.theil for fold in found]).sum(axis=0),
        whiteness=whiteness[0],
        whiteness_p=whiteness[1],
    )


@dataclass(frozen=True)
class _Fold:
    """A held-out part of a flight, predicted.

    Attributes:
        validation: of it, without whiteness.
        measured: (3,) power of its acceleration.
        power: for its whiteness, see `whiteness_of`.
    """

    validation: Validation
    measured: Array
    power: tuple[Array, Array, NDArray[np.int64]]


def _predicted(
    data: WhitenedMoments,
    basis: ActuatorDynamics,
    choice: DeviationChoice | None,
    held_out: Mask,
    prior: Prior | None,
    start: RotationFit | None,
) -> _Fold | None:
    """A part of the flight, predicted by a fit to the others."""
    if held_out.all():
        return None
    found = fit_whitened(data, basis, start, prior, choice=choice, only=~held_out)
    if found is None:
        return None
    fit = found.rotation
    own = data.of_axes([data.whiteners.index(whitener) for whitener in fit.whiteners])
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
    share = 1.0 - float(data.counts[held_out].sum() / data.counts.sum())
    nothing = np.full(3, np.nan)
    axes = np.arange(3)
    return _Fold(
        judge_prediction(rest, fit, share, nothing, nothing),
        rest[axes, axes - 3, axes - 3],
        _slow_power(data, basis, kept, fit),
    )


def _slow_power(
    data: WhitenedMoments, basis: ActuatorDynamics, kept: Mask, fit: RotationFit
) -> tuple[Array, Array, NDArray[np.int64]]:
    """Of the innovations that were not fitted, as `whiteness_of` takes it.

    Were they white, another whitener would make of them

        sigma_b^2 = sigma_a^2 mean over omega of |W_b / W_a|^2 ,

    with W_b one for which what is slow counts more.
    """
    own_places = [data.whiteners.index(whitener) for whitener in fit.whiteners]
    references = [slower(data.whiteners, i) for i in own_places]
    TP = residual_maker(fit.Q) @ basis.map_at(fit.coordinates)
    omega = np.pi * (np.arange(_FREQUENCIES) + 0.5) / _FREQUENCIES
    ratio = np.array(
        [
            np.mean(data.whiteners[b].power(omega) / data.whiteners[a].power(omega))
            for a, b in zip(own_places, references, strict=True)
        ]
    )
    powers = []
    for pick in (own_places, references):
        batches, counts = data.of_axes(pick)[kept], data.counts[kept]
        batches, counts = grouped(batches, counts, data.grouped)
        powers.append(by_parts(lambda some: axis_power(TP, some), batches))
    own, slow = powers
    return slow, ratio * own, counts
