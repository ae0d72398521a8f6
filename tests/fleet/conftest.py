"""A few short flights in folders as people keep them, and the command on them."""

import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from gcs_sysid.cli import batch_command
from gcs_sysid.cli.program import run
from gcs_sysid.model.airframe import load_airframe

SHORT = ("--mission", "all-axes", "--noise", "paper", "--sigma", "0.002", "--rate", "20")


@pytest.fixture(scope="session")
def flights(fly) -> list[Path]:
    """Three short flights."""
    return [fly(*SHORT, "--duration", "16", "--seed", str(n)).tlog for n in (1, 2, 3)]


def fill(folder: Path, flights: list[Path]) -> None:
    """Two vehicles with flights of equal names, a copy, and a broken log."""
    for name in ("one", "two"):
        (folder / name).mkdir(parents=True)
    for flight, place in zip(flights, ("one/a.tlog", "one/b.tlog", "two/a.tlog"), strict=True):
        shutil.copy(flight, folder / place)
    shutil.copy(flights[0], folder / "one" / "copy without a suffix")
    (folder / "two" / "broken.ulg").write_bytes(b"nothing of the kind" * 20)
    (folder / "two" / "notes.txt").write_text("wind from the west")


@pytest.fixture
def logs(flights, tmp_path) -> Path:
    """A folder of these."""
    fill(tmp_path / "logs", flights)
    return tmp_path / "logs"


class OneThread(ThreadPoolExecutor):
    """A pool of this process: another takes a processor second to start."""

    capacity = 2

    def __init__(self, workers, work):
        super().__init__(1)
        self.work = work

    def submit(self, task):
        return super().submit(self.work, task)

    def close(self):
        self.shutdown()


@pytest.fixture
def batch(capsys, monkeypatch):
    """Runs `batch` in this process, or in `workers`; (status, standard error). Nothing may go to
    standard output."""

    def batch(*argv):
        if "--workers" not in argv:
            monkeypatch.setattr(batch_command, "LocalPool", OneThread)
        status = run(["batch", *map(str, argv)])
        out = capsys.readouterr()
        assert out.out == ""
        return status, out.err

    return batch


@pytest.fixture
def airframe_file():
    """Writes the paper's airframe under another name."""

    def write(path: Path, name: str, mass: float = 1.5) -> None:
        airframe = load_airframe("paper")
        lines = [f"name = {json.dumps(name)}", f"mass = {mass}"]
        for rotor in airframe.as_json()["rotors"]:
            lines += ["[[rotor]]", *(f"{key} = {json.dumps(v)}" for key, v in rotor.items())]
        path.write_text("\n".join(lines))

    return write
