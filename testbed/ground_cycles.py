"""Emulated flights written to a file, with the rates that a study asks for."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from gcs_sysid.telemetry.messages import MESSAGE_IDS
from sim_bridge.ground_cycle import GroundCycle
from sim_bridge.links import TlogLink
from sim_bridge.missions import MISSIONS, Mission
from sim_bridge.px4 import Px4
from sim_bridge.sensor_faults import SensorFaults
from sim_bridge.server import Pace, TruthFile, fly
from sim_bridge.simulation import Change, Simulation
from sim_bridge.vehicle_files import load_vehicle

FAST = {
    "ESC_STATUS": 500.0,
    "ACTUATOR_OUTPUT_STATUS": 100.0,
    "SERVO_OUTPUT_RAW": 0.0,
    "ATTITUDE": 100.0,
    "ATTITUDE_QUATERNION": 0.0,
}
"""Hz beside a HIGHRES_IMU of 1000 Hz. What is not named comes as it usually does."""
FLIGHT = 62.0
"""s of the article's mission, the one that is flown."""
CLIMBS = 12.0
"""s of one flight's climb and landing."""


def set_rates(autopilot: Px4, rates: Mapping[str, float]) -> None:
    """Send these messages at these rates in Hz; 0: never."""
    for name, rate in rates.items():
        interval = 1e6 / rate if rate else -1.0
        autopilot.schedule.set_interval(MESSAGE_IDS[name], interval, 0)
        if name == "ESC_STATUS" and rate:
            autopilot.instruments.retime("rotor", 1.0 / rate)
        if name == "ATTITUDE" and rate:
            autopilot.instruments.retime("attitude", 1.0 / rate)


def emulate(
    path: Path,
    *,
    rate: float = 1000.0,
    rates: Mapping[str, float] | None = None,
    flights: int = 1,
    ground: float = 12.0,
    noise: str = "mems",
    seed: int = 1,
    sensor_faults: SensorFaults | None = None,
    changes: Sequence[Change] = (),
    seconds: float = math.inf,
    mission: Mission = MISSIONS["paper"],
) -> float:
    """Fly a mission once or several times, from the ground and back, into a .tlog.

    Args:
        path: replaced if it is there; beside it the truth, as NAME.truth.json.
        rate: Hz of the IMU.
        rates: see `set_rates`.
        flights: one after the other.
        ground: s of each stay on the ground.
        noise: of the sensors, one of `NOISE_MODELS`.
        seed: of noise and traps.
        sensor_faults: in force.
        changes: of the vehicle.
        seconds: after which it ends at the latest.
        mission: flown in the air, the article's if none is given.

    Returns:
        The length of the recording in s.
    """
    gusts, sensors = np.random.SeedSequence(seed).spawn(2)
    ground_cycle = GroundCycle(mission, ground, flights)
    simulation = Simulation(load_vehicle("paper"), ground_cycle, gusts, None, list(changes))
    autopilot = Px4(simulation, noise, 0.02, rate, sensors, sensor_faults or SensorFaults())
    set_rates(autopilot, rates or {})
    seconds = min(seconds, ground_cycle.duration)
    autopilot.show_parameters()
    link = TlogLink(path, replace=True)
    truth = TruthFile(path.with_suffix(".truth.json"), simulation, autopilot)
    try:
        fly(simulation, autopilot, [link], seconds, Pace(math.inf), truth)
    finally:
        link.close()
    return seconds


def flights_in(seconds: float, ground: float = 12.0) -> int:
    """How many flights last so long at least, with the stays between them."""
    return max(1, math.ceil((seconds - ground) / (FLIGHT + CLIMBS + ground)))
