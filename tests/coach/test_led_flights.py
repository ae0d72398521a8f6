"""Flights that do what the coach says, by the whole path: emulator, frames, chain."""

from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.live.flight_coach import Coach, CoachOptions
from sim_bridge.missions import MISSIONS
from sim_bridge.swings import ManoeuvreMission, Swings
from testbed.led_flights import TARGET, Flight

HALF = 0.5


@pytest.mark.thorough
def test_progress_is_of_motion_and_not_of_time():
    mission = ManoeuvreMission()
    flight = Flight("px4-sih", mission, 2)
    coach = Coach(flight.chain, CoachOptions(TARGET))
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


def test_a_reset_between_looking_and_thinking_ends_the_thought():
    flight = Flight("px4-sih", ManoeuvreMission(), 2, rate=100.0)
    coach = Coach(flight.chain, CoachOptions(TARGET))
    flight.fly(4.5)
    coach.look()
    assert coach._thought is not None
    flight.chain.reset()
    coach.think()
    assert coach.choice is None
    assert coach.look() is None


@pytest.mark.slow
def test_a_swing_that_the_autopilot_damps_is_told_and_expected_no_more():
    mission = ManoeuvreMission()
    flight = Flight("px4-sih", mission, 2, rate=100.0)
    coach = Coach(flight.chain, CoachOptions(TARGET))
    flight.fly(4.5)
    assert coach.advise() is not None
    assert coach.choice is not None
    asked = coach.choice.manoeuvre
    assert asked.roll > 0.0
    expected = coach.choice.motion.rates.copy()
    # The pilot gives the whole stick; a third of the swing comes.
    came = replace(asked, roll=asked.roll / 3.0, pitch=asked.pitch / 3.0).lasting(11.0)
    mission.add(Swings.from_json(came.as_json()), flight.simulation.time)
    told = []
    while not any("swing too small" in text for text in told) and len(told) < 12:
        flight.fly(1.0)
        advice = coach.advise()
        told.append(advice.text if advice else "")
    words = next(text for text in told if "swing too small" in text).partition(";")[0]
    degrees = round(np.degrees(asked.roll))
    assert words.startswith("swing too small (±")
    assert words.endswith(f"of ±{degrees}° at {asked.pace:g} Hz)")
    share = float(words.partition("±")[2].partition("°")[0]) / degrees
    assert share == pytest.approx(1.0 / 3.0, abs=0.12)
    assert coach.choice is not None
    after = coach.choice
    if after.manoeuvre.pace == asked.pace and after.manoeuvre.roll == asked.roll:
        # The same once more, but no more is expected of it than came.
        assert np.abs(after.motion.rates[:, 0]).max() < 0.6 * np.abs(expected[:, 0]).max()
    else:
        assert (after.manoeuvre.pace, after.manoeuvre.name) != (asked.pace, asked.name)


@pytest.mark.thorough
def test_estimates_are_the_same_with_a_coach_and_without():
    ends = []
    for led in (False, True):
        flight = Flight("paper", MISSIONS["all-axes"], 4, rate=100.0)
        coach = Coach(flight.chain) if led else None
        for _ in range(8):
            flight.fly(1.0)
            if coach is not None:
                coach.advise()
        ends.append(flight.finish().dumps())
    assert ends[0] == ends[1]
