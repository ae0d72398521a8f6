"""Accuracy over noise seeds, through the whole path: emulator, MAVLink, .tlog, analysis.

`make bench-accuracy` prints the table of the README. Each flight is one run of `sim-bridge` and
one of `gcs-sysid analyze`, as a user would run them.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

PARAMETERS = ("Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Ixz", "cg_x", "cg_y", "k_T", "k_M")


@dataclass(frozen=True)
class Case:
    """One row of the table."""

    name: str
    flight: tuple[str, ...]


CASES = (
    Case(
        "paper mission, 20 Hz, the article's noise (0.02)",
        ("--mission", "paper", "--noise", "paper", "--sigma", "0.02", "--rate", "20"),
    ),
    Case(
        "paper mission, 250 Hz, MEMS sensors",
        ("--mission", "paper", "--noise", "mems", "--rate", "250"),
    ),
    Case(
        "all-axes mission, 250 Hz, MEMS sensors",
        ("--mission", "all-axes", "--noise", "mems", "--rate", "250"),
    ),
)


@dataclass(frozen=True)
class Outcome:
    """Errors of one flight."""

    percent: tuple[float, ...]
    """|error| in % of the truth, as PARAMETERS."""
    inside: tuple[bool, ...]
    """Whether the 95 % interval holds the truth."""
    verdict: str


def fly(case: Case, seed: int) -> Outcome:
    """One flight and its analysis."""
    with tempfile.TemporaryDirectory() as folder:
        log, truth_file = Path(folder) / "flight.tlog", Path(folder) / "truth.json"
        python = [sys.executable, "-m"]
        flight = [*python, "sim_bridge", "--airframe", "paper", *case.flight]
        flight += ["--seed", str(seed), "--speed", "max"]
        subprocess.run([*flight, "--tlog", log, "--truth", truth_file], check=True)
        analysis = [*python, "gcs_sysid", "analyze", str(log), "--airframe", "paper"]
        done = subprocess.run([*analysis, "--json", "-"], check=True, capture_output=True)
        truth = json.loads(truth_file.read_text())
    result = json.loads(done.stdout)
    estimates = [result["parameters"][name] for name in PARAMETERS]
    true = [truth[name] for name in PARAMETERS]
    return Outcome(
        tuple(abs(e["value"] / t - 1.0) * 100.0 for e, t in zip(estimates, true, strict=True)),
        tuple(e["ci95"][0] <= t <= e["ci95"][1] for e, t in zip(estimates, true, strict=True)),
        result["verdict"],
    )


def table(case: Case, outcomes: Sequence[Outcome]) -> list[str]:
    """Lines of Markdown for one case."""
    percent = np.array([o.percent for o in outcomes])
    inside = np.array([o.inside for o in outcomes])
    identified = sum(o.verdict == "identified" for o in outcomes)
    cells = [
        f"{np.median(column):.2f} / {column.max():.2f}"
        for column in [*percent.T, percent.max(axis=1)]
    ]
    return [
        f"| {case.name} | " + " | ".join(cells) + f" | {100 * inside.mean():.0f} % "
        f"| {identified} of {len(outcomes)} |"
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    options = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    print(f"Error in %, median / largest of {options.seeds} seeds.\n")
    print("| flight | " + " | ".join([*PARAMETERS, "largest"]) + " | intervals hold | identified |")
    print("|---" * (len(PARAMETERS) + 4) + "|")
    with ThreadPoolExecutor(options.workers) as pool:
        for case in CASES:
            flights = [pool.submit(fly, case, seed) for seed in range(1, options.seeds + 1)]
            outcomes = []
            for number, flight in enumerate(flights, 1):
                outcomes.append(flight.result())
                if sys.stderr.isatty():
                    print(f"\r{case.name}: {number}/{len(flights)}\033[K", end="", file=sys.stderr)
            if sys.stderr.isatty():
                print("\r\033[K", end="", file=sys.stderr)
            print("\n".join(table(case, outcomes)), flush=True)


if __name__ == "__main__":
    main()
