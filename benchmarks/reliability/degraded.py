"""Identification over bad links and with bad sensors, against the same flights undisturbed.

    python -m benchmarks.reliability.degraded [--only SECTION] [--seeds 10] [--processes 2]

Each seed is another vehicle's noise on one mission (PX4's messages, MEMS sensors). A flight is
flown once; what a link does to it is done to its frames, and what arrives is recorded with the
time of its arrival and analyzed as any recording.
"""

import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.reliability.fault_cases import CASES, DROPOUTS, HEADLINE, Case
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.results.result import Result
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.significance import Z95
from gcs_sysid.telemetry.tlog import TlogReader
from sim_bridge.autopilot import BOOT_US, EPOCH_US
from sim_bridge.bad_line import BadLine
from sim_bridge.links import TlogLink
from sim_bridge.missions import MISSIONS
from sim_bridge.px4 import Px4
from sim_bridge.sensor_faults import NO_SENSOR_FAULTS, SensorFaults
from sim_bridge.simulation import Simulation
from sim_bridge.vehicle_files import load_vehicle
from testbed.linked import linked
from testbed.study import WORKERS, T, arguments, in_processes, markdown

AIRFRAME = "paper"
WRONG = 4.5
"""Standard deviations beyond which a number called identified is wrong: by chance, one in
10 000, where a table has some thousands."""
BACK_WITHIN = 3.0
"""s after a dropout, in which the estimate is to go on."""
SETTLED = 0.1
"""s after a dropout, in which what came before it is still being taken in."""
Tape = list[tuple[list[bytes], int]]
"""Frames sent together, and the vehicle's true time then, us."""


class Flight(NamedTuple):
    """What is flown: a mission of the emulator, Hz of IMU and rotor speeds, s."""

    mission: str = "all-axes"
    rate: float = 250.0
    seconds: float = 60.0


class Outcome(NamedTuple):
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
    told: tuple[str, ...]

    def off(self) -> dict[str, float]:
        """Sizes of the errors in standard deviations."""
        return {name: abs(self.error[name]) / std for name, std in self.std.items()}


Row = list[Outcome]
"""A case over its seeds."""


def names_in(row: Row) -> list[str]:
    """Parameters that every seed has."""
    return [n for n in row[0].std if all(n in o.std for o in row)]


def rms(row: Row, name: str, of: str = "error") -> float:
    """Of an error, or of what was reported; infinite where a seed gives nothing."""
    return float(np.sqrt(np.mean([getattr(o, of).get(name, np.inf) ** 2 for o in row])))


def held(row: Row, *names: str) -> float:
    """% of 95 % intervals that hold the truth, of some parameters or of all."""
    off = [v for o in row for n, v in o.off().items() if not names or n in names]
    return 100.0 * float(np.mean(np.array(off) <= Z95)) if off else 100.0


@lru_cache(maxsize=12)
def fly(flight: Flight, seed: int, sensor_faults: SensorFaults = NO_SENSOR_FAULTS) -> Tape:
    """The frames of one flight; each seed has its own noise."""
    gusts, sensors = np.random.SeedSequence(seed).spawn(2)
    simulation = Simulation(load_vehicle(AIRFRAME), MISSIONS[flight.mission], gusts, 0.0)
    autopilot = Px4(simulation, "mems", 0.02, flight.rate, sensors, sensor_faults)
    autopilot.show_parameters()
    tape: Tape = []
    for tick in range(round(flight.seconds / simulation.step_size) + 1):
        if tick:
            simulation.step()
        frames = autopilot.poll(tick)
        if frames:
            tape.append((frames, BOOT_US + tick * simulation.step_us))
    return tape


def record(case: Case, flight: Flight, seed: int, folder: str) -> Path:
    """Write what arrives over the line."""
    path = Path(folder) / "flight.tlog"
    link = TlogLink(path, recorded=True)
    line = BadLine(link, case.line, np.random.SeedSequence([seed, 0x11FE]))
    for frames, time_us in fly(flight, seed, case.sensor_faults):
        line.send(frames, time_us)
    line.close()
    return path


def outcome_of(result: Result) -> Outcome:
    """Errors against the truth, of what has an uncertainty."""
    true = load_vehicle(AIRFRAME).truth()
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
        return outcome_of(analyze_log(record(case, flight, seed, folder), load_airframe(AIRFRAME)))


class Return(NamedTuple):
    """How an estimate came back after a dropout.

    Attributes:
        back: s from its end until data were used again.
        then: the estimate `BACK_WITHIN` s after its end.
    """

    back: float
    then: Outcome


def returns(case: Case, flight: Flight, seed: int) -> list[Return]:
    """Take a flight as a live session does, and look how it comes back after each dropout."""
    span = case.line.silence
    assert span is not None
    ends = np.arange(span.start + span.length, flight.seconds - BACK_WITHIN, span.every)
    found: list[Return] = []
    with tempfile.TemporaryDirectory() as folder:
        chain, link = linked(load_airframe(AIRFRAME))
        waiting = ends.tolist()
        used, back = None, np.inf
        for time_us, frame in TlogReader(record(case, flight, seed, folder)):
            now = 1e-6 * (time_us - EPOCH_US - BOOT_US)
            if waiting and now >= waiting[0]:
                seconds = 0.0 if chain.estimator is None else chain.estimator.seconds
                if now < waiting[0] + SETTLED:
                    used = seconds
                if used is not None and seconds > used and back == np.inf:
                    back = now - waiting[0]
                if now >= waiting[0] + BACK_WITHIN:
                    chain.take(link.rest())
                    found.append(Return(back, outcome_of(chain.result())))
                    waiting.pop(0)
                    used, back = None, np.inf
            chain.take(link.gather([frame]))
    return found


def over_seeds(work: Callable[[int], T], seeds: int, processes: int, label: str) -> list[T]:
    """Outcomes of seeds 1 to n."""
    return in_processes(work, range(1, seeds + 1), processes, label)


def headline(flight: Flight, seeds: int, processes: int) -> Iterator[str]:
    """Clean against 20 % loss, 5 % reordering and 20 ms jitter, parameter by parameter."""
    rows = {
        case.name: over_seeds(partial(analyzed, case, flight), seeds, processes, case.name)
        for case in (CASES[0], HEADLINE)
    }
    clean, bad = rows.values()
    yield f"## {HEADLINE.name}: {flight.mission}, {flight.rate:.0f} Hz, {seeds} seeds\n"
    yield from markdown(
        "parameter | clean: rms error, std told | rms error, std told | times clean | "
        "intervals that hold: clean | "
    )
    true = load_vehicle(AIRFRAME).truth()
    for name in names_in(clean):
        unit = abs(true[name]) / 100.0 or 1.0
        sign = " %" if true[name] else ""
        cells = [
            f"{rms(row, name) / unit:.3g}{sign}, {rms(row, name, 'std') / unit:.3g}{sign}"
            for row in (clean, bad)
        ]
        yield (
            f"| {name} | {' | '.join(cells)} | {rms(bad, name) / rms(clean, name):.2f} "
            f"| {held(clean, name):.0f} % | {held(bad, name):.0f} % |"
        )
    for name, row in rows.items():
        yield (
            f"\n{name}: {dict(Counter(o.verdict for o in row))}, {held(row):.1f} % of intervals "
            f"hold, {np.mean([o.used for o in row]):.1f} s of {flight.seconds:.0f} s used"
        )


def dropouts(flight: Flight, seeds: int, processes: int) -> Iterator[str]:
    """How soon an estimate goes on after the link was silent."""
    yield "## Dropouts of the whole link\n"
    yield from markdown(
        "link | returns | data used again after, worst | intervals that hold then | "
        "worst error, std"
    )
    for case in DROPOUTS:
        flights = over_seeds(partial(returns, case, flight), seeds, processes, case.name)
        found = [r for one in flights for r in one]
        worst = max(v for r in found for v in r.then.off().values())
        yield (
            f"| {case.name} | {len(found)} | {max(r.back for r in found):.2f} s "
            f"| {held([r.then for r in found]):.1f} % | {worst:.1f} |"
        )


def table(flight: Flight, seeds: int, processes: int, cases: Sequence[Case]) -> Iterator[str]:
    """Every fault alone, and some together, beside the first case."""
    yield (
        f"## Every fault: {flight.mission} for {flight.seconds:.0f} s, {flight.rate:.0f} Hz, "
        f"{seeds} seeds\n"
    )
    yield from markdown(
        "fault | verdict | used | rms error, times clean (median, worst) | "
        "intervals that hold | worst error, std | wrong | told"
    )
    for seed in range(1, seeds + 1):
        fly(flight, seed)  # once for all faults of the line: forked children have it
    clean: Row | None = None
    for case in cases:
        row = over_seeds(partial(analyzed, case, flight), seeds, processes, case.name)
        clean = clean or row
        yield line_of(case.name, row, clean)


def line_of(name: str, row: Row, clean: Row) -> str:
    """A line of the table."""
    verdicts = Counter(o.verdict for o in row)
    verdict = ", ".join(f"{w} {n}" if len(verdicts) > 1 else w for w, n in verdicts.items())
    used = f"{np.mean([o.used for o in row]):.1f} s"
    told = "; ".join(dict.fromkeys(t for o in row for t in o.told))
    off = [(v, n, n in o.identified) for o in row for n, v in o.off().items()]
    if not off:
        return f"| {name} | {verdict} | {used} | - | - | - | no | {told} |"
    common = [n for n in names_in(row) if n in names_in(clean)]
    times = sorted(rms(row, n) / rms(clean, n) for n in common) or [float("nan")]
    worst, worst_name, _ = max(off)
    wrong = sorted({n for v, n, is_claimed in off if is_claimed and v > WRONG})
    return (
        f"| {name} | {verdict} | {used} | {np.median(times):.1f}, {times[-1]:.1f} "
        f"| {held(row):.0f} % | {worst:.1f} ({worst_name}) "
        f"| {', '.join(wrong) or 'no'} | {told} |"
    )


SECTIONS = ("headline", "dropouts", "table")


def main(argv: Sequence[str] | None = None) -> int:
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
    for name in options.only or SECTIONS:
        seconds = options.duration or (40.0 if name == "table" else 60.0)
        flight = Flight(options.mission, options.rate, seconds)
        how = flight, options.seeds or (3 if name == "table" else 10), options.processes
        wanted = options.case or [""]
        cases = [c for c in CASES if c is CASES[0] or any(word in c.name for word in wanted)]
        run = {"headline": headline, "dropouts": dropouts, "table": partial(table, cases=cases)}
        for line in run[name](*how):
            print(line, flush=True)
        print()
    return 0


if __name__ == "__main__":
    sys.exit(main())
