"""Identification over bad links and with bad sensors, against the same flights undisturbed.

    python -m benchmarks.reliability.degraded [--only SECTION] [--seeds 10] [--processes 2]

Each seed is another vehicle's noise on one mission (PX4's messages, MEMS sensors). A flight is
flown once; what a link does to it is done to its frames, and what arrives is recorded with the
time of its arrival and analyzed as any recording.
"""

import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from benchmarks.reliability.fault_cases import CASES, DROPOUTS, HEADLINE, Case
from gcs_sysid.intervals import Z95
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.results.result import Result
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.telemetry.tlog import read_tlog
from sim_bridge.autopilot import BOOT_US, EPOCH_US
from sim_bridge.bad_line import BadLine
from sim_bridge.line_faults import LineFaults
from sim_bridge.links import TlogLink
from sim_bridge.missions import MISSIONS
from sim_bridge.px4 import Px4
from sim_bridge.sensor_faults import NO_SENSOR_FAULTS, SensorFaults
from sim_bridge.simulation import Simulation
from sim_bridge.vehicle_files import load_vehicle
from testbed.linked import linked
from testbed.study import WORKERS, T, arguments, in_processes, markdown

AIRFRAME = "paper"
NO_LINE = LineFaults()
WRONG = 4.5
"""Standard deviations beyond which a number called identified is wrong: by chance, one in
10 000, where a table has some thousands."""
BACK_WITHIN = 3.0
"""s after a dropout, in which the estimate is to go on."""

SETTLED = 0.1
"""s after a dropout, in which what came before it is still being taken in."""

Tape = list[tuple[list[bytes], int]]
"""Frames sent together, and the vehicle's true time then, us."""


@dataclass(frozen=True)
class Flight:
    """What is flown.

    Attributes:
        mission: of the emulator.
        rate: Hz, of IMU and rotor speeds.
        seconds: s.
    """

    mission: str = "all-axes"
    rate: float = 250.0
    seconds: float = 60.0


@dataclass(frozen=True)
class Outcome:
    """What one analysis said.

    Attributes:
        verdict: of the result.
        error: parameter -> estimate less truth.
        std: parameter -> standard deviation reported; those without one are left out.
        identified: parameters so called.
        used: s of flight that the estimate rests on.
        told: kinds of what the result says happened, and first reason.
    """

    verdict: str
    error: dict[str, float]
    std: dict[str, float]
    identified: frozenset[str]
    used: float
    told: tuple[str, ...] = ()

    @property
    def off(self) -> dict[str, float]:
        """Errors in standard deviations."""
        return {name: self.error[name] / std for name, std in self.std.items()}


@dataclass
class Row:
    """A case over its seeds."""

    outcomes: list[Outcome] = field(default_factory=list)

    def names(self) -> list[str]:
        """Parameters that every seed has."""
        return [n for n in self.outcomes[0].std if all(n in o.std for o in self.outcomes)]

    def rms(self, name: str) -> float:
        """Root of the mean squared error; infinite where a seed gives nothing."""
        return float(np.sqrt(np.mean([o.error.get(name, np.inf) ** 2 for o in self.outcomes])))

    def told(self, name: str) -> float:
        """Root of the mean variance reported."""
        return float(np.sqrt(np.mean([o.std.get(name, np.inf) ** 2 for o in self.outcomes])))

    def held(self, name: str) -> float:
        """Share of 95 % intervals that hold the truth."""
        return float(np.mean([abs(o.off.get(name, 0.0)) <= Z95 for o in self.outcomes]))

    def held_of_all(self) -> float:
        """The same over all parameters."""
        return float(np.mean([abs(v) <= Z95 for o in self.outcomes for v in o.off.values()]))


@lru_cache(maxsize=12)
def fly(flight: Flight, seed: int, sensor_faults: SensorFaults = NO_SENSOR_FAULTS) -> Tape:
    """The frames of one flight; each seed has its own noise."""
    gusts, sensors = np.random.SeedSequence(seed).spawn(2)
    simulation = Simulation(load_vehicle(AIRFRAME), MISSIONS[flight.mission], gusts, 0.0)
    autopilot = Px4(simulation, "mems", 0.02, flight.rate, sensors, sensor_faults)
    tape: Tape = []
    for tick in range(round(flight.seconds / simulation.step_size) + 1):
        if tick:
            simulation.step()
        frames = autopilot.poll(tick)
        if frames:
            tape.append((frames, BOOT_US + tick * simulation.step_us))
    return tape


def record(tape: Tape, faults: LineFaults, seed: int, path: Path) -> None:
    """Write what arrives over the line."""
    line = BadLine(TlogLink(path, recorded=True), faults, np.random.SeedSequence([seed, 0x11FE]))
    for frames, time_us in tape:
        line.send(frames, time_us)
    line.close()


def truth() -> dict[str, float]:
    """Of the vehicle flown."""
    return load_vehicle(AIRFRAME).truth()


def outcome_of(result: Result) -> Outcome:
    """Errors against the truth, of what has an uncertainty."""
    true = truth()
    known = {
        name: e
        for name, e in result.parameters.items()
        if e.value is not None and e.std and name in true
    }
    kinds = Counter(str(event["kind"]) for event in result.events)
    told = [f"{kind} x{n}" if n > 1 else kind for kind, n in kinds.items()]
    return Outcome(
        result.verdict,
        {name: (e.value or 0.0) - true[name] for name, e in known.items()},
        {name: e.std or 0.0 for name, e in known.items()},
        frozenset(name for name, e in known.items() if e.status == "identified"),
        float(result.telemetry.get("used_seconds", 0.0)),
        (*told, *result.reasons[:1]),
    )


def analyzed(case: Case, flight: Flight, seed: int) -> Outcome:
    """One flight with one case's faults."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight.tlog"
        record(fly(flight, seed, case.sensor_faults), case.line, seed, path)
        return outcome_of(analyze_log(path, load_airframe(AIRFRAME)))


@dataclass(frozen=True)
class Return:
    """How an estimate came back after a dropout.

    Attributes:
        end: s after the start, when the dropout ended.
        back: s from then until data were used again.
        then: the estimate `BACK_WITHIN` s after the dropout.
    """

    end: float
    back: float
    then: Outcome


def returns(case: Case, flight: Flight, seed: int) -> list[Return]:
    """Take a flight as a live session does, and look how it comes back after each dropout."""
    span = case.line.silence
    assert span is not None
    ends = np.arange(span.start + span.length, flight.seconds - BACK_WITHIN, span.every)
    found: list[Return] = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight.tlog"
        record(fly(flight, seed), case.line, seed, path)
        chain, link = linked(load_airframe(AIRFRAME))
        waiting = ends.tolist()
        used, back = None, np.inf
        for time_us, frame in read_tlog(path):
            now = 1e-6 * (time_us - EPOCH_US - BOOT_US)
            if waiting and now >= waiting[0]:
                seconds = 0.0 if chain.estimator is None else chain.estimator.seconds
                if now < waiting[0] + SETTLED:
                    used = seconds
                if used is not None and seconds > used and back == np.inf:
                    back = now - waiting[0]
                if now >= waiting[0] + BACK_WITHIN:
                    chain.take(link.rest())
                    then = outcome_of(chain.result())
                    found.append(Return(waiting.pop(0), back, then))
                    used, back = None, np.inf
            chain.take(link.gather([frame]))
    return found


def several(cases: Sequence[Case], flight: Flight, seed: int) -> list[Outcome]:
    """One flight with each case's faults; flown once for all faults of the line."""
    return [analyzed(case, flight, seed) for case in cases]


def over_seeds(work: Callable[[int], T], seeds: int, processes: int, label: str) -> list[T]:
    """Outcomes of seeds 1 to n."""
    return in_processes(work, range(1, seeds + 1), processes, label)


def headline(flight: Flight, seeds: int, processes: int) -> list[str]:
    """Clean against 20 % loss, 5 % reordering and 20 ms jitter, parameter by parameter."""
    cases = (Case("clean"), HEADLINE)
    found = over_seeds(partial(several, cases, flight), seeds, processes, HEADLINE.name)
    rows = {case.name: Row([o[i] for o in found]) for i, case in enumerate(cases)}
    clean, bad = rows.values()
    lines = [
        f"## {HEADLINE.name}: {flight.mission}, {flight.rate:.0f} Hz, {seeds} seeds",
        "",
        *markdown(
            "parameter | clean: rms error, std told | rms error, std told | times clean | "
            "intervals that hold: clean | "
        ),
    ]
    true = truth()
    for name in clean.names():
        unit = abs(true[name]) / 100.0 or 1.0
        sign = " %" if true[name] else ""
        cells = [
            f"{row.rms(name) / unit:.3g}{sign}, {row.told(name) / unit:.3g}{sign}"
            for row in (clean, bad)
        ]
        lines.append(
            f"| {name} | {' | '.join(cells)} | {bad.rms(name) / clean.rms(name):.2f} "
            f"| {100 * clean.held(name):.0f} % | {100 * bad.held(name):.0f} % |"
        )
    for name, row in rows.items():
        verdicts = Counter(o.verdict for o in row.outcomes)
        used = np.mean([o.used for o in row.outcomes])
        lines.append(
            f"\n{name}: {dict(verdicts)}, {100 * row.held_of_all():.1f} % of intervals hold, "
            f"{used:.1f} s of {flight.seconds:.0f} s used"
        )
    return lines


def dropouts(flight: Flight, seeds: int, processes: int) -> list[str]:
    """How soon an estimate goes on after the link was silent."""
    lines = [
        "## Dropouts of the whole link",
        "",
        *markdown(
            "link | returns | data used again after, worst | intervals that hold then | "
            "worst error, std"
        ),
    ]
    for case in DROPOUTS:
        found = [
            r
            for one in over_seeds(partial(returns, case, flight), seeds, processes, case.name)
            for r in one
        ]
        off = [abs(v) for r in found for v in r.then.off.values()]
        lines.append(
            f"| {case.name} | {len(found)} | {max(r.back for r in found):.2f} s "
            f"| {100 * np.mean(np.array(off) <= Z95):.1f} % | {max(off):.1f} |"
        )
    return lines


def table(flight: Flight, seeds: int, processes: int, cases: Sequence[Case] = CASES) -> list[str]:
    """Every fault alone, and some together."""
    lines = [
        f"## Every fault: {flight.mission} for {flight.seconds:.0f} s, {flight.rate:.0f} Hz, "
        f"{seeds} seeds",
        "",
        *markdown(
            "fault | verdict | used | rms error, times clean (median, worst) | "
            "intervals that hold | worst error, std | wrong | told"
        ),
    ]
    clean: Row | None = None
    for case in cases:
        if case.sensor_faults == NO_SENSOR_FAULTS:
            for seed in range(1, seeds + 1):
                fly(flight, seed)  # once for all faults of the line: forked children have it
        row = Row(over_seeds(partial(analyzed, case, flight), seeds, processes, case.name))
        clean = clean or row
        lines.append(line_of(case.name, row, clean))
        print(lines[-1], file=sys.stderr, flush=True)
    return lines


def line_of(name: str, row: Row, clean: Row) -> str:
    """A line of the table."""
    verdicts = Counter(o.verdict for o in row.outcomes)
    verdict = ", ".join(
        f"{word} {n}" if len(verdicts) > 1 else word for word, n in verdicts.items()
    )
    used = f"{np.mean([o.used for o in row.outcomes]):.1f} s"
    told = "; ".join(dict.fromkeys(t for o in row.outcomes for t in o.told))
    if not any(o.std for o in row.outcomes):
        return f"| {name} | {verdict} | {used} | - | - | - | no | {told} |"
    common = [n for n in row.names() if n in clean.names()]
    times = sorted(row.rms(n) / clean.rms(n) for n in common) or [float("nan")]
    worst_name, worst = max(
        ((n, abs(v)) for o in row.outcomes for n, v in o.off.items()), key=lambda pair: pair[1]
    )
    wrong = sorted(
        {n for o in row.outcomes for n, v in o.off.items() if n in o.identified and abs(v) > WRONG}
    )
    return (
        f"| {name} | {verdict} | {used} | {np.median(times):.1f}, {times[-1]:.1f} "
        f"| {100 * row.held_of_all():.0f} % | {worst:.1f} ({worst_name}) "
        f"| {', '.join(wrong) or 'no'} | {told} |"
    )


SECTIONS = ("headline", "dropouts", "table")


def main(argv: Sequence[str] | None = None) -> None:
    """Run what is asked for and print it."""
    parser = arguments(__doc__)
    parser.add_argument("--only", choices=SECTIONS, action="append", help="may be repeated")
    parser.add_argument("--case", action="append", help="of the table: those whose name has this")
    parser.add_argument("--seeds", type=int, help="default: 10; 3 for the table")
    parser.add_argument("--mission", choices=sorted(MISSIONS), default="all-axes")
    parser.add_argument("--rate", type=float, default=250.0, help="Hz (default: 250)")
    parser.add_argument("--duration", type=float, help="s (default: 60; 40 for the table)")
    parser.add_argument("--processes", type=int, default=WORKERS)
    options = parser.parse_args(argv)
    flight = Flight(options.mission, options.rate, options.duration or 60.0)
    chosen = options.only or SECTIONS
    if "headline" in chosen:
        print("\n".join(headline(flight, options.seeds or 10, options.processes)), "\n")
    if "dropouts" in chosen:
        print("\n".join(dropouts(flight, options.seeds or 10, options.processes)), "\n")
    if "table" in chosen:
        shorter = Flight(options.mission, options.rate, options.duration or 40.0)
        wanted = options.case or [""]
        cases = [c for c in CASES if c is CASES[0] or any(word in c.name for word in wanted)]
        print("\n".join(table(shorter, options.seeds or 3, options.processes, cases)))


if __name__ == "__main__":
    main()
