"""Quaternions against SciPy's rotations."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gcs_sysid.model import attitude

TIGHT = {"rtol": 0.0, "atol": 1e-14}
"""A handful of roundings on numbers of size one."""


def random_quaternions(seed, n=200):
    q = np.random.default_rng(seed).normal(size=(n, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def as_rotation(q):
    return Rotation.from_quat(np.roll(q, -1, axis=-1))


def same_rotation(a, b, atol=1e-14):
    np.testing.assert_allclose(np.abs(np.sum(a * b, axis=-1)), 1.0, rtol=0.0, atol=atol)


def test_product_is_composition():
    a, b = random_quaternions(1), random_quaternions(2)
    product = attitude.multiply(a, b)
    expected = (as_rotation(a) * as_rotation(b)).as_matrix()
    np.testing.assert_allclose(as_rotation(product).as_matrix(), expected, rtol=0, atol=1e-14)
    v = np.random.default_rng(3).normal(size=(200, 3))
    np.testing.assert_allclose(
        attitude.rotate(product, v), attitude.rotate(a, attitude.rotate(b, v)), rtol=0, atol=1e-13
    )


def test_conjugate_undoes():
    q = random_quaternions(4)
    identity = attitude.multiply(q, attitude.conjugate(q))
    np.testing.assert_allclose(identity, np.tile([1.0, 0, 0, 0], (200, 1)), **TIGHT)


def test_rotate_takes_body_to_world():
    q, v = random_quaternions(5), np.random.default_rng(6).normal(size=(200, 3))
    np.testing.assert_allclose(attitude.rotate(q, v), as_rotation(q).apply(v), rtol=0, atol=1e-14)
    # Nose up by 90 degrees: the body's x axis points against world down.
    nose_up = attitude.from_rotation_vector(np.array([0.0, np.pi / 2, 0.0]))
    forward = attitude.rotate(nose_up, np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(forward, [0.0, 0.0, -1.0], **TIGHT)


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-13, 1e-8, 1e-3, 1.0, 3.0, np.pi - 1e-9])
def test_rotation_vector_round_trip(angle):
    axes = np.random.default_rng(7).normal(size=(50, 3))
    v = angle * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    q = attitude.from_rotation_vector(v)
    same_rotation(q, np.roll(Rotation.from_rotvec(v).as_quat(), 1, axis=-1))
    np.testing.assert_allclose(attitude.to_rotation_vector(q), v, rtol=1e-13, atol=0.0)
    np.testing.assert_allclose(attitude.to_rotation_vector(-q), v, rtol=1e-13, atol=0.0)


def test_rotation_vector_of_half_a_turn():
    v = attitude.to_rotation_vector(np.array([0.0, 0.0, 1.0, 0.0]))
    np.testing.assert_allclose(v, [0.0, np.pi, 0.0], rtol=1e-15)


def test_euler_angles_are_zyx():
    q = random_quaternions(8)
    expected = as_rotation(q).as_euler("ZYX")[:, ::-1]
    # Roll and yaw lose digits as pitch comes near 90 degrees; the sample stays 1 degree away.
    assert np.abs(expected[:, 1]).max() < np.radians(89)
    np.testing.assert_allclose(attitude.to_euler(q), expected, rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(attitude.to_euler(-q), attitude.to_euler(q))


@pytest.mark.parametrize(("pitch"), [np.pi / 2, -np.pi / 2])
def test_euler_angles_at_the_pole_are_finite(pitch):
    q = attitude.from_rotation_vector(np.array([0.0, pitch, 0.0])) * (1.0 + 1e-15)
    assert attitude.to_euler(q)[1] == pytest.approx(pitch, abs=1e-7)


def test_align_signs_keeps_rotations_and_joins_neighbors():
    rng = np.random.default_rng(9)
    smooth = attitude.from_rotation_vector(np.linspace(0, 6, 100)[:, None] * [0.6, 0.0, 0.8])
    flipped = smooth * rng.choice([-1.0, 1.0], (100, 1))
    aligned = attitude.align_signs(flipped)
    assert np.all(np.sum(aligned[1:] * aligned[:-1], axis=1) > 0.0)
    np.testing.assert_array_equal(np.abs(aligned), np.abs(smooth))
    np.testing.assert_array_equal(aligned[0], flipped[0])
    assert attitude.align_signs(flipped[:1]) is not None
    assert len(attitude.align_signs(flipped[:0])) == 0
