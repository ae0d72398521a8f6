"""Flights that do what the coach says, by the whole path: emulator, frames, chain."""

import numpy as np
import pytest

from benchmarks.coach import AGREES, TARGET, WANTED, Flight, coached, modes
from gcs_sysid.live.flight_coach import Coach, CoachOptions
from sim_bridge.missions import MISSIONS
from sim_bridge.swings import ManoeuvreMission, Swings

HALF = 0.5


@pytest.mark.slow
@pytest.mark.thorough
def test_the_coach_needs_less_time_than_the_articles_modes():
    """Seeds of `python -m benchmarks.coach`, each against the same seed of the modes."""
    seeds = (1, 3)
    led = [coached(seed, "paper") for seed in seeds]
    others = [modes(seed, "paper") for seed in seeds]
    for mine, other in zip(led, others, strict=True):
        assert mine.reached <= WANTED * other.reached
        assert max(mine.errors.values()) < 100.0 * TARGET
    later = [ratio for flight in led for part in flight.told[1:] for ratio in part]
    assert 1.0 / AGREES < np.median(later) < AGREES


@pytest.mark.slow
def test_progress_is_of_motion_and_not_of_time():
    mission = ManoeuvreMission()
    flight = Flight("px4-sih", mission, 2)
    coach = Coach(flight.pipeline.chain, CoachOptions(TARGET))
    assert coach.advise() is None
    flight.fly(4.5)
    first = coach.advise()
    assert first is not None
    assert first.manoeuvre
    assert first.text.endswith("first estimates of all parameters")
    assert first.gains == ()
    flight.fly(4.0)
    waiting = coach.advise()
    assert waiting is not None
    assert waiting.progress < 0.02
    assert coach.choice is not None
    swings = Swings.from_json(coach.choice.manoeuvre.as_json())
    mission.add(swings, flight.simulation.time)
    flight.fly(HALF * swings.seconds)
    midway = coach.advise()
    assert midway is not None
    assert midway.manoeuvre == waiting.manoeuvre
    assert 0.3 < midway.progress < 0.75
    flight.fly(HALF * swings.seconds + 1.0)
    after = coach.advise()
    assert after is not None
    assert after.enough or after.text != waiting.text
    assert after.enough or all(gain.expected < (gain.now or 1.0) for gain in after.gains)


@pytest.mark.slow
def test_estimates_are_the_same_with_a_coach_and_without():
    ends = []
    for led in (False, True):
        flight = Flight("paper", MISSIONS["all-axes"], 4, rate=100.0)
        coach = Coach(flight.pipeline.chain) if led else None
        for _ in range(8):
            flight.fly(1.0)
            if coach is not None:
                coach.advise()
        ends.append(flight.pipeline.finish().dumps())
    assert ends[0] == ends[1]
