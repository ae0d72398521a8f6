"""The emulated pilot flies what a plan lists."""

import math

import numpy as np
import pytest

from sim_bridge.ensemble import fly_ensemble
from sim_bridge.swings import LEAD, PAUSE, ManoeuvreMission, Swings
from sim_bridge.vehicle_files import load_vehicle

D20 = math.radians(20.0)
STIR = Swings(D20, D20, 0.0, 0.0, 0.7, 0.7, 6.0)
NOSE = Swings(D20, 0.0, D20, 0.0, 1.0, 0.5, 5.0)
CLIMB = Swings(0.0, 0.0, 0.0, 1.0, 0.5, 0.5, 6.0)


def test_one_after_the_other_with_a_pause():
    mission = ManoeuvreMission([STIR, NOSE])
    assert mission.duration == LEAD + 6.0 + PAUSE + 5.0 + PAUSE
    mission.add(CLIMB, 0.0)
    assert mission.duration == LEAD + 6.0 + 5.0 + 6.0 + 3.0 * PAUSE
    mission.add(STIR, 100.0)
    assert mission.duration == 106.0 + PAUSE
    for still in (0.0, 0.9 * LEAD, LEAD + 6.0 + 0.5 * PAUSE, 99.0, 200.0):
        assert mission.reference(still).rate == (0.0, 0.0, 0.0)


@pytest.mark.slow
def test_the_vehicle_swings_as_far_as_it_should_and_stays_where_it_is():
    mission = ManoeuvreMission([STIR, CLIMB])
    flight = fly_ensemble(load_vehicle("px4-quad-x"), mission, 50.0)
    roll, pitch, _ = np.abs(flight.angles()[0].T)
    stirred = (flight.t > LEAD) & (flight.t < LEAD + 6.0)
    assert np.degrees(roll[stirred].max()) == pytest.approx(20.0, abs=4.0)
    assert np.degrees(pitch[stirred].max()) == pytest.approx(20.0, abs=4.0)
    moved = np.cumsum(flight.velocity[0], axis=0) * flight.interval
    assert np.abs(moved[stirred]).max() < 1.5
    climbed = moved[~stirred, 2]
    assert 1.5 < climbed.max() - climbed.min() < 2.5
    assert np.abs(moved[-1, :2]).max() < 0.5
