"""Velocities go on where an estimator reset them; what a vehicle did is no reset."""

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
def test_a_velocity_goes_on_as_if_it_had_not_been_set_anew(jump):
    velocity, force = flight(jump)
    velocity[700:760] = np.nan
    found = VelocityJumps().without(DT, velocity, force, fresh=True)
    # Neither hard flight nor a gap is a jump.
    assert np.flatnonzero(np.isnan(found[:, 0])).tolist() == [*range(700, 760), JUMP_AT]
    np.testing.assert_array_equal(found[:700], velocity[:700])
    np.testing.assert_allclose((velocity - found)[JUMP_AT + 1 :] - jump, 0.0, atol=0.3)


def test_what_jumps_again_and_again_is_no_reset():
    velocity, force = flight((0.0, 0.0, 0.0))
    velocity[JUMP_AT::50] += 1.0
    found = VelocityJumps().without(DT, velocity, force, fresh=True)
    assert np.nanmax(np.abs(velocity - found)[JUMP_AT + 2 :]) < 1.3  # the first one, once
