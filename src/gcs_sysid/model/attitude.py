"""Quaternions (w, x, y, z; body to world, Hamilton) and Euler angles (ZYX), vectorised.

Every function takes and returns arrays whose last axis is the quaternion or vector.
"""

import math

import numpy as np

from gcs_sysid.arrays import Array

# a b = (matrix of a) b; its entries are a's, permuted and signed.
_FACTOR = np.array([[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]])
_INVERSE = np.array([1.0, -1.0, -1.0, -1.0])
_SIGN = np.array([[1, -1, -1, -1], [1, 1, -1, 1], [1, 1, 1, -1], [1, -1, 1, 1]], dtype=float)


def _quadratic() -> Array:
    """(16, 9): products of a quaternion's entries to the entries of its matrix."""
    form = np.zeros((4, 4, 3, 3))
    form[0, 0] = np.eye(3)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        form[i + 1, i + 1] = -np.eye(3)
        form[i + 1, i + 1, i, i] = 1.0
        form[i + 1, j + 1, i, j] = form[i + 1, j + 1, j, i] = 2.0
        form[0, i + 1, j, k], form[0, i + 1, k, j] = -2.0, 2.0
    return form.reshape(16, 9)


_QUADRATIC = _quadratic()


def multiply(a: Array, b: Array) -> Array:
    """Quaternion product a b, shapes (..., 4)."""
    return (a[..., _FACTOR] * _SIGN @ b[..., None])[..., 0]


def conjugate(q: Array) -> Array:
    """The inverse rotation of unit quaternions (..., 4)."""
    return q * _INVERSE


def from_rotation_vector(v: Array) -> Array:
    """Unit quaternions of rotation vectors (..., 3) in rad."""
    half = 0.5 * np.sqrt((v * v).sum(axis=-1, keepdims=True))
    q = np.empty((*v.shape[:-1], 4))
    q[..., :1] = np.cos(half)
    safe = np.maximum(half, 1e-150)
    q[..., 1:] = 0.5 * np.sin(safe) / safe * v
    return q


def from_angles(angles: Array) -> Array:
    """Unit quaternions (n, 4) of (n, 3) roll, pitch, yaw in rad."""
    turns = angles[:, :, None] * np.eye(3)  # (n, axis, 3)
    roll, pitch, yaw = np.moveaxis(from_rotation_vector(turns), 1, 0)
    return multiply(multiply(yaw, pitch), roll)


def to_rotation_vector(q: Array) -> Array:
    """Rotation vectors (..., 3) in rad of unit quaternions, angles up to pi."""
    real, vector = q[..., :1], q[..., 1:]
    sine = np.maximum(np.sqrt((vector * vector).sum(axis=-1, keepdims=True)), 1e-150)
    # q and -q are the same rotation; the shorter way is wanted.
    half = np.arctan2(sine, np.abs(real))
    return np.copysign(2.0 * half / sine, real) * vector


def matrices(q: Array) -> Array:
    """(..., 3, 3) matrices from body to world axes."""
    squares = (q[..., :, None] * q[..., None, :]).reshape(*q.shape[:-1], 16)
    return (squares @ _QUADRATIC).reshape(*q.shape[:-1], 3, 3)


def down_axis(q: Array) -> Array:
    """(..., 3) the body's down axis in world axes."""
    return matrices(q)[..., 2]


def rotate(q: Array, v: Array) -> Array:
    """Body vectors (..., 3) in world axes."""
    return (matrices(q) @ v[..., None])[..., 0]


def from_euler(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Unit quaternion w, x, y, z of one set of angles in rad (plain floats: once a message)."""
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def to_euler(q: Array) -> Array:
    """(..., 3) roll, pitch, yaw in rad."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    return np.stack(
        [
            np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
            np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0)),
            np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
        ],
        axis=-1,
    )


def align_signs(q: Array) -> Array:
    """(n, 4) the same rotations with signs such that neighbors are close."""
    if len(q) < 2:
        return q
    flips = np.where(np.sum(q[1:] * q[:-1], axis=-1) < 0.0, -1.0, 1.0)
    return q * np.concatenate([[1.0], np.cumprod(flips)])[:, None]
