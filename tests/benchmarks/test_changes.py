"""The vehicles of the benchmark of changes in flight."""

import numpy as np
import pytest

from gcs_sysid.model.parameters import GRAVITY
from sim_bridge.ensemble import fly_ensemble
from sim_bridge.missions import MISSIONS
from sim_bridge.simulated_vehicle import stack_vehicles
from testbed.fleets import PAPER, follow, samples_of, vehicles


def test_vehicles_are_drawn_anew_by_each_seed_and_can_fly():
    one, again, other = vehicles(3, 1), vehicles(3, 1), vehicles(3, 2)
    assert one == again != other
    assert len({v.mass for v in one}) == 3
    for v in vehicles(5, 3, curve=0.3):
        assert v.thrust_curve == 0.3
        assert v.T_max * len(v.rotors) > 2.0 * v.mass * GRAVITY
        # Hover takes the speed that it takes the emulator's own: k_T goes with the mass.
        assert v.k_T / v.mass == pytest.approx(PAPER.k_T / PAPER.mass)


@pytest.mark.slow
@pytest.mark.parametrize("commands", [False, True])
def test_a_short_hover_is_followed(commands):
    fleet = stack_vehicles(vehicles(2, 1))
    flight = fly_ensemble(fleet, MISSIONS["hover"], 250, 2.0).with_noise("mems", 0.0, [1, 2])
    tracker = follow(samples_of(flight, 1, commands=commands), flight.t, commands=commands)
    assert tracker.events == []
    assert np.isfinite(tracker.fit(quick=True).seconds)
