"""How far the thrust curve of disturbed flights scatters from one stretch of it to another.

Curve, lag and T_max are found from what thrust does to second order. So do vertical speed under
inflow and commands that the stream does not show, in some maneuvers more than in others: in one
flight of an outside simulator the curve was right, 0.56, until yaw was flown, and 0.40 from then
on, with an interval of 0.06. Batches of a second, which maneuvers have alike, do not show that;
fits without one third of the flight each do (delete-a-group jackknife: Kott 2001, Journal of
Official Statistics 17, 521-526).
"""

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit.axis_problem import AxisProblem, minimize_axes
from gcs_sysid.estimation.fit.priors import Unknown
from gcs_sysid.estimation.fit.rotation import RotationFit

_STRETCHES = 3
"""A minute has about as many kinds of maneuver."""
_STEPS = 10


def curve_scatter(
    problem: AxisProblem, fit: RotationFit, batches: Array, counts: NDArray[np.int64]
) -> Array:
    """(p,) what all that is fitted errs by with the curve, beyond the fit's own interval.

    Args:
        problem: that was solved.
        fit: its solution.
        batches: (k, 3, width, width) moments, in time order, with its whiteners.
        counts: (k,) rows in each.
    """
    nothing = np.zeros(problem.p)
    if Unknown.CURVE not in problem.free or len(counts) < _STRETCHES:
        return nothing
    own = fit.extended_covariance[np.ix_(problem.free, problem.free)]
    at = int(np.flatnonzero(problem.free == Unknown.CURVE)[0])
    if not own[at, at] > 0.0:
        return nothing
    ends = np.cumsum(counts)
    stretch = np.minimum((ends - 1) * _STRETCHES // ends[-1], _STRETCHES - 1)
    without = [stretch != i for i in range(_STRETCHES)]
    others = AxisProblem(
        np.stack([batches[kept].sum(axis=0) for kept in without]),
        np.array([counts[kept].sum() for kept in without]),
        problem.basis,
        problem.prior,
        np.zeros((1, *batches.shape[1:])),
        problem.deviations,
    )
    unknowns = np.concatenate([fit.unknowns, fit.deviations])
    point, _ = minimize_axes(others, np.tile(unknowns, (_STRETCHES, 1)), _STEPS)
    curves = point.unknowns[:, Unknown.CURVE]
    variance = (_STRETCHES - 1) * float(curves.var()) - own[at, at]
    along: Array = own[:, at] / own[at, at] * np.sqrt(max(variance, 0.0))
    return along
