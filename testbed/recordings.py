"""Recorded flights: where they are, what their users know of them, and what is true of them.

A log's truth is the .truth.json of its name, else that of its family (the CineRat's pendulum and
bench values, which are themselves good to some 10 %; its Ixx and Iyy are those of throws without
feedback, and not known of the flight with a camera). Keys come in several spellings. A log's
airframe is the .toml of its name or family, else what its truth says, else `paper`, the emulator's.
"""

import json
import os
import random
import struct
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.model.airframe import Airframe, Rotor, load_airframe
from gcs_sysid.signals.columns import RecordBlock, Track
from gcs_sysid.signals.records import Record, Stream
from gcs_sysid.telemetry import logs
from gcs_sysid.telemetry.messages import MESSAGE_IDS
from gcs_sysid.telemetry.tlog import TlogReader
from gcs_sysid.telemetry.track_collector import TrackCollector
from testbed.emulated import Truth

PROJECT = Path(__file__).resolve().parents[1]
SHARED = Path(os.environ.get("GCS_SYSID_LOGS", PROJECT.parent / "shared" / "logs"))
"""Recordings that are not part of the project; what is absent is skipped."""
KEPT = PROJECT / "build" / "accept"
"""What is made once and used again."""
SUFFIXES = (".tlog", ".ulg", ".bin")
ALL_SUFFIXES = {*SUFFIXES, ".bbl", ".bfl", ".txt", ".log", ".csv"}
OPEN_LOOP = {"Ixx": 5.8e-4, "Iyy": 7.4e-4}
"""kg m^2 of the CineRat, of throws of 0.45 s without feedback."""
THROWN_INERTIA = 6e-4
"""kg m^2 in roll and pitch, that arms of Indiflight's simulated vehicles are taken with."""
_WITH_CAMERA = "LOG00340"
_FAMILIES = {"LOG00": "cinerat", "crazyflie": "crazyflie"}
"""Logs that share an airframe file, by how their names begin."""
_SPELLINGS = {
    "ixx": "Ixx", "iyy": "Iyy", "izz": "Izz", "ixy": "Ixy", "iyz": "Iyz", "ixz": "Ixz",
    "kT": "k_T", "kT_N_per_rad2": "k_T", "kM": "k_M", "t_max": "T_max", "kdv": "linear_drag",
    "kdw": "rotational_damping", "t_tau": "motor_lag",
}  # fmt: skip
_FAST = {"HIGHRES_IMU": 5, "ESC_STATUS": 5, "ACTUATOR_OUTPUT_STATUS": 5, "SERVO_OUTPUT_RAW": 5}
_KEPT = ("HEARTBEAT", "EXTENDED_SYS_STATE", "PARAM_VALUE")
AIR_TIMES: dict[str, list[tuple[float, float]]] = {
    "LOG00230": [(9.65, 20.21)], "LOG00259": [(0.96, 6.65)], "LOG00264": [(0.93, 7.38)],
    "LOG00267": [(0.96, 24.17), (24.93, 31.12)], "LOG00269": [(0.96, 19.88), (20.58, 23.08)],
    "LOG00271": [(0.95, 7.97)], "LOG00277": [(0.95, 11.39), (12.83, 14.28)],
    "LOG00281": [(0.94, 42.79)], "LOG00340": [(2.63, 17.60)], "LOG00267_cmd": [
        (0.96, 24.17), (24.93, 31.12)], "LOG00267_cmd_floor1000": [(0.96, 24.17), (24.93, 31.12)],
}  # fmt: skip
"""s in the air, by height above the ground; of the hand throw (230), from its release on."""
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


def block_of(records: Iterable[Record]) -> RecordBlock:
    """Records that follow each other, as one block."""
    collector = TrackCollector()
    for order, record in enumerate(records):
        collector.add_record(order, record)
    return collector.block()


def in_sequence(block: RecordBlock) -> list[Record]:
    """The records of a block one by one, in the order in which they came."""
    made = [*block.parameters]
    for track in block.tracks:
        rows = zip(track.order.tolist(), track.t.tolist(), track.values.tolist(), strict=True)
        made += [
            (order, Record(track.stream, t, tuple(values), track.offset, track.source))
            for order, t, values in rows
        ]
    return [record for _, record in sorted(made, key=itemgetter(0))]


def records_of(log: logs.Log) -> list[Record]:
    """The same of a log."""
    return [record for block in log.blocks() for record in in_sequence(block)]


def columns_of(log: logs.Log) -> dict[tuple[Stream, str], tuple[Array, Array]]:
    """(n,) times and (n, width) values of each stream of a log, by stream and source.

    Where blocks have them of different widths, the narrowest counts.
    """
    parts: dict[tuple[Stream, str], list[Track]] = {}
    for block in log.blocks():
        for track in block.tracks:
            parts.setdefault((track.stream, track.source), []).append(track)
    found = {}
    for key, tracks in parts.items():
        width = min(track.values.shape[1] for track in tracks)
        values = np.concatenate([track.values[:, :width] for track in tracks])
        found[key] = np.concatenate([track.t for track in tracks]), values
    return found


def all_logs() -> Iterator[Log]:
    """Those of the project, then the shared ones."""
    for folder in (PROJECT / "logs", SHARED):
        for file in sorted(folder.rglob("*")):
            if file.suffix.lower() in ALL_SUFFIXES:
                name = f"{'shared/' if folder is SHARED else ''}{file.relative_to(folder)}"
                yield Log(file, name, given(file))


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
    if truth.exists() and json.loads(truth.read_text()).keys() & {"cg_m", "derived"}:
        return airframe_of(log).with_anchor("mass", _mass_before(log))
    airframe = load_airframe("paper")
    return airframe if airframe.anchor() else airframe.with_anchor("mass", 1.5)


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
    if thrown := table.get("derived"):  # accelerations: arms over inertia
        each = THROWN_INERTIA / thrown["k_T_N_per_rad2_s2"]
        roll, pitch, yaw = (thrown[f"{axis}_acc_per_omega2"] for axis in ("roll", "pitch", "yaw"))
        turns = zip(roll, pitch, yaw, strict=True)
        rotors = [Rotor(p * each, -r * each, 1 if y > 0.0 else -1) for r, p, y in turns]
        return Airframe("thrown", tuple(rotors))
    return load_airframe("px4-sih").with_arm(table["l_roll"] * 2.0**0.5)


def rectangle(name: str, x: float, y: float) -> Airframe:
    """A quad X of these levers."""
    airframe = load_airframe(name)
    rotors = tuple(
        Rotor(float(np.copysign(x, r.x)), float(np.copysign(y, r.y)), r.spin)
        for r in airframe.rotors
    )
    return replace(airframe, rotors=rotors)


def _mass_before(log: Path) -> float:
    """At the start of a recording."""
    table = json.loads(log.with_suffix(".truth.json").read_text(encoding="utf-8"))
    if "derived" in table:
        return float(table["derived"]["mass_kg"])
    return float(table["mass"] if "mass" in table else table["flights"][0]["mass"])


def truth_file(log: Path) -> Path | None:
    """Where a log's truth is; None: nowhere."""
    own = log.with_suffix(".truth.json")
    if own.exists():
        return own
    for begin, name in _FAMILIES.items():
        shared = log.with_name(f"{name}.truth.json")
        if log.name.startswith(begin) and shared.exists():
            return shared
    return None


def truth_of(log: Path) -> Truth:
    """True parameters of a log with a `truth_file`, by the names of a result."""
    path = truth_file(log)
    assert path is not None
    truth = _read(path)
    if path.name == f"{_FAMILIES['LOG00']}.truth.json":
        known = {} if log.name.startswith(_WITH_CAMERA) else OPEN_LOOP
        truth = {name: v for name, v in truth.items() if name not in OPEN_LOOP} | known
    return truth


def is_changed_in_flight(log: Path) -> bool:
    """Whether the vehicle of a log with a `truth_file` changes."""
    path = truth_file(log)
    assert path is not None
    table = json.loads(path.read_text(encoding="utf-8"))
    return "payload" in table or any("mass_after" in event for event in table.get("events", []))


def _read(path: Path) -> Truth:
    """As `truth_of`, of its file."""
    table: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    truth: Truth = {}
    for key, value in table.items():
        name = _SPELLINGS.get(key, key)
        if _is_number(value) or (isinstance(value, list) and all(map(_is_number, value))):
            truth[name] = value
    if "cg_m" in table:
        truth["cg_x"], truth["cg_y"] = table["cg_m"][:2]
    if "q_max" in table:
        truth["moment_ratio"] = table["q_max"] / table["t_max"]
    if "kdw" in table:
        truth["thrust_curve"] = 0.0
    elif "k_T" in truth and "k_M" in truth and "moment_ratio" not in truth:
        truth["moment_ratio"] = truth["k_M"] / truth["k_T"]
    if "kT" in table:
        # ArduPilot's simulator has drag and damping of its own kind.
        truth = {n: v for n, v in truth.items() if "drag" not in n and "damping" not in n}
    if "mass_after" in table:
        truth["mass"] = table["mass_after"]  # a result is of the vehicle as it was last
    elif "flights" in table:
        truth["mass"] = table["flights"][-1]["mass"]
    return truth


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def cases(folder: Path) -> dict[str, list[Path]]:
    """Logs with a truth by the name of the folder they lie in."""
    found: dict[str, list[Path]] = {}
    for log in logs_in([folder]):
        if truth_file(log) is not None:
            place = log.parent.name if log.parent != folder else "autopilots' simulators"
            found.setdefault(place, []).append(log)
    return found


def thinned(log: Path, to: Path, seed: int, drop: float = 0.05) -> Path:
    """A .tlog with a fifth of the fast messages, at a phase by the seed, and some of all lost."""
    rng, seen = random.Random(seed), Counter[int]()
    every = {MESSAGE_IDS[name]: k for name, k in _FAST.items()}
    kept = {MESSAGE_IDS[name] for name in _KEPT}
    with open(to, "wb") as file:
        for time_us, frame in TlogReader(log):
            seen[frame.message_id] += 1
            step = every.get(frame.message_id, 1)
            if seen[frame.message_id] % step != seed % step:
                continue
            if frame.message_id in kept or rng.random() >= drop:
                file.write(struct.pack(">Q", time_us) + frame.raw)
    return to


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
        arm, mass = table["l_roll"] * 2.0**0.5, _mass_before(file)
        return ("--airframe", "px4-sih", "--arm", f"{arm:.17g}", "--mass", f"{mass:.17g}")
    if table.keys() & {"rotor_pos_rel_cg_m", "derived"}:
        written = _airframe_file(file, airframe_of(file))
        return ("--airframe", written, "--mass", f"{_mass_before(file):.17g}")
    return ()


def _airframe_file(log: Path, airframe: Airframe) -> str:
    """Written for a log of a simulator whose layout is no known one."""
    text = f'name = "{log.stem}"\n'
    for rotor in airframe.rotors:
        spin = "ccw" if rotor.spin > 0 else "cw"
        text += f'[[rotor]]\nx = {rotor.x:.17g}\ny = {rotor.y:.17g}\nspin = "{spin}"\n'
    file = KEPT / f"{log.stem}.toml"
    KEPT.mkdir(parents=True, exist_ok=True)
    if not file.exists() or file.read_text() != text:
        file.write_text(text)
    return str(file)
