"""Recorded flights with a known truth: a folder's logs, with the airframes and truths beside them.

A log's truth is the .truth.json of its name, else that of its family (the CineRat's pendulum and
bench values, which are themselves good to some 10 %; its Ixx and Iyy are those of throws without
feedback, as in `real_flights`, and not known of the flight with a camera). Keys come in several
spellings.
"""

import json
from pathlib import Path
from typing import Any

from benchmarks.recorded import airframe_for, logs_in
from benchmarks.truth.emulated import Truth
from benchmarks.truth.judge import judge
from benchmarks.truth.real_flights import OPEN_LOOP

_FAMILIES = {"LOG00": "cinerat"}
_WITH_CAMERA = "LOG00340"
_SPELLINGS = {
    "ixx": "Ixx", "iyy": "Iyy", "izz": "Izz", "ixy": "Ixy", "iyz": "Iyz", "ixz": "Ixz",
    "kT": "k_T", "kT_N_per_rad2": "k_T", "kM": "k_M", "t_max": "T_max", "kdv": "linear_drag",
    "kdw": "rotational_damping", "t_tau": "motor_lag",
}  # fmt: skip


def truth_file(log: Path) -> Path | None:
    """Where a log's truth is; None: nowhere."""
    own = log.with_suffix(".truth.json")
    if own.exists():
        return own
    for begin, name in _FAMILIES.items():
        shared = log.with_name(f"{name}.truth.json")
        if log.name.startswith(begin) and shared.exists():
            return shared
    return None


def truth_of(log: Path) -> tuple[Truth, bool]:
    """True parameters of a log with a `truth_file`, and whether the vehicle changes in flight."""
    path = truth_file(log)
    assert path is not None
    truth, changes = _read(path)
    if path.name == f"{_FAMILIES['LOG00']}.truth.json":
        known = {} if log.name.startswith(_WITH_CAMERA) else OPEN_LOOP
        truth = {name: v for name, v in truth.items() if name not in OPEN_LOOP} | known
    return truth, changes


def _read(path: Path) -> tuple[Truth, bool]:
    """As `truth_of`, by the names of a result."""
    table: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    truth: Truth = {}
    for key, value in table.items():
        name = _SPELLINGS.get(key, key)
        if _is_number(value) or (isinstance(value, list) and all(map(_is_number, value))):
            truth[name] = value
    if "cg_m" in table:
        truth["cg_x"], truth["cg_y"] = table["cg_m"][:2]
    if "q_max" in table:
        truth["moment_ratio"] = table["q_max"] / table["t_max"]
    if "kdw" in table:
        truth["thrust_curve"] = 0.0
    elif "k_T" in truth and "k_M" in truth and "moment_ratio" not in truth:
        truth["moment_ratio"] = truth["k_M"] / truth["k_T"]
    if "kT" in table:
        # ArduPilot's simulator has drag and damping of its own kind.
        truth = {n: v for n, v in truth.items() if "drag" not in n and "damping" not in n}
    changes = any("mass_after" in event for event in table.get("events", []))
    if changes and "mass_after" in table:
        truth["mass"] = table["mass_after"]  # a result is of the vehicle as it was last
    return truth, changes


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def cases(folder: Path) -> dict[str, list[Path]]:
    """Logs with a truth by the name of the folder they lie in."""
    found: dict[str, list[Path]] = {}
    for log in logs_in([folder]):
        if truth_file(log) is not None:
            place = log.parent.name if log.parent != folder else "autopilots' simulators"
            found.setdefault(place, []).append(log)
    return found


def run(log: Path) -> dict[str, Any]:
    """One log's outcome."""
    truth, changes = truth_of(log)
    out = judge(log, airframe_for(log), truth, peer=log.suffix == ".tlog")
    out["vehicle"] = log.name
    if changes:
        # Some of what it tells is so; others count that.
        out["events"] = []
    return out
