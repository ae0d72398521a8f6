"""What the emulator, the estimator and a live session cost, in processor time: `make bench`.

Prints a table. Bars are ratios to the flight's own length, so they mean the same on any machine
that can fly it in real time at all.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from gcs_sysid.estimation.online.online import OnlineEstimator
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.live.live_estimate import HoverWatch
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.signals.complementary import ComplementaryFilter
from gcs_sysid.signals.records import Samples
from gcs_sysid.telemetry.intake import Intake
from gcs_sysid.telemetry.tlog import TlogReader
from sim_bridge.ensemble import fly_ensemble
from sim_bridge.missions import MISSIONS
from sim_bridge.simulated_vehicle import stack_vehicles
from sim_bridge.vehicle_files import load_vehicle
from testbed.article_flights import GEOMETRY, fly, measure
from testbed.recordings import block_of, in_sequence
from testbed.study import arguments, free_port, run

RATE = 250
FLIGHT = ["--airframe", "paper", "--mission", "paper", "--noise", "mems", "--rate", str(RATE)]


def cost_of(*words: str) -> float:
    """Run a command; its processor time in s."""
    done = run(words)
    if done.status not in (0, 1):  # 1: half a second of flight allows no answer
        sys.exit(done.said)
    return done.seconds


def emulator(folder: Path) -> float:
    """Real time over processor time of a flight into a file."""
    start_up = cost_of("sim_bridge", "--version")
    log = str(folder / "flight.tlog")
    return 62.0 / (cost_of("sim_bridge", *FLIGHT, "--speed", "max", "--tlog", log) - start_up)


def ensemble_speed(vehicles: int = 1000, seconds: float = 2.0) -> float:
    """Flown time over processor time of an ensemble, without messages."""
    fleet = stack_vehicles([load_vehicle("paper")] * vehicles)
    began = time.process_time()
    fly_ensemble(fleet, MISSIONS["paper"], 50.0, seconds)
    return vehicles * seconds / (time.process_time() - began)


def step_rate(block: int) -> float:
    """Samples a second through complementary filter and estimator alone, refit at 10 Hz."""
    seen = measure(fly("paper", RATE), "mems", 0.0, seed=1)
    complementary, estimator = (
        ComplementaryFilter(1.0 / RATE),
        OnlineEstimator(GEOMETRY, 1.0 / RATE, EstimatorTuning()),
    )
    n, refit = len(seen.gyro), RATE // 10
    began = time.process_time()
    for start in range(0, n, block):
        part = slice(start, min(start + block, n))
        attitude = complementary.update(seen.gyro[part], seen.attitude[part])
        samples = Samples(
            gyro=seen.gyro[part],
            rates=seen.gyro[part] - complementary.biases,
            speeds=seen.speeds[part],
            attitude=attitude,
            force=seen.force[part],
            velocity=seen.velocity[part],
        )
        first = (start // refit + 1) * refit
        stops = [k - start for k in range(first, part.stop + 1, refit)]
        estimator.follow(samples, stops)
    return n / (time.process_time() - began)


def live_share(*words: str, seconds: float = 30.0) -> float:
    """Processor share of a headless live session at real time; words for the emulator."""
    port = free_port()
    flying = subprocess.Popen(
        [
            *(sys.executable, "-m", "sim_bridge", *FLIGHT, *words),
            *("--connect", f"udpout:127.0.0.1:{port}", "--duration", str(2 * seconds)),
        ],
    )
    try:
        live = ["gcs_sysid", "live", f"udpin:127.0.0.1:{port}", "--airframe", "paper"]
        live += ["--headless", "--no-record", "--json", os.devnull]
        start_up = cost_of(*live, "--duration", "0.5")
        return (cost_of(*live, "--duration", str(seconds + 0.5)) - start_up) / seconds
    finally:
        flying.terminate()
        flying.wait()


def health_share(folder: Path, seconds: float = 160.0) -> float:
    """Processor share of the live look at the hover, once its memory is full."""
    log = folder / "hover.tlog"
    hover = [*FLIGHT[:2], "--mission", "hover", *FLIGHT[4:], "--duration", str(seconds)]
    cost_of("sim_bridge", *hover, "--speed", "max", "--tlog", str(log))
    intake = Intake()
    records = in_sequence(intake.frames(frame for _, frame in TlogReader(log)))
    watch, airframe = HoverWatch(intake, "link"), load_airframe("paper")
    size = max(round(0.02 * len(records) / seconds), 1)
    blocks = [block_of(records[i : i + size]) for i in range(0, len(records), size)]
    begin = len(blocks) * 2 // 3
    began = 0.0
    for i, block in enumerate(blocks):
        if i == begin:
            began = time.process_time()
        watch.add_records(block)
        watch.look(airframe)
    return (time.process_time() - began) / (seconds * (1.0 - begin / len(blocks)))


def main() -> None:
    """Print the table."""
    arguments(__doc__).parse_args()
    with tempfile.TemporaryDirectory() as folder:
        speed = emulator(Path(folder))
        looking = health_share(Path(folder))
    rows = [
        ("emulator, full 250 Hz message set, to file", f"{speed:.1f} x real time", ">= 50"),
        (
            "emulator, 1000 vehicles without messages",
            f"{ensemble_speed():.0f} x real time",
            ">= 1000",
        ),
        ("live, headless, 250 Hz IMU", f"{100 * live_share():.1f} % of a core", "<= 25 %"),
        (
            "live, headless, the same on commands",
            f"{100 * live_share('--rotor-input', 'command'):.1f} % of a core",
            "<= 30 %",
        ),
        ("live look at health, 250 Hz", f"{100 * looking:.2f} % of a core", "<= 3 %"),
        *(
            (f"online step, refit at 10 Hz, {name}", f"{step_rate(block):.0f} samples/s", bar)
            for name, block, bar in (
                ("blocks of 10 s", 10 * RATE, ">= 20000"),
                ("blocks of 0.1 s", RATE // 10, ""),
                ("sample by sample", 1, ">= 3000"),
            )
        ),
    ]
    print(f"{'what':<50}{'measured':>22}{'bar':>10}")
    for what, measured, bar in rows:
        print(f"{what:<50}{measured:>22}{bar:>10}")


if __name__ == "__main__":
    main()
