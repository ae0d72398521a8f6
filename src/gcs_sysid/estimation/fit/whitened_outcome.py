"""From the solution of an axis problem to an estimate with its covariance."""

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.arrays import Array, by_parts
from gcs_sysid.estimation.fit.axis_problem import AxisPoint, AxisProblem
from gcs_sysid.estimation.fit.rotation import Outcome
from gcs_sysid.estimation.fit.search import N_X, residual_maker

_AXES = 3


class WhitenedOutcome(Outcome):
    """What follows from points near the solutions of K hypotheses."""

    def __init__(self, problem: AxisProblem, point: AxisPoint) -> None:
        super().__init__(problem, point, np.zeros(0))  # type: ignore[arg-type]
        self._at = point

    @property
    def pull(self) -> Array:
        """(K, p) zeros: the known noise is taken out of the problem already."""
        return np.zeros_like(self._scale)

    def _explained(self) -> Array:
        """(K, 3) share of each axis' whitened acceleration that the model explains."""
        problem, axes = self._problem, np.arange(_AXES)
        places = problem.bank.shape[-1] - _AXES + axes
        all_ = problem.bank[:, axes, places, places] / problem.rows[:, None]
        share: Array = 1.0 - self._at.variance / np.maximum(all_, 1e-300)
        return share

    def scores(self, i: int, batches: Array, counts: NDArray[np.int64]) -> Array:
        """(k, p) scaled downhill gradient of half the cost, batch by batch.

        Args:
            i: of the hypothesis.
            batches: (k, 3, width, width) without the known noise.
            counts: (k,) rows in each.
        """
        f, point = len(self._problem.basis.free), self._at
        P = self._problem.maps(self._unknowns[i : i + 1])[0]
        TP = residual_maker(point.Q[i]) @ P
        WG = point.WG[i].reshape(self._linear, -1)
        slopes = (TP[1:] / point.variance[i][:, None]).reshape(f, -1)

        def some(batches: Array) -> Array:
            k = len(batches)
            TPM = (TP[0][:, None] @ batches)[:, :, 0]
            of_theta = (TPM @ P[0, :N_X].T).reshape(k, -1) @ WG.T
            return np.column_stack([of_theta, -TPM.reshape(k, -1) @ slopes.T])

        scores = by_parts(some, batches)
        # Away from the solution, as where a prior pulls, all batches pull one way: no scatter.
        scores -= np.outer(counts / counts.sum(), scores.sum(axis=0))
        scaled: Array = scores / self._scale[i]
        return scaled

    def shares(self, i: int, batches: Array) -> Array:
        """(k, p) what each batch is expected to add to the variance of each unknown.

        Args:
            i: of the hypothesis.
            batches: (k, 3, width, width) of this hypothesis.
        """
        n, inverse_root, point = self._linear, self.roots[1][i], self._at
        P = self._problem.maps(self._unknowns[i : i + 1])[0]
        inverse = (inverse_root @ inverse_root) / self._scales[i]
        moved = (inverse[:n, :n] @ point.WG[i].reshape(n, -1)).reshape(n, _AXES, N_X)
        weighted = moved * point.variance[i][:, None]
        # (3 N_X N_X, n): of each axis the outer product of what a parameter does to its Q.
        powers = (moved[..., None] * weighted[..., None, :]).reshape(n, -1).T
        X, TP = P[0, :N_X], residual_maker(point.Q[i]) @ P[1:]
        weights = 1.0 / point.variance[i]

        def some(batches: Array) -> Array:
            of_theta = (X @ batches @ X.T).reshape(len(batches), -1) @ powers
            bends = [
                (((row[:, None] @ batches)[:, :, 0] * row).sum(axis=-1) * weights).sum(axis=-1)
                for row in TP
            ]
            return np.column_stack([of_theta, *bends])

        return by_parts(some, batches)
