"""Statistics of outcomes: what a study's errors and standard deviations come to."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.significance import Z95
from testbed.article import NAMES

Data = dict[str, dict[str, Any]]
"""Outcomes of the cases that were run, by name; what JSON holds."""
MEDIAN = 0.674490
"""Median size of a normal error, in standard deviations."""


def stack(outcomes: Sequence[dict[str, list[float]]]) -> tuple[Array, Array]:
    """(seeds, 10) errors and standard deviations in %."""
    return np.array([o["error"] for o in outcomes]), np.array([o["std"] for o in outcomes])


def kind(case: dict[str, Any], *keys: str) -> tuple[Array, Array]:
    """(seeds, 10) errors and deviations of one kind of outcome, in %."""
    outcomes = case["outcomes"]
    for key in keys:
        outcomes = [o[key] for o in outcomes]
    return stack(outcomes)


def summary(errors: Array) -> tuple[float, float]:
    """Median over seeds of the mean of the parameters, 95th percentile of the largest."""
    sizes = np.abs(errors)
    return float(np.median(sizes.mean(axis=1))), float(np.percentile(sizes.max(axis=1), 95))


def held(errors: Array, std: Array) -> Array:
    """(10,) share of the 95 % intervals that hold the truth, in %."""
    inside: Array = np.abs(errors) <= Z95 * std
    return 100.0 * np.asarray(inside.mean(axis=0))


def settled(t: Array, errors: Array, level: float = 5.0) -> Array:
    """(seeds, 10) time from which errors (seeds, times, 10) stay within the level; inf: never."""
    good = np.abs(errors) <= level  # NaN is not
    stays = np.flip(np.logical_and.accumulate(np.flip(good, 1), axis=1), 1)
    return np.where(stays.any(axis=1), np.maximum(t[stays.argmax(axis=1)], 0.0), np.inf)


def bound(data: Data, noise: str, sigma: float, speeds: str) -> Array:
    """(10,) least standard deviations in % (Cramér-Rao), scale known; NaN for k_T."""
    return np.array(data["bounds"]["outcomes"][0][f"{noise} {sigma:g} {speeds}"], dtype=float)


def least(std: Array) -> tuple[float, float]:
    """Least that Gaussian errors at the bound make of `summary`.

    The median of the mean is least when all errors rise and fall together; the largest of ten is
    at least the largest parameter's own 95th percentile.
    """
    known = std[np.isfinite(std)]
    return float(MEDIAN * known.sum() / len(NAMES)), float(Z95 * known.max())
