"""The loop that flies a mission and talks: paced by the clock, or as fast as it goes."""

import json
import math
import os
import sys
import time
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any, Protocol

from gcs_sysid.errors import InputError
from sim_bridge.autopilot import BOOT_US, Autopilot
from sim_bridge.links import Link
from sim_bridge.simulated_vehicle import Vehicle
from sim_bridge.simulation import Simulation

LISTEN_STEPS = 4
"""Physics steps between looks at what has arrived."""
FASTEST = 250.0
"""m/s that a vehicle can have and fly."""


class Pacing(Protocol):
    """Holds a sender to a pace."""

    def wait(self, flown: float) -> None:
        """Wait until this many seconds of flight are due."""
        ...


class Pace:
    """Holds the flight to the clock.

    A late loop catches up: what counts is the time since the start, not since the last step.
    """

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._start = time.monotonic()

    def wait(self, flown: float) -> None:
        """Wait until this many seconds of flight are due."""
        if self._speed == math.inf:
            return
        ahead = self._start + flown / self._speed - time.monotonic()
        if ahead > 0.0:
            time.sleep(ahead)


def plain(value: Any) -> Any:
    """A value of an effect as JSON holds it."""
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value


class TruthFile:
    """The true parameters in force, as JSON: written at the start and after every change."""

    def __init__(self, path: Path | None, simulation: Simulation, autopilot: Autopilot) -> None:
        self._path = path
        self._sim = simulation
        self._autopilot = autopilot
        self._written = -1
        self.update()

    def update(self) -> None:
        """Write the file when something has changed since the last time."""
        if self._path is None or len(self._sim.done) == self._written:
            return
        self._written = len(self._sim.done)
        content = self._truth(self._sim.vehicle)
        events = [
            {
                "t": change.time,
                "time_usec": self._autopilot.clock.at(round(change.time / self._sim.step_size)),
                "kind": change.kind,
                "before": self._truth(before),
                "after": self._truth(after),
            }
            for change, before, after in self._sim.done
        ]
        if events:
            content["events"] = events
        try:
            # Whole or not at all: another program may be waiting for the file.
            part = self._path.with_name(self._path.name + ".part")
            part.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
            os.replace(part, self._path)
        except OSError as error:
            raise InputError(f"cannot write {self._path}: {error.strerror}") from error

    def _truth(self, vehicle: Vehicle) -> dict[str, Any]:
        facts = {**vehicle.truth(), "rotor_delay": self._autopilot.rotor_delay}
        on = self._sim.physics.switched_on
        return {**facts, "physics": {k: plain(v) for k, v in on.items()}} if on else facts


def fly(
    simulation: Simulation,
    autopilot: Autopilot,
    links: list[Link],
    duration: float,
    pace: Pacing,
    truth: TruthFile,
) -> None:
    """Fly to the end of the mission, sending and answering all the way.

    Args:
        simulation: at its start.
        autopilot: that sends and answers.
        links: to send on.
        duration: s.
        pace: of the flight.
        truth: kept up to date.

    Raises:
        InputError: the vehicle does not stay up; what it sent until then has been sent.
    """
    progress = Progress(duration)
    steps = round(duration * 1e6 / simulation.step_us)
    for tick in range(steps + 1):
        if tick:
            simulation.step()
            if tick % LISTEN_STEPS == 0:
                _check_flies(simulation)
        frames = autopilot.poll(tick)
        if tick % LISTEN_STEPS == 0:
            pace.wait(simulation.time)
            for link in links:
                arrived = link.receive()
                if arrived:
                    frames += autopilot.receive(arrived, tick)
            truth.update()
            progress.show(simulation.time)
        if frames:
            stamp = BOOT_US + tick * simulation.step_us
            for link in links:
                link.send(frames, stamp)
    progress.end()


def _check_flies(simulation: Simulation) -> None:
    """Stop a flight that no message could represent any more: speeds go up to 327 m/s in some."""
    speed = math.hypot(*simulation.state.velocity)
    if not speed < FASTEST:
        raise InputError(
            f"{simulation.time:.1f} s after the start the vehicle is out of control at over "
            f"{FASTEST:g} m/s: its rotors cannot carry this mass, or the wind is too strong"
        )


class Progress:
    """One line on standard error, when that is a terminal."""

    def __init__(self, duration: float) -> None:
        self._duration = duration
        self._on = sys.stderr.isatty()
        self._next = 0.0

    def show(self, flown: float) -> None:
        """Show the time flown, once a second of flight."""
        if self._on and flown >= self._next:
            self._next += 1.0
            print(f"\r{flown:5.0f} s of {self._duration:.0f} s", end="", file=sys.stderr)

    def end(self) -> None:
        """Leave the line."""
        if self._on:
            print(file=sys.stderr)
