"""The gyro against the attitude that the autopilot reports.

Over some tenths of a second the attitude turns by the rotation vector phi, and the gyro integrates
to theta. Where both measure the same body,

    theta = G phi + b dt + tau (omega_1 - omega_0),

with G the identity, b the bias and tau by how much the attitude is late. A gyro in another unit or
of another scale, a turned board, a dead or exchanged axis shows in G. Terms of second order in the
turn are left out, with turns above half a radian.

Both sides are noisy: the autopilot corrects its attitude on the way, and a slow gyro misses turns.
Regressed one way a scale comes out too small, by the share R^2 that the fit explains at most.
"""

import math
from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array, Mask, complete_rows
from gcs_sysid.model import attitude


@dataclass(frozen=True)
class GyroCheckRules:
    """Settings of the comparison.

    Attributes:
        interval: s, long against the attitude's lag, short against a turn.
        largest_turn: rad in an interval.
        fewest: intervals, some six for each of the seven unknowns of an axis.
        most: intervals that are kept, 40 minutes.
        least_share: explained, below which noise hides everything.
        noisy: share of noise in an attitude's turns, known to some 0.2, up to which they are
            turns.
    """

    interval: float = 0.3
    largest_turn: float = 0.5
    fewest: int = 40
    most: int = 8192
    least_share: float = 0.05
    noisy: float = 0.25


RULES = GyroCheckRules()


@dataclass(frozen=True)
class GyroAgainstAttitude:
    """What the gyro reads of what the attitude turns.

    Attributes:
        gain: (3, 3) G.
        std: (3, 3) its standard deviation, half of what noise of the attitude may hide included.
        bias: (3,) rad/s that the gyro reads too much.
        turned: (3,) rms, rad, of what the attitude turned in an interval; 0 where its noise may
            make most of that.
        seconds: of flight that were compared.
    """

    gain: Array
    std: Array
    bias: Array
    turned: Array
    seconds: float


class GyroCheck:
    """Collects intervals of flight, block by block; how samples are grouped does not matter."""

    def __init__(self) -> None:
        self._number = -1
        self._run = 0
        self._last = False
        self._angle = np.zeros(3)
        self._ends: list[Array] = []
        self._before: tuple[float, Array] | None = None
        self._found: tuple[int, GyroAgainstAttitude | None] = 0, None

    def update(self, t: Array, gyro: Array, reported: Array, *, fresh: bool = False) -> None:
        """Take a block.

        Args:
            t: (n,) s.
            gyro: (n, 3) rad/s as measured; NaN where it does not fly or was not read.
            reported: (n, 4) attitude (w, x, y, z).
            fresh: whether a gap lies before it.
        """
        there = complete_rows(gyro) & complete_rows(reported)
        if fresh:
            self._last = False
        joined = there & np.append(self._last, there[:-1])
        first = gyro[:1] if self._before is None else self._before[1][None]
        start = t[0] if self._before is None else self._before[0]
        rates = np.vstack([first, gyro])
        steps = 0.5 * (rates[1:] + rates[:-1]) * np.diff(t, prepend=start)[:, None]
        angle = self._angle + np.cumsum(np.where(joined[:, None], steps, 0.0), axis=0)
        run = self._run + np.cumsum(~joined)
        number = np.floor(t / RULES.interval).astype(np.int64)
        ends = there & (np.diff(number, prepend=self._number) != 0)
        if ends.any() and len(self._ends) < RULES.most:
            columns = (t, run, angle, reported, gyro)
            self._ends += list(np.column_stack(columns)[ends])
        self._number, self._run, self._angle = int(number[-1]), int(run[-1]), angle[-1]
        self._last, self._before = bool(there[-1]), (float(t[-1]), gyro[-1].copy())

    def result(self) -> GyroAgainstAttitude | None:
        """What was found; None while there is too little to compare.

        It is renewed each time there is a fifth more, so that asking often costs little.
        """
        count = 2 * RULES.fewest
        if len(self._ends) < count:
            return None
        while (more := math.ceil(1.2 * count)) <= len(self._ends):
            count = more
        if count != self._found[0]:
            self._found = count, _compared(np.array(self._ends[:count]))
        return self._found[1]


def _compared(ends: Array) -> GyroAgainstAttitude | None:
    """From the (n, 12) ends of intervals: time, run, angle, attitude and rate."""
    t, run, angle, q, rate = np.split(ends, [1, 2, 5, 9], axis=1)
    same = (run[1:] == run[:-1])[:, 0] & (np.diff(t[:, 0]) < 2.0 * RULES.interval)
    dt = np.diff(t, axis=0)[same]
    phi = attitude.to_rotation_vector(attitude.multiply(attitude.conjugate(q[:-1]), q[1:]))[same]
    theta, change = np.diff(angle, axis=0)[same], np.diff(rate, axis=0)[same]
    small: Mask = np.linalg.norm(phi, axis=1) < RULES.largest_turn
    columns = np.column_stack([phi, dt, change])[small]
    phi, theta = phi[small], theta[small]
    if len(phi) < RULES.fewest:
        return None
    fits = [_robust(columns, theta[:, axis]) for axis in range(3)]
    explained = np.array([[max(share, RULES.least_share)] for *_, share in fits])
    gain = np.array([value[:3] for value, *_ in fits])
    std = np.sqrt([np.diag(covariance)[:3] for _, covariance, _ in fits])
    half = 0.5 * gain * (1.0 / explained - 1.0)
    gain, std = gain + half, np.hypot(std, half)
    bias = np.array([value[3] for value, *_ in fits])
    turned = np.where(_noise_share(phi) < RULES.noisy, np.sqrt((phi**2).mean(axis=0)), 0.0)
    return GyroAgainstAttitude(gain, std, bias, turned, float(dt[small].sum()))


def _noise_share(phi: Array) -> Array:
    """(3,) share of the variance of (n, 3) turns that noise of the attitude makes.

    Differences of white noise that follow each other are correlated by -1/2.
    """
    following = (phi[1:] * phi[:-1]).mean(axis=0)
    return -2.0 * following / ((phi**2).mean(axis=0) + math.ulp(1.0))


def _robust(columns: Array, y: Array) -> tuple[Array, Array, float]:
    """(k,) Cauchy-weighted least squares, (k, k) its sandwich covariance, explained share."""
    weights = np.ones(len(y))
    ridge = 1e-9 * np.diag((columns**2).sum(axis=0) + math.ulp(1.0))
    for _ in range(10):
        weighted = columns.T * weights
        inverse = np.linalg.inv(weighted @ columns + ridge)
        value = inverse @ (weighted @ y)
        residual = y - columns @ value
        scale = 2.0 * 1.4826 * float(np.median(np.abs(residual))) + 1e-9
        weights = 1.0 / (1.0 + (residual / scale) ** 2)
    scores = columns * (weights * residual)[:, None]
    share = 1.0 - float(weights @ residual**2) / (float(weights @ y**2) + math.ulp(1.0))
    return value, inverse @ (scores.T @ scores) @ inverse, share
