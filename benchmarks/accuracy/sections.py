"""docs/accuracy.md from the outcomes: the template's prose, and numbers from nowhere else."""

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks import filter_claims
from benchmarks.accuracy.statistics import Data, bound, held, kind, least, summary
from gcs_sysid.arrays import Array
from testbed.article import CONVERGENCE, NAMES, TABLE_2, TABLE_3
from testbed.study import markdown, number

TEMPLATE = Path(__file__).with_name("template.md")
SPEEDS = ("exact", "telemetered")
_ESTIMATORS = ("online", "offline")


def spread(errors: Array) -> list[str]:
    """Median / 95th percentile of each parameter's error."""
    sizes = np.abs(errors)
    return [
        f"{number(float(np.median(e)))} / {number(float(np.percentile(e, 95)))}" for e in sizes.T
    ]


def article_flight(data: Data) -> list[str]:
    case = data["baseline"]
    both = [(name, speeds) for name in _ESTIMATORS for speeds in SPEEDS]
    rows = [
        ["article, Table 2 (one run)", *(number(float(e)) for e in TABLE_2)],
        *([f"{n}, {speeds}", *spread(kind(case, f"{n} {speeds}")[0])] for n, speeds in both),
        *(
            [f"Cramér-Rao, {speeds} (one std)", *map(number, bound(data, "paper", 0.02, speeds))]
            for speeds in SPEEDS
        ),
    ]
    lines = [f"{case['seeds']} seeds. Error in %, median / 95th percentile:", ""]
    return lines + markdown(["", *NAMES], rows)


def at_noise(data: Data, sigma: float, label: str) -> Array:
    """(seeds, 10) errors at a level of noise, in %, whichever case flew it."""
    if sigma == 0.02:
        return kind(data["baseline"], label)[0]
    if sigma == 0.05:
        return kind(data["noisiest"], label)[0]
    return kind(data["sweep"], str(sigma), label)[0]


def noise_sweep(data: Data) -> list[str]:
    rows = []
    for name in _ESTIMATORS:
        for speeds in SPEEDS:
            for sigma, claimed in TABLE_3.items():
                found = summary(at_noise(data, sigma, f"{name} {speeds}"))
                floors = least(bound(data, "paper", sigma, speeds))
                cells = map(number, (*claimed, *found, *floors))
                rows.append([f"{name}, {speeds}", f"{sigma:g}", *cells])
    return [
        f"{data['sweep']['seeds']} seeds; {data['baseline']['seeds']} at 0.02 and "
        f"{data['noisiest']['seeds']} at 0.05. Error in %: median of the mean, 95th percentile of "
        "the largest; the article reports one run. The bounds are the smallest values compatible "
        "with Cramér-Rao: all ten errors fully correlated, and the worst parameter alone.",
        "",
        *markdown(
            " | noise | article, average | article, maximum | mean | largest | bound, mean | "
            "bound, largest",
            rows,
        ),
    ]


def efficiency(data: Data) -> list[str]:
    """The bound over what was reached."""
    rows = []
    for label, case, noise, speeds in (
        ("white, exact", "white", "white", "exact"),
        ("article's noise, exact", "baseline", "paper", "exact"),
        ("article's noise, telemetered", "baseline", "paper", "telemetered"),
    ):
        floor = bound(data, noise, 0.02, speeds)
        for name in ("offline", "online"):
            errors, _ = kind(data[case], f"{name} {speeds}")
            ratio = floor / np.sqrt((errors**2).mean(axis=0))
            rows.append([f"{name}, {label}", *map(number, ratio.tolist())])
    count = data["white"]["seeds"]
    return [
        f"{count} seeds in white noise, {data['baseline']['seeds']} in the article's, which "
        f"determine a ratio to ± {100.0 / math.sqrt(2.0 * count):.0f} % (one std). Cramér-Rao std "
        "/ rms error (k_T comes from the translation, which this bound does not cover):",
        "",
        *markdown(["", *NAMES], rows),
    ]


def fast(data: Data) -> list[str]:
    case, few = data["mems"], data.get("mems-offline")
    rows = [[f"online, {n}", *spread(kind(case, n)[0])] for n in ("still", "vibrating")]
    if few is not None:
        for name in _ESTIMATORS:
            rows.append([f"{name}, {few['seeds']} seeds", *spread(kind(few, name)[0])])
    lines = [f"{case['seeds']} seeds. Error in %, median / 95th percentile:", ""]
    return lines + markdown(["", *NAMES], rows)


def coverage(data: Data) -> list[str]:
    base, mems = data["baseline"], data["mems"]
    kinds = [
        *((f"20 Hz {n}, {s} speeds", base, f"{n} {s}") for n in _ESTIMATORS for s in SPEEDS),
        *((f"250 Hz online, {k}", mems, k) for k in ("still", "vibrating")),
    ]
    rows = []
    for label, case, key in kinds:
        shares = held(*kind(case, key))
        rows.append([label, *(f"{s:.0f}" for s in shares), f"{shares.mean():.1f}"])
    count = base["seeds"]
    return [
        f"{count} seeds at 20 Hz, {mems['seeds']} at 250 Hz: {count} determine the share of one "
        f"parameter to ± {100.0 * math.sqrt(0.95 * 0.05 / count):.1f} % (one std). Share of the "
        "95 % intervals that contain the truth, in %:",
        "",
        *markdown(["", *NAMES, "all"], rows),
    ]


def convergence(data: Data) -> list[str]:
    case = data["course"]

    def over_runs(name: str) -> Array:
        return np.array([o[name] for o in case["outcomes"]])

    times = np.median(over_runs("settled"), axis=0)
    at_end, wrong = over_runs("wrong at end"), over_runs("wrong refits")
    identified = over_runs("identified refits").sum(axis=0)
    share = 100.0 * wrong.sum(axis=0) / np.maximum(identified, 1)
    any_end, any_ever = at_end.any(axis=1), over_runs("any wrong at any refit")
    any_share = 100.0 * wrong.sum() / max(int(identified.sum()), 1)

    def percent(per_parameter: Array, of_any: Array) -> list[str]:
        return [f"{100.0 * v:.0f}" for v in (*per_parameter.mean(axis=0), of_any.mean())]

    rows = [
        ["settled within 5 %, median, s", *map(number, times.tolist()), ""],
        ["wrong at the end, % of runs", *percent(at_end, any_end)],
        ["wrong at any refit, % of runs", *percent(wrong > 0, any_ever)],
        ["wrong, % of `identified` refits", *(f"{v:.1f}" for v in (*share, any_share))],
    ]
    ideal = 100.0 * (1.0 - 0.95 ** len(NAMES))
    return [
        f"{case['seeds']} seeds, a refit every 0.1 s. The article claims {CONVERGENCE:g} s for all "
        "parameters. “Wrong” is a parameter with status `identified` whose 95 % interval misses "
        "the truth; `weak` and `unobservable` do not count. Intervals in flight are meant to hold "
        "at all refits jointly; the last one is a single look, and ten independent ones include a "
        f"miss in {ideal:.0f} % of runs.",
        "",
        *markdown(["", *NAMES, "any"], rows),
    ]


def late(data: Data) -> list[str]:
    case = data["delay"]
    rows = []
    for name in case["outcomes"][0]:
        rate, delay = name.split()
        off = np.abs([o[name]["off"] for o in case["outcomes"]])
        found = float(np.median(off)), float(np.percentile(off, 95)), *summary(kind(case, name)[0])
        rows.append([f"{rate} Hz", f"{1000.0 * float(delay):.0f} ms", *map(number, found)])
    head = (
        " | delay | delay error, median ms | 95th percentile, ms | mean error % | "
        "largest, 95th percentile, %"
    )
    return [f"{case['seeds']} seeds, speeds in whole rpm.", "", *markdown(head, rows)]


def chains(data: Data) -> list[str]:
    case = data["chains"]
    rows = []
    for name in case["outcomes"][0]:
        errors, std = kind(case, name)
        rms = np.sqrt((errors**2).mean(axis=0))
        cells = [*map(number, rms), number(rms.mean()), f"{held(errors, std).mean():.0f}"]
        rows.append([name, *cells])
    lines = [f"{case['seeds']} seeds: rms error in %.", ""]
    return lines + markdown(["", *NAMES, "mean", "coverage, %"], rows)


def whole_path(data: Data) -> list[str]:
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
    return lines + markdown(head, rows)


SECTIONS: dict[str, tuple[tuple[str, ...], Callable[[Data], list[str]]]] = {
    "article-flight": (("bounds", "baseline"), article_flight),
    "noise": (("bounds", "baseline", "sweep", "noisiest"), noise_sweep),
    "efficiency": (("bounds", "baseline", "white"), efficiency),
    "fast": (("mems",), fast),
    "coverage": (("baseline", "mems"), coverage),
    "convergence": (("course",), convergence),
    "delay": (("delay",), late),
    "chains": (("chains",), chains),
    "filters": (("filters",), lambda data: filter_claims.tables(data["filters"]["outcomes"])),
    "whole-path": (("end-to-end",), whole_path),
}
"""Place in the template to the cases that it needs and what goes there."""


def page(data: Data) -> str:
    """The page; a case that was not run is left out, with a line saying so."""
    lines = {"run": run_table(data)}
    for name, (needs, of) in SECTIONS.items():
        lacking = [need for need in needs if need not in data]
        lines[name] = [f"Not in this run (`--only {lacking[0]}`)."] if lacking else of(data)
    text = TEMPLATE.read_text(encoding="utf-8")
    return re.sub(r"\{\{([a-z-]+)\}\}", lambda m: "\n".join(lines[m[1]]), text)


def run_table(data: Data) -> list[str]:
    """What each case cost."""
    rows = [
        [
            f"`{name}`",
            "–" if name == "bounds" else str(case["seeds"]),
            f"{case['prepared']:.0f}",
            f"{case['each'] * len(case['outcomes']):.0f}",
            f"{case['seconds']:.0f}",
        ]
        for name, case in data.items()
    ]
    minutes = sum(case["seconds"] for case in data.values()) / 60.0
    workers = max((case["workers"] for case in data.values()), default=0)
    return [
        f"Seeds run from 1 to the number given. The run took {minutes:.0f} min on {workers} cores.",
        "",
        *markdown("case | seeds | setup, core s | run, core s | elapsed, s", rows),
    ]
