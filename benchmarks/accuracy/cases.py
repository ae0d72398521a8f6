"""What is flown and estimated: a case maps a seed to an outcome that JSON can hold."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks import filter_claims
from benchmarks.accuracy import end_to_end
from benchmarks.accuracy.estimators import (
    article_noise,
    at_known_mass,
    bound,
    offline,
    online,
    outcome,
    white_noise,
)
from benchmarks.accuracy.statistics import settled
from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation.online.online import OnlineEstimator
from gcs_sysid.estimation.record.article_estimator import Method
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.significance import Z95
from testbed.article import NAMES, TABLE_3
from testbed.article_flights import EXCITED_FROM, GEOMETRY, fly, fly_late, measure

SIGMA = 0.02
"""The article's baseline noise."""
NOISIEST = 0.05
SPEEDS = {"exact": False, "telemetered": True}
"""Rotor speeds as they are, and in whole rpm as ESC_STATUS carries them."""
VIBRATION = 0.03
"""rad/s, of each rotor on each axis of the gyro."""
DELAYS = (0.0, 0.010, 0.020, 0.030, 0.040)
REFIT = 0.1
"""s between estimates of a running flight."""
NOTHING_BEFORE = 3.0
"""s of flight before which the program claims nothing (`session.chain`)."""


@dataclass(frozen=True)
class Case:
    """A Monte Carlo study.

    Attributes:
        name: for --only and for the file of outcomes.
        seeds: how many by default.
        run: seed to outcome.
        prepare: flies what all seeds share, before the work is divided among processes.
        together: seeds that one run takes, from the one given on.
        once: there is no noise in it, and `seeds` is always 1.
    """

    name: str
    seeds: int
    run: Callable[[int], dict[str, Any]]
    prepare: Callable[[], object]
    together: int = 1
    once: bool = False


def _both(noise: str, sigma: float, seed: int) -> dict[str, Any]:
    """20 Hz paper mission: {exact, telemetered} rotor speeds x {online, offline}."""
    out: dict[str, Any] = {}
    for kind, rounded in SPEEDS.items():
        samples = measure(fly("paper", 20), noise, sigma, seed, rounded=rounded)
        fit = online(samples, 0.05)
        better = offline(samples, 0.05, fit)
        out |= {f"online {kind}": outcome(fit), f"offline {kind}": outcome(better)}
    return out


def bounds(_: int) -> dict[str, list[float]]:
    """Cramér-Rao bounds of the article's flight: no seed in them."""
    noises = {("paper", sigma): article_noise(sigma, 0.05) for sigma in TABLE_3}
    noises["white", SIGMA] = white_noise(SIGMA)
    return {
        f"{noise} {sigma:g} {kind}": bound("paper", 20, model, rounded=rounded)
        for (noise, sigma), model in noises.items()
        for kind, rounded in SPEEDS.items()
    }


def baseline(seed: int) -> dict[str, Any]:
    return _both("paper", SIGMA, seed)


def sweep(seed: int) -> dict[str, Any]:
    levels = [sigma for sigma in TABLE_3 if sigma not in (SIGMA, NOISIEST)]
    return {str(sigma): _both("paper", sigma, seed) for sigma in levels}


def noisiest(seed: int) -> dict[str, Any]:
    return _both("paper", NOISIEST, seed)


def white(seed: int) -> dict[str, Any]:
    samples = measure(fly("paper", 20), "white", SIGMA, seed, rounded=False)
    fit = online(samples, 0.05)
    return {
        "online exact": outcome(fit),
        "offline exact": outcome(offline(samples, 0.05, fit)),
    }


def mems(seed: int) -> dict[str, Any]:
    flight, out = fly("paper", 250), {}
    for name, vibration in (("still", 0.0), ("vibrating", VIBRATION)):
        samples = measure(flight, "mems", 0.0, seed, vibration=vibration)
        out[name] = outcome(online(samples, 0.004))
    return out


def mems_offline(seed: int) -> dict[str, Any]:
    samples = measure(fly("paper", 250), "mems", 0.0, seed)
    fit = online(samples, 0.004)
    return {"online": outcome(fit), "offline": outcome(offline(samples, 0.004, fit))}


def history(seed: int) -> dict[str, Any]:
    """Refits of the all-axes mission at 10 Hz while it is flown, and what was claimed at each."""
    dt = 0.05
    samples = measure(fly("all-axes", 20), "paper", SIGMA, seed)
    estimator = OnlineEstimator(GEOMETRY, dt, EstimatorTuning())
    step = round(REFIT / dt)
    t, errors, std, identified = [], [], [], []
    for begin in range(0, len(samples.gyro), step):
        estimator.update(samples.part(slice(begin, begin + step)))
        # The last is the one that a session ends with.
        fit = estimator.fit(quick=begin + step < len(samples.gyro))
        if fit.seconds < NOTHING_BEFORE:
            fit = replace(fit, rotation=None)
        values = at_known_mass(fit)
        known = outcome(fit)
        t.append(round(min(begin + step, len(samples.gyro)) * dt - EXCITED_FROM, 3))
        errors.append(known["error"])
        std.append(known["std"])
        identified.append([values[name].status == "identified" for name in NAMES])
    return followed(np.array(t), np.array(errors), np.array(std), np.array(identified))


def followed(t: Array, errors: Array, std: Array, identified: Mask) -> dict[str, Any]:
    """What a history comes to.

    Args:
        t: (n,) s.
        errors: (n, 10) in %, as std.
        std: of the same.
        identified: (n, 10) whether that was the status.
    """
    wrong = identified & (np.abs(errors) > Z95 * std)
    return {
        "settled": settled(t, errors[None])[0].tolist(),
        "wrong at end": wrong[-1].tolist(),
        "wrong refits": wrong.sum(axis=0).tolist(),
        "identified refits": identified.sum(axis=0).tolist(),
        "any wrong at any refit": bool(wrong.any()),
    }


def delays(seed: int) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for rate, noise in ((20, "paper"), (250, "mems")):
        for delay in DELAYS:
            samples = measure(fly_late("paper", rate, delay), noise, SIGMA, seed)
            fit = online(samples, 1.0 / rate)
            assert fit.rotation is not None
            out[f"{rate} {delay}"] = {
                **outcome(fit),
                "off": 1000.0 * (fit.rotation.delay - delay),
                "off_std": 1000.0 * fit.rotation.delay_std,
            }
    return out


CHAINS: dict[Method, str] = {
    "article": "article, as printed",
    "article-usual-td": "article, usual TD",
    "article-stepwise": "article, stepwise",
    "central-difference": "central differences + RLS",
}
"""`--method` -> its row."""


def chains(seed: int) -> dict[str, Any]:
    samples = measure(fly("paper", 20), "paper", SIGMA, seed)
    fit = online(samples, 0.05)
    tunings = {label: EstimatorTuning(method=method) for method, label in CHAINS.items()}
    return {
        **{label: outcome(online(samples, 0.05, tuning)) for label, tuning in tunings.items()},
        "here, online": outcome(fit),
        "here, offline": outcome(offline(samples, 0.05, fit)),
    }


def _fly_late() -> None:
    for rate in (20, 250):
        for delay in DELAYS:
            fly_late("paper", rate, delay)


def _slow() -> object:
    return fly("paper", 20)


def _fast() -> object:
    return fly("paper", 250)


# Together some 10 minutes on two cores; more with --seeds.
CASES = (
    Case("bounds", 1, bounds, _slow, once=True),
    Case("baseline", 100, baseline, _slow),
    Case("sweep", 40, sweep, _slow),
    Case("noisiest", 100, noisiest, _slow),
    Case("white", 100, white, _slow),
    Case("mems", 100, mems, _fast),
    Case("mems-offline", 3, mems_offline, _fast),
    Case("course", 200, history, lambda: fly("all-axes", 20)),
    Case("delay", 24, delays, _fly_late),
    Case("chains", 8, chains, _slow),
    Case("filters", 100, filter_claims.measure, filter_claims.prepare, filter_claims.AT_ONCE),
    Case("end-to-end", 3, end_to_end.run, lambda: None),
)
