"""Six degrees of freedom by Newton-Euler, integrated by RK4.

Frames: world north-east-down, body forward-right-down with its origin at the CG.

    m v'  = R (0, 0, -T) + (0, 0, m g) - D v + F_d
    q'    = q (0, w) / 2
    J w'  = M - w x (J w + h) - h' - d w
    Omega_i' = (Omega_c,i - Omega_i) / tau,  or so for u_i or T_i where these lag

    T = sum k_T Omega_i^2
    M = sum (r_i - r_cg) x (0, 0, -k_T Omega_i^2) + sum s_i k_M Omega_i^2 z + M_d
    h = -J_r sum s_i Omega_i z

Rotors that differ, or are canted, and the
reaction of rotor inertia behind any other lag than the speed's are in `sim_bridge.uneven_rotors`.

A rotor that turns counter-clockwise seen from above (s_i = +1) turns about -z, hence the sign
of h. F_d and M_d are disturbances (turbulence), held over a step.

Everything is written component by component, so that a component may be a float (one vehicle)
or an array of shape (N,) (an ensemble): plain floats are several times faster than small arrays,
and there is one implementation for both.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from gcs_sysid.model.parameters import GRAVITY
from sim_bridge.simulated_vehicle import Value, Vehicle
from sim_bridge.uneven_rotors import UnevenRotors

STEP_US = 1000
"""Usual step of the physics, us."""

STEP = 1e-6 * STEP_US
"""The same in s."""


@dataclass
class State:
    """Where the vehicle is and how it moves.

    Attributes:
        body: thirteen components: position (NED, m), velocity (NED, m/s), attitude quaternion
            body to world (w, x, y, z), body rates p, q, r (rad/s).
        speeds: rotor speeds, rad/s, in motor order.
    """

    body: list[Value]
    speeds: list[Value]

    @property
    def position(self) -> list[Value]:
        """North, east, down in m."""
        return self.body[0:3]

    @property
    def velocity(self) -> list[Value]:
        """North, east, down in m/s."""
        return self.body[3:6]

    @property
    def quaternion(self) -> list[Value]:
        """Body to world: w, x, y, z."""
        return self.body[6:10]

    @property
    def rates(self) -> list[Value]:
        """Body rates p, q, r in rad/s."""
        return self.body[10:13]


@dataclass(frozen=True)
class Disturbance:
    """A force (N, world axes) and a torque (N m, body axes) from outside."""

    force: tuple[Value, Value, Value] = (0.0, 0.0, 0.0)
    torque: tuple[Value, Value, Value] = (0.0, 0.0, 0.0)


CALM = Disturbance()


@dataclass
class Dynamics:
    """The equations of motion of one vehicle, or of an ensemble.

    Attributes:
        vehicle: the true parameters; set it by `use` when they change in flight.
        gravity: m/s^2.
        step_size: s.
        uneven: the rotors one by one, where they are not all alike; None where they are.
    """

    vehicle: Vehicle
    gravity: float = GRAVITY
    step_size: float = STEP
    uneven: UnevenRotors | None = field(init=False, repr=False)
    _damping: tuple[Value, Value, Value] = field(init=False, repr=False)
    _inertia: tuple[Value, ...] = field(init=False, repr=False)
    _inverse: tuple[Value, ...] = field(init=False, repr=False)
    _rotors: list[tuple[Value, Value, float]] = field(init=False, repr=False)
    _decay: tuple[Value, Value, Value] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.use(self.vehicle)

    def use(self, vehicle: Vehicle) -> None:
        """Go on with these parameters (a payload dropped, say); the state stays as it is."""
        v = self.vehicle = vehicle
        self._inertia = (v.Ixx, v.Iyy, v.Izz, v.Ixy, v.Iyz, v.Ixz)
        self._inverse = invert_symmetric(*self._inertia)
        self._rotors = [(-(r.y - v.cg_y), r.x - v.cg_x, float(r.spin)) for r in v.rotors]
        self._damping = v.damping or (v.rotational_damping,) * 3
        reacts = v.lag_of != "speed" and bool(np.any(v.rotor_inertia))
        self.uneven = UnevenRotors(v) if v.traits is not None or reacts else None
        h = self.step_size
        # The lag is solved in closed form within a step: Omega_c + (Omega - Omega_c) e^(-t/tau).
        lag = v.motor_lag
        tau = np.maximum(lag, 1e-9)
        half, whole = np.exp(-0.5 * h / tau), np.exp(-h / tau)
        rate = np.where(np.asarray(lag) > 1e-9, 1.0 / tau, 0.0)
        self._decay = (_plain(half), _plain(whole), _plain(rate))

    def wrench(self, speeds: Sequence[Value], targets: Sequence[Value]) -> tuple[Value, ...]:
        """What the rotors do: T, M_x, M_y, M_z, h_z and h_z' (N, N m, N m s, N m).

        Args:
            speeds: rotor speeds, rad/s.
            targets: the speeds they are heading for, rad/s.
        """
        if self.uneven is not None:
            return self.uneven.wrench(speeds, targets)
        thrust = m_x = m_y = spin_square = spin_speed = spin_accel = 0.0
        rate = self._decay[2]
        for (lever_x, lever_y, spin), speed, target in zip(
            self._rotors, speeds, targets, strict=True
        ):
            square = speed * speed
            thrust = thrust + square
            m_x = m_x + lever_x * square
            m_y = m_y + lever_y * square
            spin_square = spin_square + spin * square
            spin_speed = spin_speed + spin * speed
            spin_accel = spin_accel + spin * (target - speed)
        v = self.vehicle
        k_T = v.k_T
        J_r = v.rotor_inertia
        return (
            k_T * thrust,
            k_T * m_x,
            k_T * m_y,
            v.k_M * spin_square,
            -J_r * spin_speed,
            -J_r * rate * spin_accel,
        )

    def derivative(
        self, body: Sequence[Value], wrench: tuple[Value, ...], disturbance: Disturbance = CALM
    ) -> tuple[Value, ...]:
        """Time derivative of the thirteen components of `State.body`."""
        _, _, _, vx, vy, vz, a, b, c, d, p, q, r = body
        thrust, m_x, m_y, m_z, h_z, h_z_rate = wrench
        v = self.vehicle
        Ixx, Iyy, Izz, Ixy, Iyz, Ixz = self._inertia
        f_x, f_y, f_z = disturbance.force
        t_x, t_y, t_z = disturbance.torque

        mass = v.mass
        lift = -thrust / mass
        drag = v.linear_drag / mass
        # Third column of R: where the body z axis points in the world.
        ax = lift * 2.0 * (b * d + a * c) - drag * vx + f_x / mass
        ay = lift * 2.0 * (c * d - a * b) - drag * vy + f_y / mass
        az = lift * (1.0 - 2.0 * (b * b + c * c)) - drag * vz + f_z / mass + self.gravity

        # Angular momentum J w + h, then the torque left to accelerate the body.
        l_x = Ixx * p + Ixy * q + Ixz * r
        l_y = Ixy * p + Iyy * q + Iyz * r
        l_z = Ixz * p + Iyz * q + Izz * r + h_z
        d_p, d_q, d_r = self._damping
        n_x = m_x + t_x - (q * l_z - r * l_y) - d_p * p
        n_y = m_y + t_y - (r * l_x - p * l_z) - d_q * q
        n_z = m_z + t_z - (p * l_y - q * l_x) - d_r * r - h_z_rate
        Kxx, Kyy, Kzz, Kxy, Kyz, Kxz = self._inverse
        return (
            vx,
            vy,
            vz,
            ax,
            ay,
            az,
            0.5 * (-b * p - c * q - d * r),
            0.5 * (a * p + c * r - d * q),
            0.5 * (a * q - b * r + d * p),
            0.5 * (a * r + b * q - c * p),
            Kxx * n_x + Kxy * n_y + Kxz * n_z,
            Kxy * n_x + Kyy * n_y + Kyz * n_z,
            Kxz * n_x + Kyz * n_y + Kzz * n_z,
        )

    def step(
        self, state: State, targets: Sequence[Value], disturbance: Disturbance = CALM
    ) -> State:
        """Advance by one step with the rotor-speed targets held.

        The rotors are solved exactly, the body by RK4 on the rotors' known history.
        """
        h = self.step_size
        half, whole, _ = self._decay
        start = state.speeds
        middle = self._lagged(start, targets, half)
        end = self._lagged(start, targets, whole)
        wrench_middle = self.wrench(middle, targets)
        y = state.body
        derivative = self.derivative
        k1 = derivative(y, self.wrench(start, targets), disturbance)
        k2 = derivative(
            [u + 0.5 * h * k for u, k in zip(y, k1, strict=True)], wrench_middle, disturbance
        )
        k3 = derivative(
            [u + 0.5 * h * k for u, k in zip(y, k2, strict=True)], wrench_middle, disturbance
        )
        k4 = derivative(
            [u + h * k for u, k in zip(y, k3, strict=True)],
            self.wrench(end, targets),
            disturbance,
        )
        sixth = h / 6.0
        new = [
            u + sixth * (a + 2.0 * (b + c) + d)
            for u, a, b, c, d in zip(y, k1, k2, k3, k4, strict=True)
        ]
        q0, q1, q2, q3 = new[6:10]
        scale = (q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3) ** -0.5
        new[6:10] = [q0 * scale, q1 * scale, q2 * scale, q3 * scale]
        return State(new, end)

    def _lagged(
        self, speeds: Sequence[Value], targets: Sequence[Value], decay: Value
    ) -> list[Value]:
        """Rotor speeds on their way to the targets, of which this share is left to go."""
        v = self.vehicle
        if v.lag_of == "speed":
            return [c + (s - c) * decay for s, c in zip(speeds, targets, strict=True)]
        if v.lag_of == "thrust":
            return [
                (c * c + (s * s - c * c) * decay) ** 0.5
                for s, c in zip(speeds, targets, strict=True)
            ]
        commands = [
            (v.command_of(s), v.command_of(c)) for s, c in zip(speeds, targets, strict=True)
        ]
        return [v.speed_of(c + (s - c) * decay) for s, c in commands]

    def imu(
        self, state: State, targets: Sequence[Value], disturbance: Disturbance = CALM
    ) -> tuple[list[Value], list[Value]]:
        """What perfect inertial sensors read: body rates (rad/s), specific force (m/s^2).

        The accelerometer sits at (imu_x, imu_y, imu_z) from the CG and so reads
        f + w' x r + w x (w x r) as well.
        """
        k = self.derivative(state.body, self.wrench(state.speeds, targets), disturbance)
        x, y, z = rotate_to_body(state.quaternion, (k[3], k[4], k[5] - self.gravity))
        p, q, r = state.rates
        v = self.vehicle
        X, Y, Z = v.imu_x, v.imu_y, v.imu_z
        dp, dq, dr = k[10], k[11], k[12]
        x = x + dq * Z - dr * Y + p * q * Y + p * r * Z - (q * q + r * r) * X
        y = y + dr * X - dp * Z + p * q * X + q * r * Z - (p * p + r * r) * Y
        z = z + dp * Y - dq * X + p * r * X + q * r * Y - (p * p + q * q) * Z
        return [p, q, r], [x, y, z]


def invert_symmetric(
    xx: Value, yy: Value, zz: Value, xy: Value, yz: Value, xz: Value
) -> tuple[Value, ...]:
    """Inverse of a symmetric 3 x 3 matrix, elements in the same order (xx, yy, zz, xy, yz, xz)."""
    c_xx = yy * zz - yz * yz
    c_xy = xz * yz - xy * zz
    c_xz = xy * yz - xz * yy
    scale = 1.0 / (xx * c_xx + xy * c_xy + xz * c_xz)
    return (
        c_xx * scale,
        (xx * zz - xz * xz) * scale,
        (xx * yy - xy * xy) * scale,
        c_xy * scale,
        (xy * xz - xx * yz) * scale,
        c_xz * scale,
    )


def rotate_to_body(
    quaternion: Sequence[Value], vector: Sequence[Value]
) -> tuple[Value, Value, Value]:
    """Turn a world vector into body axes: R^T u for the body-to-world quaternion."""
    a, b, c, d = quaternion
    x, y, z = vector
    # u + 2 a (t) + 2 (e x t) with e the conjugate's vector part and t = e x u.
    t_x = d * y - c * z
    t_y = b * z - d * x
    t_z = c * x - b * y
    return (
        x + 2.0 * (a * t_x - c * t_z + d * t_y),
        y + 2.0 * (a * t_y - d * t_x + b * t_z),
        z + 2.0 * (a * t_z - b * t_y + c * t_x),
    )


def rotate_to_world(
    quaternion: Sequence[Value], vector: Sequence[Value]
) -> tuple[Value, Value, Value]:
    """Turn a vector of body axes into the world's: R u for the body-to-world quaternion."""
    a, b, c, d = quaternion
    return rotate_to_body((a, -b, -c, -d), vector)


def _plain(value: np.ndarray | np.floating) -> Value:
    """A float where the value is one number: numpy's own scalars are slow."""
    return float(value) if np.ndim(value) == 0 else value
