"""Flights that the coach leads, against the article's three modes.

    python -m benchmarks.coach [--seeds 20] [--processes 2] [--airframe paper]

Every flight passes the whole path: emulator, MAVLink frames, the live session's chain. A pilot who
does what the coach says is emulated too: each second he looks at the advice, and when his hands
are free he flies it to its end. The other pilot flies the article's modes, again and again.
"""

import argparse
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from gcs_sysid.coach.targets import shares
from gcs_sysid.estimation.parameters import CORE
from gcs_sysid.model.airframe import Airframe, load_airframe
from gcs_sysid.session.chain import ChainOptions
from gcs_sysid.session.coaching import Coach, CoachOptions
from gcs_sysid.session.pipeline import Pipeline
from gcs_sysid.telemetry.frames import FrameScanner
from sim_bridge.manoeuvres import ManoeuvreMission, Swings
from sim_bridge.missions import MISSIONS, Mission
from sim_bridge.px4 import Px4
from sim_bridge.simulation import Simulation
from sim_bridge.vehicle import Vehicle
from sim_bridge.vehicle_files import load_vehicle

TARGET = 0.02
AGREES = 1.5
WANTED = 0.6
"""Share of the article's flight time within which the coach is to reach the target."""
MOST = 400.0
"""s after which a flight is given up."""
MOST_COACHED = 120.0
LOOK = 1.0
HALF = 1.959963984540054


@dataclass
class Flown:
    """What one flight came to.

    Attributes:
        reached: s of flight after which every interval met the target; infinite if none did.
        errors: % of the truth, then.
        outcomes: reached over expected, of every interval after every manoeuvre.
        said: what was advised.
    """

    reached: float = np.inf
    errors: dict[str, float] = field(default_factory=dict)
    outcomes: list[float] = field(default_factory=list)
    said: list[str] = field(default_factory=list)


class Flight:
    """A vehicle in flight, with the chain that listens to it."""

    def __init__(self, name: str, mission: Mission, seed: int, rate: float = 250.0) -> None:
        self.vehicle: Vehicle = load_vehicle(name)
        self.airframe: Airframe = load_airframe(name)
        if self.airframe.anchor() is None:
            self.airframe = self.airframe.with_anchor("mass", self.vehicle.mass)
        gusts, sensors = np.random.SeedSequence(seed).spawn(2)
        self.simulation = Simulation(self.vehicle, mission, gusts)
        self._autopilot = Px4(self.simulation, "mems", 0.02, rate, sensors)
        self._scanner = FrameScanner()
        self.pipeline = Pipeline(
            self.airframe, "emulator", options=ChainOptions(course_interval=0.5)
        )

    def fly(self, seconds: float) -> None:
        """Fly on for a while."""
        ticks = round(seconds / self.simulation.step_size)
        for _ in range(ticks):
            frames = self._autopilot.poll(self.simulation.tick)
            if frames:
                self.pipeline.take(self._scanner.feed(b"".join(frames)))
            self.simulation.step()

    def errors(self) -> dict[str, float]:
        """% of the truth."""
        chain, truth = self.pipeline.chain, self.vehicle.truth()
        values = chain.values(chain.fit)
        return {
            name: 100.0 * abs((values[name].value or np.nan) / truth[name] - 1.0) for name in CORE
        }

    def widest(self) -> float:
        """Half of the widest interval over the true value."""
        chain, truth = self.pipeline.chain, self.vehicle.truth()
        values = chain.values(chain.fit)
        widths = [
            HALF * std / abs(truth[name]) if (std := values[name].std) is not None else np.inf
            for name in CORE
        ]
        return float(max(widths))


def modes(seed: int, airframe: str, mission: str = "paper") -> Flown:
    """The article's modes, until every interval meets the target."""
    flight, flown = Flight(airframe, MISSIONS[mission], seed), Flown()
    while flight.simulation.time < MOST:
        flight.fly(LOOK)
        if flight.widest() <= TARGET:
            return Flown(flight.simulation.time, flight.errors())
    return flown


def coached(seed: int, airframe: str) -> Flown:
    """What the coach says, until it says that it is enough and every interval is."""
    mission = ManoeuvreMission()
    flight = Flight(airframe, mission, seed)
    chain = flight.pipeline.chain
    coach = Coach(chain, CoachOptions(TARGET))
    flown = Flown()
    promised: dict[str, float | None] | None = None
    while flight.simulation.time < MOST_COACHED:
        flight.fly(LOOK)
        advice = coach.advise()
        now = flight.simulation.time
        if now < mission.duration - 0.5 * LOOK or advice is None:
            if flight.widest() <= TARGET and not np.isfinite(flown.reached):
                flown.reached, flown.errors = now, flight.errors()
            continue
        if promised is not None:
            got = shares(chain.values(chain.fit), flight.airframe.arm, chain.rotor_input)
            flown.outcomes += list(compared(promised, got))
            promised = None
        if flight.widest() <= TARGET and not np.isfinite(flown.reached):
            flown.reached, flown.errors = now, flight.errors()
        if advice.enough:
            return flown
        if coach.choice is not None:
            flown.said.append(f"{now:.0f} s: {advice.text}")
            promised = dict(coach.choice.expected)
            mission.add(Swings.from_json(coach.choice.manoeuvre.as_json()), now)
    return flown


def compared(
    promised: dict[str, float | None], got: dict[str, float | None]
) -> Iterator[float]:
    """Reached over expected shares."""
    for name, share in promised.items():
        reached = got.get(name)
        if share:
            yield np.inf if reached is None else reached / share


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--airframe", default="paper")
    options = parser.parse_args()
    seeds = range(options.seeds)
    with ProcessPoolExecutor(options.processes) as pool:
        led = list(pool.map(partial(coached, airframe=options.airframe), seeds))
        others = list(pool.map(partial(modes, airframe=options.airframe), seeds))
    print(f"time until every interval is within {100 * TARGET:g} % of the true value, s")
    print("seed  coach  modes  manoeuvres  largest error then, %")
    for seed, (mine, other) in enumerate(zip(led, others, strict=True)):
        error = max(mine.errors.values(), default=np.nan)
        print(
            f"{seed:4d}  {mine.reached:5.0f}  {other.reached:5.0f}  {len(mine.said):10d}  {error:.2f}"
        )
    mine_t, other_t = (float(np.median([f.reached for f in g])) for g in (led, others))
    print(f"median: {mine_t:.0f} s against {other_t:.0f} s: {100 * mine_t / other_t:.0f} %, wanted "
          f"at most {100 * WANTED:.0f} %")
    ratios = np.array([r for f in led for r in f.outcomes])
    agree = np.mean((ratios <= AGREES) & (ratios >= 1.0 / AGREES))
    print(
        f"interval reached over expected: median {np.median(ratios):.2f}, 5 to 95 % of them "
        f"{np.quantile(ratios, 0.05):.2f} to {np.quantile(ratios, 0.95):.2f}, "
        f"{100 * agree:.0f} % within a factor of {AGREES}"
    )
    print("the first flight:")
    for line in led[0].said:
        print(f"  {line}")


if __name__ == "__main__":
    main()
