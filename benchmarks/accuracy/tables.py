"""Tables of docs/accuracy.md from the outcomes; a bar is what the program is held to."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from benchmarks.accuracy.article import (
    CONVERGENCE,
    INERTIA_AFTER_MASS_STEP,
    NAMES,
    TABLE_2,
    TABLE_3,
)
from benchmarks.accuracy.estimators import Z95, article_noise, bound, stack, white_noise
from gcs_sysid.arrays import Array

Data = dict[str, dict[str, Any]]
"""Outcomes of the cases that were run, by name."""
_FAST = "250 Hz MEMS"
_COLUMNS = ("quantity", "bar", "measured", "")


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of Markdown."""
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    return [*lines, *("| " + " | ".join(row) + " |" for row in rows), ""]


def most(what: str, value: float, bar: float, unit: str = "%", why: str = "") -> list[str]:
    """A row of which the value must not exceed the bar; `why` explains a miss."""
    met = value <= bar
    said = "met" if met else "**not met**" + (f"; {why}" if why else "")
    return [
        what,
        f"≤ {bar:g} {unit}".strip(),
        f"{number(value)} {unit}".strip() if math.isfinite(value) else number(value),
        said,
    ]


def within(what: str, value: float, low: float, high: float) -> list[str]:
    met = low <= value <= high
    bar = f"≥ {low:g} %" if high >= 100.0 else f"{low:g}–{high:g} %"
    return [what, bar, f"{value:.1f} %", "met" if met else "**not met**"]


def number(value: float) -> str:
    """Three digits."""
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "never"
    return f"{value:.3g}" if abs(value) < 100.0 else f"{value:.0f}"


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
    return 100.0 * (np.abs(errors) <= Z95 * std).mean(axis=0)


def least(std: Array) -> tuple[float, float]:
    """What Gaussian errors at the bound make of `summary`.

    Mean of the mean, and the largest parameter's own 95th percentile: the largest of ten is more.
    """
    known = std[np.isfinite(std)]
    return float(math.sqrt(2.0 / math.pi) * known.sum() / len(NAMES)), float(Z95 * known.max())


def seeds(case: dict[str, Any]) -> str:
    return f"{case['seeds']} seeds."


def spread(errors: Array) -> list[str]:
    """Median / 95th percentile of each parameter's error."""
    sizes = np.abs(errors)
    return [
        f"{number(float(np.median(e)))} / {number(float(np.percentile(e, 95)))}" for e in sizes.T
    ]


# ---- the article's flight --------------------------------------------------------------------


def article_flight(data: Data) -> list[str]:
    case = data["baseline"]
    floors = {
        speeds: bound("paper", 20, article_noise(0.02, 0.05), rounded=speeds == "telemetered")
        for speeds in ("telemetered", "exact")
    }
    judged = []
    for speeds, floor in floors.items():
        least_mean, least_largest = least(floor)
        for name, bars in (("online", (0.35, 2.0)), ("offline", (0.12, 0.8))):
            mean, largest = summary(kind(case, f"{name} {speeds}")[0])
            judged += [
                most(
                    f"{name}, {speeds}: mean of the ten, median",
                    mean,
                    bars[0],
                    why=f"Cramér-Rao bound {number(least_mean)} %",
                ),
                most(
                    f"{name}, {speeds}: largest of the ten, 95th percentile",
                    largest,
                    bars[1],
                    why=f"Cramér-Rao bound {number(least_largest)} % or more",
                ),
            ]
    rows = [["article, Table 2 (one run)", *(number(float(e)) for e in TABLE_2)]]
    for name in ("online telemetered", "offline telemetered", "online exact", "offline exact"):
        rows.append([name, *spread(kind(case, name)[0])])
    for speeds, floor in floors.items():
        rows.append([f"bound, {speeds} (one std)", *(number(float(b)) for b in floor)])
    return [
        seeds(case),
        "",
        *table(_COLUMNS, judged),
        "Error in %, median / 95th percentile:",
        "",
        *table(["", *NAMES], rows),
    ]


def noise_sweep(data: Data) -> list[str]:
    sweep, base = data["sweep"], data["baseline"]
    rows, judged, misses = [], [], {"online": [], "offline": []}
    for sigma, (average, maximum) in TABLE_3.items():
        cells = [f"{sigma:g}", number(average), number(maximum)]
        for name in misses:
            label = f"{name} telemetered"
            found = kind(base, label) if sigma == 0.02 else kind(sweep, str(sigma), label)
            mean, largest = summary(found[0])
            cells += [number(mean), number(largest)]
            if mean >= average or largest >= maximum:
                misses[name].append(f"{sigma:g}")
            if sigma == 0.05:
                floor = least(bound("paper", 20, article_noise(sigma, 0.05), rounded=True))[1]
                judged.append(
                    most(
                        f"{name}, 0.05: largest, 95th percentile",
                        largest,
                        4.5 if name == "online" else 2.0,
                        why=f"Cramér-Rao bound {number(floor)} % or more",
                    )
                )
        floor_mean, floor_largest = least(
            bound("paper", 20, article_noise(sigma, 0.05), rounded=True)
        )
        rows.append([*cells, number(floor_mean), number(floor_largest)])
    for name, missed in misses.items():
        said = "**not met** at " + ", ".join(missed) if missed else "met"
        beaten = f"{len(TABLE_3) - len(missed)} of {len(TABLE_3)} rows"
        judged.append([f"{name}: Table 3 beaten, average and maximum", "every row", beaten, said])
    head = ["noise", "article, average", "article, maximum"]
    for name in misses:
        head += [f"{name}, mean", f"{name}, largest"]
    return [
        f"{sweep['seeds']} seeds ({base['seeds']} at 0.02).",
        "",
        *table(_COLUMNS, judged),
        "Error in %: median of the mean, 95th percentile of the largest; the article's are of one "
        "run. The bound of the largest is that of the worst parameter alone.",
        "",
        *table([*head, "bound, mean", "bound, largest"], rows),
    ]


def efficiency(data: Data) -> list[str]:
    case = data["white"]
    rows, worst = [], {}
    for label, rounded in (("exact", False), ("telemetered", True)):
        floor = bound("paper", 20, white_noise(0.02), rounded=rounded)
        for name in ("offline", "online"):
            errors, _ = kind(case, f"{name} {label}")
            ratio = floor / np.sqrt((errors**2).mean(axis=0))
            rows.append([f"{name} {label}", *(number(float(r)) for r in ratio)])
            worst[name, label] = float(np.nanmin(ratio))
    slack = 1.0 / math.sqrt(2.0 * case["seeds"])
    judged = []
    for label in ("exact", "telemetered"):
        value = worst["offline", label]
        said = "met" if value >= 0.85 else "**not met**"
        judged.append([f"offline, {label}: least of nine", "≥ 0.85", f"{value:.2f}", said])
    return [
        f"{seeds(case)} So many tell a ratio to ± {100.0 * slack:.0f} % (one std).",
        "",
        *table(_COLUMNS, judged),
        "Cramér-Rao std / RMS error (k_T rests on the translation, of which the bound does not "
        "speak):",
        "",
        *table(["", *NAMES], rows),
    ]


# ---- 250 Hz ----------------------------------------------------------------------------------


def fast(data: Data) -> list[str]:
    case = data["mems"]
    rows, judged = [], []
    for name in ("still", "vibrating"):
        errors, _ = kind(case, name)
        p95 = np.percentile(np.abs(errors), 95, axis=0)
        rows.append([f"online, {name}", *spread(errors)])
        judged += [
            most(f"{name}: Ixx, Iyy, 95th percentile", float(p95[:2].max()), 0.3),
            most(f"{name}: the others, 95th percentile", float(p95[2:].max()), 3.0),
        ]
    out = [seeds(case), "", *table(_COLUMNS, judged)]
    if "mems-offline" in data:
        few = data["mems-offline"]
        for name in ("online", "offline"):
            rows.append([f"{name}, {few['seeds']} seeds", *spread(kind(few, name)[0])])
    return [
        *out,
        "Error in %, median / 95th percentile:",
        "",
        *table(["", *NAMES], rows),
    ]


def coverage(data: Data) -> list[str]:
    base, mems = data["baseline"], data["mems"]
    rows, judged = [], []
    for label, case, key, (low, high), floor in (
        ("20 Hz online", base, "online telemetered", (92.0, 98.0), 87.0),
        ("20 Hz offline", base, "offline telemetered", (92.0, 98.0), 87.0),
        (f"{_FAST} online", mems, "still", (88.0, 98.0), 82.0),
    ):
        shares = held(*kind(case, key))
        rows.append([label, *(f"{s:.0f}" for s in shares)])
        judged.append(within(f"{label}: all together", float(shares.mean()), low, high))
        lowest = NAMES[int(shares.argmin())]
        judged.append(within(f"{label}: lowest ({lowest})", float(shares.min()), floor, 100.0))
    return [
        f"{base['seeds']} seeds at 20 Hz, {mems['seeds']} at 250 Hz.",
        "",
        *table(_COLUMNS, judged),
        "Share of the 95 % intervals that hold the truth, in %:",
        "",
        *table(["", *NAMES], rows),
    ]


# ---- over time -------------------------------------------------------------------------------


def settled(t: Array, errors: Array, level: float = 5.0) -> Array:
    """(seeds, 10) time from which errors (seeds, times, 10) stay within the level; inf: never."""
    good = np.abs(errors) <= level  # NaN is not
    stays = np.flip(np.logical_and.accumulate(np.flip(good, 1), axis=1), 1)
    return np.where(stays.any(axis=1), np.maximum(t[stays.argmax(axis=1)], 0.0), np.inf)


def convergence(data: Data) -> list[str]:
    case = data["course"]
    outcomes = case["outcomes"]
    t = np.array(outcomes[0]["t"])
    errors = np.array([o["error"] for o in outcomes])
    std = np.array([o["std"] for o in outcomes])
    identified = np.array([o["identified"] for o in outcomes], dtype=bool)
    times = np.median(settled(t, errors), axis=0)
    groups = (
        ("Ixx, Iyy", [0, 1], 4.0),
        ("Izz, k_M", [2, 9], 8.0),
        ("Ixy, Iyz, Ixz", [3, 4, 5], 15.0),
    )
    judged = [most(name, float(times[which].max()), bar, "s") for name, which, bar in groups]
    wrong = identified & (np.abs(errors) > Z95 * std)
    at_end, ever = 100.0 * wrong[:, -1].mean(axis=0), 100.0 * wrong.any(axis=1).mean(axis=0)
    worst = NAMES[int(at_end.argmax())]
    any_end = 100.0 * float(wrong[:, -1].any(axis=1).mean())
    ideal = 100.0 * (1.0 - 0.95 ** len(NAMES))
    judged += [
        most(f"wrongly identified at the end: one parameter, worst ({worst})", at_end.max(), 10.0),
        most(
            "wrongly identified at the end: any of the ten",
            any_end,
            10.0,
            why=f"ten independent 95 % intervals: {ideal:.0f} %",
        ),
    ]
    any_ever = 100.0 * float(wrong.any(axis=(1, 2)).mean())
    rows = [
        ["within 5 %, median, s", *(number(float(v)) for v in times), ""],
        ["wrong at the end, % of runs", *(f"{v:.0f}" for v in at_end), f"{any_end:.0f}"],
        ["wrong at any instant, % of runs", *(f"{v:.0f}" for v in ever), f"{any_ever:.0f}"],
    ]
    step = t[1] - t[0]
    return [
        f"{seeds(case)} An estimate each {step:g} s. The article says {CONVERGENCE:g} s for all.",
        "",
        *table(_COLUMNS, judged),
        "“Wrong” counts a run in which the parameter has the status `identified` and the truth "
        "is outside its 95 % interval, at the end of the flight or at any one of the "
        f"{len(t)} estimates of it; `weak` and `unobservable` do not count.",
        "",
        *table(["", *NAMES, "any"], rows),
    ]


def steps(data: Data) -> list[str]:
    case = data["changes"]
    judged = []
    for name in ("mass", "payload"):
        outcomes = [o[name] for o in case["outcomes"]]
        delay = np.array([np.inf if o["delay"] is None else 1000.0 * o["delay"] for o in outcomes])
        limit = 20.0 if name == "mass" else 50.0
        judged.append(most(f"{name}: detected, median", float(np.median(delay)), limit, "ms"))
        t, errors = np.array(outcomes[0]["t"]), np.array([o["error"] for o in outcomes])
        if name == "mass":
            at = int(np.searchsorted(t, 1.0, side="right")) - 1
            seen = np.nan_to_num(np.abs(errors), nan=np.inf)
            value = float(np.percentile(seen[:, at, 0], 95, method="higher"))
            judged.append(most(f"mass: its error at {t[at]:.1f} s, 95th percentile", value, 1.0))
            value = float(np.percentile(seen[:, -1, 1:].max(axis=1), 95, method="higher"))
            judged.append(
                most(
                    f"mass: largest of six inertia errors at {t[-1]:.0f} s, 95th percentile",
                    value,
                    INERTIA_AFTER_MASS_STEP,
                )
            )
        else:
            back = np.median(settled(t, errors[:, :, 1:]), axis=0)
            judged.append(
                most("payload: Ixx, Iyy within 5 %, median", float(back[:2].max()), 5, "s")
            )
            judged.append(most("payload: all six within 5 %, median", float(back.max()), 20, "s"))
    out = [seeds(case), ""]
    before = sum(o[name]["false"] for o in case["outcomes"] for name in ("mass", "payload"))
    if "false-alarms" in data:
        flights = [f for o in data["false-alarms"]["outcomes"] for f in o.values()]
        minutes = sum(f["minutes"] for f in flights)
        alarms = sum(f["alarms"] for f in flights)
        judged.append(
            most(
                f"false alarms in 10 min ({alarms} in {minutes:.0f} min)",
                10 * alarms / minutes,
                1,
                "",
            )
        )
    else:
        out += ["False alarms in quiet flights were not studied in this run.", ""]
    return [*out, *table(_COLUMNS, judged), f"Alarms before the change: {before}.", ""]


def late(data: Data) -> list[str]:
    case = data["delay"]
    rows, judged = [], []
    names = list(case["outcomes"][0])
    for rate in sorted({name.split()[0] for name in names}, key=int):
        off_most, ratios = 0.0, []
        plain = None
        for name in (n for n in names if n.split()[0] == rate):
            mean, largest = summary(kind(case, name)[0])
            off = np.abs([o[name]["off"] for o in case["outcomes"]])
            plain = mean if plain is None else plain
            ratios.append(mean / plain)
            p95 = float(np.percentile(off, 95))
            off_most = max(off_most, p95)
            delay = 1000.0 * float(name.split()[1])
            rows.append(
                [
                    f"{rate} Hz",
                    f"{delay:.0f} ms",
                    number(float(np.median(off))),
                    number(p95),
                    number(mean),
                    number(largest),
                ]
            )
        judged.append(most(f"{rate} Hz: delay, 95th percentile, worst", off_most, 0.2, "ms"))
        judged.append(most(f"{rate} Hz: mean error over that without", max(ratios), 1.15, ""))
    return [
        seeds(case),
        "",
        *table(_COLUMNS, judged),
        *table(
            ["", "delay", "off, median ms", "off, p95 ms", "mean error %", "largest, p95 %"], rows
        ),
    ]


# ---- others ----------------------------------------------------------------------------------


def comparison(data: Data) -> list[str]:
    out = []
    for key, label in (("peers", "20 Hz, the article's noise"), ("peers-mems", _FAST)):
        if key not in data:
            out += [f"{label}: not in this run.", ""]
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
        out += [
            f"{label}, {case['seeds']} seeds: RMS error in %.",
            "",
            *table(["", *NAMES, "mean", "intervals hold, %"], rows),
        ]
    return out


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
    head = ["flight", *NAMES, "largest", "intervals hold", "identified"]
    return [
        f"Error in %, median / largest of {case['seeds']} seeds.",
        "",
        *table(head, rows),
    ]


SECTIONS: dict[str, tuple[tuple[str, ...], Callable[[Data], list[str]]]] = {
    "article-flight": (("baseline",), article_flight),
    "noise": (("baseline", "sweep"), noise_sweep),
    "efficiency": (("white",), efficiency),
    "fast": (("mems",), fast),
    "coverage": (("baseline", "mems"), coverage),
    "convergence": (("course",), convergence),
    "changes": (("changes",), steps),
    "delay": (("delay",), late),
    "comparison": (("peers",), comparison),
    "whole-path": (("end-to-end",), whole_path),
}
"""Place in the template to the cases that it needs and what goes there."""
