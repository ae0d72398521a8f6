"""What lags behind commands, as a hypothesis of a fit to rows of the window."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.whitened_fit import WhitenedFit
from gcs_sysid.estimation.rows.actuator_dynamics import ActuatorDynamics, LagPlace


def fit_lag_places(
    fitted: Callable[[RotationFit | None], WhitenedFit | None],
    basis: ActuatorDynamics,
    places: Sequence[LagPlace],
    independent: float,
) -> WhitenedFit | None:
    """The fit with the likeliest place of the lag; the others widen it.

    By what the others differ from it, it may be off with their probability (Hoeting et al. (1999),
    Bayesian model averaging: a tutorial, Statistical Science 14, 382-417).

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
    cost = np.array([fit.cost for fit, _ in found])
    weight = np.exp(-independent * (cost - cost.min()))
    best, basis.lag_place = found[int(np.argmin(cost))]
    rotation = best.rotation
    away = np.stack([fit.rotation.unknowns - rotation.unknowns for fit, _ in found])
    doubt = (away * (weight / weight.sum())[:, None]).T @ away
    rotation = replace(rotation.widened(doubt), lag_place=basis.lag_place, lag_doubt=doubt)
    return replace(best, rotation=rotation)
