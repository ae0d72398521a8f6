"""Rotors that are not all alike: unequal, canted, or with inertia behind any kind of lag.

Rotor i pushes with e_i k_T Omega_i^2 along its own axis, where e_i is its share of the vehicle's
k_T, and turns the body by s_i e'_i k_M Omega_i^2 about that axis. Its axis is canted by delta in
the direction of rotation about the center that its drag torque has, as builders do for yaw
authority: with c = cos delta, s = sin delta and t_i = (-y, x, 0) / |(x, y)|,

    a_i = s s_i t_i - c z ,   F = sum T_i a_i ,   M = sum r_i x T_i a_i - s_i Q_i a_i

(Newton-Euler, MODEL.md, with -z replaced by a_i). With delta = 0 that is MODEL.md's M.

The acceleration of a rotor, for the reaction torque -h' of rotor inertia, follows from what lags:

    speed:    Omega' = (Omega_c - Omega) / tau
    thrust:   T' = (T_c - T) / tau  ->  Omega' = (Omega_c^2 - Omega^2) / (2 tau Omega)
    command:  u' = (u_c - u) / tau  ->  Omega' = (T_max / k_T) (1 - c + 2 c u) u' / (2 Omega)
"""

import math
from collections.abc import Sequence

import numpy as np

from sim_bridge.simulated_vehicle import Value, Vehicle, even, per_thrust

SLOWEST = 1.0
"""rad/s: below it a rotor's acceleration is not computed from its thrust, which is nearly zero."""


class UnevenRotors:
    """The rotors' wrench, rotor by rotor, for `Dynamics`."""

    def __init__(self, vehicle: Vehicle) -> None:
        v = self._vehicle = vehicle
        traits = v.traits or even(len(v.rotors))
        cosine = math.cos(traits.tilt)
        self._spins = [float(r.spin) for r in v.rotors]
        self._rows: list[tuple[Value, ...]] = []
        self._sideways: list[tuple[Value, Value]] = []
        for r, e, e_m in zip(v.rotors, traits.thrust, traits.torque, strict=True):
            k_T = e * v.k_T
            f_x, f_y, m_x, m_y, m_z = per_thrust(v, r, e_m * v.k_M / k_T)
            self._rows.append((k_T * cosine, k_T * m_x, k_T * m_y, k_T * m_z))
            self._sideways.append((k_T * f_x, k_T * f_y))
        self.canted = traits.tilt != 0.0
        self._has_inertia = bool(np.any(v.rotor_inertia))
        lag = np.asarray(v.motor_lag, dtype=float)
        rate = np.where(lag > 1e-9, 1.0 / np.maximum(lag, 1e-9), 0.0)
        self._rate: Value = float(rate) if rate.ndim == 0 else rate

    def wrench(self, speeds: Sequence[Value], targets: Sequence[Value]) -> tuple[Value, ...]:
        """T, M_x, M_y, M_z, h_z and h_z', as `Dynamics.wrench` gives them.

        The horizontal part of a canted rotor's angular momentum, sin(delta) of it, is left out.
        """
        thrust = m_x = m_y = m_z = 0.0
        for (a, b, c, d), speed in zip(self._rows, speeds, strict=True):
            square = speed * speed
            thrust = thrust + a * square
            m_x = m_x + b * square
            m_y = m_y + c * square
            m_z = m_z + d * square
        if not self._has_inertia:
            return thrust, m_x, m_y, m_z, 0.0, 0.0
        J_r, rate = self._vehicle.rotor_inertia, self._rate
        spinning = speeding = 0.0
        if self._vehicle.lag_of == "speed":
            for spin, speed, target in zip(self._spins, speeds, targets, strict=True):
                spinning = spinning + spin * speed
                speeding = speeding + spin * (target - speed)
        else:
            for spin, speed, target in zip(self._spins, speeds, targets, strict=True):
                spinning = spinning + spin * speed
                speeding = speeding + spin * self._pull(speed, target)
        return thrust, m_x, m_y, m_z, -J_r * spinning, -J_r * rate * speeding

    def side_force(self, speeds: Sequence[Value]) -> tuple[Value, Value]:
        """Body x and y force of canted rotors, N."""
        f_x = f_y = 0.0
        for (x, y), speed in zip(self._sideways, speeds, strict=True):
            square = speed * speed
            f_x = f_x + x * square
            f_y = f_y + y * square
        return f_x, f_y

    def _pull(self, speed: Value, target: Value) -> Value:
        """Its acceleration times tau, of a rotor whose thrust or command lags."""
        v = self._vehicle
        turning = (
            np.maximum(speed, SLOWEST) if isinstance(speed, np.ndarray) else max(speed, SLOWEST)
        )
        if v.lag_of == "thrust":
            return (target * target - speed * speed) / (2.0 * turning)
        u, u_c = v.command_of(speed), v.command_of(target)
        slope = v.T_max / v.k_T * (1.0 - v.thrust_curve + 2.0 * v.thrust_curve * u)
        return slope * (u_c - u) / (2.0 * turning)
