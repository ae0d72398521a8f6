"""Vehicles drawn at random, 0.25 to 15 kg, and what their pilots fly with them.

Sizes and coefficients hang together as those of built ones do: the arm goes with the root of the
mass, inertia with mass times arm squared; propellers fill the room between the arms and turn with a
tip speed of 60 to 80 m/s in hover.
"""

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from gcs_sysid.model.airframe import Airframe, CommandRange, Rotor
from gcs_sysid.model.parameters import GRAVITY
from sim_bridge.doublets import DoubletMission
from sim_bridge.simulated_vehicle import Vehicle

LIGHTEST, HEAVIEST = 0.25, 15.0
"""kg."""
LAYOUTS = ("quad-x", "quad-plus", "quad-h", "hexa", "octo", "x8")
Places = list[tuple[float, float, int]]


def places(layout: str) -> Places:
    """x, y and spin of the rotors, for a mean arm of 1, in PX4's order for the quad X."""
    if layout == "quad-h":
        x, y = 0.78, 1.0
        quad = [(x, y, 1), (-x, -y, 1), (x, -y, -1), (-x, y, -1)]
        arm = math.hypot(x, y)
        return [(a / arm, b / arm, s) for a, b, s in quad]
    if layout == "x8":
        upper = places("quad-x")
        return [*upper, *[(x, y, -s) for x, y, s in upper]]
    first, count = {"quad-x": (45, 4), "quad-plus": (0, 4), "hexa": (30, 6), "octo": (22.5, 8)}[
        layout
    ]
    around = [math.radians(first + 360.0 * k / count) for k in range(count)]
    ring = [(math.cos(a), math.sin(a), 1 if k % 2 == 0 else -1) for k, a in enumerate(around)]
    return [ring[0], ring[2], ring[3], ring[1]] if count == 4 else ring


@dataclass(frozen=True)
class Drawn:
    """A vehicle, and how far its arms reach.

    Attributes:
        layout: one of `LAYOUTS`.
        vehicle: its true parameters.
        arm: m.
    """

    layout: str
    vehicle: Vehicle
    arm: float

    @property
    def airframe(self) -> Airframe:
        """What its user knows: where the rotors are, and what it weighs. No truth besides."""
        return Airframe("drawn", self.vehicle.rotors, mass=self.vehicle.mass)

    def mission(self, name: str, rate: float, length: float, climb: float = 0.0) -> DoubletMission:
        """Doublets up to this rate where its rotors have the torque for it."""
        v = self.vehicle
        lift = v.mass * GRAVITY
        # A doublet accelerates by 12.3 times its largest rate over its length.
        most = 0.3 * lift * self.arm * length / 12.3 / max(v.Ixx, v.Iyy)
        yaw_length = 2.0 * length
        most_yaw = 0.35 * lift * v.k_M / v.k_T * yaw_length / 12.3 / v.Izz
        return DoubletMission(
            name, min(rate, most), length, min(0.6 * rate, most_yaw), yaw_length, climb
        )


def draw(seed: int, layouts: tuple[str, ...] = LAYOUTS) -> Drawn:
    """One vehicle."""
    rng = np.random.default_rng([seed, 0x7EA])
    layout = layouts[seed % len(layouts)]
    uniform = rng.uniform
    mass = float(np.exp(uniform(math.log(LIGHTEST), math.log(HEAVIEST))))
    arm = 0.19 * math.sqrt(mass) * uniform(0.85, 1.15)
    ring = places(layout)
    rotors = tuple(Rotor(arm * x, arm * y, s) for x, y, s in ring)
    apart = min(
        math.dist((a.x, a.y), (b.x, b.y))
        for a, b in combinations(rotors, 2)
        if (a.x, a.y) != (b.x, b.y)
    )
    radius = 0.45 * apart
    Ixx = uniform(0.17, 0.25) * mass * arm**2
    Iyy = uniform(0.88, 1.12) * Ixx
    Izz = uniform(0.80, 0.93) * (Ixx + Iyy)
    hover = uniform(60.0, 80.0) / radius
    k_T = mass * GRAVITY / len(rotors) / hover**2
    size = radius / 0.127
    vehicle = Vehicle(
        name="drawn",
        rotors=rotors,
        mass=mass,
        Ixx=Ixx,
        Iyy=Iyy,
        Izz=Izz,
        Ixy=uniform(-0.05, 0.05) * Ixx,
        Iyz=uniform(-0.05, 0.05) * Ixx,
        Ixz=uniform(-0.05, 0.05) * Ixx,
        k_T=k_T,
        k_M=uniform(0.11, 0.17) * radius * k_T,
        T_max=uniform(2.2, 3.5) * mass * GRAVITY / len(rotors),
        cg_x=uniform(-0.04, 0.04) * arm,
        cg_y=uniform(-0.04, 0.04) * arm,
        thrust_curve=uniform(0.0, 1.0),
        motor_lag=0.035 * size**0.6 * uniform(0.8, 1.25),
        rotational_damping=uniform(0.2, 0.6) * Ixx,
        # A propeller with its motor's bell, of the power carried: mass times radius squared.
        rotor_inertia=3e-5 * (mass / len(rotors) / 0.25) * size**2,
        linear_drag=uniform(0.1, 0.3) * mass,
        command=CommandRange(),
    )
    return Drawn(layout, vehicle, arm)
