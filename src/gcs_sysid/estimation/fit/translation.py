"""Thrust over mass, and drag over mass, from momentum balance or from the accelerometer.

Momentum balance in world axes, averaged with the same window on both sides:

    v' - g z = -kappa (R z) sum O - delta (v - wind),    kappa = k_T / m, delta = D / m

Gravity is the reference: over a flight the mean vertical acceleration is nearly nothing, so
kappa does not suffer from an accelerometer's bias. Where the vehicle sends no velocity, the
accelerometer itself serves as second source:

    f_z = -kappa sum O + x (r p - q') + y (q r + p') - z (p^2 + q^2) + bias

with (x, y, z) from the CG to where it is believed to be to where it is. Both are then unknowns,
observable as far as thrust varies otherwise than the squares of the rates do.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit.solver import scales
from gcs_sysid.estimation.noise.uncertainty import slow_inflation, symmetric_roots
from gcs_sysid.model.parameters import GRAVITY

WIDTH = 4
"""Width of a row [thrust direction times sum O, velocity, 1, output], one for each axis."""

ACCELEROMETER_BIAS_STD = 0.2
"""m/s^2, what a MEMS accelerometer's bias may be in flight: temperature, and a level calibration of
a degree or two."""

CALM, _LIFT = 0.8, 0.25
"""m/s^2, and a share. Wind lifts rotors, which looks like a larger kappa: by 2 to 10 % where it
pushes with 1.7 to 3.4 m/s^2. Flights without wind read up to 0.4."""
TILT_ERROR_SHARE = 5e-4
"""Relative error of kappa that attitude errors of 0.03 rad rms leave: 1 - mean cosine. The most
that is allowed for; the horizontal axes may show that it is less."""

GAIN_DRIFT = 5e-4
"""Relative change of the gain that half an hour of temperature may bring, or thrust (5 mm/s^2 of
bias)."""

_MIN_ROWS = 50
_MIN_CALIBRATED_ROWS = 12
_FOLLOWS = 0.4
"""Correlation with thrust of the force that a fit to variations of thrust leaves, where nothing
shows the velocity. Aerobatic flights of three vehicles, emulated, have 0.33 to 0.46 by drag alone,
and none without drag; noise of the rotor speeds is in what is left as well."""
_MIN_BATCHES_FOR_BIAS = 10
"""Fewer do not determine the error of the bias itself."""
_TINY = 1e-300
_ROWS_IN_WINDOW = 9.0
"""That share its noise."""


@dataclass(frozen=True)
class AccelerometerGain:
    """Of the accelerometer against momentum balance, with its relative standard deviation."""

    value: float
    share: float


@dataclass(frozen=True)
class MomentumStart:
    """Warm start for a later fit of the same, longer record.

    Attributes:
        weights: (axes,) inverse residual variances.
        scores: (k, unknowns) of batches, see `uncertainty.slow_inflation`.
    """

    weights: Array
    scores: Array


@dataclass(frozen=True)
class TranslationFit:
    """Thrust and drag over mass.

    Attributes:
        kappa: k_T / m in N s^2/kg; T_max / m in N/kg with commands.
        kappa_std: its standard deviation.
        delta: D / m in 1/s; NaN when the source is the accelerometer.
        delta_std: its standard deviation.
        source: what they rest on.
        warm start: what `follow_momentum` starts from.
    """

    kappa: float
    kappa_std: float
    delta: float
    delta_std: float
    source: Literal["momentum", "accelerometer"]
    warm_start: MomentumStart | None = None
    curve_slope: float = 0.0
    """Change of kappa with the thrust curve, where that is estimated."""
    quickness: float = 0.0
    """1/s^2, square of horizontal acceleration over that of velocity. An attitude that is late by
    tau turns thrust by what the vehicle turns in that time, along the change of acceleration, which
    is against the velocity: it looks like a delta of tau times this."""
    wind: float = 0.0
    """m/s^2, steady horizontal acceleration that thrust and drag leave: drag by wind, mostly."""
    unbiased: float = np.nan
    """Of the accelerometer: kappa as if it had no bias, to which an `AccelerometerGain` applies."""


def fit_momentum(
    batches: Array,
    counts: NDArray[np.int64],
    total: Array | None = None,
    before: MomentumStart | None = None,
) -> TranslationFit | None:
    """Fit the momentum balance.

    Args:
        batches: (k, 3, WIDTH, WIDTH) moments of north, east and down rows.
        counts: (k,) rows in each.
        total: their sum, if known.
        before: of an earlier segment. The autopilot's velocity errs as slowly as it did there,
            which the first batches of the next cannot show.

    Returns:
        The fit, or None with too few rows.
    """
    rows = int(counts.sum())
    if rows < _MIN_ROWS:
        return None
    total = batches.sum(axis=0) if total is None else total
    balance = _Balance(total[None], np.array([rows]), _MOMENTUM)
    balance.converge()
    scores = balance.scores(batches)
    return _momentum(balance, scores if before is None else np.vstack((before.scores, scores)))[0]


def follow_momentum(totals: Array, rows: Array, start: TranslationFit) -> list[TranslationFit]:
    """Follow a growing record from an earlier fit; how far its score scatters is taken over.

    Args:
        totals: (K, 3, WIDTH, WIDTH) moments of all rows at K instants.
        rows: (K,) in them.
        start: a fit of the same record when it was shorter.

    Returns:
        K fits.
    """
    assert start.warm_start is not None
    balance = _Balance(totals, rows, _MOMENTUM)
    balance.step(start.warm_start.weights)
    return _momentum(balance, start.warm_start.scores)


def _momentum(balance: "_Balance", scores: Array) -> list[TranslationFit]:
    variance = np.diagonal(balance.covariance(slow_inflation(scores)), axis1=1, axis2=2)
    kappas, deltas = -balance.estimate[:, 0], -balance.estimate[:, 1]
    wind = np.hypot(balance.estimate[:, 3], balance.estimate[:, 4])
    by_wind = np.where(wind > CALM, _LIFT * wind / GRAVITY, 0.0)
    shares = np.hypot(_tilt_shares(balance), by_wind)
    kappa_stds = np.hypot(np.sqrt(variance[:, 0]), shares * kappas)
    delta_stds = np.sqrt(variance[:, 1])
    return [
        TranslationFit(
            float(kappas[i]),
            float(kappa_stds[i]),
            float(deltas[i]),
            float(delta_stds[i]),
            "momentum",
            MomentumStart(weights, scores),
            quickness=float(balance.quickness[i]),
            wind=float(wind[i]),
        )
        for i, weights in enumerate(balance.weights)
    ]


def _tilt_shares(balance: "_Balance") -> Array:
    """(K,) relative errors of kappa that attitude errors leave.

    They turn gravity into horizontal acceleration that nothing accounts for. What the horizontal
    axes leave with the vertical one's thrust and without wind is the most that they can be.
    """
    estimate = balance.estimate.copy()
    estimate[:, 2], estimate[:, 3:] = estimate[:, 0], 0.0
    sideways = balance.mean_squares(estimate)[:, :2].sum(axis=1) / GRAVITY**2
    return np.minimum(0.5 * sideways, TILT_ERROR_SHARE)


def accelerometer_gain(
    momentum: TranslationFit | None, accelerometer: TranslationFit | None
) -> AccelerometerGain | None:
    """How the accelerometer's kappa must be scaled to agree with momentum balance.

    In flight both sides of its bias, b and the mean specific force g, stay the same when the mass
    changes, so one gain holds before and after.
    """
    if momentum is None or accelerometer is None or momentum.source != "momentum":
        return None
    return AccelerometerGain(
        momentum.kappa / accelerometer.unbiased,
        float(np.hypot(momentum.kappa_std / momentum.kappa, GAIN_DRIFT)),
    )


def fit_accelerometer(
    batches: Array,
    counts: NDArray[np.int64],
    gain: AccelerometerGain | None = None,
    place: float = 0.0,
) -> TranslationFit | None:
    """Fit thrust over mass to the accelerometer's z axis alone.

    Args:
        batches: (k, 6, 6) moments of rows [sum O, what a place in x, y and z adds, 1, output].
        counts: (k,) rows in each.
        gain: of this accelerometer against momentum balance, where that is known.
        place: m, standard deviation of each coordinate of where it is; 0: as it is believed.
    """
    rows = int(counts.sum())
    if rows < (_MIN_ROWS if gain is None else _MIN_CALIBRATED_ROWS):
        return None
    total = batches.sum(axis=0)
    balance = _Balance(total[None, None], np.array([rows]), _VERTICAL)
    balance.converge()
    kappa = -float(balance.estimate[0, 0])
    # A window's worth of neighboring rows counts once: early on there are no batches to show it.
    least = 1.0 if gain is None else _ROWS_IN_WINDOW
    inflated = slow_inflation(balance.scores(batches[:, None]), least)
    std = float(np.sqrt(balance.covariance(inflated)[0, 0, 0]))
    if gain is not None:
        share = float(np.hypot(std / abs(kappa), gain.share))
        scaled = kappa * gain.value
        return TranslationFit(
            scaled, share * abs(scaled), np.nan, np.nan, "accelerometer", unbiased=kappa
        )
    usual = np.array([place, place, place, ACCELEROMETER_BIAS_STD])
    added = usual * total[0, 1:-1] / max(float(total[0, 0]), _TINY)
    best = kappa, float(np.hypot(std, np.linalg.norm(added)))
    if len(batches) >= _MIN_BATCHES_FOR_BIAS:
        best = _with_bias(batches, rows, total, usual)
    return TranslationFit(*best, np.nan, np.nan, "accelerometer", unbiased=kappa)


def _with_bias(batches: Array, rows: int, total: Array, usual: Array) -> tuple[float, float]:
    """Kappa and its standard deviation with place and bias as unknowns, of (4,) usual sizes.

    These are weighed against the information that the scatter of the scores leaves: overlapping
    rows overstate what the data know.
    """
    unknown = np.append(True, usual > 0.0)
    balance = _Balance(total[None, None], np.array([rows]), _BIASED[..., unknown])
    balance.converge()
    information = balance.information(slow_inflation(balance.scores(batches[:, None])))[0]
    # What else pushes as thrust varies, drag or a bias that vibration shifts, tilts the line of
    # specific force over thrust about its middle.
    mean, output = total[[0, -1], -2] / rows
    left = balance.mean_squares(balance.estimate).item()
    pushes = float(np.hypot(GAIN_DRIFT * GRAVITY, _FOLLOWS * np.sqrt(left)))
    apart = pushes / np.sqrt(max(float(total[-1, -1]) / rows - output**2, _TINY))
    apart = min(apart, 1.0)  # a slope that is off by all of itself is not known
    tilted = np.zeros(len(information))
    tilted[0], tilted[-1] = (apart * float(balance.estimate[0, 0])) * np.array([1.0, -mean])
    moved = information @ tilted
    information = information - np.outer(moved, moved) / (1.0 + tilted @ moved)
    units = np.append(1.0 / np.sqrt(information[0, 0]), usual)[unknown]
    known = information * np.outer(units, units) + np.diag([0.0, *np.ones(len(units) - 1)])
    value = np.linalg.solve(known, units * (information @ balance.estimate[0]))
    std = units[0] * np.sqrt(np.linalg.inv(known)[0, 0])
    return -units[0] * float(value[0]), float(std)


def _layouts() -> tuple[Array, Array, Array]:
    """Of momentum balance, of the accelerometer's z axis, and of that with place and bias."""
    # Unknowns: -kappa, -delta, -kappa of the horizontal axes, wind north, wind east. Wind is a
    # nuisance (a vertical one would be taken for thrust). So is horizontal thrust: the vertical
    # axis depends on gravity, the horizontal ones on tilt alone, and the lag between velocity and
    # attitude makes them low by a few percent.
    momentum = np.zeros((3, 3, 5))
    momentum[2, 0, 0] = 1.0
    momentum[:, 1, 1] = 1.0
    momentum[:2, 0, 2] = 1.0
    momentum[0, 2, 3] = momentum[1, 2, 4] = 1.0
    # Unknowns: -kappa; then place and bias.
    biased = np.eye(5)[None]
    return momentum, biased[..., :1], biased


_MOMENTUM, _VERTICAL, _BIASED = _layouts()


class _Balance:
    """Least squares over several axes that share unknowns, weighted by each axis' residual.

    Args:
        totals: (K, axes, WIDTH, WIDTH) moments of all rows, at K instants.
        rows: (K,) in them.
        layout: (axes, inputs, unknowns): inputs of an axis as combinations of unknowns.

    Attributes:
        estimate: (K, unknowns) after a step.
        weights: (K, axes) that follow from its residuals.
        quickness: (K,) 1/s^2, see `TranslationFit`.
    """

    def __init__(self, totals: Array, rows: Array, layout: Array) -> None:
        self._layout, self._rows = layout, rows[:, None]
        axes, inputs, unknowns = layout.shape
        turned = np.swapaxes(layout, 1, 2)
        self._normals = turned @ totals[..., :inputs, :inputs] @ layout
        self._rights = (turned @ totals[..., :inputs, inputs:])[..., 0]
        self._powers = totals[..., -1, -1]
        horizontal = totals[:, :2].sum(axis=1)
        self.quickness = horizontal[:, -1, -1] / np.maximum(horizontal[:, 1, 1], _TINY)
        self._floor = np.maximum(1e-12 * self._powers / self._rows, 1e-300)
        self.estimate = np.zeros((len(totals), unknowns))
        self.weights = np.ones((len(totals), axes))

    def step(self, weights: Array) -> None:
        """Solve with (K, axes) weights, or (axes,) for all."""
        weights = weights[..., None]
        normal = (weights[..., None] * self._normals).sum(axis=1)
        right = (weights * self._rights).sum(axis=1)
        d = scales(normal)
        scaled = normal / (d[:, :, None] * d[:, None, :]) + 1e-12 * np.eye(d.shape[1])
        self.estimate = np.linalg.solve(scaled, (right / d)[..., None])[..., 0] / d
        self.weights = 1.0 / np.maximum(self.mean_squares(self.estimate), self._floor)

    def mean_squares(self, estimate: Array) -> Array:
        """(K, axes) of the residuals that (K, unknowns) leave."""
        fitted = (self._normals @ estimate[:, None, :, None])[..., 0]
        explained = ((2.0 * self._rights - fitted) * estimate[:, None]).sum(axis=2)
        return (self._powers - explained) / self._rows

    def converge(self) -> None:
        """Step until the weights are those of the residuals."""
        for _ in range(20):
            before = self.estimate
            self.step(self.weights)
            if (np.abs(self.estimate - before) <= 1e-11 * np.abs(self.estimate)).all():
                break

    def scores(self, batches: Array) -> Array:
        """(k, unknowns) of batches, of unit covariance where residuals are white.

        Args:
            batches: (k, axes, WIDTH, WIDTH) of the only instant.
        """
        axes, inputs, unknowns = self._layout.shape
        made = np.ones((axes, inputs + 1, 1))
        made[:, :inputs, 0] = -self._layout @ self.estimate[0]
        residual = (batches[:, :, :inputs] @ made).reshape(len(batches), -1)
        weighted = self.weights[0, :, None, None] * self._layout
        scores = residual @ weighted.reshape(axes * inputs, unknowns)
        d, (_, inverse_root) = self._roots()
        return np.sqrt(len(batches)) * (scores / d[0]) @ inverse_root[0]

    def covariance(self, inflated: Array) -> Array:
        """(K, unknowns, unknowns), given that inflation."""
        d, (_, inverse_root) = self._roots()
        scaled = inverse_root @ inflated @ inverse_root
        return scaled / (d[:, :, None] * d[:, None, :])

    def information(self, inflated: Array) -> Array:
        """(K, unknowns, unknowns) likewise, the inverse: zero of what has no effect."""
        d, (root, _) = self._roots()
        scaled = root @ np.linalg.inv(inflated) @ root
        return scaled * (d[:, :, None] * d[:, None, :])

    def _roots(self) -> tuple[Array, tuple[Array, Array]]:
        """(K, unknowns) scales, and roots of the scaled information and of its inverse."""
        normal = (self.weights[..., None, None] * self._normals).sum(axis=1)
        d = scales(normal)
        return d, symmetric_roots(normal / (d[:, :, None] * d[:, None, :]))
