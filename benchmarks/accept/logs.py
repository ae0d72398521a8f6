"""Recorded flights, and what a user would have said of their vehicles on the command line."""

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.accept.trees import PROJECT

SHARED = Path(os.environ.get("GCS_SYSID_LOGS", PROJECT.parent / "shared" / "logs"))
"""Recordings that are not part of the project; what is absent is skipped."""
KEPT = PROJECT / "build" / "accept"
"""What is made once and used again."""
SUFFIXES = {".tlog", ".ulg", ".bin", ".bbl", ".bfl", ".txt", ".log", ".csv"}
_FAMILIES = {"LOG00": "cinerat", "crazyflie": "crazyflie"}
"""Logs that share an airframe file, by how their names begin."""
_FIELD: dict[str, tuple[str, ...]] = {
    "quiver": ("--arm", "0.67", "--mass", "20.15+-0.5"),
    "greenreaper": ("--arm", "0.11", "--mass", "0.5"),
    "betaflight": ("--arm", "0.11", "--mass", "0.65"),
    "indiflight": ("--airframe", "sil158.toml"),
    "crazyflie": ("--airframe", "n_cf27.toml", "--csv", "indi.toml"),
    "crazypad": ("--airframe", "n_cf.toml", "--csv", "pad.toml"),
    "other": ("--arm", "0.67", "--mass", "20.15"),
}
"""What is known of the vehicles of a folder; files lie in it."""
_OWN: dict[str, tuple[str, ...]] = {
    "geprc-on-the-ground.bbl": ("--arm", "0.06", "--mass", "0.2"),
    "greenreaper06-idle-on-the-ground.bfl": ("--arm", "0.11", "--mass", "0.5"),
    "pisun003-erpm-read-as-rad.bbl": (
        *("--airframe", "betaflight-quad-x", "--arm", "0.08", "--mass", "0.4"),
    ),
    "nazgul.bbl": ("--arm", "0.12", "--mass", "0.7"),
    "quiver_00000087.bin": ("--airframe", "ardupilot-quad-x", "--arm", "0.75", "--mass", "18"),
    "gazebo-iris.csv": ("--airframe", "px4-quad-x", "--arm", "0.25", "--mass", "1.5"),
}


@dataclass(frozen=True)
class Log:
    """A recording.

    Attributes:
        file: it.
        name: below the folder that it was found in, unique.
        given: options of `analyze` that tell of the vehicle.
    """

    file: Path
    name: str
    given: tuple[str, ...]

    @property
    def table(self) -> tuple[str, ...]:
        """Options that name the mapping file of a table."""
        at = self.given.index("--csv") if "--csv" in self.given else len(self.given)
        return self.given[at : at + 2]


def all_logs() -> Iterator[Log]:
    """Those of the project, then the shared ones."""
    for folder in (PROJECT / "logs", SHARED):
        for file in sorted(folder.rglob("*")):
            if file.suffix.lower() in SUFFIXES:
                name = f"{'shared/' if folder is SHARED else ''}{file.relative_to(folder)}"
                yield Log(file, name, given(file))


def given(file: Path) -> tuple[str, ...]:
    """What a user would give of a log's vehicle."""
    words = _OWN.get(file.name) or _known_beside(file)
    words = words or _FIELD.get(file.parent.name) or ("--airframe", "paper", "--mass", "1.5")
    return tuple(str(file.parent / word) if word.endswith(".toml") else word for word in words)


def _known_beside(file: Path) -> tuple[str, ...]:
    """By the airframe file of its name or family, else by its truth."""
    family = next((name for begin, name in _FAMILIES.items() if file.name.startswith(begin)), None)
    names = [file.stem, *([f"{family}_cmd" if "_cmd" in file.stem else family] if family else [])]
    for name in names:
        if file.with_name(f"{name}.toml").exists():
            return ("--airframe", f"{name}.toml")
    truth = file.with_suffix(".truth.json")
    table = json.loads(truth.read_text(encoding="utf-8")) if truth.exists() else {}
    if "l_roll" in table:
        arm = table["l_roll"] * 2.0**0.5
        mass = table["mass"] if "mass" in table else table["flights"][0]["mass"]
        return ("--airframe", "px4-sih", "--arm", f"{arm:.17g}", "--mass", f"{mass:.17g}")
    if "rotor_pos_rel_cg_m" in table:
        return ("--airframe", _airframe_file(file, table), "--mass", f"{table['mass']:.17g}")
    return ()


def _airframe_file(log: Path, truth: dict[str, Any]) -> str:
    """Written for a log of ArduPilot's simulator, whose quad X is no square."""
    spins = ("ccw", "ccw", "cw", "cw")
    text = f'name = "{log.stem}"\n'
    for spin, (_, place) in zip(spins, sorted(truth["rotor_pos_rel_cg_m"].items()), strict=True):
        x, y = (at + cg for at, cg in zip(place[:2], truth["cg_m"], strict=False))
        text += f'[[rotor]]\nx = {x:.17g}\ny = {y:.17g}\nspin = "{spin}"\n'
    file = KEPT / f"{log.stem}.toml"
    KEPT.mkdir(parents=True, exist_ok=True)
    if not file.exists() or file.read_text() != text:
        file.write_text(text)
    return str(file)
