"""Sections of docs/accuracy.md on what happens during a flight."""

import numpy as np

from benchmarks.accuracy.statistics import Data, kind, summary
from benchmarks.accuracy.verdicts import Section, at_most, number, of, table
from gcs_sysid.arrays import Array
from testbed.article import CONVERGENCE, NAMES


def convergence(data: Data) -> Section:
    case = data["course"]
    outcomes = case["outcomes"]

    def over_runs(name: str) -> Array:
        return np.array([o[name] for o in outcomes])

    times = np.median(over_runs("settled"), axis=0)
    at_end = 100.0 * over_runs("wrong at end").mean(axis=0)
    ever = 100.0 * (over_runs("wrong refits") > 0).mean(axis=0)
    identified = over_runs("identified refits").sum(axis=0)
    share = 100.0 * over_runs("wrong refits").sum(axis=0) / np.maximum(identified, 1)
    judged = [
        at_most(f"{name} settle within 5 %, median", float(times[which].max()), bar, "s")
        for name, which, bar in (
            ("Ixx, Iyy", [0, 1], 4.0),
            ("Izz, k_M", [2, 9], 8.0),
            ("Ixy, Iyz, Ixz", [3, 4, 5], 15.0),
        )
    ]
    for when, wrong in (("at the end", at_end), ("at any refit", ever)):
        worst = NAMES[int(wrong.argmax())]
        what = f"runs with a parameter wrongly `identified` {when}, worst ({worst})"
        judged.append(at_most(what, float(wrong.max()), 10.0))
    any_end = 100.0 * over_runs("wrong at end").any(axis=1).mean()
    any_ever = 100.0 * over_runs("any wrong at any refit").mean()
    any_share = 100.0 * over_runs("wrong refits").sum() / max(int(identified.sum()), 1)
    rows = [
        ["settled within 5 %, median, s", *(number(float(v)) for v in times), ""],
        ["wrong at the end, % of runs", *(f"{v:.0f}" for v in at_end), f"{any_end:.0f}"],
        ["wrong at any refit, % of runs", *(f"{v:.0f}" for v in ever), f"{any_ever:.0f}"],
        ["wrong, % of `identified` refits", *(f"{v:.1f}" for v in share), f"{any_share:.1f}"],
    ]
    ideal = 100.0 * (1.0 - 0.95 ** len(NAMES))
    lines = [
        f"{case['seeds']} seeds, a refit every 0.1 s. The article claims {CONVERGENCE:g} s for all "
        "parameters. “Wrong” is a parameter with status `identified` whose 95 % interval misses "
        "the truth; `weak` and `unobservable` do not count. Intervals in flight are meant to hold "
        "at all refits jointly; the last one is a single look, and ten independent ones include a "
        f"miss in {ideal:.0f} % of runs.",
        "",
        *table(["", *NAMES, "any"], rows),
    ]
    return Section(of("all-axes mission, 20 Hz", case["seeds"], judged), lines)


def late(data: Data) -> Section:
    case = data["delay"]
    rows, judged = [], []
    names = list(case["outcomes"][0])
    for rate in sorted({name.split()[0] for name in names}, key=int):
        off_most = 0.0
        sizes: dict[float, float] = {}  # mean error of all runs, by delay
        for name in (n for n in names if n.split()[0] == rate):
            errors, _ = kind(case, name)
            mean, largest = summary(errors)
            off = np.abs([o[name]["off"] for o in case["outcomes"]])
            p95 = float(np.percentile(off, 95))
            off_most = max(off_most, p95)
            delay = 1000.0 * float(name.split()[1])
            sizes[delay] = float(np.abs(errors).mean())
            cells = map(number, (float(np.median(off)), p95, mean, largest))
            rows.append([f"{rate} Hz", f"{delay:.0f} ms", *cells])
        plain = sizes.pop(0.0)
        judged += [
            at_most(f"{rate} Hz: error of the delay, 95th percentile, worst", off_most, 0.2, "ms"),
            at_most(
                f"{rate} Hz: mean error of the ten, relative to no delay",
                float(np.mean(list(sizes.values()))) / plain,
                1.15,
                "times",
            ),
        ]
    lines = [
        f"{case['seeds']} seeds, speeds in whole rpm.",
        "",
        *table(
            [
                *("", "delay", "delay error, median ms", "95th percentile, ms"),
                *("mean error %", "largest, 95th percentile, %"),
            ],
            rows,
        ),
    ]
    return Section(of("delay of 10–40 ms", case["seeds"], judged), lines)
