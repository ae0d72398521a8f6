"""Studies on flights that are drawn and flown: truth, accuracy, early results, changes, gusts."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.accept.judge import Figure, Study, coverage, figure, share
from benchmarks.accuracy import cases
from benchmarks.truth import __main__ as truth
from benchmarks.truth import closed_loop
from gcs_sysid.significance import Z95
from testbed import command_flights as early
from testbed import fleets as changes
from testbed import independent
from testbed.article_flights import fly, measure
from testbed.judge import MOMENTS, claims
from testbed.scenarios import SCENARIOS

Outcomes = Sequence[dict[str, Any]]

# ---- vehicles that are not the model ---------------------------------------------------------

WRONG = ("swap", "spins", "pair", "tilt", "turned")
"""Scenarios in which the user's airframe is not the vehicle's."""
_SHORT = ("a", "d", "s", "swap", "ou")


def _truth_units(is_short: bool) -> list[tuple[str, int]]:
    if is_short:
        return [(name, 0) for name in _SHORT]
    names = [*(s.name for s in SCENARIOS), *independent.available()]
    return [(name, number) for number in range(2) for name in names]


def _truth(unit: tuple[str, int]) -> dict[str, Any]:
    name, number = unit
    return {**truth.fly(name, None, number), "scenario": name}


def claim_figures(what: str, outcomes: Outcomes) -> list[Figure]:
    """Of flights held against their truth by `testbed.judge`."""

    def holds(*, all_shown: bool) -> list[list[bool]]:
        return [[f["holds"] for _, f in claims(o, all_shown=all_shown)] for o in outcomes]

    def moments(units: Outcomes) -> list[dict[str, Any]]:
        return [f for o in units for name, f in claims(o) if name in MOMENTS]

    def errors(units: Outcomes) -> float:
        return _median([100.0 * abs(f["error"]) for f in moments(units)])

    def halves(units: Outcomes) -> float:
        # z is the error over the standard deviation.
        stds = [abs(f["error"] / f["z"]) for f in moments(units) if f["z"]]
        return _median([100.0 * Z95 * std for std in stds])

    def far(units: Outcomes) -> float:
        return sum(abs(f["z"]) > 4.0 for o in units for _, f in claims(o))

    def events(units: Outcomes) -> float:
        return sum(len(o.get("events", ())) for o in units)

    return [
        coverage(f"{what}: `identified` that hold, %", holds(all_shown=False)),
        coverage(f"{what}: all shown that hold, %", holds(all_shown=True)),
        figure(f"{what}: claims beyond 4 sigma", "never", outcomes, far),
        figure(
            f"{what}: `identified` a flight", "high", outcomes,
            lambda units: float(np.mean([len(claims(o)) for o in units])),
        ),
        figure(
            f"{what}: moments of inertia claimed, %", "high", outcomes,
            lambda units: 100.0 * len(moments(units)) / (len(MOMENTS) * len(units)),
        ),
        figure(f"{what}: error of claimed moments, median %", "low", outcomes, errors),
        figure(f"{what}: half width of claimed moments, median %", "low", outcomes, halves),
        figure(f"{what}: false changes", "never", outcomes, events),
        figure(
            f"{what}: internal errors", "never", outcomes,
            lambda units: sum(o["verdict"] == "error" for o in units),
        ),
    ]  # fmt: skip


def _truth_figures(outcomes: Outcomes) -> list[Figure]:
    wrong = [o for o in outcomes if o["scenario"] in WRONG]
    by_data = [[f["holds"] for _, f in claims(o["by_data"])] for o in outcomes]
    return [
        *claim_figures("truth", outcomes),
        coverage("truth, all given exact: `identified` that hold, %", by_data),
        figure(
            "truth: wrong airframes `identified`", "never", wrong,
            lambda units: sum(o["verdict"] == "identified" for o in units),
        ),
    ]  # fmt: skip


def _truth_details(outcomes: Outcomes) -> list[str]:
    from benchmarks.truth import page

    names = list(dict.fromkeys(o["scenario"] for o in outcomes))
    return page.lines({n: {"outcomes": [o for o in outcomes if o["scenario"] == n]} for n in names})


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if len(values) else math.nan


# ---- the vehicle that the method assumes -----------------------------------------------------


def _accuracy_units(is_short: bool) -> list[tuple[str, int]]:
    counts = {"baseline": 4} if is_short else {"baseline": 16, "mems": 8, "course": 6}
    return [(name, seed) for name, count in counts.items() for seed in range(1, count + 1)]


def _accuracy(unit: tuple[str, int]) -> dict[str, Any]:
    name, seed = unit
    if name == "mems":
        # Without the vibrating one of `benchmarks.accuracy`.
        samples = measure(fly("paper", 250), "mems", 0.0, seed)
        return {"case": name, "online": cases.outcome(cases.online(samples, 0.004))}
    run = {"baseline": cases.baseline, "course": cases.history}[name]
    return {"case": name, **run(seed)}


_KINDS = (
    ("article's flight", "baseline", "online telemetered"),
    ("article's flight, offline", "baseline", "offline telemetered"),
    ("MEMS, 250 Hz", "mems", "online"),
)


def _accuracy_figures(outcomes: Outcomes) -> list[Figure]:
    figures = []
    for what, case, key in _KINDS:
        found = [o[key] for o in outcomes if o["case"] == case]
        if not found:
            continue
        name = f"accuracy, {what}"
        figures += [
            figure(f"{name}: mean error of the ten, median %", "low", found, _mean_error),
            figure(
                f"{name}: half width, median %", "low", found,
                lambda units: Z95 * float(np.median([o["std"] for o in units])),
            ),
            coverage(f"{name}: intervals that hold, %", [_held(o) for o in found]),
        ]  # fmt: skip
    course = [o for o in outcomes if o["case"] == "course"]
    if course:
        figures += [
            figure(
                "accuracy, all axes: settled within 5 %, slowest median s", "low", course,
                lambda units: float(np.median([o["settled"] for o in units], axis=0).max()),
            ),
            figure(
                "accuracy, all axes: refits wrong of those `identified`, %", "low", course,
                lambda units: 100.0 * _sum(units, "wrong refits")
                / _sum(units, "identified refits"),
            ),
        ]  # fmt: skip
    return figures


def _mean_error(units: Outcomes) -> float:
    return float(np.median(np.abs([o["error"] for o in units]).mean(axis=1)))


def _held(o: dict[str, Any]) -> list[bool]:
    return [abs(e) <= Z95 * s for e, s in zip(o["error"], o["std"], strict=True)]


def _sum(units: Outcomes, key: str) -> float:
    return float(sum(sum(o[key]) for o in units))


# ---- early results on commands ---------------------------------------------------------------


def _early_units(is_short: bool) -> list[tuple[str, int]]:
    return [("speed", 2)] if is_short else [(lag_of, 3) for lag_of in early.LAGS]


def _early(unit: tuple[str, int]) -> list[dict[str, list[float]]]:
    return [
        {f"{at:g}": [z for z, _ in found.values()] for at, found in flight.items()}
        for flight in early.flights(*unit)
    ]


def _early_figures(outcomes: Sequence[list[dict[str, list[float]]]]) -> list[Figure]:
    figures = []
    for at in early.TIMES:
        z = [flight[f"{at:g}"] for flights in outcomes for flight in flights]
        held = [[abs(e) <= Z95 for e in flight] for flight in z]
        figures += [
            coverage(f"early, {at:g} s: shown that hold, %", held),
            figure(f"early, {at:g} s: shown a flight", "high", [len(f) for f in z], _mean),
        ]
    return figures


def _early_details(outcomes: Sequence[list[dict[str, list[float]]]]) -> list[str]:
    """Of all flights, how many intervals hold at each time, and by how far others miss."""
    lines = []
    for at in early.TIMES:
        z = [e for flights in outcomes for flight in flights for e in flight[f"{at:g}"]]
        missed = " ".join(f"{e:+.1f}" for e in z if abs(e) > Z95)
        lines.append(f"at {at:2.0f} s: {len(z) - len(missed.split())} of {len(z)} hold {missed}")
    return lines


# ---- changes ---------------------------------------------------------------------------------


def _quiet_units(is_short: bool) -> list[tuple[str, int]]:
    names = ("climbs",) if is_short else tuple(changes.QUIET)
    return [(name, 1 + i) for i, name in enumerate(names)]


def _quiet(unit: tuple[str, int]) -> dict[str, Any]:
    return changes.quiet_flights(*unit, count=2)


def _quiet_figures(outcomes: Outcomes) -> list[Figure]:
    figures = []
    for key in changes.INPUTS:
        flights = [flight for o in outcomes for flight in o[key]]
        figures += [
            figure(
                f"quiet, {key}: false changes", "never", flights,
                lambda units: sum(len(f["called"]) for f in units),
                f"{_total(flights, 'seconds') / 60.0:.0f} min",
            ),
            figure(
                f"quiet, {key}: flight that is used, %", "high", flights,
                lambda units: 100.0 * _total(units, "used") / _total(units, "seconds"),
            ),
        ]  # fmt: skip
    return figures


def _total(units: Outcomes, key: str) -> float:
    return float(sum(unit[key] for unit in units))


def _step_units(is_short: bool) -> list[tuple[str, int]]:
    return [("speeds", 2)] if is_short else [(name, 2) for name in changes.STEPS]


def _step(unit: tuple[str, int]) -> list[dict[str, Any]]:
    return changes.step_flights(*unit)


def _step_figures(outcomes: Sequence[list[dict[str, Any]]]) -> list[Figure]:
    flights = [flight for found in outcomes for flight in found]
    delays = [f["delay"] for f in flights if f["delay"] is not None]
    return [
        share("steps: found within 2 s, %", [f["delay"] is not None and f["delay"] <= changes.SOON
                                             for f in flights]),
        share("steps: named right, %", [f["named"] for f in flights]),
        figure("steps: median delay, s", "low", delays, _median),
        figure(
            "steps: other changes called", "never", flights,
            lambda units: _total(units, "others"),
        ),
        *(
            figure(
                f"steps: {name} afterwards, rms error %", "low",
                [f[name] for f in flights if name in f],
                lambda units: 100.0 * float(np.sqrt(np.mean(np.square(units)))),
            )
            for name in ("mass", "inertia")
        ),
    ]  # fmt: skip


# ---- gusts under feedback --------------------------------------------------------------------

_CELLS = ("doublets:none", "gentle:none", "aggressive:ou1", "doublets:ou3.5", "gentle:wind")


def _loop_units(is_short: bool) -> list[tuple[str, int]]:
    return [(cell, 4 if is_short else 8) for cell in (_CELLS[:1] if is_short else _CELLS)]


def _loop(unit: tuple[str, int]) -> dict[str, Any]:
    cell, flights = unit
    vehicle = closed_loop.Vehicle()
    excitation, disturbance = cell.split(":")
    samples = closed_loop.fly(
        vehicle, closed_loop.EXCITATIONS[excitation], closed_loop.DISTURBANCES[disturbance],
        flights=flights, seconds=30.0, rate=250.0, seed=1 + 1000 * _CELLS.index(cell),
    )  # fmt: skip
    found = closed_loop.judge(samples, vehicle, closed_loop.estimators(0.004)["whitened"])
    return {"cell": cell, "error": found.error[:, :3].tolist(), "std": found.std[:, :3].tolist()}


def _loop_figures(outcomes: Outcomes) -> list[Figure]:
    figures = []
    for o in outcomes:
        flights = list(zip(o["error"], o["std"], strict=True))
        name = f"closed loop, {o['cell']}"
        figures += [
            figure(
                f"{name}: bias of Ixx, Iyy, %", "low", flights,
                lambda units: abs(100.0 * float(np.mean([e[:2] for e, _ in units]))),
            ),
            figure(
                f"{name}: half width of Ixx, Iyy, median %", "low", flights,
                lambda units: 100.0 * Z95 * float(np.median([s[:2] for _, s in units])),
            ),
            coverage(
                f"{name}: Ixx, Iyy, Izz that hold, %",
                [[abs(a) <= Z95 * b for a, b in zip(e, s, strict=True)] for e, s in flights],
            ),
        ]  # fmt: skip
    return figures


STUDIES = (
    Study("truth", _truth_units, _truth, _truth_figures, _truth_details),
    Study("accuracy", _accuracy_units, _accuracy, _accuracy_figures),
    Study("early", _early_units, _early, _early_figures, _early_details),
    Study("quiet", _quiet_units, _quiet, _quiet_figures),
    Study("steps", _step_units, _step, _step_figures),
    Study("closed loop", _loop_units, _loop, _loop_figures),
)
