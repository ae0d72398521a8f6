"""Flights of drawn vehicles on the project's own emulator, as recordings."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gcs_sysid.model.airframe import Airframe, Rotor
from gcs_sysid.telemetry.dialect import mavlink
from sim_bridge.autopilot import BOOT_US
from sim_bridge.ground_cycle import GroundCycle
from sim_bridge.links import TlogLink
from sim_bridge.loads import SLOSH_DEPTH
from sim_bridge.missions import Mission
from sim_bridge.physics import Physics
from sim_bridge.px4 import Px4
from sim_bridge.sensor_faults import SensorFaults
from sim_bridge.simulation import Simulation
from testbed.scenarios import Scenario, known_exactly, measured, mounted
from testbed.vehicles import Drawn, draw

_SPEEDS = (mavlink.MAVLINK_MSG_ID_ESC_STATUS, mavlink.MAVLINK_MSG_ID_ESC_INFO)
_COMMANDS = (
    mavlink.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS,
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW,
)

Truth = dict[str, Any]
"""Parameter -> value, or a list of values that it has at once (unequal rotors)."""


@dataclass(frozen=True)
class Recording:
    """A flight in a file.

    Attributes:
        log: the file.
        airframe: as the user has it, measured.
        exact: the same without errors of measurement.
        truth: for the judge alone.
        vehicle: what it was, for the page.
    """

    log: Path
    airframe: Airframe
    exact: Airframe
    truth: Truth
    vehicle: str


def record(
    scenario: Scenario, number: int, folder: Path, seconds: float | None = None
) -> Recording:
    """Fly one vehicle of a scenario.

    Args:
        scenario: what to fly.
        number: of the vehicle; the same number is the same vehicle where layouts are the same.
        folder: for the file.
        seconds: of flight; None for the whole mission.
    """
    drawn = draw(number, scenario.layouts)
    random = np.random.default_rng([number, *scenario.name.encode()])
    (errors,) = random.spawn(1)
    known = scenario.known(drawn.airframe)
    physics = mounted(scenario.physics(random), known, errors)
    mission: Mission = drawn.mission(
        scenario.mission, scenario.rate, 1.5, 2.0 if scenario.mission == "climbs" else 0.0
    )
    if scenario.ground:
        mission = GroundCycle(mission, 4.0)
    simulation = Simulation(
        drawn.vehicle,
        mission,
        np.random.SeedSequence([number, 1]),
        0.0,
        physics=physics,
    )
    rate = float(random.choice(scenario.imu))
    log = folder / f"{scenario.name}_{number}.tlog"
    write(simulation, log, number, rate, seconds, commands=scenario.commands, esc=scenario.esc)
    truth = simulation.vehicle.truth() if simulation.done else _start_truth(simulation)
    if simulation.physics.slosh[0]:
        truth = _sloshing(truth, simulation.physics, drawn.vehicle.rotors)
    if physics.tilt:
        truth |= {n: math.cos(physics.tilt) * truth[n] for n in ("k_T", "k_M")}  # along body z
    for name in scenario.unjudged:
        truth.pop(name, None)
    user, exact = measured(known, errors), known_exactly(known, physics)
    return Recording(log, user, exact, truth, describe(drawn))


def _start_truth(simulation: Simulation) -> Truth:
    """True parameters; where rotors are unequal, all the values that there are."""
    truth = simulation.vehicle.truth()
    if simulation.physics.scatter:
        each = zip(truth["k_M_rotors"], truth["k_T_rotors"], strict=True)
        truth["moment_ratio"] = [k_M / k_T for k_M, k_T in each]
        truth["k_T"], truth["k_M"] = truth["k_T_rotors"], truth["k_M_rotors"]
    return truth


def _sloshing(truth: Truth, physics: Physics, rotors: tuple[Rotor, ...]) -> Truth:
    """With the inertia that a liquid has between slow motion and fast, which leaves it behind."""
    arm = float(np.mean([math.hypot(r.x, r.y) for r in rotors]))
    left_behind = physics.slosh[0] * truth["mass"] * (SLOSH_DEPTH * arm) ** 2
    return truth | {name: [truth[name] - left_behind, truth[name]] for name in ("Ixx", "Iyy")}


def describe(drawn: Drawn) -> str:
    """A vehicle in three words."""
    return f"{drawn.layout}, {drawn.vehicle.mass:.2g} kg, arm {drawn.arm:.2g} m"


def write(
    simulation: Simulation,
    log: Path,
    seed: int,
    rate: float,
    seconds: float | None = None,
    *,
    commands: bool = False,
    esc: float = 0.0,
) -> None:
    """Fly to the end, as PX4 with MEMS sensors, into a .tlog.

    Args:
        simulation: at its start.
        log: file to write.
        seed: of the sensors.
        rate: of IMU and rotors, Hz.
        seconds: of flight; None for the whole mission.
        commands: sent instead of rotor speeds.
        esc: Hz of the rotor speeds; 0: `rate`.
    """
    faults = replace(SensorFaults(), never_sent=_SPEEDS if commands else _COMMANDS)
    autopilot = Px4(simulation, "mems", 0.0, rate, np.random.SeedSequence([seed, 2]), faults)
    if esc:
        autopilot.schedule.set_interval(mavlink.MAVLINK_MSG_ID_ESC_STATUS, 1e6 / esc, 0)
        # An ESC's clock is its own: its samples fall anywhere between those of the IMU.
        phase = np.random.default_rng([seed, 3]).uniform(0.0, 1e6 / esc)
        autopilot.schedule.streams[mavlink.MAVLINK_MSG_ID_ESC_STATUS].due = float(phase)
        autopilot.instruments.retime("rotor", 1.0 / esc)
    fly_into(log, simulation, autopilot, seconds)


def fly_into(
    log: Path, simulation: Simulation, autopilot: Px4, seconds: float | None = None
) -> None:
    """Fly a simulation from its start into a .tlog, for so many seconds or the whole mission."""
    length = simulation.mission.duration if seconds is None else seconds
    autopilot.show_parameters()
    link = TlogLink(log, replace=True)
    try:
        for tick in range(round(length / simulation.step_size) + 1):
            if tick:
                simulation.step()
            frames = autopilot.poll(tick)
            if frames:
                link.send(frames, BOOT_US + tick * simulation.step_us)
    finally:
        link.close()
