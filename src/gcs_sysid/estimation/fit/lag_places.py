"""What lags behind commands: hypotheses of a fit, and the doubt that the others leave."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.whitened_fit import WhitenedFit
from gcs_sysid.estimation.rows.actuator_dynamics import ActuatorDynamics, LagPlace


def fit_lag_places(
    fitted: Callable[[RotationFit | None], WhitenedFit | None],
    basis: ActuatorDynamics,
    places: Sequence[LagPlace],
    independent: float,
) -> WhitenedFit | None:
    """The fit to rows of the window with the likeliest place of the lag; the others widen it.

    Args:
        fitted: fits with the place that the basis has; from the first one's fit, or None.
        basis: of the elements; is left with the place that is taken.
        places: hypotheses.
        independent: how many rows there would be, did windows not overlap.
    """
    found: list[tuple[WhitenedFit, LagPlace]] = []
    for basis.lag_place in places:
        fit = fitted(found[0][0].rotation if found else None)
        if fit is not None:
            found.append((fit, basis.lag_place))
        elif not found:
            return None
    best, basis.lag_place = min(found, key=lambda pair: pair[0].cost)
    rotation = best.rotation
    costs = [independent * fit.cost for fit, _ in found]
    doubt = rivals_doubt([fit.rotation for fit, _ in found], costs)
    rotation = replace(rotation.widened(doubt), lag_place=basis.lag_place, lag_doubt=doubt)
    return replace(best, rotation=rotation)


def rivals_doubt(fits: Sequence[RotationFit], costs: Sequence[float]) -> Array:
    """(N_UNKNOWNS, N_UNKNOWNS) covariance of the likeliest fit's error by the others' likelihood.

    By what the others differ from it, it may be off with their probability (Hoeting et al. (1999),
    Bayesian model averaging: a tutorial, Statistical Science 14, 382-417).

    Args:
        fits: one for each place of the lag.
        costs: nats, of each.
    """
    less = np.min(costs) - np.asarray(costs)
    weight = np.exp(less) / np.exp(less).sum()
    unknowns = np.stack([fit.unknowns for fit in fits])
    away = unknowns - unknowns[int(np.argmin(costs))]
    doubt: Array = (away * weight[:, None]).T @ away
    return doubt
