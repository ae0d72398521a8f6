"""Sections of docs/accuracy.md on the article's chains, filters and the whole path."""

import numpy as np

from benchmarks import filter_claims
from benchmarks.accuracy.statistics import Data, held, kind
from benchmarks.accuracy.verdicts import Section, at_least, at_most, number, of, table
from testbed.article import NAMES


def chains(data: Data) -> Section:
    case = data["chains"]
    rows = []
    for name in case["outcomes"][0]:
        errors, std = kind(case, name)
        rms = np.sqrt((errors**2).mean(axis=0))
        rows.append(
            [name, *map(number, rms), number(rms.mean()), f"{held(errors, std).mean():.0f}"]
        )
    lines = [f"{case['seeds']} seeds: rms error in %.", ""]
    return Section([], [*lines, *table(["", *NAMES, "mean", "coverage, %"], rows)])


def filters(data: Data) -> Section:
    outcomes = data["filters"]["outcomes"]
    attitude, derivative = [], []
    for case in filter_claims.CASES:
        less = 100.0 * (1.0 - filter_claims.attitude_left(outcomes, case)["tool"])
        if case.noise != "mems":  # the limit is for white and colored noise
            attitude.append(at_least(f"{case}: variance below the reference's", less, 80.0))
        left = filter_claims.acceleration_left(outcomes, case)
        ours = left[filter_claims.DEFAULT.name][1]
        less = 100.0 * (1.0 - ours / left[filter_claims.BACKWARD.name][0])
        ratio = ours / left[filter_claims.CENTRAL.name][0]
        derivative += [
            at_least(f"{case}: squared error below backward differences'", less, 60.0),
            at_most(f"{case}: squared error relative to central differences", ratio, 1.0, ""),
        ]
    fewest = min(sum(o[str(case)]["seeds"] for o in outcomes) for case in filter_claims.CASES)
    return Section(
        [
            *of("complementary filter, default", fewest, attitude),
            *of("differentiator, default, lag removed", fewest, derivative),
        ],
        filter_claims.tables(outcomes),
    )


def whole_path(data: Data) -> Section:
    """The README's rows."""
    case = data["end-to-end"]
    rows = []
    for name in case["outcomes"][0]:
        errors, std = kind(case, name)
        sizes = np.abs(errors)
        cells = [f"{np.median(e):.2f} / {e.max():.2f}" for e in [*sizes.T, sizes.max(axis=1)]]
        identified = sum(o[name]["verdict"] == "identified" for o in case["outcomes"])
        share = f"{held(errors, std).mean():.0f} %"
        rows.append([name, *cells, share, f"{identified} of {case['seeds']}"])
    head = ["flight", *NAMES, "largest of ten", "interval coverage", "identified"]
    lines = [f"Error in %, median / largest of {case['seeds']} seeds.", ""]
    return Section([], [*lines, *table(head, rows)])
