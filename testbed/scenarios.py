"""What is flown with the vehicles drawn, and what their users know wrongly."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gcs_sysid.model.airframe import Airframe, Rotor
from sim_bridge.physics import IDEAL, Physics
from testbed.vehicles import LAYOUTS

Random = np.random.Generator
_CANT = math.radians(4.0)
_AIR_BESIDES = ("linear_drag", "rotational_damping")
"""Parameters with no one true value where the air does more than drag and damp linearly."""


def _ideal(random: Random) -> Physics:
    del random
    return IDEAL


def _air(random: Random) -> Physics:
    """Rotor drag, inflow and flapping of half to one and a half times the usual strength."""
    a, b, c, d = random.uniform(0.5, 1.5, 4)
    return Physics(
        rotor_drag=0.3 * a,
        inflow=0.6 * b,
        flapping=1.0 * c,
        forward_lift=0.003 * d,
        quadratic_drag=20.0,
        rotor_height=0.02,
    )


def _wind(random: Random) -> Physics:
    come_from = float(random.uniform(0.0, 2.0 * math.pi))
    return replace(_air(random), wind=(6.0, come_from), gusts=1.5)


def as_it_is(airframe: Airframe) -> Airframe:
    """What the user knows is right."""
    return airframe


def measured(airframe: Airframe, random: Random) -> Airframe:
    """A vehicle as it was measured: with errors of the standard deviations that are stated."""
    assert airframe.mass is not None
    sigma, arm, mass = airframe.uncertainty, airframe.arm, airframe.mass
    scale = 1.0 + sigma.arm.of(arm) / arm * random.standard_normal()
    places = random.normal(0.0, sigma.rotor_position.of(arm), (len(airframe.rotors), 2))
    rotors = tuple(
        replace(r, x=scale * r.x + float(x), y=scale * r.y + float(y))
        for r, (x, y) in zip(airframe.rotors, places, strict=True)
    )
    return replace(airframe, rotors=rotors, mass=random.normal(mass, sigma.mass.of(mass)))


def mounted(physics: Physics, airframe: Airframe, random: Random) -> Physics:
    """An IMU beside the middle and not quite level, as far as the airframe says it may be."""
    sigma = airframe.uncertainty
    x, y, z = random.normal(0.0, sigma.imu_position.amount, 3).tolist()
    roll, pitch, yaw = random.normal(0.0, math.radians(sigma.imu_rotation.amount), 3).tolist()
    return replace(physics, imu_place=(x, y, z), imu_rotation=(roll, pitch, yaw))


def known_exactly(airframe: Airframe, physics: Physics) -> Airframe:
    """All that is given is true and stated so, but for the IMU's turn, which a flight shows."""
    exact = dict.fromkeys(("arm", "rotor_position", "mass", "imu_position"), 0.0)
    return replace(airframe, imu_position=physics.imu_place).with_uncertainty(exact, "exact")


def _hardly_measured(airframe: Airframe) -> Airframe:
    return airframe.with_uncertainty({"arm": "3%"}, "--arm")


def _hardly_weighed(airframe: Airframe) -> Airframe:
    return airframe.with_uncertainty({"mass": "5%"}, "--mass")


def _swapped(airframe: Airframe) -> Airframe:
    """The first rotor's place and that of its neighbor in the list are taken for each other."""
    a, b, *rest = airframe.rotors
    return replace(airframe, rotors=(b, a, *rest))


def _spun(airframe: Airframe) -> Airframe:
    rotors = tuple(replace(r, spin=-r.spin) for r in airframe.rotors)
    return replace(airframe, rotors=rotors)


def _upside_down(airframe: Airframe) -> Airframe:
    """Upper and lower rotor of one arm are taken for each other."""
    first = airframe.rotors[0]
    at = min(range(1, len(airframe.rotors)), key=lambda i: _between(first, airframe.rotors[i]))
    rotors = list(airframe.rotors)
    rotors[0], rotors[at] = rotors[at], rotors[0]
    return replace(airframe, rotors=tuple(rotors))


def _between(a: Rotor, b: Rotor) -> float:
    return math.hypot(a.x - b.x, a.y - b.y)


def _turned(airframe: Airframe) -> Airframe:
    """Front taken for the right-hand side."""
    return replace(airframe, rotors=tuple(Rotor(-r.y, r.x, r.spin) for r in airframe.rotors))


def _canted(airframe: Airframe) -> Airframe:
    """The builder knows by what angle the rotors are canted."""
    sine, cosine = math.sin(_CANT), math.cos(_CANT)

    def axis(r: Rotor) -> tuple[float, float, float]:
        side = r.spin * sine / math.hypot(r.x, r.y)
        return -side * r.y, side * r.x, -cosine

    return replace(airframe, rotors=tuple(replace(r, axis=axis(r)) for r in airframe.rotors))


@dataclass(frozen=True)
class Scenario:
    """What is flown, and how it is told.

    Attributes:
        name: for --only.
        says: what it is, for the page.
        physics: of a vehicle, drawn.
        mission: "doublets" or "climbs".
        rate: of the largest doublets, rad/s.
        commands: whether commands are sent instead of rotor speeds.
        imu: rates of the IMU in Hz, one drawn.
        esc: Hz of the rotor speeds; 0: the IMU's.
        ground: take-off and landing are in it.
        layouts: to draw from.
        known: the airframe as the user takes it to be, before he measures it.
        unjudged: parameters without one true value.
    """

    name: str
    says: str
    physics: Callable[[Random], Physics] = _ideal
    mission: str = "doublets"
    rate: float = 2.0
    commands: bool = False
    imu: tuple[float, ...] = (250.0,)
    esc: float = 0.0
    ground: bool = False
    layouts: tuple[str, ...] = LAYOUTS
    known: Callable[[Airframe], Airframe] = as_it_is
    unjudged: tuple[str, ...] = ()


SCENARIOS = (
    Scenario("a", "the model itself"),
    Scenario("aclimb", "the same with climbs and descents of 2 m", mission="climbs"),
    Scenario("j", "rotor drag, inflow, flapping, quadratic drag", _air, unjudged=_AIR_BESIDES),
    Scenario(
        "acro",
        "the same, up to 5 rad/s",
        _air,
        rate=5.0,
        unjudged=_AIR_BESIDES,
    ),
    Scenario(
        "jr",
        "yaw damping a tenth of that of roll and pitch",
        lambda _: Physics(damping=(0.5, 0.5, 0.05)),
        unjudged=("rotational_damping",),
    ),
    Scenario("s", "k_T and k_M differ by 3 % from rotor to rotor", lambda _: Physics(scatter=0.03)),
    Scenario("d", "commands, rotors with inertia", commands=True),
    Scenario("dslow", "commands, IMU and commands at 100 Hz", commands=True, imu=(100.0,)),
    Scenario(
        "c",
        "commands, a battery that loses 5 % of its voltage",
        lambda _: Physics(battery=(0.05, 55.0), battery_drop=0.03),
        commands=True,
        unjudged=("T_max",),
    ),
    Scenario(
        "i",
        "IMU at 50 or 100 Hz, rotor speeds at 50 Hz between its samples",
        imu=(50.0, 100.0),
        esc=50.0,
    ),
    Scenario(
        "k",
        "15 % of the mass sloshes",
        lambda _: Physics(slosh=(0.15, 1.2)),
        unjudged=("rotational_damping",),
    ),
    Scenario(
        "l",
        "hexa, rotors canted by 4 degrees",
        lambda _: Physics(tilt=_CANT),
        layouts=("hexa",),
        known=_canted,
    ),
    Scenario(
        "n",
        "take-off, ground effect, landing",
        lambda _: Physics(ground_effect=0.5),
        ground=True,
    ),
    Scenario("b", "wind of 6 m/s, Dryden gusts, aerodynamics", _wind, unjudged=_AIR_BESIDES),
    Scenario(
        "ou",
        "an unmodeled moment of 1 rad/s² rms",
        lambda _: Physics(ou_moment=(1.0, 1.0), ou_force=(0.3, 1.0)),
    ),
    Scenario("arm", "arms known to 3 %", known=_hardly_measured),
    Scenario("mass", "mass known to 5 %", known=_hardly_weighed),
    Scenario("swap", "two rotors swapped in the airframe file", known=_swapped),
    Scenario("spins", "all spin directions reversed", known=_spun),
    Scenario(
        "pair",
        "X8, upper and lower rotor of one arm swapped in the airframe file",
        layouts=("x8",),
        known=_upside_down,
    ),
    Scenario(
        "tilt",
        "hexa, rotors canted by 4 degrees, flat in the airframe file",
        lambda _: Physics(tilt=_CANT),
        layouts=("hexa",),
    ),
    Scenario("turned", "airframe rotated by 90 degrees", known=_turned),
)
"""Letters are those under which such flights were first collected."""
