"""Squared errors of the attitude filters and differentiators on the emulator's flight, by seed.

`measure` takes many seeds side by side; `filter_claims` makes tables of what it returns.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.model import attitude
from gcs_sysid.signals.complementary import ComplementaryFilter, complementary
from gcs_sysid.signals.differentiator import (
    ARTICLE_R,
    DEFAULT_BANDWIDTH,
    LinearDifferentiator,
    backward_difference,
    central_difference,
    nonlinear_differentiator,
)
from gcs_sysid.signals.smoothers import DAMPING, cosine_window
from sim_bridge.ensemble import Flight
from sim_bridge.missions import PAPER
from testbed.article_flights import PHYSICS_RATE, fly

SIGMA = 0.02
START, END = PAPER.lead, PAPER.duration - 0.5
"""s. What counts: the excited part. The filters start with the record, in the hover before."""
SETTLED = 20.0
"""s, from where on the bias is known well."""
AT_ONCE = 50
"""Seeds that are filtered together, side by side."""
FEW = 20
"""Of these at 250 Hz, where a record is a dozen times as long."""
TUNING_SEEDS = (100001, 100002)
"""On which the best R is chosen."""
ARTICLE_K_P = 5.0
GAINS = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 1.0, 1.4, 2.0, 3.0, 5.0, 8.0)
"""k_p tried, 1/s."""
SPEEDS = (15.0, 20.0, 30.0, 40.0, 60.0, 80.0, 120.0, 160.0, 240.0, 320.0, 480.0)
"""R tried for the nonlinear differentiator, rad/s."""
DIVERGED = 10.0
"""Errors above this multiple of the derivative itself are called divergence."""


@dataclass(frozen=True)
class Case:
    """One column.

    Attributes:
        rate: Hz.
        noise: model of `sim_bridge.sensors`.
    """

    rate: int
    noise: str

    def __str__(self) -> str:
        words = {"paper": "article's noise", "white": "white", "mems": "MEMS"}
        return f"{self.rate} Hz, {words[self.noise]}"


CASES = (
    Case(20, "paper"),
    Case(20, "white"),
    Case(250, "paper"),
    Case(250, "white"),
    Case(250, "mems"),
)


def physics() -> Flight:
    """The article's flight at every step of the physics, without noise."""
    return fly("paper", PHYSICS_RATE)


@cache
def acceleration() -> Array:
    """(K, 3) true angular acceleration on the grid of `physics`, rad/s^2."""
    derivative: Array = np.gradient(physics().gyro[0], physics().interval, axis=0)
    return derivative


def clean(rate: int) -> Flight:
    """Every so many-th sample of it."""
    step = round(1000 / rate)
    fields = {n: v[::step] if n == "t" else v[:, ::step] for n, v in vars(physics()).items()}
    return replace(physics(), **fields)


def noisy(case: Case, seeds: Sequence[int]) -> Flight:
    """The flight as sensors with noise see it."""
    return clean(case.rate).repeated(len(seeds)).with_noise(case.noise, SIGMA, seeds)


def counts(t: Array) -> Mask:
    """Instants that count."""
    return (t >= START) & (t <= END)


# Attitude


def euler_rates(gyro: Array, angles: Array) -> Array:
    """Derivatives of roll, pitch and yaw from body rates and measured angles."""
    p, q, r = np.moveaxis(gyro, -1, 0)
    roll, pitch = angles[..., 0], angles[..., 1]
    turn = q * np.sin(roll) + r * np.cos(roll)
    return np.stack(
        [
            p + np.tan(pitch) * turn,
            q * np.cos(roll) - r * np.sin(roll),
            turn / np.cos(pitch),
        ],
        axis=-1,
    )


def turned_away(q: Array, truth: Array) -> float:
    """Sum of the squared angles between two courses of attitude, rad^2."""
    between = attitude.multiply(q, attitude.conjugate(truth))
    return float(np.sum(attitude.to_rotation_vector(between) ** 2))


def attitude_squares(flights: Flight) -> dict[str, Any]:
    """Squared errors of the attitude, summed over the seeds.

    Returns:
        "raw": of the measured angles; "formula": of the article's filter at each of `GAINS`;
        "reference" and "tool": of the measured attitude and of the tool's filter, whole and from
        `SETTLED` on.
    """
    truth = clean(round(1.0 / flights.interval))
    used = counts(truth.t)
    true_angles, dt = truth.angles()[0][used], truth.interval
    settled = used & (truth.t >= SETTLED)
    angles = np.moveaxis(flights.angles(), 1, 0).copy()
    rates = euler_rates(np.moveaxis(flights.gyro, 1, 0), angles)

    def square(filtered: Array) -> float:
        return float(np.sum((filtered[used] - true_angles[:, None]) ** 2))

    tool, reference_left = np.zeros(2), np.zeros(2)
    for gyro, reference in zip(flights.gyro, flights.quaternion, strict=True):
        filtered = ComplementaryFilter(dt).update(gyro, reference)
        for k, span in enumerate((used, settled)):
            reference_left[k] += turned_away(reference[span], truth.quaternion[0, span])
            tool[k] += turned_away(filtered[span], truth.quaternion[0, span])
    return {
        "raw": square(angles),
        "formula": [square(complementary(rates, angles, dt, k_p)) for k_p in GAINS],
        "reference": reference_left.tolist(),
        "tool": tool.tolist(),
    }


# Angular acceleration


@dataclass(frozen=True)
class Method:
    """A differentiator.

    Attributes:
        name: of its row.
        apply: signals (n, m) and dt to derivatives.
        lag: s, from dt; None to find the best on the flight without noise.
    """

    name: str
    apply: Callable[[Array, float], Array]
    lag: Callable[[float], float] | None


def true_acceleration(t: Array, lag: float) -> Array:
    """(n, 3) at t - lag."""
    grid = physics().t
    return np.stack([np.interp(t - lag, grid, a) for a in acceleration().T], axis=-1)


def mean_square(case: Case, derivative: Array, lag: float) -> float:
    """Mean squared error of (n, 3 seeds) against the truth `lag` ago, per axis."""
    t = clean(case.rate).t
    used = counts(t)
    wide = derivative.reshape(len(t), -1, 3)[used]
    return float(np.mean((wide - true_acceleration(t, lag)[used, None]) ** 2))


def best_lag(case: Case, derivative: Array) -> float:
    """The shift, s, after which a derivative (n, 3) of the flight without noise errs least."""
    t = clean(case.rate).t
    used = counts(t)
    at = np.round(t[used] * 1000.0).astype(int)  # of `physics`, whose step is a millisecond
    last = len(acceleration()) - 1
    lags = range(-20, 300)
    left = []
    for lag in lags:
        truth = acceleration()[np.clip(at - lag, 0, last)]
        left.append(float(np.sum((derivative[used] - truth) ** 2)))
    return lags[int(np.argmin(left))] / 1000.0


def signals(flights: Flight) -> Array:
    """Gyros of several seeds side by side, (n, 3 seeds)."""
    return np.moveaxis(flights.gyro, 1, 0).reshape(len(flights.t), -1)


def errors(case: Case, method: Method, measured: Array) -> list[float]:
    """Mean squared error as it comes and with the lag taken out, (rad/s^2)^2.

    Args:
        case: rate and noise.
        method: the differentiator.
        measured: (n, 3 seeds) gyros.
    """
    dt = 1.0 / case.rate
    if method.lag is not None:
        derivative = method.apply(measured, dt)
        lag = method.lag(dt)
    else:
        # The flight without noise rides along in three more columns.
        both = method.apply(np.hstack([clean(case.rate).gyro[0], measured]), dt)
        derivative, lag = both[:, 3:], best_lag(case, both[:, :3])
    return [mean_square(case, derivative, 0.0), mean_square(case, derivative, lag)]


def substeps(dt: float) -> int:
    """Steps of 2.5 ms at most; at least four a sample."""
    return max(4, round(dt / 0.0025))


def usual(R: float) -> Method:
    """The nonlinear differentiator with R^2."""
    return Method(
        f"R = {R:g}",
        lambda v, dt: nonlinear_differentiator(v, dt, R, substeps=substeps(dt))[1],
        None,
    )


@cache
def best_speed(case: Case) -> float:
    """The R with the least error once the lag is out."""
    flights = [clean(case.rate).gyro[0], *noisy(case, TUNING_SEEDS).gyro]
    inputs = np.hstack(flights)
    # All R side by side: the differentiator works on each column by itself.
    wide, R = np.tile(inputs, len(SPEEDS)), np.repeat(SPEEDS, inputs.shape[1])
    dt = 1.0 / case.rate
    out = nonlinear_differentiator(wide, dt, R, substeps=substeps(dt))[1]  # type: ignore[arg-type]
    left = []
    for found in np.split(out, len(SPEEDS), axis=1):
        lag = best_lag(case, found[:, :3])
        left.append(mean_square(case, found[:, 3:], lag))
    return SPEEDS[int(np.argmin(left))]


def window(v: Array, dt: float) -> Array:
    """The estimator's symmetric window at every sample; zeros where it does not fit."""
    tuning = EstimatorTuning()
    half = max(tuning.min_half_samples, round(tuning.half_width / dt))
    weights = cosine_window(half, dt).derivative
    return np.stack([np.convolve(column, weights[::-1], "same") for column in v.T], axis=-1)


BACKWARD = Method("backward differences", backward_difference, lambda dt: 0.5 * dt)
CENTRAL = Method("central differences", central_difference, lambda dt: 0.0)
PRINTED = Method(
    f"TD as printed (R = {ARTICLE_R:.0f})",
    lambda v, dt: nonlinear_differentiator(v, dt, form="printed", substeps=substeps(dt))[1],
    None,
)
IN_ESTIMATOR = EstimatorTuning().bandwidth
SHARED = Method(
    f"linear TD of `--method forward-td` (R = {IN_ESTIMATOR:g}, critical)",
    lambda v, dt: LinearDifferentiator(dt, IN_ESTIMATOR, DAMPING).update(v)[1],
    lambda dt: LinearDifferentiator(dt, IN_ESTIMATOR, DAMPING).lag,
)
WINDOW = Method("the estimator's window (0.1 s or 4 samples a side)", window, lambda dt: 0.0)
DEFAULT = Method(
    f"linear TD by default (R = {DEFAULT_BANDWIDTH:g}, b = √2)",
    lambda v, dt: LinearDifferentiator(dt).update(v)[1],
    lambda dt: LinearDifferentiator(dt).lag,
)


BEST = "TD with R², nonlinear, best R"


# Outcomes


def prepare() -> None:
    """What all seeds share: the flight, and the R chosen for each column."""
    for case in CASES:
        best_speed(case)


def measure(first: int) -> dict[str, Any]:
    """Squared errors of `AT_ONCE` seeds from the first on, for each of `CASES`; JSON holds it."""
    out: dict[str, Any] = {}
    for case in CASES:
        count = AT_ONCE if case.rate <= 50 else FEW
        flights = noisy(case, range(first, first + count))
        R = best_speed(case)
        methods = [BACKWARD, CENTRAL, PRINTED, replace(usual(R), name=BEST)]
        methods += [SHARED, WINDOW, DEFAULT]
        gyros = signals(flights)
        out[str(case)] = {
            "seeds": count,
            "attitude": attitude_squares(flights),
            "acceleration": {m.name: errors(case, m, gyros) for m in methods},
            "R": R,
            "power": float(np.mean(acceleration()[counts(physics().t)] ** 2)),
        }
    return out
