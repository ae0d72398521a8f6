"""The whole path, as a user runs it: emulator, MAVLink, .tlog, analysis."""

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.accuracy.estimators import in_percent
from testbed import study
from testbed.article import NAMES

FLIGHTS: dict[str, tuple[str, ...]] = {
    "paper mission, 20 Hz, the article's noise (0.02)": (
        *("--mission", "paper", "--noise", "paper", "--sigma", "0.02", "--rate", "20"),
    ),
    "paper mission, 250 Hz, MEMS sensors": (
        *("--mission", "paper", "--noise", "mems", "--rate", "250"),
    ),
    "all-axes mission, 250 Hz, MEMS sensors": (
        *("--mission", "all-axes", "--noise", "mems", "--rate", "250"),
    ),
}


def run(seed: int) -> dict[str, Any]:
    return {name: _fly(flight, seed) for name, flight in FLIGHTS.items()}


def _fly(flight: tuple[str, ...], seed: int) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        words = ("--airframe", "paper", *flight, "--seed", str(seed))
        log, _ = study.flown(words, Path(folder))
        analysis = ("gcs_sysid", "analyze", str(log), "--airframe", "paper", "--json", "-")
        done = study.sound(study.run(analysis))
    result = json.loads(done.told)
    estimates = [result["parameters"][name] for name in NAMES]
    value, std = (np.array([e[key] for e in estimates], dtype=float) for key in ("value", "std"))
    return {**in_percent(value, std), "verdict": result["verdict"]}
