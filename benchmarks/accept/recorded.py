"""Studies on recorded flights: with a truth, of one real vehicle, thinned, of other people.

Every log is analyzed once. A .truth.json beside it may list a true change: `mass_after` and, under
`events`, the Unix time at which that came into force; other logs have none.
"""

import json
import math
import re
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.accept.emulated import claim_figures
from benchmarks.accept.judge import Figure, Study, coverage, figure, share
from benchmarks.truth.real_flights import FLIGHTS
from gcs_sysid.arrays import Array, Mask
from gcs_sysid.errors import InputError
from gcs_sysid.model.parameters import REGISTRY
from gcs_sysid.results.history import History
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.session.chain import Chain, ChainOptions
from gcs_sysid.signals.sampling import SampleBlock
from gcs_sysid.significance import Z95
from gcs_sysid.telemetry.tlog import TlogReader
from testbed import judge as truth_judge
from testbed import recordings, study
from testbed.hover_flights import between_flights
from testbed.recordings import AIR_TIMES, OPEN_LOOP, SHARED, given

Outcomes = Sequence[dict[str, Any]]
Change = tuple[float, float, float]
"""s, kg, kg: when the mass changed, from and to what."""
LANDING = 0.5
"""s within which a landing is to be found."""
_SAME, _LATER = 2.0, 20.0
"""s within which a change called is the true one; after it, when mass and inertia are looked at."""
_SHOWN = ("mass", "Ixx", "Iyy", "Izz")

# ---- logs with a truth, and changes in all of them -------------------------------------------


def _log_units(is_short: bool) -> list[str]:
    logs = [log for log in recordings.logs_in([SHARED]) if "field" not in log.parts]
    if is_short:
        logs = [log for log in logs if log.name in ("c_3.tlog", "LOG00267.tlog")]
    return [str(log) for log in sorted(logs, key=lambda log: -log.stat().st_size)]


@dataclass
class _Onlooker:
    """Keeps when the vehicle flew, and the history of its estimates."""

    t: list[Array] = field(default_factory=list)
    flies: list[Mask] = field(default_factory=list)
    history: History | None = None

    def begin(self) -> None:
        self.t, self.flies = [], []

    def take(self, block: SampleBlock) -> None:
        self.t.append(block.t)
        self.flies.append(block.flying)

    def end(self, chain: Chain) -> None:
        self.history = chain.history


def _log(unit: str) -> dict[str, Any]:
    log, seen = Path(unit), _Onlooker()
    change = change_in(log)
    options = truth_judge.OPTIONS if change is None else ChainOptions(history_interval=1.0)
    try:
        result = analyze_log(log, recordings.airframe_for(log), options=options, observers=[seen])
    except InputError as error:
        return {"log": log.name, "verdict": "refused", "error": str(error), "false": []}
    t, flies = (np.concatenate(parts or [np.zeros(1)]) for parts in (seen.t, seen.flies))
    flies = flies.astype(bool)
    called = [e for e in result.events if "detected" in e and e["kind"] != "disturbance"]
    found = next((e for e in called if change and abs(e["t"] - change[0]) < _SAME), None)
    out: dict[str, Any] = {
        "log": log.name,
        "verdict": result.verdict,
        "rotor_input": str(result.rotor_input),
        "false": [f"{e['kind']}@{e['t']:.1f}" for e in called if e is not found],
        "disturbances": sum(e["kind"] == "disturbance" for e in result.events),
        "landings": _landings(log, t[flies]),
        "used": float(result.telemetry["used_seconds"]),
        "airborne": float(np.sum(np.diff(t, append=t[-1]) * flies)),
        "moments": {
            name: [e.value, e.std, e.status]
            for name, e in result.parameters.items()
            if name in (*OPEN_LOOP, "k_T")
        },
    }
    known = recordings.truth_file(log) is not None
    if known and change is None and recordings.is_changed_in_flight(log):
        out["false"] = out["false"][1:]  # of a payload on the ground one is called at the landing
    truth = recordings.truth_of(log) if known else {}
    if change is not None:
        decided = found["decided"] if found and found.get("decided") else None
        out["delay"] = None if decided is None else decided - change[0]
        values = {name: result.parameters[name].value for name in _SHOWN}
        out["at the end"] = _errors(values, truth)
        history = seen.history
        if history is not None and len(history.t):
            k = min(int(np.searchsorted(history.t, change[0] + _LATER)), len(history.t) - 1)
            out[f"after {_LATER:.0f} s"] = _errors(
                {name: float(history.value[name][k]) for name in _SHOWN}, truth
            )
    if known:
        out["judged"] = truth_judge.outcome(result, truth)
        if recordings.is_changed_in_flight(log):
            out["judged"]["events"] = []
    return out


def change_in(log: Path) -> Change | None:
    """When and by how much the mass truly changed in flight."""
    file = log.with_suffix(".truth.json")
    truth = json.loads(file.read_text()) if file.exists() else {}
    for event in truth.get("events", ()):
        if "mass_after" in event and log.suffix == ".tlog":
            began, _ = next(iter(TlogReader(log)))
            return event["unix"] - 1e-6 * began, truth["mass"], event["mass_after"]
    return None


def _landings(log: Path, aloft: Array) -> list[float]:
    """How late each true landing was found, s."""
    late = []
    for start, end in AIR_TIMES.get(log.stem, ()):
        flown = aloft[(aloft > start) & (aloft < end + 2.0 * LANDING)]
        late.append(float(flown[-1]) - end if len(flown) else math.inf)
    return late


def _errors(values: dict[str, float | None], truth: dict[str, Any]) -> list[float]:
    """In % of the truth."""
    return [100.0 * ((values[n] or math.nan) / truth[n] - 1.0) for n in _SHOWN]


def _log_details(outcomes: Outcomes) -> list[str]:
    """What was found in each log, and every judged parameter's error and half width."""
    lines = [
        f"{'log':<40}{'verdict':<11}{'in air s':>9}{'used s':>8}{'disturbances':>13}"
        f"{'landings late s':>18}  false changes"
    ]
    for o in outcomes:
        if "landings" not in o:
            lines.append(f"{o.get('log', '-'):<40}{o.get('error', 'not judged: see the defects')}")
            continue
        late = " ".join(f"{s:.2f}" for s in o["landings"])
        lines.append(
            f"{o['log']:<40}{o['verdict']:<11}{o['airborne']:9.1f}{o['used']:8.1f}"
            f"{o['disturbances']:13d}{late:>18}  {' '.join(o['false']) or '-'}"
        )
        if "delay" in o:
            told = "never" if o["delay"] is None else f"after {o['delay']:.1f} s"
            lines.append(f"    the change is called {told}")
        for when in ("at the end", f"after {_LATER:.0f} s"):
            if when in o:
                errors = zip(_SHOWN, o[when], strict=True)
                lines.append(f"    {when}: {', '.join(f'{n} {e:+.2f} %' for n, e in errors)}")
        for name, found in o.get("judged", {}).get("parameters", {}).items():
            unit, scale = (" %", 100.0) if REGISTRY.get(name) and found["z"] else ("", 1.0)
            half = Z95 * abs(found["error"] / found["z"]) if found["z"] else math.nan
            lines.append(
                f"    {name:<20}{scale * found['error']:>10.3g}{unit:<2}"
                f"{scale * half:>10.3g}{unit:<2}  {'holds' if found['holds'] else 'MISSES'}"
                f"  {found['status'] if found['status'] != 'identified' else ''}".rstrip()
            )
    return lines


def _log_figures(outcomes: Outcomes) -> list[Figure]:
    judged = [o["judged"] for o in outcomes if "judged" in o]
    landings = [abs(s) for o in outcomes for s in o.get("landings", ())]
    figures = claim_figures("recorded", judged) if judged else []
    figures += [
        figure(
            "recorded: false changes in all logs", "never", outcomes,
            lambda units: float(sum(len(o["false"]) for o in units)),
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
                _rms,
            )
        )  # fmt: skip
    for o in outcomes:
        if "at the end" in o:
            late = math.inf if o["delay"] is None else o["delay"]
            figures += [
                Figure("recorded change: called after, s", "low", late, 0.5, "1, a look"),
                Figure(
                    "recorded change: mass and inertia, rms error %", "low",
                    _rms(o["at the end"]), 0.5, "1, half widths of 1 %",
                ),
            ]  # fmt: skip
    return figures + _real_figures([o for o in outcomes if o["log"] in FLIGHTS])


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


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
    return [] if is_short else [(name, seed) for name in found for seed in (1, 2)]


def _thinned(unit: tuple[str, int]) -> dict[str, Any]:
    name, seed = unit
    log = SHARED / name
    truth, airframe = recordings.truth_of(log), recordings.airframe_for(log)
    with tempfile.TemporaryDirectory() as folder:
        thin = recordings.thinned(log, Path(folder) / name, seed)
        return truth_judge.judge(thin, airframe, truth)


def _thinned_figures(outcomes: Outcomes) -> list[Figure]:
    return [f for f in claim_figures("thinned", outcomes) if "false changes" not in f.name]


# ---- logs of other people --------------------------------------------------------------------

NOT_IN_THE_AIR = {
    "bench-run-pt2-002.bin", "ground-run-pt1-082.bin", "groundlink-log_2.bin",
    "idle-on-ground-118.bin", "jschall_quad_mav1_2014.tlog", "geprc-on-the-ground.bbl",
    "greenreaper06-idle-on-the-ground.bfl", "hiro-no-accelerometer.bfl",
    "baseflight2016-zero-accelerometer.TXT", "inav9-s-predictor.TXT", "pisun006.bbl",
    "speedybee002.bbl", "groundlink-d2_log_1.bin", "nan.log", "y6b-2014.bin",
}  # fmt: skip
"""On the ground, on a bench, in a hand, without an accelerometer or outputs: no hover in them."""
_ONE_DAY = re.compile(r"000001[2]\d\.BIN")
"""Flights of one vehicle, one battery, one day."""
_REPEATED = ("k_T", "thrust_to_weight", "cg x", "cg y", "yaw_imbalance", "hover_throttle")


def _field_units(is_short: bool) -> list[str]:
    folder = SHARED / "field"
    files = sorted(f for f in folder.rglob("*") if f.suffix.lower() in
                   (".bin", ".bfl", ".bbl", ".ulg", ".tlog", ".txt", ".log"))  # fmt: skip
    return [str(f) for f in files][:: 12 if is_short else 1]


def _field(unit: str) -> dict[str, Any]:
    log = Path(unit)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "health.json"
        done = study.run(("gcs_sysid", "health", unit, *given(log), "--json", str(out)))
        told = json.loads(out.read_text()) if out.exists() else {}
    found: dict[str, Any] = {"log": log.name, "folder": log.parent.name, "status": done.status}
    found["said"] = done.said.strip()[-200:]
    found["crash"] = done.status not in (0, 1, 2) or "internal error" in done.said
    found["crash"] |= "Traceback" in done.said or "Warning" in done.said
    cg = told.get("cg") or {}
    values = {**told, "cg x": cg.get("x"), "cg y": cg.get("y")}
    found["values"] = {
        name: [values[name]["value"], values[name]["std_data"]]
        for name in _REPEATED
        if isinstance(values.get(name), dict) and values[name].get("std_data")
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
        share("field: flights that `health` answers, %", [o["status"] == 0 for o in aloft]),
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
        for name in _REPEATED:
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
    reduced = between_flights(pairs)
    return max(reduced, 1.0 / max(reduced, 1e-9))


STUDIES = (
    Study("recorded", _log_units, _log, _log_figures, _log_details),
    Study("thinned", _thinned_units, _thinned, _thinned_figures),
    Study("field", _field_units, _field, _field_figures),
)
