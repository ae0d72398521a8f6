"""What is assumed of a vehicle before it has flown, and of its sensors."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.coach.information import Craft, Noise, speed_noise
from gcs_sysid.estimation.fit.priors import COORDINATE_STD
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.parameters import GRAVITY, REGISTRY
from gcs_sysid.model.rotor_input import RotorInput


@dataclass(frozen=True)
class UsualVehicle:
    """What is expected of a vehicle of which little is known.

    Attributes:
        gyration: radius of gyration in roll and pitch over the arm; 0.54 to 0.57 of a Crazyflie,
            an Iris and the default vehicle of PX4's SIH.
        hover_speed: rad/s, of the rotors, where k_T is not known.
        hover_command: thrust in hover over the greatest, where T_max is not known.
        acceleration_density: rad^2/s^3: with commands, motion of the motors that their commands
            do not explain.
    """

    gyration: float = 0.55
    hover_speed: float = 500.0
    hover_command: float = 0.4
    acceleration_density: float = 3e-4


USUAL = UsualVehicle()

GYRO_DENSITY = 0.01 * np.pi / 180.0
"""rad/s per root hertz, one-sided: a usual MEMS gyro in flight."""
SPEED_STD = 0.5
"""rad/s, of one sample of a rotor's speed."""
RATE = 250.0
"""Hz, of IMU and rotors."""


class PriorVehicle(NamedTuple):
    """A vehicle of its size and mass, with wide margins.

    Attributes:
        craft: for predictions.
        std: (N_UNKNOWNS,) of theta and of delay, lag and curve.
        kappa: thrust over mass, k_T / m or T_max / m.
    """

    craft: Craft
    std: Array
    kappa: float

    def at(self, kappa: float) -> "PriorVehicle":
        """The same vehicle where flight determines its thrust over mass."""
        factor = np.full(rb.N_THETA, self.kappa / kappa)
        factor[~rb.RELATIVE] = 1.0
        craft = replace(self.craft, theta=factor * self.craft.theta, thrust=GRAVITY / kappa)
        std = np.concatenate([factor * self.std[: rb.N_THETA], self.std[rb.N_THETA :]])
        return PriorVehicle(craft, std, kappa)


def prior_vehicle(airframe: Airframe, rotor_input: RotorInput = RotorInput.SPEED) -> PriorVehicle:
    """The vehicle that an airframe file lets one expect; its priors replace rules of thumb."""
    rotors, arm = len(airframe.rotors), airframe.arm
    known = {name: value for name, (value, _) in airframe.priors.items()}
    mass = airframe.mass or known.get("mass") or 1.0
    weight = mass * GRAVITY
    load = USUAL.hover_command if rotor_input.motors else USUAL.hover_speed**2
    thrust = (
        getattr(airframe, rotor_input.thrust)
        or known.get(rotor_input.thrust)
        or weight / (rotors * load)
    )
    around = mass * (USUAL.gyration * arm) ** 2
    usual = np.array([REGISTRY[name].usual for name in rb.THETA])
    theta, std = np.where(rb.RELATIVE, around / thrust, arm) * usual.T
    for name, value in known.items():
        parameter = REGISTRY[name]
        if parameter.theta:
            relative = parameter.scale == "thrust"
            theta[rb.THETA.index(parameter.theta)] = value / (thrust if relative else 1.0)
    most = None if airframe.T_max is None else airframe.T_max * rotors / weight
    craft = Craft(airframe.geometry, theta, weight / thrust, rotor_input, most)
    coordinates = COORDINATE_STD.copy()
    return PriorVehicle(craft, np.concatenate([std, coordinates]), thrust / mass)


def prior_noise(craft: Craft) -> Noise:
    """Of usual sensors: see GYRO_DENSITY, SPEED_STD and RATE."""
    gyro = 0.5 * GYRO_DENSITY**2 * np.eye(3)
    if craft.rotor_input.motors:
        return Noise(gyro, USUAL.acceleration_density * np.eye(3))
    std = np.full(craft.geometry.shape[1], SPEED_STD)
    return Noise(gyro, speed_noise(craft, std, 1.0 / RATE))
