"""Loads that do not stay where they are: a liquid in its tank, and a payload on a line.

Both are part of the weighed mass. The equations of motion (`dynamics`) have them fixed at the CG;
what they do differently is a force and a moment on top, with the vehicle's own mean
acceleration over the period before.
"""

import math
from collections.abc import Sequence

import numpy as np

from sim_bridge.simulated_vehicle import Value, Vehicle

SLOSH_DAMPING = 0.05
"""Of critical: water in a tank with one baffle."""
SLOSH_DEPTH = 0.3
"""Depth of the liquid below the CG, in arms."""
TANK_RADIUS = 0.2
"""Half width of the tank, in arms: how far the middle of the liquid can move."""
_WALL = 8.0
"""Hz at which liquid meets a wall: critically damped, it runs up rather than bounces."""

Triple = tuple[Value, Value, Value]


class Slosh:
    """A liquid's first mode as a mass on springs that slides fore and aft and sideways.

    The mechanical analogy of Ibrahim, "Liquid Sloshing Dynamics" (2005), ch. 5: with xi the place
    in the tank, r = (0, 0, z) that of its middle, f the specific force and a_t = f + w' x r,

        xi'' = -W^2 xi - 2 zeta W xi' - a_t    (x and y)
        F = -m_s xi'',   M = -m_s (r x xi'' + xi x f)

    Linear in xi up to the walls; terms with w^2 are left out.
    """

    def __init__(self, vehicle: Vehicle, share: float, hertz: float, period: float) -> None:
        self._mass = share * vehicle.mass
        self._omega = 2.0 * math.pi * hertz
        self._h = period
        arm = sum(math.hypot(r.x, r.y) for r in vehicle.rotors) / len(vehicle.rotors)
        self._z = SLOSH_DEPTH * arm
        self._radius = TANK_RADIUS * arm
        self._place: tuple[Value, Value] = (0.0, 0.0)
        self._speed: tuple[Value, Value] = (0.0, 0.0)

    def wrench(self, force: Triple, turning: Sequence[Value]) -> tuple[Value, ...]:
        """F_x, F_y, M_x, M_y, M_z in body axes; goes on by one step.

        Args:
            force: specific force at the CG, body axes, m/s^2.
            turning: angular acceleration, rad/s^2.
        """
        f_x, f_y, f_z = force
        omega, h, z = self._omega, self._h, self._z
        (x, y), (v_x, v_y) = self._place, self._speed
        loss = 2.0 * SLOSH_DAMPING * omega
        a_x = self._wall(x, v_x) - omega * omega * x - loss * v_x - (f_x + turning[1] * z)
        a_y = self._wall(y, v_y) - omega * omega * y - loss * v_y - (f_y - turning[0] * z)
        # Semi-implicit, which keeps the energy of an oscillation.
        v_x, v_y = v_x + h * a_x, v_y + h * a_y
        self._speed = (v_x, v_y)
        self._place = (x + h * v_x, y + h * v_y)
        m = self._mass
        return (
            -m * a_x,
            -m * a_y,
            m * (z * a_y - y * f_z),
            -m * (z * a_x - x * f_z),
            -m * (x * f_y - y * f_x),
        )

    def _wall(self, place: Value, speed: Value) -> Value:
        """Acceleration by the tank's wall along one axis, m/s^2: -W_w^2 e - 2 W_w v beyond it."""
        beyond = np.sign(place) * np.maximum(abs(place) - self._radius, 0.0)
        omega = 2.0 * math.pi * _WALL
        return -omega * omega * beyond - 2.0 * omega * speed * (beyond != 0.0)


class Swing:
    """A payload that swings on a massless line of length l, hung a little below the CG.

    With n the unit vector from hook to payload (world axes), a the hook's acceleration and g that
    of gravity (spherical pendulum; Sreenath, Lee and Kumar, CDC 2013):

        n'' = -|n'|^2 n - ((a - g) - n (n . (a - g))) / l,   T = m_L (l |n'|^2 - n . (a - g))
        F = T n + m_L (a - g),   M = r x R^T T n

    F is on top of a payload fixed at the CG: in steady hover it is zero.
    """

    HOOK = 0.2
    """Of the hook below the CG, in arms."""

    def __init__(self, vehicle: Vehicle, share: float, length: float, period: float) -> None:
        self._mass = share * vehicle.mass
        self._length = length
        self._h = period
        arm = sum(math.hypot(r.x, r.y) for r in vehicle.rotors) / len(vehicle.rotors)
        self.hook = self.HOOK * arm
        # A twentieth of a radian aside, as the vehicle has just arrived.
        self._n: Triple = (math.sin(0.05), 0.0, math.cos(0.05))
        self._rate: Triple = (0.0, 0.0, 0.0)

    def pull(self, force: Triple) -> tuple[Triple, Triple]:
        """(F, T n) in N, world axes; goes on by one period.

        Args:
            force: a - g of the CG, world axes, m/s^2.
        """
        (n_x, n_y, n_z), (r_x, r_y, r_z), h = self._n, self._rate, self._h
        a_x, a_y, a_z = force
        along = n_x * a_x + n_y * a_y + n_z * a_z
        square = r_x * r_x + r_y * r_y + r_z * r_z
        over = 1.0 / self._length
        r_x = r_x - h * (square * n_x + (a_x - n_x * along) * over)
        r_y = r_y - h * (square * n_y + (a_y - n_y * along) * over)
        r_z = r_z - h * (square * n_z + (a_z - n_z * along) * over)
        x, y, z = n_x + h * r_x, n_y + h * r_y, n_z + h * r_z
        norm = (x * x + y * y + z * z) ** -0.5
        x, y, z = x * norm, y * norm, z * norm
        self._n = (x, y, z)
        # The line's length stays: no velocity along it.
        off = x * r_x + y * r_y + z * r_z
        self._rate = (r_x - off * x, r_y - off * y, r_z - off * z)
        m = self._mass
        line = m * (self._length * square - along)
        t_x, t_y, t_z = line * n_x, line * n_y, line * n_z
        return (t_x + m * a_x, t_y + m * a_y, t_z + m * a_z), (t_x, t_y, t_z)
