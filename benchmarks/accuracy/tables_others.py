"""Sections of docs/accuracy.md on others' estimators, filters, cost and the whole path."""

from dataclasses import replace

import numpy as np

from benchmarks import filter_claims, filter_errors
from benchmarks.accuracy.statistics import Data, held, kind
from benchmarks.accuracy.verdicts import Section, Verdict, at_least, at_most, number, of, table
from testbed.article import NAMES

_TITLES = {"peers": "20 Hz, the article's noise", "peers-mems": "250 Hz MEMS"}


def comparison(data: Data) -> Section:
    lines = []
    for key, label in _TITLES.items():
        if key not in data:
            lines += [f"{label}: not in this run.", ""]
            continue
        case = data[key]
        rows = []
        chosen = case["outcomes"][0]["settings"]
        for peer in case["outcomes"][0]:
            if peer == "settings":
                continue
            errors, std = kind(case, peer)
            rms = np.sqrt((errors**2).mean(axis=0))
            holds = f"{held(errors, std).mean():.0f}" if np.isfinite(std).all() else "–"
            setting = f" ({chosen[peer]:g})" if peer in chosen else ""
            rows.append([peer + setting, *map(number, rms), number(rms.mean()), holds])
        lines += [
            f"{label}, {case['seeds']} seeds: rms error in %.",
            "",
            *table(["", *NAMES, "mean", "coverage, %"], rows),
        ]
    return Section([], lines)


def filters(data: Data) -> Section:
    outcomes = data["filters"]["outcomes"]
    attitude, derivative = [], []
    for case in filter_errors.CASES:
        less = 100.0 * (1.0 - filter_claims.attitude_left(outcomes, case)["tool"])
        if case.noise != "mems":  # the limit is for white and colored noise
            attitude.append(at_least(f"{case}: variance below the reference's", less, 80.0))
        left = filter_claims.acceleration_left(outcomes, case)
        ours = left[filter_errors.DEFAULT.name][1]
        as_they_come, half_sample_out = left[filter_errors.BACKWARD.name]
        less, harder = (100.0 * (1.0 - ours / base) for base in (as_they_come, half_sample_out))
        verdict = at_least(f"{case}: squared error below backward differences'", less, 60.0)
        ratio = ours / left[filter_errors.CENTRAL.name][0]
        derivative += [
            replace(
                verdict, measured=f"{verdict.measured} ({number(harder)} % with their lag removed)"
            ),
            at_most(f"{case}: squared error relative to central differences", ratio, 1.0, ""),
        ]
    fewest = min(sum(o[str(case)]["seeds"] for o in outcomes) for case in filter_errors.CASES)
    return Section(
        [
            *of("complementary filter, default", fewest, attitude),
            *of("differentiator, default, lag removed", fewest, derivative),
        ],
        filter_claims.tables(outcomes),
    )


def cost(data: Data) -> Section:
    outcomes = data["speed"]["outcomes"]
    block, ticks, single = (
        float(np.median([o[name] for o in outcomes])) for name in ("block", "ticks", "single")
    )
    verdicts: list[Verdict] = [
        at_least("blocks of 10 s", block, 20000.0, "samples/s"),
        at_least("sample by sample", single, 3000.0, "samples/s"),
    ]
    lines = [
        f"Complementary filter and online estimator with a refit every 0.1 s at 250 Hz, one core: "
        f"{block:.0f} samples per second in blocks of 10 s, {ticks:.0f} in blocks of 0.1 s, "
        f"{single:.0f} sample by sample (median of {len(outcomes)} flights, with the other core "
        "equally busy). `make bench` measures the whole chain from decoded messages on.",
    ]
    return Section(of("cost, refit at 10 Hz", len(outcomes), verdicts), lines)


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
    lines = [
        f"Error in %, median / largest of {case['seeds']} seeds.",
        "",
        *table(head, rows),
    ]
    return Section([], lines)
