"""Expected intervals against those of flights that the emulator really flew."""

import numpy as np
import pytest

from gcs_sysid.coach.information import information, prior_vehicle, within_reach
from gcs_sysid.coach.manoeuvre_library import Limits, library
from gcs_sysid.estimation.online.online import OnlineEstimator
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.airframe import load_airframe
from sim_bridge.ensemble import fly_ensemble
from sim_bridge.swings import ManoeuvreMission, Swings
from testbed.article_flights import measure

RATE, SECONDS = 100.0, 16.0
FREE = slice(0, rb.N_THETA + 1)
"""Theta and the delay."""


def expected_std(manoeuvre, motion, craft, noise):
    told = information(motion, craft, noise) * manoeuvre.effective_seconds
    margin = prior_vehicle(load_airframe("paper")).at(9.80665 / craft.thrust).std
    total = (told + np.diag(margin**-2.0))[FREE, FREE]
    return np.sqrt(np.diag(np.linalg.inv(total)))[: rb.DAMPING]


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["roll and slow yaw", pytest.param("roll and pitch", marks=pytest.mark.thorough)]
)
def test_intervals_come_out_as_expected(name, craft, noise, vehicle):
    (wanted,) = (m for m in library(Limits()) if m.name == name and m.pace == 1.0)
    found = within_reach(wanted.lasting(SECONDS), craft)
    assert found is not None
    manoeuvre, motion = found
    mission = ManoeuvreMission([Swings.from_json(manoeuvre.as_json())])
    flight = fly_ensemble(vehicle, mission, RATE, mission.duration)
    stds = []
    for seed in range(4):
        estimator = OnlineEstimator(craft.geometry, 1.0 / RATE, EstimatorTuning())
        estimator.update(measure(flight, "mems", 0.0, seed))
        rotation = estimator.fit().rotation
        assert rotation is not None
        stds.append((rotation.std / rotation.warm_start.widening[: rb.N_THETA])[: rb.DAMPING])
    ratio = np.median(stds, axis=0) / expected_std(manoeuvre, motion, craft, noise)
    # An interval's own width is uncertain: sixteen batches tell it to some 20 %.
    assert 1.0 / 1.5 < np.median(ratio) < 1.5, ratio
    assert (np.abs(np.log(ratio)) < np.log(2.0)).all(), ratio


def test_roll_alone_tells_ixx_and_not_iyy(craft, noise):
    (roll,) = (m for m in library(Limits()) if m.name == "roll" and m.pace == 1.0)
    found = within_reach(roll, craft)
    assert found is not None
    std = expected_std(found[0], found[1], craft, noise) / craft.theta[: rb.DAMPING]
    assert abs(std[0]) < 0.01
    assert abs(std[1]) > 0.3


def test_yaw_alone_tells_only_the_ratio_of_izz_and_torque(craft, noise):
    """And roll with it tells them apart."""

    def izz(name):
        (found,) = (
            within_reach(m, craft) for m in library(Limits()) if m.name == name and m.pace == 0.7
        )
        assert found is not None
        return expected_std(*found, craft, noise)[2] / craft.theta[2]

    assert izz("roll and slow yaw") < 0.05 * izz("yaw")
