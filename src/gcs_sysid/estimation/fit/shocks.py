"""Batches that hold a collision or a bump in the air.

That is no stationary noise of any kind: batches of a quarter of a second whose innovations are far
stronger than the median, and more than the rotors explain of their motion, are left out.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.arrays import Array, Mask, by_parts
from gcs_sysid.estimation.fit.priors import COORDINATES
from gcs_sysid.estimation.fit.problem import axis_power, residual_maker
from gcs_sysid.estimation.fit.solver import minimize
from gcs_sysid.estimation.fit.whitener_choice import TRY, BankProblem
from gcs_sysid.estimation.noise.whitening import WhitenedMoments
from gcs_sysid.estimation.rows.actuator_dynamics import ActuatorDynamics
from gcs_sysid.model import rigid_body as rb

SHOCK = 6.0
"""Times the median power of innovations, from which a batch is left out."""
_OWN = 0.5
"""Share of a batch's motion that the fit does not explain, up to which it is no shock."""
_AXES = np.arange(3)
_MOST_SHOCKS = 0.25
"""Share of the batches; what happens more often is no shock."""
_JUDGED_ALIKE = 12
"""Times that batches are judged by the whiteners found before, 5 s each: a bump shows with any of
them."""
_JUDGES = 3
"""Iterations of a fit that judges, from the one before: the strongest are 6 times the median."""
_CALM, _ALIKE = 2.5, (0.5, 1.5)
"""Times their median, up to which innovations under the fit before hold no shock, and times what it
left, between which that median shows that the fit still holds: another one would move neither to
where shocks begin. Most of a flight is so, and need not be fitted in order to be judged."""


def innovation_maker(Q: Array, basis: ActuatorDynamics, coordinates: Array) -> Array:
    """(3, width) what makes innovations of rows of elements, at a fit's Q and coordinates."""
    TP: Array = residual_maker(Q) @ basis.map_at(coordinates)
    return TP


def find_shocks(TP: Array, variance: Array, batches: Array, counts: NDArray[np.int64]) -> Mask:
    """(k,) which batches' innovations are far stronger than the median.

    Args:
        TP: (3, width) what makes innovations of rows of elements, by a fit.
        variance: (3,) of them.
        batches: (k, 3, width, width) with its whiteners.
        counts: (k,) rows in each.
    """
    relative = _relative(TP, variance, batches, counts)
    motion = (batches[:, _AXES, _AXES - 3, _AXES - 3] / counts[:, None] / variance).mean(axis=1)
    # What rotors explain for the most part, they did: most of a flight may be far calmer.
    shocks: Mask = relative > np.maximum(SHOCK * np.median(relative), _OWN * motion)
    return shocks if shocks.mean() <= _MOST_SHOCKS else np.zeros(len(counts), dtype=bool)


def _relative(TP: Array, variance: Array, batches: Array, counts: NDArray[np.int64]) -> Array:
    """(k,) power of innovations over their variance, mean of the axes."""
    power = by_parts(lambda some: axis_power(TP, some), batches)
    relative: Array = (power / counts[:, None] / variance).mean(axis=1)
    return relative


@dataclass(frozen=True)
class ShockReference:
    """Where the fit starts by which the next batches are judged.

    Attributes:
        unknowns: (N_UNKNOWNS,) fitted to those before.
        pick: whitener of each axis.
        variance: (3,) power of the innovations of that fit.
        age: how many times others were judged by these whiteners.
    """

    unknowns: Array
    pick: tuple[int, ...]
    variance: Array
    age: int = 0

    def innovation_maker(self, basis: ActuatorDynamics) -> Array:
        """(3, width) what makes its innovations of rows of elements."""
        Q = rb.forward_matrix(self.unknowns[: rb.N_THETA])
        return innovation_maker(Q, basis, self.unknowns[COORDINATES])

    def is_calm(self, data: WhitenedMoments, basis: ActuatorDynamics) -> bool:
        """Whether it shows, without another fit, that no batch holds a shock."""
        relative = _relative(
            self.innovation_maker(basis), self.variance, data.of_axes(self.pick), data.counts
        )
        middle = float(np.median(relative))
        return _ALIKE[0] < middle < _ALIKE[1] and bool(relative.max() <= _CALM * middle)


def shocks_in(
    data: WhitenedMoments,
    basis: ActuatorDynamics,
    start: ShockReference | None,
    *,
    quick: bool = False,
) -> tuple[Mask, ShockReference | None]:
    """(k,) which batches are to be left out, by a fit to these batches alone, where one is needed.

    Args:
        data: the batches.
        basis: of the elements.
        start: what the batches before were judged by; None: these are the first.
        quick: whether that fit will do where it shows that nothing is near a shock.

    Returns:
        The mask, and what the next ones are judged by.
    """
    none = np.zeros(len(data.counts), dtype=bool)
    before = start if start is not None and start.age < _JUDGED_ALIKE else None
    if before is not None and quick and before.is_calm(data, basis):
        return none, replace(before, age=before.age + 1)
    bank = BankProblem(data, basis)
    age, limit = 0, TRY
    if before is not None:
        pick, unknowns, age, limit = before.pick, before.unknowns[None], before.age + 1, _JUDGES
    else:
        trial = bank.scanned() if start is None else bank.tried(start.unknowns)
        if trial is None:
            return none, None
        pick = trial.pick
        unknowns = trial.unknowns[list(pick)[:1]]
    point, _ = minimize(bank.axes(pick), unknowns, limit)
    found = ShockReference(point.unknowns[0], pick, point.variance[0], age)
    TP = found.innovation_maker(basis)
    return find_shocks(TP, found.variance, data.of_axes(pick), data.counts), found
