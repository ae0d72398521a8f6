"""Changes, landings and air time found in recorded flights, and what they are to be.

Part of `benchmarks.changes logs`. Airframes are found as by `benchmarks.recorded`. A .truth.json
beside a log may list a true change: `mass_after` and, under `events`, the Unix time at which
`mass_after` came into force. Other logs have none.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.recorded import airframe_for, logs_in, truth_of
from gcs_sysid.arrays import Array, Mask
from gcs_sysid.errors import InputError
from gcs_sysid.intervals import Z95
from gcs_sysid.results.result import Result
from gcs_sysid.results.snapshot import History
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.session.chain import Chain
from gcs_sysid.session.chain_options import ChainOptions
from gcs_sysid.signals.samples import NEEDED_RATE
from gcs_sysid.signals.sampling import SampleBlock
from gcs_sysid.telemetry.tlog import read_tlog

AIR_TIMES: dict[str, list[tuple[float, float]]] = {
    "LOG00230": [(9.65, 20.21)], "LOG00259": [(0.96, 6.65)], "LOG00264": [(0.93, 7.38)],
    "LOG00267": [(0.96, 24.17), (24.93, 31.12)], "LOG00269": [(0.96, 19.88), (20.58, 23.08)],
    "LOG00271": [(0.95, 7.97)], "LOG00277": [(0.95, 11.39), (12.83, 14.28)],
    "LOG00281": [(0.94, 42.79)], "LOG00340": [(2.63, 17.60)], "LOG00267_cmd": [
        (0.96, 24.17), (24.93, 31.12)], "LOG00267_cmd_floor1000": [(0.96, 24.17), (24.93, 31.12)],
}  # fmt: skip
"""s in the air, by height above the ground; of the hand throw (230), from its release on."""
LANDING, LATER = 0.5, 20.0
"""s within which a landing is to be found; after a change, when mass and inertia are looked at."""
_SAME = 2.0
"""s within which a change called is the true one."""
_INERTIA = ("Ixx", "Iyy", "Izz")


@dataclass
class Flown:
    """A log's result, and when the vehicle counted as flying.

    Attributes:
        log: analyzed.
        result: of all of it.
        t: (n,) s of the samples.
        flies: (n,) whether it flies.
        history: of the estimates, where a true change makes that worth while.
        change: (s, kg, kg) when the mass changed, from and to what; None: it did not.
    """

    log: Path
    result: Result
    t: Array
    flies: Mask
    history: History | None
    change: tuple[float, float, float] | None

    @property
    def called(self) -> list[dict[str, Any]]:
        """The changes that were called."""
        events = self.result.events
        return [e for e in events if "detected" in e and e["kind"] != "disturbance"]

    @property
    def found(self) -> dict[str, Any] | None:
        """The true one among them."""
        if self.change is None:
            return None
        return next((e for e in self.called if abs(e["t"] - self.change[0]) < _SAME), None)

    @property
    def false(self) -> list[dict[str, Any]]:
        """The others."""
        return [e for e in self.called if e is not self.found]

    @property
    def landings(self) -> list[float]:
        """How late each true landing was found, s."""
        errors = []
        for start, end in AIR_TIMES.get(self.log.stem, ()):
            aloft = self.t[self.flies & (self.t > start) & (self.t < end + 2.0 * LANDING)]
            errors.append(float(aloft[-1]) - end if len(aloft) else np.inf)
        return errors

    @property
    def used(self) -> float:
        """Flight that the result rests on, s."""
        return float(self.result.telemetry["used_seconds"])

    @property
    def is_usable(self) -> bool:
        """Whether IMU and rotors are there, and fast enough."""
        told = self.result.telemetry
        rate = told.get("grid_rate") or 0.0
        return rate >= 0.9 * NEEDED_RATE and told["rotor_input"]["source"] is not None

    @property
    def airborne(self) -> float:
        """What counts as flight, s."""
        return float(np.sum(np.diff(self.t, append=self.t[-1]) * self.flies))


@dataclass
class _Blocks:
    """Keeps when it flew, and the history."""

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


def fly(log: Path) -> Flown:
    """Analyze a log.

    Raises:
        InputError: it cannot be read.
    """
    change, blocks = change_in(log), _Blocks()
    options = ChainOptions(history_interval=None if change is None else 1.0)
    result = analyze_log(log, airframe_for(log), options=options, observer=blocks)
    t, flies = np.zeros(1), np.zeros(1, dtype=bool)
    if blocks.t:
        t, flies = np.concatenate(blocks.t), np.concatenate(blocks.flies)
    return Flown(log, result, t, flies, blocks.history, change)


def change_in(log: Path) -> tuple[float, float, float] | None:
    """When and by how much the mass truly changed, as of `Flown.change`."""
    file = log.with_suffix(".truth.json")
    truth = json.loads(file.read_text()) if file.exists() else {}
    for event in truth.get("events", ()):
        if "mass_after" in event and log.suffix == ".tlog":
            began, _ = next(iter(read_tlog(log)))
            return event["unix"] - 1e-6 * began, truth["mass"], event["mass_after"]
    return None


def logs(paths: Sequence[Path]) -> int:
    """List what is found in recorded flights, then the bars; how many changes were false.

    Raises:
        InputError: a file or folder is not there.
    """
    missing = [path for path in paths if not path.exists()]
    if missing:
        raise InputError(f"{missing[0]}: no such file or folder")
    all_flown, false = [], 0
    print(
        f"{'log':<36}{'verdict':<11}{'in air s':>9}{'used s':>8}{'disturbances':>13}"
        f"{'landings late s':>18}  changes called"
    )
    for log in logs_in(list(paths)):
        try:
            flown = fly(log)
        except InputError as error:
            print(f"{log.name:<36}{error}")
            continue
        all_flown.append(flown)
        false += len(flown.false)
        told = [f"{e['kind']}@{e['t']:.1f}" for e in flown.called]
        others = sum(e["kind"] == "disturbance" for e in flown.result.events)
        late = " ".join(f"{s:.2f}" for s in flown.landings)
        print(
            f"{log.name:<36}{flown.result.verdict:<11}{flown.airborne:9.1f}{flown.used:8.1f}"
            f"{others:13d}{late:>18}  {' '.join(told) or '-'}",
            flush=True,
        )
    print("\nbars:")
    for flown in all_flown:
        if flown.change is not None:
            _tell_change(flown)
        elif "unchanged" in flown.log.stem:
            _tell_unchanged(flown)
    errors = [abs(s) for flown in all_flown for s in flown.landings]
    if errors:
        late = sum(e > LANDING for e in errors)
        _tell("landings", f"{len(errors)}, at most {max(errors):.2f} s off", not late)
    idle = [f for f in all_flown if f.airborne > 1.0 and not f.used]
    slow = [f.log.name for f in idle if not f.is_usable]
    unused = [f.log.name for f in idle if f.is_usable]
    _tell("flights of which 0 s were used", ", ".join(unused) or "none", not unused)
    if slow:
        print(f"    besides, refused as too slow or without rotors: {', '.join(slow)}")
    _tell("false changes", f"{false} in {len(all_flown)} logs", not false)
    return false


def _tell_unchanged(flown: Flown) -> None:
    name, truth = flown.log.stem, truth_of(flown.log)
    values = flown.result.parameters
    off = {n: values[n].value / truth[n] - 1.0 for n in ("T_max", *_INERTIA) if values[n].value}
    held = [
        n for n, e in values.items()
        if e.status in ("identified", "weak") and truth.get(n) is not None and e.std
        and abs(e.value - truth[n]) <= Z95 * e.std
    ]  # fmt: skip
    judged = [
        n for n, e in values.items()
        if e.status in ("identified", "weak") and truth.get(n) is not None and e.std
    ]  # fmt: skip
    called = len(flown.called)
    _tell(f"{name}: changes called", f"{called}", not called)
    thrust, worst = off.get("T_max", np.nan), max(abs(off.get(n, np.nan)) for n in _INERTIA)
    _tell(f"{name}: T_max", f"{100.0 * thrust:+.2f} % off", abs(thrust) < 0.01)
    _tell(f"{name}: inertia", f"at most {100.0 * worst:.2f} % off", worst < 0.02)
    missed = sorted(set(judged) - set(held))
    says = f"{len(held)} of {len(judged)} hold{', not ' + ', '.join(missed) if missed else ''}"
    _tell(f"{name}: intervals", says, not missed)


def _tell_change(flown: Flown) -> None:
    assert flown.change is not None
    name, (at, _, mass), event = flown.log.stem, flown.change, flown.found
    says = f"at {at:.1f} s, not called"
    if event is not None:
        delay = event["decided"] - at if event.get("decided") else np.nan
        says = (
            f"{event['kind']}, {event['t'] - at:+.1f} s from {at:.1f} s, called after {delay:.1f} s"
        )
    _tell(f"{name}: change", says, event is not None and event["kind"] == "mass_change")
    _tell(f"{name}: false changes", f"{len(flown.false)}", not flown.false)
    truth = truth_of(flown.log) | {"mass": mass}
    values = flown.result.parameters
    last = {n: values[n].value or np.nan for n in ("mass", *_INERTIA)}
    history = flown.history
    if history is not None and len(history.t):
        k = min(int(np.searchsorted(history.t, at + LATER)), len(history.t) - 1)
        _tell_errors(
            f"{name}: after {history.t[k] - at:.0f} s",
            {n: float(history.value[n][k]) for n in last}, truth,
        )  # fmt: skip
    _tell_errors(f"{name}: at the end", last, truth)


def _tell_errors(what: str, values: dict[str, float], truth: dict[str, float]) -> None:
    off = {n: value / truth[n] - 1.0 for n, value in values.items()}
    worst = max(abs(off[n]) for n in _INERTIA)
    says = f"mass {100.0 * off['mass']:+.2f} %, inertia at most {100.0 * worst:.2f} % off"
    _tell(what, says, abs(off["mass"]) < 0.03 and worst < 0.03)


def _tell(what: str, says: str, met: bool) -> None:
    print(f"  {what:<54}{says:<58}{'met' if met else 'NOT MET'}", flush=True)
