"""Thrust near the ground: T / T_free = 1 / (1 - (R / 4 z)^2).

Cheeseman and Bennett, "The effect of the ground on a helicopter rotor in forward flight" (ARC R&M
3021, 1955), in hover: R is the rotor's radius, z its height above the ground. The form is theirs
down to z = R / 2 and is held there.
"""

from sim_bridge.controller import clip
from sim_bridge.simulated_vehicle import Value

GEAR = 0.6
"""Height of the rotors above the ground when the vehicle stands on it, in rotor radii."""
LOWEST = 0.5
"""Least height that the formula is used with, in rotor radii."""


def thrust_gain(height: Value, radius: float) -> Value:
    """T / T_free - 1 with the landing gear this high above the ground, m."""
    z = clip(height + GEAR * radius, LOWEST * radius, 1e9)
    ratio = radius / (4.0 * z)
    square = ratio * ratio
    return square / (1.0 - square)
