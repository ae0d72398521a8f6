"""Sections of docs/accuracy.md on what happens during a flight."""

from collections import Counter
from typing import Any

import numpy as np

from benchmarks.accuracy.statistics import Data, kind, settled, summary
from benchmarks.accuracy.verdicts import Section, Verdict, at_most, number, of, table
from gcs_sysid.arrays import Array
from testbed.article import CONVERGENCE, INERTIA_AFTER_MASS_STEP, NAMES

MAX_TILT = 45.0
"""Degrees; a vehicle that leans further after a change is no longer called stable."""


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


def changes(data: Data) -> Section:
    case = data["changes"]
    verdicts = [
        *of("mass +20 %, 250 Hz", case["seeds"], _mass(case) + _false_alarms(data)),
        *of("payload, 250 Hz", case["seeds"], _payload(case)),
    ]
    rows = []
    for name in ("mass", "payload"):
        outcomes = [o[name] for o in case["outcomes"]]
        known = Counter(str(o["cause"]) for o in outcomes).most_common()
        said = ", ".join(f"`{cause}` {count}" for cause, count in known)
        again = sum(o["again"] for o in outcomes)
        t, errors = _history(outcomes)
        back = np.median(settled(t, errors), axis=0)
        rows.append([name, said, str(again), *(number(float(b)) for b in back)])
    lines = [
        f"{case['seeds']} seeds. Event reported, later alarms in all runs together, and median "
        "time in s until each estimate stays within 5 %:",
        "",
        *table(
            ["", "event", "later alarms", "mass", "Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Ixz"], rows
        ),
    ]
    return Section(verdicts, lines)


def _history(outcomes: list[dict[str, Any]]) -> tuple[Array, Array]:
    """Times (n,) after the change and errors (seeds, n, 7) in %: mass and inertia."""
    errors = np.array([o["error"] for o in outcomes], dtype=float)
    return np.array(outcomes[0]["t"]), errors


def _detection(outcomes: list[dict[str, Any]], bar: float) -> Verdict:
    delay = [np.inf if o["delay"] is None else 1000.0 * o["delay"] for o in outcomes]
    return at_most("detected, median", float(np.median(delay)), bar, "ms")


def _mass(case: dict[str, Any]) -> list[Verdict]:
    outcomes = [o["mass"] for o in case["outcomes"]]
    t, errors = _history(outcomes)
    sizes = np.nan_to_num(np.abs(errors), nan=np.inf)
    at = int(np.searchsorted(t, 1.0, side="right")) - 1
    mass = float(np.percentile(sizes[:, at, 0], 95, method="higher"))
    inertia = float(np.percentile(sizes[:, -1, 1:].max(axis=1), 95, method="higher"))
    motion = outcomes[0]["motion"]  # of the true state: the same for all seeds
    return [
        _detection(outcomes, 20.0),
        at_most(f"error of the mass after {t[at]:.1f} s, 95th percentile", mass, 1.0),
        at_most(
            f"largest of six inertia errors after {t[-1]:.0f} s, 95th percentile",
            inertia,
            INERTIA_AFTER_MASS_STEP,
        ),
        at_most(
            f"vehicle stays stable: largest tilt (before: {motion['tilt'][0]:.0f}°)",
            motion["tilt"][1],
            MAX_TILT,
            "°",
        ),
        at_most(
            "vehicle stays stable: vertical speed of the last 5 s, relative to before",
            motion["vertical speed"][1] / max(motion["vertical speed"][0], 1e-9),
            1.0,
            "times",
        ),
    ]


def _payload(case: dict[str, Any]) -> list[Verdict]:
    outcomes = [o["payload"] for o in case["outcomes"]]
    t, errors = _history(outcomes)
    back = np.median(settled(t, errors[:, :, 1:]), axis=0)
    return [
        _detection(outcomes, 50.0),
        at_most("Ixx, Iyy settle within 5 %, median", float(back[:2].max()), 5.0, "s"),
        at_most("all six settle within 5 %, median", float(back.max()), 20.0, "s"),
    ]


def _false_alarms(data: Data) -> list[Verdict]:
    """Over flights without a change, and over those with one but for its own alarm."""
    runs = [o[name] for o in data["changes"]["outcomes"] for name in ("mass", "payload")]
    alarms = sum(o["false"] + o["again"] for o in runs)
    minutes = sum(o["minutes"] for o in runs)
    for o in data.get("false-alarms", {"outcomes": []})["outcomes"]:
        alarms += sum(flight["alarms"] for flight in o.values())
        minutes += sum(flight["minutes"] for flight in o.values())
    what = f"false alarms in 10 min ({alarms} in {minutes:.0f} min)"
    return [at_most(what, 10.0 * alarms / minutes, 1.0, "")]


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
