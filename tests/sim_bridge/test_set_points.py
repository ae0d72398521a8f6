"""Set-points looked up many at a time are those of single instants."""

import numpy as np
import pytest

from sim_bridge.doublets import ALL_MISSIONS
from sim_bridge.ground_cycle import GroundCycle
from sim_bridge.missions import MISSIONS, Mission
from sim_bridge.set_points import AHEAD, SetPoints

FLOWN = [*ALL_MISSIONS.values(), GroundCycle(MISSIONS["paper"], 3.0, 2)]


@pytest.mark.parametrize("mission", FLOWN, ids=lambda mission: type(mission).__name__)
def test_set_points_are_those_of_the_mission(mission: Mission) -> None:
    set_points = SetPoints(mission, 0.001, 4)
    # Long enough for a second block, from there on at another time, and off the grid of before.
    ticks = [*range(0, 4 * AHEAD + 12, 4), *range(61_000, 61_040, 4), 61_041, 61_045, 500]
    for tick in ticks:
        for got, expected in zip(set_points.at(tick), mission.reference(tick * 0.001), strict=True):
            np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-12)
