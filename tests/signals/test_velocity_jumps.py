"""Velocities that an estimator reset are gaps; what a vehicle did is none."""

import numpy as np
import pytest

from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.signals.sampling import VelocityJumps

DT, JUMP_AT = 0.02, 1500


def flight(jump, seed=1):
    """(n, 3) velocity and specific force of a vehicle that climbs, brakes and tilts hard."""
    rng = np.random.default_rng(seed)
    t = DT * np.arange(3000)
    turned = np.column_stack([5.0 * np.sin(1.3 * t), 4.0 * np.cos(0.9 * t), 6.0 * np.sin(2.0 * t)])
    force = turned - (0.0, 0.0, GRAVITY)
    velocity = DT * np.cumsum(turned, axis=0) + rng.normal(0.0, 0.02, turned.shape)
    velocity[JUMP_AT:] += jump
    return velocity, force + rng.normal(0.0, 0.5, force.shape)


@pytest.mark.parametrize("jump", [(5.0, 0.0, 0.0), (0.0, 0.0, -2.0), (0.0, 0.7, 0.0)])
def test_a_velocity_that_is_set_anew_is_a_jump(jump):
    found = VelocityJumps().update(DT, *flight(jump), fresh=True)
    assert np.flatnonzero(found).tolist() == [JUMP_AT]


def test_hard_flight_and_gaps_are_no_jump():
    velocity, force = flight((0.0, 0.0, 0.0))
    velocity[700:760] = np.nan
    assert not VelocityJumps().update(DT, velocity, force, fresh=True).any()
