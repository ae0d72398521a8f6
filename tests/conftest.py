"""Emulated flights that several test folders share, each flown once."""

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from gcs_sysid.records import Record
from gcs_sysid.telemetry.intake import Intake
from gcs_sysid.telemetry.tlog import read_tlog

AS_THE_ARTICLE = ("--mission", "paper", "--noise", "paper", "--sigma", "0.02", "--rate", "20")


@dataclass(frozen=True)
class Flight:
    """A recording of the emulator, and what is true of its vehicle."""

    tlog: Path
    truth_file: Path

    @property
    def truth(self) -> dict[str, float]:
        table: dict[str, float] = json.loads(self.truth_file.read_text())
        return table

    def records(self) -> list[Record]:
        """What the recording's frames say, as the chain takes it."""
        return Intake().frames(frame for _, frame in read_tlog(self.tlog))


FlyFunction = Callable[..., Flight]


@pytest.fixture(scope="session")
def fly(tmp_path_factory: pytest.TempPathFactory) -> FlyFunction:
    """Flies the emulator as a program; options as on its command line."""

    def fly(*options: str) -> Flight:
        folder = tmp_path_factory.mktemp("flight")
        flight = Flight(folder / "flight.tlog", folder / "truth.json")
        command = [sys.executable, "-m", "sim_bridge", "--airframe", "paper", *options]
        files = ["--speed", "max", "--tlog", str(flight.tlog), "--truth", str(flight.truth_file)]
        subprocess.run([*command, *files], check=True, capture_output=True, timeout=300)
        return flight

    return fly


@pytest.fixture(scope="session")
def paper_flight(fly: FlyFunction) -> Flight:
    """The article's three modes with its noise at 20 Hz, seed 1."""
    return fly(*AS_THE_ARTICLE, "--seed", "1")


@pytest.fixture(scope="session")
def paper_records(paper_flight: Flight) -> list[Record]:
    """Its records."""
    return paper_flight.records()
