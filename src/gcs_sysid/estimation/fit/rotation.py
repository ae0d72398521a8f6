"""Estimates of the rotational parameters, with their uncertainty."""

import math
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit.deviations import NO_DEVIATIONS, Deviations
from gcs_sysid.estimation.fit.priors import COORDINATES, N_UNKNOWNS
from gcs_sysid.estimation.noise.whitening import Whitener
from gcs_sysid.estimation.rows.actuator_dynamics import Coordinate, LagPlace
from gcs_sysid.model import rigid_body as rb

_IMITATED = math.radians(0.3)
"""rad, such a turn: rotorpy's vehicles, whose IMU is not turned at all, are read as if it were by
0.1 to 1 degree, where noise alone would leave 0.1."""


@dataclass(frozen=True)
class RotationStart:
    """Warm start for a later fit of the same, longer record.

    Attributes:
        unknowns: (N_UNKNOWNS,) at the minimum of the cost.
        inflation: (p, p) of the covariance, see `uncertainty.inflation`.
        widening: (p,) of the standard deviations, see `uncertainty.student_factor`.
    """

    unknowns: Array
    inflation: Array
    widening: Array


@dataclass(frozen=True)
class RotationFit:
    """Rotational parameters relative to k_T, with their uncertainty.

    Attributes:
        theta: (N_THETA,) estimate, see `rigid_body.THETA`.
        covariance: (N_THETA, N_THETA), corrected for colored residuals, delay included, and
            widened so that 1.96 standard deviations are Student's 95 % interval.
        residual_covariance: (3, 3) of one row's residual.
        r_squared: (3,) share of each axis' angular acceleration that the model explains.
        rows: number of rows fitted.
        converged: whether the minimizer was reached.
        coordinates: (N_COORDINATES,) rotor delay (s), motor lag (s), thrust curve, and nuisances of
            the lag, see `estimation.rows.actuator_dynamics`.
        whiteners: of each axis; empty of the article's.
        of_steps: whether rows are of one step, so that much of them is noise; else of the window.
        disturbance: (3,) nats a second by which an unmodeled moment explains an axis better than
            sensor noise alone, see `BankTrial.detected`; NaN where rows are the window's.
        data_std: (N_THETA,) standard deviations without the prior: huge where the flight alone does
            not determine a parameter.
        by_prior: (N_THETA, N_THETA) derivatives of the estimate by the prior's means.
        full_covariance: (N_UNKNOWNS, N_UNKNOWNS) of theta and the coordinates; zeros where one
            was not estimated.
        warm start: what `follow_rotation` starts from.
        deviations: (m,) values of those that were fitted, see `estimation.fit.deviations`.
        extended_covariance: (N_UNKNOWNS + m, N_UNKNOWNS + m) with theirs.
        deviating: which these are.
        ages: (rotors,) s by which the readings of each are older than the mean of all, beyond
            chance; empty where that was not asked.
        lag_place: what was taken to lag, of commands; None where nothing does.
        lag_doubt: (N_UNKNOWNS, N_UNKNOWNS) part of the covariance that stems from not knowing that;
            empty where there is none.
    """

    theta: Array
    covariance: Array
    residual_covariance: Array
    r_squared: Array
    rows: int
    converged: bool
    coordinates: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0, 0.0, 0.0]))
    data_std: Array = field(default_factory=lambda: np.empty(0))
    by_prior: Array = field(default_factory=lambda: np.zeros((rb.N_THETA, rb.N_THETA)))
    full_covariance: Array = field(default_factory=lambda: np.empty((0, 0)))
    warm_start: RotationStart | None = None
    whiteners: tuple[Whitener, ...] = ()
    of_steps: bool = False
    disturbance: Array = field(default_factory=lambda: np.full(3, np.nan))
    deviations: Array = field(default_factory=lambda: np.zeros(0))
    extended_covariance: Array = field(default_factory=lambda: np.empty((0, 0)))
    deviating: Deviations = NO_DEVIATIONS
    ages: Array = field(default_factory=lambda: np.empty(0))
    lag_place: LagPlace | None = None
    lag_doubt: Array = field(default_factory=lambda: np.empty((0, 0)))

    def __post_init__(self) -> None:
        if not self.data_std.size:
            object.__setattr__(self, "data_std", self.std)
        if not self.full_covariance.size:
            full = np.zeros((N_UNKNOWNS, N_UNKNOWNS))
            full[: rb.N_THETA, : rb.N_THETA] = self.covariance
            object.__setattr__(self, "full_covariance", full)
        if not self.extended_covariance.size:
            object.__setattr__(self, "extended_covariance", self.full_covariance)

    @property
    def Q(self) -> Array:
        """(3, N_SIGNALS) of w' = Q x as read, deviations included."""
        return self.deviating.forward(self.theta, self.deviations)

    @property
    def std(self) -> Array:
        """(N_THETA,) standard deviations."""
        return standard_deviations(np.diag(self.covariance))

    @property
    def deviations_covariance(self) -> Array:
        """(m, m) of the deviations."""
        return self.extended_covariance[N_UNKNOWNS:, N_UNKNOWNS:]

    def widened(self, doubt: Array) -> Self:
        """The same with an error that the scatter of the data does not show.

        Args:
            doubt: (k, k) its covariance, of the first k of theta, the coordinates and deviations.
        """
        n, k = rb.N_THETA, len(doubt)
        extended, full = self.extended_covariance.copy(), self.full_covariance.copy()
        extended[:k, :k] += doubt
        full[:k, :k] += doubt[:N_UNKNOWNS, :N_UNKNOWNS]
        return replace(
            self,
            covariance=self.covariance + doubt[:n, :n],
            full_covariance=full,
            extended_covariance=extended,
            data_std=np.hypot(self.data_std, np.sqrt(np.diag(doubt)[:n])),
        )

    def imitated_turns(self, colored: float = 0.0) -> Array:
        """(k, N_UNKNOWNS + m) errors by what looks like a turn of the IMU and is none.

        Air in motion does, and what rows of the window leave out.

        Args:
            colored: by how much a turn's standard deviation is too small: where rows scatter more
                than noise does, more looks like a turn. 0: in calm air.
        """
        turns, errors = self.deviating.turns, []
        for k, turn in enumerate(np.abs(turns).max(axis=1, initial=0.0)):
            if turn:
                own = self.extended_covariance[N_UNKNOWNS + k, N_UNKNOWNS + k]
                air = colored * (_IMITATED / turn) ** 2
                off = math.sqrt(air + max(colored**2 - 1.0, 0.0) * own)
                errors.append(along(self.extended_covariance, N_UNKNOWNS + k, off))
        return np.array(errors).reshape(-1, len(self.extended_covariance))

    @property
    def unknowns(self) -> Array:
        """(N_UNKNOWNS,) theta and the coordinates."""
        return np.concatenate([self.theta, self.coordinates])

    @property
    def coordinates_std(self) -> Array:
        """(N_COORDINATES,) standard deviations; zero where one was not estimated."""
        return np.sqrt(np.diag(self.full_covariance))[COORDINATES]

    @property
    def delay(self) -> float:
        """s, of the rotor stream behind the IMU stream."""
        return float(self.coordinates[Coordinate.DELAY])

    @property
    def delay_std(self) -> float:
        """s; zero where the delay was not estimated."""
        return float(self.coordinates_std[Coordinate.DELAY])


def standard_deviations(variances: Array) -> Array:
    """Square roots; without limit where less noise than there is left negative information."""
    return np.sqrt(np.where(variances >= 0.0, variances, np.inf))


def along(covariance: Array, place: int, off: float) -> Array:
    """(N,) what all unknowns err by where one of them is off by so much; zeros where it is given.

    Args:
        covariance: (N, N).
        place: of that one.
        off: in its units.
    """
    own = covariance[place, place]
    if not own > 0.0:
        return np.zeros(len(covariance))
    return covariance[:, place] / own * off
