"""What is flown and estimated: a case maps a seed to an outcome that JSON can hold."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.accuracy import changes, end_to_end, peers
from benchmarks.accuracy.article import NAMES, TABLE_3
from benchmarks.accuracy.estimators import at_known_mass, offline, online, outcome
from benchmarks.accuracy.flights import (
    EXCITED_FROM,
    GEOMETRY,
    MEMS_SPEED_STD,
    fly,
    fly_late,
    measure,
    part,
)
from gcs_sysid.estimation.online import OnlineEstimator, Tuning
from gcs_sysid.estimation.speed_noise import ROUNDING_STD

SIGMA = 0.02
"""The article's baseline noise."""
VIBRATION = 0.03
"""rad/s, of each rotor on each axis of the gyro."""
DELAYS = (0.0, 0.010, 0.020, 0.030, 0.040)
COURSE_STEP = 0.5
"""s between estimates of a course, as in a live session."""
NOTHING_BEFORE = 3.0
"""s of flight before which the program claims nothing (`session.chain`)."""


@dataclass(frozen=True)
class Case:
    """A Monte Carlo study.

    Attributes:
        name: for --only and for the file of outcomes.
        seeds: how many, unless told.
        run: seed to outcome.
        prepare: flies what all seeds share, before the work is divided among processes.
    """

    name: str
    seeds: int
    run: Callable[[int], dict[str, Any]]
    prepare: Callable[[], object]


def _both(noise: str, sigma: float, seed: int, *, offline_exact: bool = True) -> dict[str, Any]:
    """20 Hz paper mission: {exact, telemetered} rotor speeds x {online, offline}."""
    out: dict[str, Any] = {}
    for rounded in (False, True):
        samples = measure(fly("paper", 20), noise, sigma, seed, rounded=rounded)
        kind = "telemetered" if rounded else "exact"
        fit = online(samples, 0.05)
        out[f"online {kind}"] = outcome(fit)
        if rounded or offline_exact:
            better = offline(samples, 0.05, fit, ROUNDING_STD if rounded else None)
            out[f"offline {kind}"] = outcome(better)
    return out


def baseline(seed: int) -> dict[str, Any]:
    return _both("paper", SIGMA, seed)


def sweep(seed: int) -> dict[str, Any]:
    levels = [sigma for sigma in TABLE_3 if sigma != SIGMA]
    return {str(sigma): _both("paper", sigma, seed, offline_exact=False) for sigma in levels}


def white(seed: int) -> dict[str, Any]:
    return _both("white", SIGMA, seed)


def mems(seed: int) -> dict[str, Any]:
    flight, out = fly("paper", 250), {}
    for name, vibration in (("still", 0.0), ("vibrating", VIBRATION)):
        samples = measure(flight, "mems", 0.0, seed, vibration=vibration)
        out[name] = outcome(online(samples, 0.004))
    return out


def mems_offline(seed: int) -> dict[str, Any]:
    samples = measure(fly("paper", 250), "mems", 0.0, seed)
    fit = online(samples, 0.004)
    level = float(np.hypot(MEMS_SPEED_STD, ROUNDING_STD))
    return {"online": outcome(fit), "offline": outcome(offline(samples, 0.004, fit, level))}


def course(seed: int) -> dict[str, Any]:
    """Estimates of the all-axes mission while it is flown."""
    dt = 0.05
    samples = measure(fly("all-axes", 20), "paper", SIGMA, seed)
    estimator = OnlineEstimator(GEOMETRY, dt, Tuning())
    step = round(COURSE_STEP / dt)
    out: dict[str, Any] = {"t": [], "error": [], "std": [], "identified": []}
    for begin in range(0, len(samples.gyro), step):
        estimator.update(part(samples, slice(begin, begin + step)))
        # The last is the one that a session ends with.
        fit = estimator.fit(quick=begin + step < len(samples.gyro))
        if fit.seconds < NOTHING_BEFORE:
            fit = replace(fit, rotation=None)
        found = at_known_mass(fit)
        known = outcome(fit)
        out["t"].append(round(min(begin + step, len(samples.gyro)) * dt - EXCITED_FROM, 3))
        out["error"].append(known["error"])
        out["std"].append(known["std"])
        out["identified"].append([found[name].status == "identified" for name in NAMES])
    return out


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


def comparison(seed: int) -> dict[str, Any]:
    samples = measure(fly("paper", 20), "paper", SIGMA, seed)
    fit = online(samples, 0.05)
    return {
        **peers.all_of(samples, 0.05, fit, "paper"),
        "ours, online": outcome(fit),
        "ours, offline": outcome(offline(samples, 0.05, fit, ROUNDING_STD)),
    }


def comparison_mems(seed: int) -> dict[str, Any]:
    samples = measure(fly("paper", 250), "mems", 0.0, seed)
    fit = online(samples, 0.004)
    return {**peers.all_of(samples, 0.004, fit, "mems"), "ours, online": outcome(fit)}


def _fly_late() -> None:
    for rate in (20, 250):
        for delay in DELAYS:
            fly_late("paper", rate, delay)


def _slow() -> object:
    return fly("paper", 20)


def _fast() -> object:
    return fly("paper", 250)


# Together at most 20 minutes on two cores; more with --seeds.
CASES = (
    Case("baseline", 50, baseline, _slow),
    Case("sweep", 25, sweep, _slow),
    Case("white", 40, white, _slow),
    Case("mems", 50, mems, _fast),
    Case("mems-offline", 4, mems_offline, _fast),
    Case("course", 50, course, lambda: fly("all-axes", 20)),
    Case("delay", 12, delays, _fly_late),
    Case("peers", 12, comparison, lambda: peers.tune("paper")),
    Case("peers-mems", 3, comparison_mems, lambda: peers.tune("mems")),
    Case("changes", 10, changes.run, changes.prepare),
    Case("false-alarms", 4, changes.quiet, changes.prepare_quiet),
    Case("end-to-end", 6, end_to_end.run, lambda: None),
)
