"""The battery: what it shows, and, where it sags, how much slower the rotors turn for it.

A motor at a given duty cycle turns in proportion to its supply, so that a command u that would give
Omega_c at the first voltage V_0 gives Omega_c V / V_0: thrust falls with V^2. For the voltage, a
source behind a resistance with one time constant (Thevenin; Chen and Rincon-Mora, "Accurate
electrical battery model", IEEE TEC 2006):

    V = V_0 (1 - a t / t_a) - V_d,   tau V_d' = V_0 b (P / P_0 - 1) - V_d,   P = sum k_M Omega_i^3

with P_0 the power in hover, where the flight begins with V_0. Without sag the battery shows a
voltage that falls a little, and nothing follows from it.
"""

from collections.abc import Sequence

from sim_bridge.physics import Physics
from sim_bridge.simulated_vehicle import Value, Vehicle, hover_thrusts

CELLS = 4
CELL_FULL = 4.1
"""V"""
CELL_SAG = 4.0e-4
"""V/s: 10 minutes of flight take a quarter of a volt off each cell."""
RELAXATION = 0.3
"""s, tau: how fast the voltage follows the load."""
LEAST = 0.5
"""Of V_0: the battery is empty then."""


def voltage(flown: float) -> float:
    """Of a battery that does not sag, after so many seconds, V."""
    return CELLS * (CELL_FULL - CELL_SAG * min(flown, 1000.0))


class Battery:
    """A battery that sags.

    Attributes:
        ratio: V / V_0.
    """

    def __init__(self, physics: Physics, vehicle: Vehicle, period: float) -> None:
        self._lost, self._seconds = physics.battery
        self._drop = physics.battery_drop
        speeds = [(thrust / vehicle.k_T) ** 0.5 for thrust in hover_thrusts(vehicle)]
        self._hover = _power(speeds)
        self._share = period / (RELAXATION + period)
        self._below: Value = 0.0
        self.ratio: Value = 1.0

    def advance(self, flown: float, speeds: Sequence[Value]) -> None:
        """Go on by one period with the rotors at these speeds, rad/s."""
        if self._drop:
            load = self._drop * (_power(speeds) / self._hover - 1.0)
            self._below = self._below + self._share * (load - self._below)
        charge = max(LEAST, 1.0 - self._lost * flown / self._seconds)
        self.ratio = charge - self._below

    @property
    def voltage(self) -> Value:
        """V."""
        return CELLS * CELL_FULL * self.ratio


def _power(speeds: Sequence[Value]) -> Value:
    """Of the rotors, over k_M."""
    return sum(speed * speed * speed for speed in speeds)
