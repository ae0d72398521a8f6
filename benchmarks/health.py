"""Health of vehicles by ordinary flights: errors, intervals, weak rotors named, false alarms.

    python -m benchmarks.health [--vehicles N] [--first N] [--weak N] [--flights FOLDER]

`vehicles`: drawn vehicles of four, six and eight rotors with thrust curves from 0 to 1 fly gentle
doublets and climbs in light turbulence; what is sent is IMU at 25 Hz, commands (and in a second
reading speeds) at 10 Hz. Their rotors scatter and stand by what the intervals assume. `weak`: each
vehicle flies twice, by commands and by speeds; in the second flight one rotor has 5 % less thrust
and torque, and ten seconds of hover must name it; the same flights without the fault, cut into
stretches of ten seconds, count the false alarms.
"""

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.health import balance
from gcs_sysid.health.airframe_guess import GuessedAirframe
from gcs_sysid.health.assessment import ReadLog, health_of
from gcs_sysid.health.command_curve import thrust_of
from gcs_sysid.health.rotor_condition import compare_loads, load_of
from gcs_sysid.health.vehicle_health import Health, HealthOptions
from gcs_sysid.model.airframe import USUAL, Airframe, CommandRange, Rotor
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.significance import Z95
from sim_bridge.doublets import DoubletMission
from sim_bridge.missions import HoverMission
from sim_bridge.simulated_vehicle import RotorTraits
from testbed.hover_flights import (
    LAYOUTS,
    ORDINARY,
    STRETCH,
    fly,
    hover_of,
    loads_of,
    streams_in,
    uneven,
)
from testbed.study import arguments, markdown
from testbed.vehicles import Drawn, draw

HOVER = 30.0
"""s of the flight used as the baseline."""
LOSS = 0.05


def misplaced(airframe: Airframe, random: np.random.Generator) -> Airframe:
    """What a user measures: each rotor off by what the intervals assume."""
    std = USUAL.rotor_position.of(airframe.arm)
    moved = tuple(
        Rotor(r.x + std * random.standard_normal(), r.y + std * random.standard_normal(), r.spin)
        for r in airframe.rotors
    )
    return replace(airframe, rotors=moved, uncertainty=USUAL)


@dataclass
class Score:
    """Errors of one number over many vehicles."""

    name: str
    unit: float
    errors: list[float]
    sigmas: list[float]

    def add(self, told: Estimate, truth: float, relative: bool = False) -> None:
        """One more vehicle's; relative errors are over the truth."""
        assert told.value is not None
        assert told.std is not None
        size = truth if relative else 1.0
        self.errors.append((told.value - truth) / size)
        self.sigmas.append(told.std / abs(size))

    def row(self) -> str:
        """Of the table."""
        e, s = np.array(self.errors), np.array(self.sigmas)
        held = 100.0 * float(np.mean(np.abs(e) <= Z95 * s))
        rms, most = self.unit * float(np.sqrt(np.mean(e**2))), self.unit * float(np.abs(e).max())
        half = self.unit * Z95 * float(np.median(s))
        return f"| {self.name} | {rms:.3g} | {most:.3g} | {half:.3g} | {held:.0f} % of {len(e)} |"


def vehicles(
    numbers: range, folder: Path, mission: DoubletMission, seconds: float
) -> Iterator[str]:
    """The table of errors and intervals."""
    yield from markdown(" | rms | largest | median half interval | intervals hold")
    for speeds in (False, True):
        for scatter in (True, False):
            scores = _scores(numbers, folder, mission, seconds, speeds=speeds, scatter=scatter)
            kind = "speeds" if speeds else "commands"
            what = "rotors 3 %, places 0.2 % off" if scatter else "rotors alike, flight alone"
            yield f"| **{kind}, {what}** | | | | |"
            for score in scores:
                yield score.row()


def _scores(
    numbers: range,
    folder: Path,
    mission: DoubletMission,
    seconds: float,
    *,
    speeds: bool,
    scatter: bool,
) -> list[Score]:
    places = Score("CG, mm", 1e3, [], [])
    scale = Score("k_T, %" if speeds else "T_max, %", 100.0, [], [])
    curves = Score("thrust curve", 1.0, [], [])
    shares = Score("thrust shares, %", 100.0, [], [])
    ratio = Score("full thrust over weight, %", 100.0, [], [])
    for number in numbers:
        drawn = draw(number, LAYOUTS)
        random = np.random.default_rng([number, 0x4EA1])
        traits = uneven(drawn, random, USUAL.rotor_thrust.of(1.0) if scatter else 0.0)
        log = folder / f"{number}_{scatter}.tlog"
        if not log.exists():
            fly(log, drawn, mission, number, traits, seconds)
        airframe = misplaced(drawn.airframe, random) if scatter else drawn.airframe
        airframe = replace(airframe, rotor_input="speed" if speeds else "command")
        airframe = replace(airframe, command=CommandRange(given=True))
        told = (
            ReadLog(log).health(HealthOptions(airframe)) if speeds else _by_commands(log, airframe)
        )
        if not told.available:
            print(f"vehicle {number}: {told.reasons}")
            continue
        assert told.cg is not None
        v = drawn.vehicle
        for place, truth in zip(told.cg, (v.cg_x, v.cg_y), strict=True):
            places.add(place if scatter else flown_alone(place), truth)
        if told.scale is not None:
            scale.add(told.scale[1], v.k_T if speeds else v.T_max, relative=True)
        if told.curve is not None:
            curves.add(told.curve.c, v.thrust_curve)
        if told.thrust_to_weight is not None:
            truth = len(v.rotors) * v.T_max / v.mass / 9.80665
            ratio.add(told.thrust_to_weight, truth, relative=True)
        true_shares = _true_shares(log, drawn, traits)
        for rotor, truth in zip(told.rotors, true_shares, strict=True):
            share = rotor.thrust_share
            shares.add(share if scatter else flown_alone(share), float(truth))
    return [s for s in (places, shares, scale, ratio, curves) if s.errors]


def _by_commands(log: Path, airframe: Airframe) -> Health:
    """Health of a log as if it had no speeds at all."""
    streams = streams_in(log, airframe, speeds=False)
    return health_of(streams, GuessedAirframe(airframe, "given"), HealthOptions(airframe), {})


def flown_alone(told: Estimate) -> Estimate:
    """Without what is assumed of rotors and places."""
    assert told.std is not None
    return replace(told, std=max(told.std**2 - told.std_given**2, 0.0) ** 0.5, std_given=0.0)


def _true_shares(log: Path, drawn: Drawn, traits: RotorTraits) -> Array:
    """Shares of thrust by the true coefficients and the speeds of the whole log in hover."""
    hover = hover_of(log, drawn.airframe, speeds=True)
    thrust = hover.speeds * np.array(traits.thrust)
    mean: Array = (thrust / thrust.sum(axis=1, keepdims=True)).mean(axis=0)
    return mean


def weak(numbers: range, folder: Path) -> Iterator[str]:
    """Weak rotors named, and false alarms."""
    yield from markdown(" | named right | named wrong | not named | false alarms | in hours")
    tally = {(s, u): np.zeros(5) for s in (True, False) for u in (False, True)}
    mission = HoverMission("hover", 10.0 * STRETCH)
    for number in numbers:
        drawn = draw(1000 + number, LAYOUTS)
        random = np.random.default_rng([number, 0x3EAC])
        traits = uneven(drawn, random, USUAL.rotor_thrust.of(1.0))
        rotor = int(random.integers(len(drawn.vehicle.rotors)))
        names = [folder / f"{number}_{part}.tlog" for part in ("before", "weak", "after")]
        lost = traits.weakened(rotor, LOSS)
        flights = (
            (names[0], 3 * number, traits, HOVER),
            (names[1], 3 * number + 1, lost, STRETCH + 2.5),
            (names[2], 3 * number + 2, traits, 3.0 * STRETCH + 2.5),
        )
        for log, seed, flown, seconds in flights:
            if not log.exists():
                fly(log, drawn, mission, seed, flown, seconds)
        for speeds in (True, False):
            both = {u: tally[speeds, u] for u in (False, True)}
            _judge(both, names, drawn, rotor, speeds=speeds)
    for (speeds, unchanged), (right, wrong, silent, alarms, seconds) in tally.items():
        kind = ("speeds" if speeds else "commands") + (", --unchanged" if unchanged else "")
        yield (
            f"| {kind} | {right:.0f} | {wrong:.0f} | {silent:.0f} | {alarms:.0f} "
            f"| {seconds / 3600.0:.2f} |"
        )


def _judge(
    tally: dict[bool, Array], names: list[Path], drawn: Drawn, rotor: int, *, speeds: bool
) -> None:
    """Count what a vehicle's flights tell, by whether it is known that nothing was moved."""
    airframe = drawn.airframe
    c = drawn.vehicle.thrust_curve
    before, after, same = (hover_of(name, airframe, speeds=speeds) for name in names)
    curve = None if speeds else c
    thrust = thrust_of(before, curve)
    base = load_of(before, thrust, curve)
    assert base is not None
    cg = balance.cg_of(before, airframe, thrust).cg.tolist()
    weak, sound = (list(loads_of(hover, speeds=speeds, c=c)) for hover in (after, same))
    for unchanged, counts in tally.items():
        for load in weak[:1]:
            found = compare_loads(base, load, airframe, cg, unchanged=unchanged)
            right = found.verdict == "rotor" and found.rotor == rotor
            counts[0] += right
            counts[1] += found.verdict == "rotor" and not right
            counts[2] += found.verdict != "rotor"
        for load in sound:
            found = compare_loads(base, load, airframe, cg, unchanged=unchanged)
            counts[3] += found.verdict == "rotor"
            counts[4] += STRETCH


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--vehicles", type=int, default=20, help="drawn for errors and intervals")
    parser.add_argument("--first", type=int, default=0, help="number of the first of them")
    parser.add_argument("--weak", type=int, default=100, help="flights with a weak rotor")
    parser.add_argument(
        "--climb", type=float, default=ORDINARY.climb, help="m, of climbs (default: %(default)s)"
    )
    parser.add_argument("--seconds", type=float, default=ORDINARY.duration, help="of a flight")
    parser.add_argument("--flights", type=Path, help="folder that keeps the flights for next time")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = options.flights or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        if options.vehicles:
            numbers = range(options.first, options.first + options.vehicles)
            mission = replace(ORDINARY, climb=options.climb)
            print(*vehicles(numbers, folder, mission, options.seconds), sep="\n", flush=True)
        if options.weak:
            numbers = range(options.first, options.first + options.weak)
            print("", *weak(numbers, folder), sep="\n", flush=True)


if __name__ == "__main__":
    main()
