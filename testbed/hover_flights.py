"""Ordinary flights of drawn vehicles as slow recordings, and what hover in a recording shows.

IMU comes at 25 Hz, rotors at 10 Hz; rotors scatter by what the intervals of health assume.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from pymavlink import mavutil

from gcs_sysid.arrays import Array, complete_rows
from gcs_sysid.health.command_curve import thrust_of
from gcs_sysid.health.hover import Windows, windows_of
from gcs_sysid.health.log_streams import Streams, streams_of
from gcs_sysid.health.rotor_condition import Load, load_of
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.signals.columns import Track
from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.logs import open_log
from sim_bridge.doublets import DoubletMission
from sim_bridge.missions import Mission
from sim_bridge.physics import IDEAL, Physics
from sim_bridge.px4 import Px4
from sim_bridge.sensor_faults import NO_SENSOR_FAULTS, SensorFaults
from sim_bridge.simulated_vehicle import RotorTraits
from sim_bridge.simulation import Simulation
from testbed.emulated import fly_into
from testbed.vehicles import Drawn

LAYOUTS = ("quad-x", "hexa", "octo")
IMU, ROTORS = 25.0, 10.0
"""Hz."""
STEP_US = 4000
"""us of a physics step: short against the motors' lag, and what is sent is slow."""
ORDINARY = DoubletMission("ordinary", 0.4, 2.5, 0.2, 4.0, 1.5, 0.02)
"""What most flights are: gentle, with climbs of 1.5 m, in light turbulence."""
STRETCH = 10.0
"""s in which a weak rotor is to be named."""


def uneven(drawn: Drawn, random: np.random.Generator, scatter: float) -> RotorTraits:
    """Rotors whose thrust and torque scatter, of mean 1."""
    n = len(drawn.vehicle.rotors)

    def shares() -> tuple[float, ...]:
        values = 1.0 + scatter * random.standard_normal(n)
        return tuple((values / values.mean()).tolist())

    return RotorTraits(shares(), shares())


def fly(
    log: Path,
    drawn: Drawn,
    mission: Mission,
    seed: int,
    traits: RotorTraits | None = None,
    seconds: float | None = None,
    physics: Physics = IDEAL,
    step_us: int = STEP_US,
    sensor_faults: SensorFaults = NO_SENSOR_FAULTS,
) -> None:
    """Fly into a .tlog at slow rates.

    Args:
        log: to write.
        drawn: that flies.
        mission: flown.
        seed: of sensors and air.
        traits: of its rotors; None: all alike.
        seconds: of flight; None: the whole mission.
        physics: besides.
        step_us: us of a physics step.
        sensor_faults: in force.
    """
    vehicle = replace(drawn.vehicle, traits=traits)
    simulation = Simulation(
        vehicle,
        mission,
        np.random.SeedSequence([seed, 1]),
        None,
        step_us=step_us,
        control_steps=1,
        physics=physics,
    )
    sensors = np.random.SeedSequence([seed, 2])
    autopilot = Px4(simulation, "mems", 0.0, IMU, sensors, sensor_faults)
    phase = np.random.default_rng([seed, 3])
    for message in (
        mavlink.MAVLINK_MSG_ID_ESC_STATUS,
        mavlink.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS,
        mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW,
    ):
        autopilot.schedule.set_interval(message, 1e6 / ROTORS, 0)
        autopilot.schedule.streams[message].due = float(phase.uniform(0.0, 1e6 / ROTORS))
    fly_into(log, simulation, autopilot, seconds)


def pressure_in(log: Path) -> tuple[Array, Array]:
    """(n,) s and Pa of a recording's barometer."""
    opened = mavutil.mavlink_connection(str(log))
    frames = iter(lambda: opened.recv_match(type="HIGHRES_IMU"), None)
    t, pressure = np.array([(f.time_usec * 1e-6, 100.0 * f.abs_pressure) for f in frames]).T
    opened.close()
    return t, pressure


def streams_in(log: Path, airframe: Airframe, *, speeds: bool, thin: bool = False) -> Streams:
    """The streams of a recording, with its speeds or without; thinned to slow rates."""
    opened = open_log(log)
    blocks = []
    for block in opened.blocks():
        tracks = tuple(
            thinned(track) if thin else track
            for track in block.tracks
            if speeds or track.stream is not Stream.ROTOR_SPEED
        )
        blocks.append(replace(block, tracks=tracks))
    assert opened.vehicle is not None
    return streams_of(blocks, airframe, opened.vehicle.key, opened.parameters)


def thinned(track: Track) -> Track:
    """A track at the rate of slow logs."""
    rates = {Stream.IMU: IMU, Stream.ROTOR_SPEED: ROTORS, Stream.ROTOR_COMMAND: ROTORS,
             Stream.ATTITUDE: ROTORS, Stream.VELOCITY: ROTORS}  # fmt: skip
    rate = rates.get(track.stream)
    if rate is None or len(track.t) < 2:
        return track
    step = np.floor(track.t * rate + 1e-6)
    return track.part(np.append(True, np.diff(step) > 0.0))


def hovering(windows: Windows, *, speeds: bool) -> Windows:
    """What of them is hover with speeds, or commands."""
    told = windows.speeds if speeds else windows.commands
    return windows.part(windows.hovering & complete_rows(told) & complete_rows(windows.turning))


def hover_of(log: Path, airframe: Airframe, *, speeds: bool) -> Windows:
    """The hover of a log."""
    windows = windows_of(streams_in(log, airframe, speeds=speeds), len(airframe.rotors))
    return hovering(windows, speeds=speeds)


def loads_of(hover: Windows, *, speeds: bool, c: float) -> Iterator[Load]:
    """The loads of stretch after stretch."""
    count = round(STRETCH / hover.half)
    for start in range(0, len(hover.t) - count + 1, count):
        part = hover.part(slice(start, start + count))
        curve = None if speeds else c
        load = load_of(part, thrust_of(part, curve), curve)
        if load is not None:
            yield load


def between_flights(pairs: Sequence[Sequence[float]]) -> float:
    """Chi-square per degree of freedom of (n, 2) values and their standard deviations."""
    values, stds = np.array(pairs).T
    weights = stds**-2.0
    mean = (weights * values).sum() / weights.sum()
    return float((weights * (values - mean) ** 2).sum()) / max(len(values) - 1, 1)
