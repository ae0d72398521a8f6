"""The article's own identification, as printed and in its usual corrections, for study.

Gyro -> tracking differentiator -> direct-form recursive least squares, joint or stepwise. Kept
to measure what the forward form gains; not what the program uses by default. Its third row has
zero on the right-hand side, so noise in the derivative pulls Izz, Iyz, Ixz and k_M to zero.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from gcs_sysid.arrays import Array, complete_rows, runs
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.signals.records import Samples
from gcs_sysid.signals.smoothers import ARTICLE_A, ARTICLE_B, ARTICLE_R, nonlinear_differentiator

Method = Literal["article", "article-usual-td", "article-stepwise", "central-difference"]

N_DIRECT = 9
"""Unknowns of the direct form: inertia, CG, k_M / k_T."""
_MODE_SECONDS = 20.0
_USUAL_R = 20.0
_IXX, _IYY, _IZZ, _IXY, _IYZ, _IXZ, _CGX, _CGY, _KM = range(N_DIRECT)
STEPS = (
    (0, (_IXX, _IXY, _CGX, _CGY)),
    (1, (_IYY,)),
    (2, (_IYZ, _IXZ)),
    (1, (_KM,)),
    (2, (_IZZ,)),
)
"""The article's order: which mode of flight serves which parameters."""


class BlockRls:
    """Recursive least squares with several equations at once.

    The printed gain, P phi' / (1 + phi P phi'), is for one scalar equation; with three rows
    phi the 1 becomes the identity and the division a matrix inverse.

    Args:
        unknowns: number of parameters.
        prior: initial variance of each.
    """

    def __init__(self, unknowns: int, prior: float = 1e6) -> None:
        self.theta = np.zeros(unknowns)
        self.P = prior * np.eye(unknowns)

    def update(self, phi: Array, y: Array) -> None:
        """Take one set of rows: phi (rows, unknowns), y (rows,)."""
        PhiT = self.P @ phi.T
        gain = PhiT @ np.linalg.inv(np.eye(len(y)) + phi @ PhiT)
        self.theta = self.theta + gain @ (y - phi @ self.theta)
        P = self.P - gain @ PhiT.T
        self.P = 0.5 * (P + P.T)


@dataclass
class _Mode:
    """Normal equations of one mode of flight."""

    normal: Array
    right: Array


class ArticleEstimator:
    """The article's chain with the interface of the online estimator's rotational part.

    Args:
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
        method: which variant.
    """

    def __init__(self, geometry: Array, dt: float, method: Method) -> None:
        self._geometry = geometry
        self._dt = dt
        self._method = method
        self._rls = BlockRls(N_DIRECT)
        self._modes = [_Mode(np.zeros((N_DIRECT, N_DIRECT)), np.zeros(N_DIRECT)) for _ in range(3)]
        self._last: tuple[Array, tuple[Array, Array]] | None = None
        self._held: tuple[Array, Array] | None = None
        self._samples = 0

    def restart(self) -> None:
        """A gap: the differentiator is reset."""
        self._last = None
        self._held = None

    def update(self, samples: Samples) -> None:
        """Take a block of samples; a missing one ends a run."""
        for run, there in runs(complete_rows(samples.gyro) & complete_rows(samples.speeds)):
            if there:
                self._add_run(*self._differentiate(samples.gyro[run], samples.speeds[run]))
            else:
                self.restart()

    def _add_run(self, gyro: Array, speeds: Array, accelerations: Array) -> None:
        rotors, _ = rb.rotor_signals(self._geometry, speeds)
        phi, y = rb.direct_rows(gyro, accelerations, rotors)
        for k in range(len(gyro)):
            self._rls.update(phi[k], y[k])
            mode = self._modes[min(int(self._samples * self._dt / _MODE_SECONDS), 2)]
            mode.normal += phi[k].T @ phi[k]
            mode.right += phi[k].T @ y[k]
            self._samples += 1

    @property
    def seconds(self) -> float:
        """Flight time used."""
        return self._samples * self._dt

    def fit(self) -> RotationFit | None:
        """The estimate; its covariance is what the article's algorithm claims.

        No share of explained motion is claimed, so every status is at best unobservable.
        """
        if self._samples < N_DIRECT:
            return None
        theta = np.zeros(rb.N_THETA)
        stepwise = self._method == "article-stepwise"
        theta[:N_DIRECT] = self._stepwise() if stepwise else self._rls.theta
        covariance = np.zeros((rb.N_THETA, rb.N_THETA))
        # Where the differentiator diverges, rounding can make the claimed variances negative.
        covariance[:N_DIRECT, :N_DIRECT] = np.diag(np.maximum(np.diag(self._rls.P), 0.0))
        return RotationFit(
            theta, covariance, np.full((3, 3), np.nan), np.zeros(3), self._samples, True
        )

    def _differentiate(self, gyro: Array, speeds: Array) -> tuple[Array, Array, Array]:
        """Samples with their accelerations; central differences come one sample late."""
        if self._method == "central-difference":
            if self._held is not None:
                gyro = np.vstack([self._held[0], gyro])
                speeds = np.vstack([self._held[1], speeds])
            self._held = gyro[-2:], speeds[-2:]
            return gyro[1:-1], speeds[1:-1], (gyro[2:] - gyro[:-2]) / (2.0 * self._dt)
        before = self._last
        v = gyro if before is None else np.vstack([before[0], gyro])
        usual = self._method == "article-usual-td"
        z1, z2 = nonlinear_differentiator(
            v,
            self._dt,
            R=_USUAL_R if usual else ARTICLE_R,
            a=ARTICLE_A,
            b=ARTICLE_B,
            form="usual" if usual else "printed",
            start=None if before is None else before[1],
        )
        self._last = (gyro[-1], (z1[-1], z2[-1]))
        return gyro, speeds, z2 if before is None else z2[1:]

    def _stepwise(self) -> Array:
        """Solve for a few parameters at a time, the others held at what is known so far."""
        theta = np.zeros(N_DIRECT)
        for mode, wanted in STEPS:
            normal, right = self._modes[mode].normal, self._modes[mode].right
            w = list(wanted)
            theta[w] = 0.0
            known = right[w] - normal[w] @ theta
            theta[w] = np.linalg.lstsq(normal[np.ix_(w, w)], known, rcond=None)[0]
        return theta
