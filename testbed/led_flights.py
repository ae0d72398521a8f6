"""Flights that the coach leads, through the whole path, and flights of the article's modes.

A pilot who does what the coach says is emulated too: each second he looks at the advice, and when
his hands are free he flies it to its end. The other pilot flies the article's modes, again and
again; that flight is the same for every seed but for the sensors' noise, and the estimator is given
its samples without frames between.
"""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from gcs_sysid.coach.choice import is_enough, shares
from gcs_sysid.coach.manoeuvre_library import Limits
from gcs_sysid.estimation.online.online import OnlineEstimator
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.live.flight_coach import Coach, CoachOptions
from gcs_sysid.model.airframe import Airframe, ScaleReference, load_airframe
from gcs_sysid.model.parameters import CORE_OF
from gcs_sysid.results.result import Result
from gcs_sysid.results.summary import values_of
from gcs_sysid.session.chain import ChainOptions
from gcs_sysid.telemetry.frames import FrameScanner
from sim_bridge.ensemble import Flight as EmulatedFlight
from sim_bridge.ensemble import fly_ensemble
from sim_bridge.missions import MISSIONS, Mission
from sim_bridge.px4 import Px4
from sim_bridge.simulated_vehicle import Vehicle
from sim_bridge.simulation import Simulation
from sim_bridge.swings import ManoeuvreMission, Swings
from sim_bridge.vehicle_files import load_vehicle
from testbed.article_flights import measure
from testbed.linked import linked

CORE = CORE_OF["speed"]
TARGET = 0.02
AGREES = 1.5
WANTED = 0.6
"""Share of the article's flight time within which the coach is to reach the target."""
MOST = 300.0
"""s after which a flight is given up."""
MOST_COACHED = 200.0
RATE = 250.0
"""Hz."""
LOOK = 1.0
"""s between looks at the intervals, of either pilot."""
LEAST = 3.0
"""s, of a manoeuvre."""


@dataclass
class Flown:
    """What one flight came to.

    Attributes:
        reached: s of flight after which every interval met the target; infinite if none did.
        errors: % of the truth, then.
        outcomes: manoeuvre by manoeuvre, reached over expected of every interval.
        told: the same of the gains that the pilot was told.
        said: what was advised.
    """

    reached: float = np.inf
    errors: dict[str, float] = field(default_factory=dict)
    outcomes: list[list[float]] = field(default_factory=list)
    told: list[list[float]] = field(default_factory=list)
    said: list[str] = field(default_factory=list)


class Flight:
    """A vehicle in flight, with the chain that listens to it."""

    def __init__(self, name: str, mission: Mission, seed: int, rate: float = RATE) -> None:
        self.vehicle: Vehicle = load_vehicle(name)
        self.airframe: Airframe = load_airframe(name)
        if self.airframe.anchor() is None:
            self.airframe = self.airframe.with_anchor("mass", self.vehicle.mass)
        gusts, sensors = np.random.SeedSequence(seed).spawn(2)
        self.simulation = Simulation(self.vehicle, mission, gusts)
        self._autopilot = Px4(self.simulation, "mems", 0.02, rate, sensors)
        self._scanner = FrameScanner()
        self.chain, self._link = linked(self.airframe, ChainOptions(history_interval=0.5))

    def fly(self, seconds: float) -> None:
        """Fly on for a while."""
        ticks = round(seconds / self.simulation.step_size)
        for _ in range(ticks):
            frames = self._autopilot.poll(self.simulation.tick)
            if frames:
                self.chain.take(self._link.gather(self._scanner.feed(b"".join(frames))))
            self.simulation.step()

    def finish(self) -> Result:
        """The final result."""
        self.chain.take(self._link.rest())
        return self.chain.finish()

    def errors(self) -> dict[str, float]:
        """% of the truth."""
        chain, truth = self.chain, self.vehicle.truth()
        values = chain.values(chain.fit)
        return {
            name: 100.0 * abs((values[name].value or np.nan) / truth[name] - 1.0) for name in CORE
        }

    def shares(self) -> dict[str, float | None]:
        """Half of each interval over its reference value, as the coach and the screen see it."""
        chain = self.chain
        return shares(chain.values(chain.fit), self.airframe.arm, chain.rotor_input)


@lru_cache(maxsize=2)
def article(name: str) -> EmulatedFlight:
    """The article's modes again and again, without noise: that does not act on the flight."""
    return fly_ensemble(load_vehicle(name), MISSIONS["paper"], RATE, MOST)


def modes(seed: int, airframe: str) -> Flown:
    """The article's modes, until every interval meets the target."""
    flight, known, vehicle = article(airframe), load_airframe(airframe), load_vehicle(airframe)
    samples = measure(flight, "mems", 0.0, seed)
    estimator = OnlineEstimator(known.geometry, 1.0 / RATE, EstimatorTuning())
    each = round(LOOK * RATE)
    for start in range(0, len(samples.gyro), each):
        (fit,) = estimator.follow(samples.part(slice(start, start + each)), [each])
        values = values_of(fit, ScaleReference("mass", vehicle.mass), known.arm, {})
        if is_enough(shares(values, known.arm, "speed"), TARGET):
            truth = vehicle.truth()
            errors = {n: 100.0 * abs((values[n].value or np.nan) / truth[n] - 1.0) for n in CORE}
            return Flown((start + each) / RATE, errors)
    return Flown()


def coached(seed: int, airframe: str, limits: Limits | None = None) -> Flown:
    """What the coach says, until it says that it is enough and every interval is."""
    mission = ManoeuvreMission()
    flight = Flight(airframe, mission, seed)
    chain = flight.chain
    coach = Coach(chain, CoachOptions(TARGET, limits or Limits()))
    flown = Flown()
    promised: dict[str, float | None] | None = None
    names: list[str] = []
    while flight.simulation.time < MOST_COACHED:
        flight.fly(LOOK)
        advice = coach.advise()
        now = flight.simulation.time
        if now < mission.duration - 0.5 * LOOK or advice is None:
            if is_enough(flight.shares(), TARGET) and not np.isfinite(flown.reached):
                flown.reached, flown.errors = now, flight.errors()
            continue
        if promised is not None:
            got = flight.shares()
            flown.outcomes.append(compared(promised, got))
            flown.told.append(compared({n: promised[n] for n in names}, got))
            promised = None
        if is_enough(flight.shares(), TARGET) and not np.isfinite(flown.reached):
            flown.reached, flown.errors = now, flight.errors()
        if advice.enough:
            return flown
        if coach.choice is not None:
            flown.said.append(f"{now:.0f} s: {advice.text}")
            promised = dict(coach.choice.expected)
            names = [gain.name for gain in advice.gains]
            advised = coach.choice.manoeuvre
            # What he has flown too gently is not yet done: he goes on with it.
            rest = (1.0 - advice.progress) * advised.seconds + LEAST * (advice.progress > 0.0)
            swings = advised.lasting(min(rest, advised.seconds))
            mission.add(Swings.from_json(swings.as_json()), now)
    return flown


def compared(promised: dict[str, float | None], got: dict[str, float | None]) -> list[float]:
    """Reached over expected shares."""
    ratios = []
    for name, share in promised.items():
        reached = got.get(name)
        if share:
            ratios.append(np.inf if reached is None else reached / share)
    return ratios
