"""Flights and decoders that several tests share."""

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from gcs_sysid.telemetry.dialect import mavlink
from sim_bridge.cli import main
from sim_bridge.ensemble import Flight, fly_ensemble
from sim_bridge.missions import MISSIONS
from sim_bridge.simulated_vehicle import Vehicle
from sim_bridge.simulation import Simulation
from sim_bridge.vehicle_files import load_vehicle


class Desk:
    """A ground station that speaks to an autopilot in the same process."""

    def __init__(self, simulation: Simulation, autopilot: Any) -> None:
        self.simulation = simulation
        self.autopilot = autopilot
        self.sender = mavlink.MAVLink(None, 245, 190)
        self.parser = mavlink.MAVLink(None)

    def ask(self, message: Any) -> list[Any]:
        frames = self.autopilot.receive(message.pack(self.sender), self.simulation.tick)
        return [self.parser.decode(bytearray(frame)) for frame in frames]

    def command(self, number: int, *params: float, target: tuple[int, int] = (1, 1)) -> list[Any]:
        filled = [*params, *[0.0] * (7 - len(params))]
        return self.ask(mavlink.MAVLink_command_long_message(*target, number, 0, *filled))

    def notice(self, seconds: float) -> list[Any]:
        """What comes in so much flight from now on."""
        heard = []
        for _ in range(round(seconds / self.simulation.step_size)):
            self.simulation.step()
            heard += self.autopilot.poll(self.simulation.tick)
        return [self.parser.decode(bytearray(frame)) for frame in heard]

    def counts(self, seconds: float) -> Counter[str]:
        """Messages of each type in so much flight."""
        return Counter(message.get_type() for message in self.notice(seconds))


@pytest.fixture(scope="session")
def open_desk() -> type[Desk]:
    return Desk


@pytest.fixture(scope="session")
def paper_vehicle() -> Vehicle:
    return load_vehicle("paper")


@pytest.fixture(scope="session")
def flights(paper_vehicle: Vehicle) -> dict[str, Flight]:
    """The paper's vehicle through any mission, 50 samples a second, no noise."""

    class Flights(dict[str, Flight]):
        def __missing__(self, name: str) -> Flight:
            self[name] = fly_ensemble(paper_vehicle, MISSIONS[name], 50.0)
            return self[name]

    return Flights()


@pytest.fixture(scope="session")
def tlog(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five seconds of the paper's mission with MEMS noise, all messages."""
    path = tmp_path_factory.mktemp("tlog") / "flight.tlog"
    assert main(["--duration", "5", "--tlog", str(path), "--seed", "7", "--noise", "mems"]) == 0
    return path


@pytest.fixture(scope="session")
def read_tlog() -> Callable[[Path], Iterator[tuple[int, Any]]]:
    """Reads a .tlog: record time (us) and message, decoded by pymavlink's own parser."""

    def read(path: Path) -> Iterator[tuple[int, Any]]:
        data = path.read_bytes()
        parser = mavlink.MAVLink(None)
        at = 0
        while at < len(data):
            size = (8 if data[at + 8] == 0xFE else 12) + data[at + 9]
            yield (
                int.from_bytes(data[at : at + 8], "big"),
                parser.decode(bytearray(data[at + 8 : at + 8 + size])),
            )
            at += 8 + size

    return read
