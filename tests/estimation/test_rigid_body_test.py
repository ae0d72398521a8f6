"""Whether a vehicle moves like a rigid body."""

import numpy as np
import pytest

from gcs_sysid.estimation.checks.model_tests import PRODUCTS, RigidBodyTest, judge_rigid_body
from gcs_sysid.model import rigid_body as rb

THETA = rb.theta_of({
    "Ixx": 80.0, "Iyy": 110.0, "Izz": 170.0, "Ixy": 6.0, "Iyz": -4.0, "Ixz": 5.0,
    "cg_x": 0.01, "cg_y": -0.02, "moment_ratio": 0.02, "rotational_damping": 60.0,
})  # fmt: skip


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


def judged(moments, Q):
    """Of moments that are the same for all axes."""
    return judge_rigid_body(np.repeat(moments[:, None], 3, axis=1), Q)


@pytest.mark.parametrize("share", [1.0, 0.0, 0.5])
def test_share_is_found(share):
    found = judged(batches(share), rb.forward_matrix(THETA))
    assert np.all(np.abs(found.share - share) < 4.0 * found.std)
    assert np.all(found.std < 0.05)
    assert found.contradicted == (share < 1.0)


def test_each_axis_may_have_moments_of_its_own():
    """Roll without gyroscopic torque, the others with it."""
    none, whole = batches(0.0), batches(1.0)
    found = judge_rigid_body(np.stack([none, whole, whole], axis=1), rb.forward_matrix(THETA))
    roll, all_ = (judged(b, rb.forward_matrix(THETA)) for b in (none, whole))
    np.testing.assert_array_equal(found.share, [roll.share[0], *all_.share[1:]])
    np.testing.assert_array_equal(found.std, [roll.std[0], *all_.std[1:]])


def test_rotation_about_one_axis_at_a_time_contradicts_nothing():
    found = judged(batches(0.0, activity=3e-3), rb.forward_matrix(THETA))
    assert np.all(found.std > 0.2)
    assert not found.contradicted


def test_no_coupling_is_no_contradiction():
    same = THETA.copy()
    same[:6] = [100.0, 100.0, 100.0, 0.0, 0.0, 0.0]
    found = judged(batches(1.0), rb.forward_matrix(same))
    assert np.isnan(found.share).all()
    assert not found.contradicted


@pytest.mark.parametrize(
    ("share", "std", "contradicted"),
    [(0.75, 0.01, False), (0.6, 0.05, True), (0.6, 0.2, False), (1.5, 0.05, True)],
)
def test_what_is_small_or_unsure_is_not_held_against_it(share, std, contradicted):
    found = RigidBodyTest(np.array([1.0, share, np.nan]), np.array([0.1, std, np.nan]))
    assert found.contradicted == contradicted


def colored(seed=7, count=24, rows=50):
    """Inputs that hang together, and outputs whose noise changes slowly from batch to batch."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(count * rows, rb.N_SIGNALS))
    x[:, PRODUCTS] += 0.4 * x[:, :6]
    slow = np.repeat(np.cumsum(rng.normal(size=(count, 3)), axis=0), rows, axis=0)
    y = x @ rb.forward_matrix(THETA).T + 0.02 * slow * x[:, PRODUCTS[:3]]
    return x, y + 0.05 * rng.normal(size=y.shape), rows


def test_share_and_deviation_are_those_of_a_regression():
    """Rows written out: residual on predicted torque, both freed of all other inputs."""
    x, y, rows = colored()
    z = np.column_stack([x, y]).reshape(-1, rows, x.shape[1] + 3)
    found = judged(np.swapaxes(z, 1, 2) @ z, rb.forward_matrix(THETA))
    Q = rb.forward_matrix(THETA)
    others = np.delete(x, PRODUCTS, axis=1)
    for axis in range(3):
        pair = np.column_stack([x[:, PRODUCTS] @ Q[axis, PRODUCTS], y[:, axis] - x @ Q[axis]])
        pair -= others @ np.linalg.lstsq(others, pair, rcond=None)[0]
        predicted, residual = pair.T
        more = predicted @ residual / (predicted @ predicted)
        scores = (predicted * (residual - more * predicted)).reshape(-1, rows).sum(axis=1)
        meat = max(scores @ scores + 2.0 * scores[1:] @ scores[:-1], scores @ scores)
        assert found.share[axis] == pytest.approx(1.0 + more, rel=1e-9)
        assert found.std[axis] == pytest.approx(np.sqrt(meat) / (predicted @ predicted), rel=1e-6)
    # It tells apart what it must: slow noise makes some axis less sure by more than a tenth.
    assert np.all(found.std > 0.0)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_gyroscopic_torque_that_follows_a_rotor_torque_tells_nothing(axis):
    """All of it is explained by the roll torque: rounding is left, whatever else moves the axis."""
    x, _, rows = colored()
    Q = rb.forward_matrix(THETA)
    x[:, PRODUCTS] = 0.0
    y = x @ Q.T
    y[:, axis] -= 5.0 * y[:, axis].std() * x[:, rb.N_SIGNALS - max(axis, 1)]
    # A thousandth of the axis' acceleration: far above what counts as none.
    strength = np.sqrt(1e-3 * (y[:, axis] ** 2).mean() / (x[:, 0] ** 2).mean())
    x[:, PRODUCTS[0]] = strength / np.abs(Q[axis, PRODUCTS[0]]) * x[:, 0]
    z = np.column_stack([x, y]).reshape(-1, rows, x.shape[1] + 3)
    found = judged(np.swapaxes(z, 1, 2) @ z, Q)
    assert np.isnan(found.share[axis])
    assert np.isnan(found.std[axis])
