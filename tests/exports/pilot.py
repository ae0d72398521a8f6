"""A controller that knows the vehicle by its identified parameters alone, and integrates nothing.

Whatever is wrong in the file that the simulator loaded stays as an error in place or attitude.
"""

import numpy as np

GRAVITY = 9.81
"""m/s^2, that of both simulators."""


class Pilot:
    """Axes forward, left, up; from state to the thrust of each rotor.

    Args:
        mass: kg.
        J: (3, 3) about the CG.
        places: (4, 3) of the rotors from the CG.
        torques: (4,) torque about the axis up over thrust, m.
    """

    def __init__(self, mass, J, places, torques):
        self.mass, self.J = mass, J
        self.allocation = np.linalg.inv([np.ones(4), places[:, 1], -places[:, 0], torques])

    def thrusts(self, goal, place, velocity, R, rates):
        """(4,) N, never below zero."""
        force = 4.0 * (goal - place) - 3.2 * velocity + [0.0, 0.0, GRAVITY]
        force = self.mass * force
        up = force / np.linalg.norm(force)
        left = np.cross(up, [1.0, 0.0, 0.0])
        left /= np.linalg.norm(left)
        wanted = np.column_stack([np.cross(left, up), left, up])
        tilt = 0.5 * (wanted.T @ R - R.T @ wanted)
        error = np.array([tilt[2, 1], tilt[0, 2], tilt[1, 0]])
        torque = self.J @ (-64.0 * error - 14.0 * rates) + np.cross(rates, self.J @ rates)
        wanted_wrench = np.concatenate([[force @ R[:, 2]], torque])
        return np.maximum(self.allocation @ wanted_wrench, 0.0)
