"""Studies on recorded flights: with a truth, of one real vehicle, thinned, of other people."""

import json
import math
import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import recorded, recorded_changes
from benchmarks.accept import trees
from benchmarks.accept.emulated import claim_figures
from benchmarks.accept.judge import Figure, Study, coverage, figure
from benchmarks.accept.logs import SHARED, given
from benchmarks.truth import judge as truth_judge
from benchmarks.truth import recorded_flights
from benchmarks.truth.real_flights import FLIGHTS, OPEN_LOOP
from gcs_sysid.errors import InputError
from gcs_sysid.intervals import Z95

Outcomes = Sequence[dict[str, Any]]

# ---- logs with a truth, and changes in all of them -------------------------------------------


def _log_units(is_short: bool) -> list[str]:
    logs = [log for log in recorded_changes.logs_in([SHARED]) if "field" not in log.parts]
    if is_short:
        logs = [log for log in logs if log.name in ("c_3.tlog", "LOG00267.tlog")]
    return [str(log) for log in sorted(logs, key=lambda log: -log.stat().st_size)]


def _log(unit: str) -> dict[str, Any] | None:
    log = Path(unit)
    try:
        flown = recorded_changes.fly(log)
    except InputError as error:
        return {"log": log.name, "verdict": "refused", "error": str(error), "false": 0}
    out: dict[str, Any] = {
        "log": log.name,
        "false": len(flown.false),
        "landings": flown.landings,
        "used": flown.used,
        "airborne": flown.airborne,
        "moments": {
            name: [e.value, e.std, e.status]
            for name, e in flown.result.parameters.items()
            if name in (*OPEN_LOOP, "k_T")
        },
    }
    if flown.change is not None:
        event, (at, _, mass) = flown.found, flown.change
        out["delay"] = event["decided"] - at if event and event.get("decided") else None
        truth, values = recorded.truth_of(log) | {"mass": mass}, flown.result.parameters
        out["after"] = [
            100.0 * (values[n].value / truth[n] - 1.0) for n in ("mass", "Ixx", "Iyy", "Izz")
        ]
    if recorded_flights.truth_file(log) is not None:
        truth, changed = recorded_flights.truth_of(log)
        out["judged"] = truth_judge.outcome(flown.result, truth)
        if changed:
            out["judged"]["events"] = []
    return out


def _log_figures(outcomes: Outcomes) -> list[Figure]:
    judged = [o["judged"] for o in outcomes if "judged" in o]
    landings = [abs(s) for o in outcomes for s in o.get("landings", ())]
    figures = claim_figures("recorded", judged) if judged else []
    figures += [
        figure(
            "recorded: false changes in all logs", "never", outcomes,
            lambda units: float(sum(o["false"] for o in units)),
        ),
        figure(
            "recorded: flight that is used, %", "high", [o for o in outcomes if o.get("airborne")],
            lambda units: 100.0 * sum(o["used"] for o in units) / sum(o["airborne"] for o in units),
        ),
    ]  # fmt: skip
    if landings:
        figures.append(
            figure(
                "recorded: landings found late, rms s", "low", landings,
                lambda units: float(np.sqrt(np.mean(np.square(units)))),
            )
        )  # fmt: skip
    for o in outcomes:
        if "after" in o:
            late = math.inf if o["delay"] is None else o["delay"]
            figures += [
                Figure("recorded change: called after, s", "low", late, 0.5, "1, a look"),
                Figure(
                    "recorded change: mass and inertia, rms error %", "low",
                    float(np.sqrt(np.mean(np.square(o["after"])))), 0.5, "1, at half widths of 1 %",
                ),
            ]  # fmt: skip
    return figures + _real_figures([o for o in outcomes if o["log"] in FLIGHTS])


def _real_figures(outcomes: Outcomes) -> list[Figure]:
    """Do flights of one real vehicle agree, within their intervals?"""
    figures = []
    for name in OPEN_LOOP:
        found = [
            (value, std)
            for value, std, status in (o["moments"][name] for o in outcomes if "moments" in o)
            if value is not None and std and status != "unobservable"
        ]
        if len(found) < 3:
            continue
        figures += [
            figure(
                f"real flights: scatter of {name}, %", "low", found,
                lambda units: 100.0 * float(np.std([v for v, _ in units]))
                / float(np.mean([v for v, _ in units])),
            ),
            figure(
                f"real flights: half width of {name}, median %", "low", found,
                lambda units: 100.0 * Z95 * float(np.median([s / v for v, s in units])),
            ),
            coverage(
                f"real flights: {name} that holds that of throws, %",
                [[abs(v - OPEN_LOOP[name]) <= Z95 * s] for v, s in found],
            ),
        ]  # fmt: skip
    if outcomes:
        shown = [[status for _, _, status in o.get("moments", {}).values()] for o in outcomes]
        figures.append(
            figure(
                "real flights: Ixx, Iyy, k_T `identified`, %", "high", shown,
                lambda units: 100.0 * sum(u.count("identified") for u in units)
                / max(sum(map(len, units)), 1),
            )
        )  # fmt: skip
    return figures


# ---- the same at 50 Hz, with losses ----------------------------------------------------------

_THINNED = ("px4-esc-cg.tlog", "px4-sih-default.tlog", "ardupilot-sitl.tlog")


def _thinned_units(is_short: bool) -> list[tuple[str, int]]:
    found = [name for name in _THINNED if (SHARED / name).exists()]
    return [] if is_short else [(name, seed) for name in found for seed in (1, 2, 3)]


def _thinned(unit: tuple[str, int]) -> dict[str, Any]:
    name, seed = unit
    log = SHARED / name
    truth = recorded.truth_of(log)
    airframe = recorded.airframe_of(log).with_anchor("mass", truth["mass"])
    with tempfile.TemporaryDirectory() as folder:
        thin = recorded.thinned(log, Path(folder) / name, seed)
        return truth_judge.judge(thin, airframe, truth, peer=False)


def _thinned_figures(outcomes: Outcomes) -> list[Figure]:
    return [f for f in claim_figures("thinned", outcomes) if "false changes" not in f.name]


# ---- logs of other people --------------------------------------------------------------------

NOT_IN_THE_AIR = {
    "bench-run-pt2-002.bin", "ground-run-pt1-082.bin", "groundlink-log_2.bin",
    "idle-on-ground-118.bin", "jschall_quad_mav1_2014.tlog", "geprc-on-the-ground.bbl",
    "greenreaper06-idle-on-the-ground.bfl", "hiro-no-accelerometer.bfl",
    "baseflight2016-zero-accelerometer.TXT",
}  # fmt: skip
"""Logs on the ground, on a bench, in a hand, or without an accelerometer: no hover in them."""
_ONE_DAY = re.compile(r"000001[2]\d\.BIN")
"""Flights of one vehicle, one battery, one day."""
_SAME = ("k_T", "thrust_to_weight", "cg x", "cg y", "yaw_imbalance", "hover_throttle")


def _field_units(is_short: bool) -> list[str]:
    folder = SHARED / "field"
    files = sorted(f for f in folder.rglob("*") if f.suffix.lower() in
                   (".bin", ".bfl", ".bbl", ".ulg", ".tlog", ".txt", ".log"))  # fmt: skip
    return [str(f) for f in files][:: 12 if is_short else 1]


def _field(unit: str) -> dict[str, Any]:
    log = Path(unit)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "health.json"
        done = trees.run(
            trees.PROJECT, ("gcs_sysid", "health", unit, *given(log), "--json", str(out))
        )
        told = json.loads(out.read_text()) if out.exists() else {}
    found: dict[str, Any] = {"log": log.name, "folder": log.parent.name, "status": done.status}
    found["said"] = done.said.strip()[-200:]
    found["crash"] = done.status not in (0, 1, 2) or "internal error" in done.said
    found["crash"] |= "Traceback" in done.said or "Warning" in done.said
    cg = told.get("cg") or {}
    values = {**told, "cg x": cg.get("x"), "cg y": cg.get("y")}
    found["values"] = {
        name: [values[name]["value"], values[name]["std"]]
        for name in _SAME
        if isinstance(values.get(name), dict) and values[name].get("std")
    }
    return found


def _field_figures(outcomes: Outcomes) -> list[Figure]:
    aloft = [o for o in outcomes if o["log"] not in NOT_IN_THE_AIR]
    still = [o for o in outcomes if o["log"] in NOT_IN_THE_AIR]
    figures = [
        figure(
            "field: internal errors and warnings of libraries", "never", outcomes,
            lambda units: float(sum(o["crash"] for o in units)),
        ),
        figure(
            "field: flights that `health` answers", "high", aloft,
            lambda units: float(sum(o["status"] == 0 for o in units)),
        ),
    ]  # fmt: skip
    if still:
        figures.append(
            figure(
                "field: logs without a flight that it answers", "never", still,
                lambda units: float(sum(o["status"] == 0 for o in units)),
            )
        )  # fmt: skip
    for vehicle, which in (
        ("quiver", [o for o in outcomes if _ONE_DAY.fullmatch(o["log"])]),
        ("greenreaper", [o for o in outcomes if o["folder"] == "greenreaper"]),
    ):
        for name in _SAME:
            found = [o["values"][name] for o in which if name in o["values"]]
            if len(found) >= 3:
                figures.append(
                    figure(
                        f"field, {vehicle}: {name} between flights, chi2/dof, off 1 by a factor",
                        "low", found, _disagreement,
                    )
                )  # fmt: skip
    return figures


def _disagreement(pairs: Sequence[Sequence[float]]) -> float:
    """Of values with standard deviations: by what factor chi-square is off its expectation."""
    values, stds = np.array(pairs).T
    weights = stds**-2.0
    mean = (weights * values).sum() / weights.sum()
    reduced = float((((values - mean) / stds) ** 2).sum()) / max(len(values) - 1, 1)
    return max(reduced, 1.0 / max(reduced, 1e-9))


STUDIES = (
    Study("recorded", _log_units, _log, _log_figures),
    Study("thinned", _thinned_units, _thinned, _thinned_figures),
    Study("field", _field_units, _field, _field_figures),
)
