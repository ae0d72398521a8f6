"""A vehicle with nothing symmetrical about it, as a result, and what its equations say."""

from dataclasses import replace

import numpy as np

from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import PARAMETERS, TIMING
from gcs_sysid.model.rotor_input import RotorInput
from tests.known_results import MASS, estimates, result_of

VALUES = {
    "mass": 1.5, "Ixx": 0.0165, "Iyy": 0.021, "Izz": 0.0292, "Ixy": 0.00136, "Iyz": 0.00255,
    "Ixz": -0.00164, "cg_x": 0.06, "cg_y": -0.025, "k_T": 2.05e-4, "k_M": 6.1e-6,
    "moment_ratio": 6.1e-6 / 2.05e-4, "rotational_damping": 0.011, "rotor_inertia": 3e-5,
    "linear_drag": 0.4,
}  # fmt: skip
"""SI; axes forward, right, down."""
FULL_SPEED, LAG = 230.0, 0.04
"""rad/s and s, which rotor speeds do not tell."""


def estimate(name, value, share=0.001, status="identified"):
    return Estimate(value, abs(share * value), (PARAMETERS | TIMING)[name].unit, status)


def speed_result(**changes):
    """As identified with rotor speeds and a weighed mass."""
    usual = result_of(
        estimates(VALUES, 0.001) | MASS,
        source="logs/a flight.tlog",
        airframe=load_airframe("px4-quad-x").with_arm(0.3).as_json(),
    )
    return replace(usual, **changes)


def without(result, *names):
    """The same, where the flight does not tell these."""
    lost = estimates(dict.fromkeys(names))
    return replace(result, parameters=result.parameters | lost)


def command_result():
    """As identified with commands."""
    result = speed_result(rotor_input=RotorInput.COMMAND)
    full = VALUES["k_T"] * FULL_SPEED**2
    parameters = {n: e for n, e in result.parameters.items() if n not in ("k_T", "k_M")}
    parameters |= {
        "T_max": estimate("T_max", full),
        "thrust_curve": estimate("thrust_curve", 1.0),
        "rotor_inertia": Estimate(None, None, "kg m^2", "unobservable"),
    }
    return replace(result, parameters=parameters, timing={"motor_lag": estimate("motor_lag", LAG)})


class Equations:
    """Rotation as of docs/method/model.md, axes forward, right, down; nothing of exports."""

    J = np.array(
        [
            [VALUES["Ixx"], VALUES["Ixy"], VALUES["Ixz"]],
            [VALUES["Ixy"], VALUES["Iyy"], VALUES["Iyz"]],
            [VALUES["Ixz"], VALUES["Iyz"], VALUES["Izz"]],
        ]
    )
    cg = np.array([VALUES["cg_x"], VALUES["cg_y"], 0.0])
    at = 0.3 / np.sqrt(2.0)
    rotors = np.array([[at, at, 0.0], [-at, -at, 0.0], [at, -at, 0.0], [-at, at, 0.0]])
    spins = np.array([1.0, 1.0, -1.0, -1.0])

    def moment(self, thrusts, cg=None):
        """(3,) moment about the CG of (4,) thrusts in N."""
        lever = self.rotors - (self.cg if cg is None else cg)
        forces = np.outer(-np.asarray(thrusts), [0.0, 0.0, 1.0])
        torque = VALUES["moment_ratio"] * self.spins @ np.asarray(thrusts)
        return np.cross(lever, forces).sum(axis=0) + np.array([0.0, 0.0, torque])

    def acceleration(self, thrusts, rates, damping, cg=None):
        """(3,) angular acceleration at (3,) rates."""
        gyroscopic = np.cross(rates, self.J @ rates)
        moment = self.moment(thrusts, cg) - damping * rates - gyroscopic
        return np.linalg.solve(self.J, moment)


TURN = np.diag([1.0, -1.0, -1.0])
"""Forward, right, down to forward, left, up."""
