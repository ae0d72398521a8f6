"""Whether a vehicle moves like a rigid body."""

import numpy as np
import pytest

from gcs_sysid.estimation.rigid_body_test import PRODUCTS, RigidBodyTest, judge_rigid_body
from gcs_sysid.model import rigid_body as rb

THETA = rb.theta_of(
    {
        "Ixx": 80.0,
        "Iyy": 110.0,
        "Izz": 170.0,
        "Ixy": 6.0,
        "Iyz": -4.0,
        "Ixz": 5.0,
        "cg_x": 0.01,
        "cg_y": -0.02,
        "moment_ratio": 0.02,
        "rotational_damping": 60.0,
    }
)

PLAIN = np.eye(rb.N_SIGNALS + 3)
"""Of moments of rows as they are."""


def batches(share, noise=0.05, rows=100, count=30, activity=1.0, seed=5):
    """Moments of rows with the gyroscopic torque of THETA multiplied by a share."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(count, rows, rb.N_SIGNALS))
    x[..., PRODUCTS] *= activity
    Q = rb.forward_matrix(THETA)
    Q[:, PRODUCTS] *= share
    y = x @ Q.T + noise * rng.normal(size=(count, rows, 3))
    z = np.concatenate([x, y], axis=-1)
    return np.swapaxes(z, 1, 2) @ z


@pytest.mark.parametrize("share", [1.0, 0.0, 0.5])
def test_share_is_found(share):
    found = judge_rigid_body(batches(share), PLAIN, THETA)
    assert np.all(np.abs(found.share - share) < 4.0 * found.std)
    assert np.all(found.std < 0.05)
    assert found.contradicted == (share < 1.0)


def test_rotation_about_one_axis_at_a_time_contradicts_nothing():
    found = judge_rigid_body(batches(0.0, activity=3e-3), PLAIN, THETA)
    assert np.all(found.std > 0.2)
    assert not found.contradicted


def test_no_coupling_is_no_contradiction():
    same = THETA.copy()
    same[:6] = [100.0, 100.0, 100.0, 0.0, 0.0, 0.0]
    found = judge_rigid_body(batches(1.0), PLAIN, same)
    assert np.isnan(found.share).all()
    assert not found.contradicted


@pytest.mark.parametrize(
    ("share", "std", "contradicted"),
    [(0.75, 0.01, False), (0.6, 0.05, True), (0.6, 0.2, False), (1.5, 0.05, True)],
)
def test_what_is_small_or_unsure_is_not_held_against_it(share, std, contradicted):
    found = RigidBodyTest(np.array([1.0, share, np.nan]), np.array([0.1, std, np.nan]))
    assert found.contradicted == contradicted
