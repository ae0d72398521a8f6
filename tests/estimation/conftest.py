"""A flight from a small simulator of its own: rigid body, motors, drag and wind by solve_ivp."""

import hashlib
from dataclasses import dataclass, replace
from math import cos, sin

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from gcs_sysid.model import attitude
from gcs_sysid.signals.records import Samples
from tests.known_theta import theta_from

G = 9.80665
SIGNALS = ("gyro", "rates", "speeds", "attitude", "force", "velocity")


@dataclass
class Truth:
    """A vehicle; lengths in m, everything in SI."""

    m: float = 1.5
    J: tuple = (
        (0.0165, 0.00135, -0.00166),
        (0.00135, 0.0167, 0.00254),
        (-0.00166, 0.00254, 0.0294),
    )
    cg: tuple = (0.1, 0.05)
    k_T: float = 2.05e-4
    k_M: float = 6.14e-6
    damping: float = 0.004
    rotor_inertia: float = 6e-5
    drag: float = 0.25
    gyroscopic: float = 1.0
    """Times the torque w x J w of a rigid body; that of its rotors, w x h, stays."""
    wind: tuple = (3.0, -2.0, 0.0)
    x: tuple = (0.25, -0.25, 0.25, -0.25)
    y: tuple = (0.25, -0.25, -0.25, 0.25)
    spin: tuple = (1, 1, -1, -1)

    @property
    def geometry(self):
        return np.array([self.x, self.y, self.spin], dtype=float)

    @property
    def theta(self):
        J = np.array(self.J)
        inertia = [J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[1, 2], J[0, 2]]
        k = self.k_T
        return theta_from(
            *(i / k for i in inertia), *self.cg, self.k_M / k, self.damping / k,
            self.rotor_inertia / k,
        )  # fmt: skip


def rates_wanted(t):
    """Smooth, incommensurate, on all axes at once."""
    return np.array(
        [
            0.9 * sin(2.6 * t) + 0.5 * sin(9.1 * t + 1.0) * sin(1.1 * t),
            0.9 * sin(3.7 * t + 2.0) + 0.5 * cos(7.3 * t),
            0.7 * sin(1.9 * t + 0.5) + 0.4 * sin(5.9 * t),
        ]
    )


def simulate(truth, seconds, dt):
    """(Samples, specific force at the CG) on a grid of dt."""
    J, z = np.array(truth.J), np.array([0.0, 0.0, 1.0])
    inverse = np.linalg.inv(J)
    r = np.column_stack([truth.x, truth.y, np.zeros(4)]) - [*truth.cg, 0.0]
    s = np.array(truth.spin, dtype=float)
    torque = np.cross(r, -truth.k_T * z) + np.outer(truth.k_M * s, z)  # (4, 3) a rotor, over O
    mixer = np.linalg.inv(np.vstack([torque.T, np.full(4, truth.k_T)]))
    wind = np.array(truth.wind)

    def change(t, state):
        w, Omega, q, v = state[:3], state[3:7], state[7:11], state[11:]
        wanted = J @ (8.0 * (rates_wanted(t) - w))
        thrust = truth.m * G * (1.0 + 0.2 * sin(1.3 * t))
        command = np.sqrt(np.maximum(mixer[:, :3] @ wanted + mixer[:, 3] * thrust, 1e3))
        Omega_dot = (command - Omega) / 0.03
        p, qq, rr = w.tolist()
        a, b, c = (truth.gyroscopic * (J @ w)).tolist()
        c -= truth.rotor_inertia * float(s @ Omega)
        gyroscopic = np.array([qq * c - rr * b, rr * a - p * c, p * b - qq * a])
        M = (Omega * Omega) @ torque - truth.damping * w - gyroscopic
        M[2] += truth.rotor_inertia * float(s @ Omega_dot)
        # Quaternions drift off unit length by rounding alone; only their direction counts.
        q0, q1, q2, q3 = q.tolist()
        q_dot = [
            0.5 * (-p * q1 - qq * q2 - rr * q3),
            0.5 * (p * q0 + rr * q2 - qq * q3),
            0.5 * (qq * q0 - rr * q1 + p * q3),
            0.5 * (rr * q0 + qq * q1 - p * q2),
        ]
        size = q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3
        down = np.array([2.0 * (q1 * q3 + q0 * q2), 2.0 * (q2 * q3 - q0 * q1),
                         q0 * q0 - q1 * q1 - q2 * q2 + q3 * q3]) / size  # fmt: skip
        force = -truth.k_T * (Omega @ Omega) * down - truth.drag * (v - wind)
        return np.concatenate([inverse @ M, Omega_dot, q_dot, G * z + force / truth.m])

    t = np.arange(round(seconds / dt)) * dt
    hover = np.sqrt(mixer @ [0, 0, 0, truth.m * G])
    start = np.concatenate([np.zeros(3), hover, [1.0, 0, 0, 0], np.zeros(3)])
    # 1e-8: far below what any test asks of the estimates.
    out = solve_ivp(change, (0.0, t[-1]), start, "DOP853", t, rtol=1e-8, atol=1e-8)
    w, Omega, q, v = out.y[:3].T, out.y[3:7].T, out.y[7:11].T, out.y[11:].T
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    lift = truth.k_T / truth.m * np.sum(Omega**2, axis=1)
    drag = attitude.rotate(attitude.conjugate(q), -truth.drag / truth.m * (v - wind))
    force = drag - lift[:, None] * z
    return Samples(gyro=w, rates=w, speeds=Omega, attitude=q, force=force, velocity=v)


@pytest.fixture(scope="session")
def simulated(once):
    """30 s at 200 Hz of a vehicle, without any noise; integrated once for all workers."""

    def simulated(truth):
        def make(folder):
            flown = simulate(truth, 30.0, 0.005)
            np.savez(folder / "flown.npz", **{name: getattr(flown, name) for name in SIGNALS})

        name = f"simulated-{hashlib.sha256(repr(truth).encode()).hexdigest()[:16]}"
        with np.load(once(name, make) / "flown.npz") as kept:
            return Samples(**{name: kept[name] for name in SIGNALS})

    return simulated


@pytest.fixture(scope="session")
def truth():
    return Truth()


@pytest.fixture(scope="session")
def flight(truth, simulated):
    return simulated(truth)


@pytest.fixture(scope="session")
def plain_flight(truth, simulated):
    """By the article's model: without damping and rotor inertia."""
    return simulated(replace(truth, damping=0.0, rotor_inertia=0.0))


@pytest.fixture(scope="session")
def untwisted_flight(truth, simulated):
    """Of what is no rigid body: without its gyroscopic torque."""
    return simulated(replace(truth, gyroscopic=0.0))
