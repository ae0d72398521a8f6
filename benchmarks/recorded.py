"""Recorded flights of real autopilots against their true parameters.

    python -m benchmarks.recorded FOLDER

prints, for every log in FOLDER that has a .truth.json of the same name, each parameter's error,
the half width of its interval, and whether that holds the truth.
"""

import argparse
import json
import random
import struct
import sys
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path

from gcs_sysid.intervals import Z95
from gcs_sysid.model.airframe import Airframe, Rotor, load_airframe
from gcs_sysid.model.parameters import REGISTRY
from gcs_sysid.results.result import Result
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.telemetry.messages import MESSAGE_IDS
from gcs_sysid.telemetry.tlog import read_tlog

SUFFIXES = (".tlog", ".ulg", ".bin")
NAMES = tuple(name for name, parameter in REGISTRY.items() if parameter.of_vehicle)
_FAMILIES = {"LOG00": "cinerat", "crazyflie": "crazyflie"}
"""Logs that share an airframe file, by how their names begin."""
_FAST = {"HIGHRES_IMU": 5, "ESC_STATUS": 5, "ACTUATOR_OUTPUT_STATUS": 5, "SERVO_OUTPUT_RAW": 5}
_KEPT = ("HEARTBEAT", "EXTENDED_SYS_STATE", "PARAM_VALUE")


def logs_in(paths: list[Path]) -> list[Path]:
    """The logs themselves, sorted; folders are looked through with all below them."""
    found = [
        log
        for path in paths
        for log in ([path] if path.is_file() else path.rglob("*"))
        if log.suffix in SUFFIXES
    ]
    return sorted(found)


def airframe_for(log: Path) -> Airframe:
    """The airframe that a log is analyzed with."""
    shared = [name for begin, name in _FAMILIES.items() if log.name.startswith(begin)]
    if shared and "_cmd" in log.stem:
        shared = [f"{shared[0]}_cmd"]
    for name in (log.stem, *shared):
        if (file := log.with_name(f"{name}.toml")).exists():
            return load_airframe(str(file))
    truth = log.with_suffix(".truth.json")
    if truth.exists() and "cg_m" in json.loads(truth.read_text()):
        return airframe_of(log).with_anchor("mass", truth_of(log)["mass"])
    airframe = load_airframe("paper")
    return airframe if airframe.anchor() else airframe.with_anchor("mass", 1.5)


def truth_of(log: Path) -> dict[str, float]:
    """True parameters of a recorded flight, by the names of a result."""
    table = json.loads(log.with_suffix(".truth.json").read_text())
    truth = {name.replace("i", "I", 1): table[name] for name in table if len(name) == 3}
    truth |= {"mass": table["mass"], "cg_x": table["cg_m"][0], "cg_y": table["cg_m"][1]}
    if "kT_N_per_rad2" in table:
        truth["k_T"] = table["kT_N_per_rad2"]
    if "kdw" in table:
        truth |= {
            "rotational_damping": table["kdw"],
            "linear_drag": table["kdv"],
            "T_max": table["t_max"],
            "moment_ratio": table["q_max"] / table["t_max"],
            "motor_lag": table["t_tau"],
            "thrust_curve": 0.0,
        }
    return truth


def airframe_of(log: Path) -> Airframe:
    """Where its rotors were: the .toml beside it, or by its truth."""
    if (file := log.with_suffix(".toml")).exists():
        return load_airframe(str(file))
    table = json.loads(log.with_suffix(".truth.json").read_text())
    if "rotor_pos_rel_cg_m" in table:
        airframe = load_airframe("ardupilot-quad-x")
        places, cg = table["rotor_pos_rel_cg_m"], table["cg_m"]
        rotors = [
            Rotor(places[str(i)][0] + cg[0], places[str(i)][1] + cg[1], rotor.spin)
            for i, rotor in enumerate(airframe.rotors, 1)
        ]
        return replace(airframe, rotors=tuple(rotors))
    return load_airframe("px4-sih").with_arm(table["l_roll"] * 2.0**0.5)


def thinned(log: Path, to: Path, seed: int, drop: float = 0.05) -> Path:
    """A .tlog with a fifth of the fast messages, at a phase by the seed, and some of all lost."""
    rng, seen = random.Random(seed), Counter[int]()
    every = {MESSAGE_IDS[name]: k for name, k in _FAST.items()}
    kept = {MESSAGE_IDS[name] for name in _KEPT}
    with open(to, "wb") as file:
        for time_us, frame in read_tlog(log):
            seen[frame.message_id] += 1
            step = every.get(frame.message_id, 1)
            if seen[frame.message_id] % step != seed % step:
                continue
            if frame.message_id in kept or rng.random() >= drop:
                file.write(struct.pack(">Q", time_us) + frame.raw)
    return to


def table(result: Result, truth: dict[str, float]) -> list[str]:
    """A line a parameter."""
    values = {**result.parameters, **result.timing}
    lines = [f"  {'parameter':<20}{'error':>12}{'+-95 %':>12}  holds"]
    for name in NAMES:
        found = values.get(name)
        if found is None or found.value is None or not found.std or name not in truth:
            continue
        true, half = truth[name], Z95 * found.std
        unit, scale = (" %", 100.0 / abs(true)) if true else ("", 1.0)
        error = found.value - true
        holds = "yes" if abs(error) <= half else "no"
        lines.append(
            f"  {name:<20}{scale * error:>10.3g}{unit:<2}{scale * half:>10.3g}{unit:<2}  {holds:<4}"
            f"{found.status if found.status != 'identified' else ''}"
        )
    return lines


def main() -> None:
    """Analyse a folder."""
    parser = argparse.ArgumentParser(description=__doc__, prog="python -m benchmarks.recorded")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--anchor", choices=("mass", "thrust"), default="mass")
    parser.add_argument("--thin", type=int, metavar="SEED", help="to 50 Hz, 5 %% of messages lost")
    options = parser.parse_args()
    logs = [
        log
        for log in sorted(options.folder.iterdir())
        if log.suffix in SUFFIXES and log.with_suffix(".truth.json").exists()
    ]
    if not logs:
        sys.exit(f"{options.folder}: no log with a .truth.json beside it")
    for log in logs:
        truth, airframe, flown = truth_of(log), airframe_of(log), log
        anchor = "mass" if options.anchor == "mass" else ("k_T" if "k_T" in truth else "T_max")
        with tempfile.TemporaryDirectory() as folder:
            if options.thin is not None:
                if log.suffix != ".tlog":
                    continue
                flown = thinned(log, Path(folder) / log.name, options.thin)
            result = analyze_log(flown, airframe.with_anchor(anchor, truth[anchor]))
        print(f"{log.name}: {result.verdict}, rotors by {result.rotor_input}, {anchor} given")
        print("\n".join(table(result, truth)), flush=True)


if __name__ == "__main__":
    main()
