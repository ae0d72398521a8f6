"""The flight controller of the emulated vehicle.

A cascade: position and velocity -> attitude -> body rates -> torques -> rotor speeds. The
mission's rate set-points are fed forward at every level: the attitude set-point carries their
integral and the torque their derivative, so that no loop works against the excitation.

The controller uses the true state as the emulated autopilot's own estimate, and the vehicle it
was built with as its model: a change in flight (a mass step) is a surprise to it, which its
integrators absorb. Components are floats, or arrays of shape (N,) for an ensemble.
"""

from dataclasses import dataclass
from typing import cast

import numpy as np

from gcs_sysid.model.parameters import GRAVITY
from sim_bridge.dynamics import State
from sim_bridge.missions import Reference
from sim_bridge.simulated_vehicle import Value, Vehicle, allocation


@dataclass(frozen=True)
class Gains:
    """Gains and limits of the loops.

    Attributes:
        position: 1/s^2, acceleration per meter. Low on purpose: the tilts of the excitation swing
            the vehicle to and fro, and a stiff position loop would take the excitation away.
        velocity: 1/s.
        height: 1/s^2.
        climb: 1/s.
        height_integral: 1/s^3.
        attitude: 1/s, rate per radian.
        rate: 1/s, angular acceleration per rate.
        rate_integral: 1/s^2.
        tilt_limit: largest tangent of the tilt asked by the position loop.
        least_thrust: of T_max, so that no rotor stops.
        integral_limit: rad/s^2, largest angular acceleration held by the rate integrators.
    """

    position: float = 0.15
    velocity: float = 0.6
    height: float = 2.0
    climb: float = 2.5
    height_integral: float = 0.6
    attitude: float = 5.0
    rate: float = 14.0
    rate_integral: float = 8.0
    tilt_limit: float = 0.3
    least_thrust: float = 0.01
    integral_limit: float = 30.0


class Controller:
    """Turns a reference and the state into rotor-speed targets.

    Attributes:
        period: s between updates.
        full_throttle: the pilot pushes the throttle all the way up, whatever the reference says.
    """

    def __init__(self, vehicle: Vehicle, period: float, gains: Gains | None = None) -> None:
        self.period = period
        self.full_throttle = False
        self._gains = gains or Gains()
        self._model = vehicle
        self._mix = allocation(vehicle)
        self._rate_integral: list[Value] = [0.0, 0.0, 0.0]
        self._height_integral: Value = 0.0

    def observe(self, state: State, step: float) -> None:
        """See every step of the physics, as a gyro does; this controller needs none of them."""

    def update(self, state: State, reference: Reference) -> list[Value]:
        """Rotor-speed targets, rad/s, for the next period."""
        a_x, a_y, a_z = self._acceleration(state, reference)
        thrust, set_point = self._attitude(state, reference, a_x, a_y, a_z)
        return self._rotors(thrust, self._torque(state, reference, set_point))

    def _acceleration(self, state: State, ref: Reference) -> tuple[Value, Value, Value]:
        """Acceleration set-point, NED, m/s^2."""
        g = self._gains
        x, y, z, vx, vy, vz = state.body[0:6]
        limit = g.tilt_limit * GRAVITY
        a_x = g.position * (ref.position[0] - x) + g.velocity * (ref.velocity[0] - vx)
        a_y = g.position * (ref.position[1] - y) + g.velocity * (ref.velocity[1] - vy)
        below = ref.position[2] - z
        self._height_integral = clip(
            self._height_integral + g.height_integral * below * self.period, -5.0, 5.0
        )
        a_z = g.height * below + g.climb * (ref.velocity[2] - vz) + self._height_integral
        return (
            clip(a_x + ref.acceleration[0], -limit, limit),
            clip(a_y + ref.acceleration[1], -limit, limit),
            clip(a_z + ref.acceleration[2], -5.0, 5.0),
        )

    def _attitude(
        self, state: State, ref: Reference, a_x: Value, a_y: Value, a_z: Value
    ) -> tuple[Value, tuple[Value, ...]]:
        """Total thrust (N) and attitude set-point quaternion."""
        up = GRAVITY - a_z
        norm = (a_x * a_x + a_y * a_y + up * up) ** 0.5
        # The body z axis must point to (-a_x, -a_y, up) / norm: shortest turn from straight down.
        b_x, b_y, b_z = -a_x / norm, -a_y / norm, up / norm
        scale = (2.0 * (1.0 + b_z)) ** -0.5
        tilt = ((1.0 + b_z) * scale, -b_y * scale, b_x * scale, 0.0)
        heading = multiply(tilt, ref.heading)
        _, b, c, _ = state.quaternion
        # cos(tilt) of the vehicle as it is, so that a tilted vehicle keeps its height.
        upright = clip(1.0 - 2.0 * (b * b + c * c), 0.5, 1.0)
        return self._model.mass * up / upright, multiply(heading, ref.tilt)

    def _torque(
        self, state: State, ref: Reference, set_point: tuple[Value, ...]
    ) -> tuple[Value, Value, Value]:
        """Torque set-point about the CG, N m."""
        g, v = self._gains, self._model
        a, b, c, d = state.quaternion
        e0, e1, e2, e3 = multiply((a, -b, -c, -d), set_point)
        turn = 2.0 * g.attitude * sign(e0)
        p, q, r = state.rates
        r_p, r_q, r_r = ref.rate
        e_p = r_p + turn * e1 - p
        e_q = r_q + turn * e2 - q
        e_r = r_r + turn * e3 - r
        step = g.rate_integral * self.period
        limit = g.integral_limit
        i_p, i_q, i_r = self._rate_integral
        i_p = clip(i_p + step * e_p, -limit, limit)
        i_q = clip(i_q + step * e_q, -limit, limit)
        i_r = clip(i_r + step * e_r, -limit, limit)
        self._rate_integral = [i_p, i_q, i_r]
        # A rotor that lags by tau needs tau times the derivative on top to follow.
        f_p, f_q, f_r = ref.angular_acceleration
        j_p, j_q, j_r = ref.angular_jerk
        lag, gain = v.motor_lag, g.rate
        x = f_p + lag * j_p + gain * e_p + i_p
        y = f_q + lag * j_q + gain * e_q + i_q
        z = f_r + lag * j_r + gain * e_r + i_r
        l_x = v.Ixx * p + v.Ixy * q + v.Ixz * r
        l_y = v.Ixy * p + v.Iyy * q + v.Iyz * r
        l_z = v.Ixz * p + v.Iyz * q + v.Izz * r
        return (
            v.Ixx * x + v.Ixy * y + v.Ixz * z + q * l_z - r * l_y,
            v.Ixy * x + v.Iyy * y + v.Iyz * z + r * l_x - p * l_z,
            v.Ixz * x + v.Iyz * y + v.Izz * z + p * l_y - q * l_x,
        )

    def _rotors(self, thrust: Value, torque: tuple[Value, Value, Value]) -> list[Value]:
        """Rotor-speed targets within what a rotor can do."""
        v = self._model
        m_x, m_y, m_z = torque
        least = self._gains.least_thrust * v.T_max
        if self.full_throttle:
            # As far up as the torques leave room: the first rotor at its limit sets the rest.
            thrust = least_of(
                [
                    (v.T_max - s_x * m_x - s_y * m_y - s_z * m_z) / s_t
                    for s_t, s_x, s_y, s_z in self._mix
                ]
            )
        return [
            (clip(s_t * thrust + s_x * m_x + s_y * m_y + s_z * m_z, least, v.T_max) / v.k_T) ** 0.5
            for s_t, s_x, s_y, s_z in self._mix
        ]


def multiply(left: tuple[Value, ...], right: tuple[Value, ...]) -> tuple[Value, ...]:
    """Product of two quaternions (w, x, y, z)."""
    a, b, c, d = left
    e, f, g, h = right
    return (
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    )


def clip(value: Value, low: Value, high: Value) -> Value:
    """The value within low..high; a float stays a float."""
    if isinstance(value, float):
        return low if value < low else high if value > high else value
    return np.clip(value, low, high)


def least_of(values: list[Value]) -> Value:
    """The least of several, element by element where they are arrays."""
    return np.minimum.reduce(values) if isinstance(values[0], np.ndarray) else min(values)


def sign(value: Value) -> Value:
    """-1.0 for negative values, else 1.0."""
    if isinstance(value, float):
        return -1.0 if value < 0.0 else 1.0
    return cast(Value, np.where(value < 0.0, -1.0, 1.0))
