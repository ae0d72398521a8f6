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
from sim_bridge.equations_of_motion import Accelerations, equations_of_motion
from sim_bridge.simulated_vehicle import Value, Vehicle
from sim_bridge.uneven_rotors import UnevenRotors

STEP_US = 1000
"""Usual step of the physics, us."""

STEP = 1e-6 * STEP_US
"""The same in s."""


@dataclass(slots=True)
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
    _accelerations: Accelerations = field(init=False, repr=False)
    _rotors: list[tuple[Value, Value, float]] = field(init=False, repr=False)
    _decay: tuple[Value, Value, Value] = field(init=False, repr=False)
    _drag: Value = field(init=False, repr=False)
    _dragged: bool = field(init=False, repr=False)
    _reacts: bool = field(init=False, repr=False)
    _usual: bool = field(init=False, repr=False)
    _imu_at_cg: bool = field(init=False, repr=False)
    _coefficients: tuple[Value, Value, Value] = field(init=False, repr=False)
    _reached: tuple[Sequence[Value], Sequence[Value], Disturbance, tuple[Value, ...]] | None = (
        field(init=False, repr=False)
    )

    def __post_init__(self) -> None:
        self.use(self.vehicle)

    def use(self, vehicle: Vehicle) -> None:
        """Go on with these parameters (a payload dropped, say); the state stays as it is."""
        v = self.vehicle = vehicle
        self._accelerations = equations_of_motion(v)
        self._rotors = [(-(r.y - v.cg_y), r.x - v.cg_x, float(r.spin)) for r in v.rotors]
        self._coefficients = v.k_T, v.k_M, -v.k_T / v.mass
        self._drag = v.linear_drag / v.mass
        self._dragged = bool(np.any(v.linear_drag))
        self._reached = None
        self._reacts = bool(np.any(v.rotor_inertia))
        self._imu_at_cg = not np.any((v.imu_x, v.imu_y, v.imu_z))
        slowly = v.lag_of != "speed" and self._reacts
        self.uneven = UnevenRotors(v) if v.traits is not None or slowly else None
        self._usual = v.lag_of == "speed" and self.uneven is None and not self._reacts
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
        thrust = m_x = m_y = spin_square = 0.0
        for (lever_x, lever_y, spin), speed in zip(self._rotors, speeds, strict=True):
            square = speed * speed
            thrust = thrust + square
            m_x = m_x + lever_x * square
            m_y = m_y + lever_y * square
            spin_square = spin_square + spin * square
        v = self.vehicle
        k_T = v.k_T
        if not self._reacts:
            return k_T * thrust, k_T * m_x, k_T * m_y, v.k_M * spin_square, 0.0, 0.0
        spin_speed = spin_accel = 0.0
        for (_, _, spin), speed, target in zip(self._rotors, speeds, targets, strict=True):
            spin_speed = spin_speed + spin * speed
            spin_accel = spin_accel + spin * (target - speed)
        J_r = v.rotor_inertia
        return (
            k_T * thrust,
            k_T * m_x,
            k_T * m_y,
            v.k_M * spin_square,
            -J_r * spin_speed,
            -J_r * self._decay[2] * spin_accel,
        )

    def derivative(
        self, body: Sequence[Value], wrench: tuple[Value, ...], disturbance: Disturbance = CALM
    ) -> tuple[Value, ...]:
        """Time derivative of the thirteen components of `State.body`."""
        vx, vy, vz = body[3:6]
        load = self._load(wrench, disturbance)
        ax, ay, az, *turning = self._accelerations(*body[6:], load)
        D = self._drag
        return (vx, vy, vz, ax - D * vx, ay - D * vy, az - D * vz, *turning)

    def _load(self, wrench: tuple[Value, ...], disturbance: Disturbance) -> tuple[Value, ...]:
        """What moves the body and does not depend on its motion.

        Returns:
            -T/m, (F_d/m + g) north, east and down, M - h', h_z.
        """
        thrust, m_x, m_y, m_z, h_z, h_z_rate = wrench
        g_x, g_y, g_z, t_x, t_y, t_z = self._push(disturbance)
        lift = -thrust / self.vehicle.mass
        return lift, g_x, g_y, g_z, m_x + t_x, m_y + t_y, m_z + t_z - h_z_rate, h_z

    def _push(self, disturbance: Disturbance) -> tuple[Value, ...]:
        """(F_d/m + g) north, east and down, M_d."""
        if disturbance is CALM:
            return 0.0, 0.0, self.gravity, 0.0, 0.0, 0.0
        mass = self.vehicle.mass
        f_x, f_y, f_z = disturbance.force
        return f_x / mass, f_y / mass, f_z / mass + self.gravity, *disturbance.torque

    def step(
        self, state: State, targets: Sequence[Value], disturbance: Disturbance = CALM
    ) -> State:
        """Advance by one step with the rotor-speed targets held.

        The rotors are solved exactly, the body by RK4 on the rotors' known history.
        """
        h = self.step_size
        half_h = 0.5 * h
        load_1 = self._load_at(state.speeds, targets, disturbance)
        speeds, load_2, load_4 = self._loads_ahead(state.speeds, targets, disturbance)
        self._reached = speeds, targets, disturbance, load_4
        slopes = self._accelerations
        x, y, z, vx, vy, vz, a, b, c, d, p, q, r = state.body
        ax_1, ay_1, az_1, a_1, b_1, c_1, d_1, p_1, q_1, r_1 = slopes(a, b, c, d, p, q, r, load_1)
        ax_2, ay_2, az_2, a_2, b_2, c_2, d_2, p_2, q_2, r_2 = slopes(
            a + half_h * a_1,
            b + half_h * b_1,
            c + half_h * c_1,
            d + half_h * d_1,
            p + half_h * p_1,
            q + half_h * q_1,
            r + half_h * r_1,
            load_2,
        )
        ax_3, ay_3, az_3, a_3, b_3, c_3, d_3, p_3, q_3, r_3 = slopes(
            a + half_h * a_2,
            b + half_h * b_2,
            c + half_h * c_2,
            d + half_h * d_2,
            p + half_h * p_2,
            q + half_h * q_2,
            r + half_h * r_2,
            load_2,
        )
        ax_4, ay_4, az_4, a_4, b_4, c_4, d_4, p_4, q_4, r_4 = slopes(
            a + h * a_3,
            b + h * b_3,
            c + h * c_3,
            d + h * d_3,
            p + h * p_3,
            q + h * q_3,
            r + h * r_3,
            load_4,
        )
        if self._dragged:
            ax_1, ax_2, ax_3, ax_4 = self._slowed(vx, ax_1, ax_2, ax_3, ax_4)
            ay_1, ay_2, ay_3, ay_4 = self._slowed(vy, ay_1, ay_2, ay_3, ay_4)
            az_1, az_2, az_3, az_4 = self._slowed(vz, az_1, az_2, az_3, az_4)
        sixth = h / 6.0
        square = h * sixth
        a = a + sixth * (a_1 + 2.0 * (a_2 + a_3) + a_4)
        b = b + sixth * (b_1 + 2.0 * (b_2 + b_3) + b_4)
        c = c + sixth * (c_1 + 2.0 * (c_2 + c_3) + c_4)
        d = d + sixth * (d_1 + 2.0 * (d_2 + d_3) + d_4)
        scale = (a * a + b * b + c * c + d * d) ** -0.5
        return State(
            [
                # The slopes of the position are the velocities above.
                x + h * vx + square * (ax_1 + ax_2 + ax_3),
                y + h * vy + square * (ay_1 + ay_2 + ay_3),
                z + h * vz + square * (az_1 + az_2 + az_3),
                vx + sixth * (ax_1 + 2.0 * (ax_2 + ax_3) + ax_4),
                vy + sixth * (ay_1 + 2.0 * (ay_2 + ay_3) + ay_4),
                vz + sixth * (az_1 + 2.0 * (az_2 + az_3) + az_4),
                a * scale,
                b * scale,
                c * scale,
                d * scale,
                p + sixth * (p_1 + 2.0 * (p_2 + p_3) + p_4),
                q + sixth * (q_1 + 2.0 * (q_2 + q_3) + q_4),
                r + sixth * (r_1 + 2.0 * (r_2 + r_3) + r_4),
            ],
            speeds,
        )

    def _slowed(
        self, v: Value, a_1: Value, a_2: Value, a_3: Value, a_4: Value
    ) -> tuple[Value, Value, Value, Value]:
        """The four slopes of a velocity v with linear drag."""
        D, h = self._drag, self.step_size
        a_1 = a_1 - D * v
        a_2 = a_2 - D * (v + 0.5 * h * a_1)
        a_3 = a_3 - D * (v + 0.5 * h * a_2)
        return a_1, a_2, a_3, a_4 - D * (v + h * a_3)

    def _load_at(
        self, speeds: Sequence[Value], targets: Sequence[Value], disturbance: Disturbance
    ) -> tuple[Value, ...]:
        """`_load` of these speeds, remembered: a step begins where the last one ended."""
        if self._reached is not None:
            end, goal, felt, load = self._reached
            # Where rotors head for matters to the reaction of their inertia alone.
            if end is speeds and felt is disturbance and (goal is targets or not self._reacts):
                return load
        load = self._load(self.wrench(speeds, targets), disturbance)
        self._reached = speeds, targets, disturbance, load
        return load

    def _loads_ahead(
        self, speeds: Sequence[Value], targets: Sequence[Value], disturbance: Disturbance
    ) -> tuple[list[Value], tuple[Value, ...], tuple[Value, ...]]:
        """Rotor speeds after a step; `_load` in its middle and at its end."""
        half, whole, _ = self._decay
        if not self._usual:
            middle = self._lagged(speeds, targets, half)
            end = self._lagged(speeds, targets, whole)
            return (
                end,
                self._load(self.wrench(middle, targets), disturbance),
                self._load(self.wrench(end, targets), disturbance),
            )
        # `_lagged`, `wrench` and `_load` in one go.
        end = []
        T_1 = x_1 = y_1 = z_1 = T_2 = x_2 = y_2 = z_2 = 0.0
        for (lever_x, lever_y, spin), speed, target in zip(
            self._rotors, speeds, targets, strict=True
        ):
            gap = speed - target
            speed = target + gap * half
            square = speed * speed
            T_1 = T_1 + square
            x_1 = x_1 + lever_x * square
            y_1 = y_1 + lever_y * square
            z_1 = z_1 + spin * square
            speed = target + gap * whole
            end.append(speed)
            square = speed * speed
            T_2 = T_2 + square
            x_2 = x_2 + lever_x * square
            y_2 = y_2 + lever_y * square
            z_2 = z_2 + spin * square
        k_T, k_M, lift = self._coefficients
        g_x, g_y, g_z, t_x, t_y, t_z = self._push(disturbance)
        return (
            end,
            (lift * T_1, g_x, g_y, g_z, k_T * x_1 + t_x, k_T * y_1 + t_y, k_M * z_1 + t_z, 0.0),
            (lift * T_2, g_x, g_y, g_z, k_T * x_2 + t_x, k_T * y_2 + t_y, k_M * z_2 + t_z, 0.0),
        )

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
        load = self._load_at(state.speeds, targets, disturbance)
        _, _, _, vx, vy, vz, a, b, c, d, p, q, r = state.body
        ax, ay, az, _, _, _, _, dp, dq, dr = self._accelerations(a, b, c, d, p, q, r, load)
        D, g = self._drag, self.gravity
        x, y, z = rotate_to_body((a, b, c, d), (ax - D * vx, ay - D * vy, az - D * vz - g))
        if self._imu_at_cg:
            return [p, q, r], [x, y, z]
        v = self.vehicle
        X, Y, Z = v.imu_x, v.imu_y, v.imu_z
        x = x + dq * Z - dr * Y + p * q * Y + p * r * Z - (q * q + r * r) * X
        y = y + dr * X - dp * Z + p * q * X + q * r * Z - (p * p + r * r) * Y
        z = z + dp * Y - dq * X + p * r * X + q * r * Y - (p * p + q * q) * Z
        return [p, q, r], [x, y, z]


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
