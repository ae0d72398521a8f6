"""Outcomes as a run would keep them, drawn from known distributions instead of flown."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

# The benchmarks are no part of the installed package.
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks import filter_claims
from testbed.article import NAMES, TABLE_3

SEEDS = 200
Random = np.random.Generator


def outcome(random: Random, scale: float) -> dict[str, list[float]]:
    """Ten errors of this standard deviation, which is also what is claimed."""
    return {"error": (scale * random.standard_normal(10)).tolist(), "std": [scale] * 10}


def case(outcomes: list[Any], seeds: int | None = None) -> dict[str, Any]:
    """A case's file."""
    count = len(outcomes) if seeds is None else seeds
    cost = {"seconds": 3.0, "prepared": 1.0, "each": 0.5, "workers": 2}
    return {"seeds": count, **cost, "outcomes": outcomes}


def both(random: Random, scale: float) -> dict[str, Any]:
    return {
        f"{name} {speeds}": outcome(random, scale)
        for name in ("online", "offline")
        for speeds in ("exact", "telemetered")
    }


def history() -> dict[str, Any]:
    return {
        "settled": [1.0] * 10,
        "wrong at end": [False] * 10,
        "wrong refits": [0] * 10,
        "identified refits": [100] * 10,
        "any wrong at any refit": False,
    }


def filtered() -> dict[str, Any]:
    """As `filter_claims.measure` gives it, each filter as good as its bar asks and a little."""
    methods = [filter_claims.BACKWARD, filter_claims.CENTRAL, filter_claims.DEFAULT]
    acceleration = dict(zip((m.name for m in methods), ([4, 2], [2, 2], [9, 1]), strict=True))
    gains = filter_claims.GAINS
    attitude = {"raw": 1.0, "formula": [0.1 + 0.01 * g for g in gains]}
    attitude |= {"reference": [1.0, 1.0], "tool": [0.15, 0.1]}
    one = {"seeds": 4, "attitude": attitude, "acceleration": acceleration, "R": 80.0, "power": 25.0}
    return {str(c): one for c in filter_claims.CASES}


@pytest.fixture
def data() -> dict[str, Any]:
    """Every case, with errors small enough for every bar."""
    random = np.random.default_rng(5)
    some = range(SEEDS)
    scale = 0.05
    bound = [scale] * 8 + [float("nan"), scale]
    bounds = {
        f"{noise} {sigma:g} {speeds}": bound
        for noise, sigma in [*(("paper", s) for s in TABLE_3), ("white", 0.02)]
        for speeds in ("exact", "telemetered")
    }
    late = [f"{rate} {delay}" for rate in (20, 250) for delay in (0.0, 0.02)]
    peer = {"other": outcome(random, 10.0), "here, online": outcome(random, scale)}
    flight = {**outcome(random, scale), "verdict": "identified"}
    return {
        "bounds": case([bounds]),
        "baseline": case([both(random, scale) for _ in some]),
        "sweep": case([{str(s): both(random, scale) for s in (0.01, 0.03, 0.04)} for _ in some]),
        "noisiest": case([both(random, scale) for _ in some]),
        "white": case([both(random, scale) for _ in some]),
        "mems": case([{k: outcome(random, scale) for k in ("still", "vibrating")} for _ in some]),
        "course": case([history() for _ in some]),
        "delay": case([{n: {"error": [0.1] * 10, "std": [0.1] * 10, "off": 0.1} for n in late}]),
        "chains": case([peer]),
        "filters": case([filtered()], seeds=50),
        "end-to-end": case([{"a flight": flight}]),
    }


assert len(NAMES) == 10
