"""Velocities go on where an estimator reset them; what a vehicle did is no reset."""

import itertools

import numpy as np
import pytest

from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.signals.sampling import RIPPLES, VelocityJumps

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
    over = JUMP_AT + round(RIPPLES / DT) + 1
    assert np.flatnonzero(np.isnan(found[:, 0])).tolist() == [
        *range(700, 760),
        *range(JUMP_AT, over),
    ]
    np.testing.assert_array_equal(found[:700], velocity[:700])
    np.testing.assert_allclose((velocity - found)[over:] - jump, 0.0, atol=0.3)


def test_what_jumps_again_and_again_is_no_reset():
    velocity, force = flight((0.0, 0.0, 0.0))
    velocity[JUMP_AT::50] += 1.0
    found = VelocityJumps().without(DT, velocity, force, fresh=True)
    assert np.nanmax(np.abs(velocity - found)[JUMP_AT + 2 :]) < 1.3  # the first one, once


def test_a_jump_between_slow_readings_is_taken_off_whole_however_it_is_cut():
    velocity, force = flight((0.0, 0.0, 0.0))
    # Readings at 10 Hz on the grid: ramps of five points, with a ripple after that of the jump.
    jump = 5.0 * np.interp(np.arange(3000), JUMP_AT + np.array([0, 5, 7, 9]), [0.0, 1.0, 1.05, 1.0])
    velocity[:, 0] += jump
    whole = VelocityJumps().without(DT, velocity, force, fresh=True)
    after = slice(JUMP_AT + 20, None)  # what it moved meanwhile, a tenth of a second, goes too
    np.testing.assert_allclose((velocity - whole)[after] - (5.0, 0.0, 0.0), 0.0, atol=0.6)
    jumps, cuts = VelocityJumps(), [0, 700, JUMP_AT + 2, JUMP_AT + 3, JUMP_AT + 8, 3000]
    parts = [
        jumps.without(DT, velocity[a:b], force[a:b], fresh=not a)
        for a, b in itertools.pairwise(cuts)
    ]
    np.testing.assert_array_equal(np.vstack(parts), whole)
