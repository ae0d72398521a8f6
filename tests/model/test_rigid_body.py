"""The equations of rotation against first principles."""

import numpy as np
import pytest

from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.parameters import INERTIA

STATES = 50
"""Random vehicles and states a case; each has its own rotors, CG, inertia and motion."""


def random_inertia(rng, size=0.02):
    """The inertia matrix of a cloud of points: physical by construction."""
    points = rng.normal(size=(20, 3)) * np.sqrt(size / 20)
    return sum((r @ r) * np.eye(3) - np.outer(r, r) for r in points)


class Vehicle:
    """A random vehicle, its random state, and w' from Newton and Euler, rotor by rotor."""

    def __init__(self, rng, n, damping=True, rotor_inertia=True):
        self.J = random_inertia(rng)
        self.cg = np.append(rng.uniform(-0.1, 0.1, 2), 0.0)
        self.r = np.column_stack([rng.uniform(-0.5, 0.5, (n, 2)), np.zeros(n)])
        self.spin = rng.choice([-1, 1], n)
        self.k_T = rng.uniform(1e-6, 1e-3)
        self.k_M = self.k_T * rng.uniform(0.005, 0.05)
        self.d = rng.uniform(0.0, 0.01) if damping else 0.0
        self.J_r = rng.uniform(0.0, 1e-4) if rotor_inertia else 0.0
        self.w = rng.normal(size=3) * 3.0
        self.Omega = rng.uniform(100.0, 900.0, n)
        self.Omega_dot = rng.normal(size=n) * 2000.0
        z = np.array([0.0, 0.0, 1.0])
        M = -self.d * self.w
        h = np.zeros(3)
        h_dot = np.zeros(3)
        for r, s, speed, change in zip(self.r, self.spin, self.Omega, self.Omega_dot, strict=True):
            M = M + np.cross(r - self.cg, -self.k_T * speed**2 * z) + s * self.k_M * speed**2 * z
            # Counter-clockwise seen from above is a turn about -z.
            h = h - self.J_r * s * speed * z
            h_dot = h_dot - self.J_r * s * change * z
        self.parts = (M, np.cross(self.w, self.J @ self.w + h), h_dot)
        self.w_dot = np.linalg.solve(self.J, M - np.cross(self.w, self.J @ self.w + h) - h_dot)

    @property
    def theta(self):
        J = self.J
        elements = [J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[1, 2], J[0, 2]]
        values = dict(zip(INERTIA, elements, strict=True)) | {
            "cg_x": self.cg[0],
            "cg_y": self.cg[1],
            "moment_ratio": self.k_M / self.k_T,
            "rotational_damping": self.d,
            "rotor_inertia": self.J_r,
        }
        return rb.theta_of(values, self.k_T)

    @property
    def geometry(self):
        return np.vstack([self.r[:, 0], self.r[:, 1], self.spin])

    @property
    def signals(self):
        rotors, H = rb.rotor_signals(self.geometry, self.Omega)
        p, q, _ = self.w
        H_dot = float(self.spin @ self.Omega_dot)
        return np.concatenate([rotors, rb.rate_signals(self.w), [q * H, p * H, H_dot]])


@pytest.mark.parametrize("rotors", [4, 6, 8])
def test_forward_form_is_newton_euler(rotors):
    rng = np.random.default_rng(rotors)
    for _ in range(STATES):
        v = Vehicle(rng, rotors)
        Q = rb.forward_matrix(v.theta)
        # Rounding: 1e-12 of what goes into the sum, which is larger than what comes out.
        scale = np.abs(np.linalg.inv(v.J)) @ np.abs(v.parts).sum(axis=0)
        assert np.all(np.abs(Q @ v.signals - v.w_dot) < 1e-12 * scale)


@pytest.mark.parametrize("rotors", [4, 6, 8])
def test_direct_rows_are_newton_euler(rotors):
    rng = np.random.default_rng(10 + rotors)
    for _ in range(STATES):
        v = Vehicle(rng, rotors, damping=False, rotor_inertia=False)
        x = v.signals
        phi, y = rb.direct_rows(v.w[None], v.w_dot[None], x[None, :4])
        scale = np.abs(phi[0]) @ np.abs(v.theta[:9]) + np.abs(y[0])
        assert np.all(np.abs(phi[0] @ v.theta[:9] - y[0]) < 1e-12 * scale)
        assert y[0, 2] == 0.0


def test_paper_layout_has_the_papers_right_hand_side():
    # Lever arm L, rotors as the article numbers them: rear right, front right, rear left, front
    # left; the right-hand sides printed in MODEL.md.
    L = 0.25
    geometry = np.array([[-L, L, -L, L], [L, L, -L, -L], [-1, 1, 1, -1]])
    O1, O2, O3, O4 = speeds_squared = np.array([3.0e4, 5.0e4, 7.0e4, 11.0e4])
    (roll, pitch, thrust, yaw), H = rb.rotor_signals(geometry, np.sqrt(speeds_squared))
    expected = [L * (O3 + O4 - O1 - O2), L * (O2 + O4 - O1 - O3), O1 + O2 + O3 + O4]
    np.testing.assert_allclose([roll, pitch, thrust], expected, rtol=1e-14)
    np.testing.assert_allclose(yaw, O2 + O3 - O1 - O4, rtol=1e-14)
    np.testing.assert_allclose(H, np.sqrt([O1, O2, O3, O4]) @ geometry[2], rtol=1e-14)


@pytest.mark.slow
def test_jacobian_is_the_complex_step_derivative():
    rng = np.random.default_rng(3)
    for _ in range(10):
        theta = Vehicle(rng, 4).theta
        Q, G = rb.forward_jacobian(theta)
        np.testing.assert_allclose(Q, rb.forward_matrix(theta), rtol=1e-12, atol=0.0)
        for k in range(rb.N_THETA):
            step = 1e-30 * max(abs(theta[k]), 1.0)
            moved = theta.astype(complex)
            moved[k] += 1j * step
            expected = rb.forward_matrix(moved).imag / step
            # No cancellation in a complex step: only rounding is left.
            np.testing.assert_allclose(G[k], expected, rtol=0.0, atol=1e-11 * np.abs(G[k]).max())


def test_signals_of_the_rates_have_their_names():
    rates = np.array([3.0, -5.0, 7.0])
    named = dict(zip(rb.SIGNALS[rb.OF_RATES], rb.rate_signals(rates), strict=True))
    products = {"qr": -35.0, "rp": 21.0, "pq": -15.0, "pp": 9.0, "qq": 25.0, "rr": 49.0}
    assert products | {"p": 3.0, "q": -5.0, "r": 7.0} == {
        name: named[name] for name in (*products, *"pqr")
    }


ROTATION = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]


def rotated(*principal):
    J = ROTATION @ np.diag(principal) @ ROTATION.T
    return [J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[1, 2], J[0, 2]]


@pytest.mark.parametrize(
    ("elements", "physical"),
    [
        ([1, 1, 1, 0, 0, 0], True),
        ([1, 1, 1.99, 0, 0, 0], True),
        ([1, 1, 2.01, 0, 0, 0], False),  # triangle inequality
        ([1, 2.01, 1, 0, 0, 0], False),
        ([2.01, 1, 1, 0, 0, 0], False),
        ([-1, 1, 1, 0, 0, 0], False),
        ([1, 1, 1, 1.01, 0, 0], False),  # product too large: not positive definite
        ([1, 1, 1, 0.4, 0, 0], True),
        ([1, 1, 1, 0.6, 0.0, 0], False),  # positive definite, but 1.6 > 1 + 0.4
        (rotated(1, 1, 1.9), True),
        (rotated(1, 1, 2.1), False),  # each element alone looks fine
        ([0.0165, 0.0167, 0.0294, 0.00135, 0.00254, -0.00166], True),  # Table 1
    ],
)
def test_is_physical(elements, physical):
    assert rb.is_physical(np.array(elements, dtype=float)) is physical


def test_every_cloud_of_points_is_physical():
    rng = np.random.default_rng(6)
    for _ in range(100):
        J = random_inertia(rng)
        assert rb.is_physical(np.array([J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[1, 2], J[0, 2]]))
