"""Health of recorded flights: known parameters, repeatability, every log of a folder.

    python -m benchmarks.health_logs FOLDER [--part thinned|repeated|between|every]

`thinned`: recordings with known parameters at 25 Hz of IMU and 10 Hz of rotors. `repeated`: one
real flight in three parts. `between`: flights of one vehicle, chi-square per degree of freedom of
what each shows, by the flights' own intervals. `every`: all logs below the folder without an
airframe file or an arm (tables with `--csv`), the findings of each or why it has none, and rotors
called weak in a flight; none has a known fault.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from gcs_sysid.errors import InputError
from gcs_sysid.files import TABLE_SUFFIXES, with_mapping
from gcs_sysid.health.airframe_guess import GuessedAirframe
from gcs_sysid.health.assessment import ReadLog, health_of
from gcs_sysid.health.autopilot_parameters import determined
from gcs_sysid.health.health_trend import series_of
from gcs_sysid.health.hover_tuning import TUNING
from gcs_sysid.health.vehicle_health import Health, HealthOptions
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.telemetry.log_formats import LOG_SUFFIXES
from testbed.hover_flights import between_flights, hover_of, streams_in
from testbed.recordings import rectangle
from testbed.study import arguments

_FLEETS = (
    ("Quiver 107 to 116", "quiver/000001[01]?.BIN", 0.67, 20.15),
    ("Quiver 120 to 128", "quiver/0000012?.BIN", 0.67, 20.15),
    ("Quiver 107 to 128", "quiver/000001*.BIN", 0.67, 20.15),
    ("greenreaper", "greenreaper/*.BFL", 0.11, 0.5),
)
"""Name, files, arm in m and mass in kg of vehicles that flew several times with the same load."""
_THRUST = ("MOT_THST_EXPO", "MOT_THST_HOVER")


def thinned_logs(folder: Path) -> Iterator[str]:
    """Recordings with known parameters, thinned to 25 and 10 Hz."""
    px4, other = rectangle("px4-quad-x", 0.17, 0.17), rectangle("ardupilot-quad-x", 0.16, 0.18)
    stock = rectangle("px4-quad-x", 0.2, 0.2)
    k_T, T_max = 1.2617414e-5, 11.2076
    known = (
        ("px4-esc-cg.tlog", px4, 1.1, (12.0, -8.0), 4.672497e-6, 6.2, 0.0),
        ("ardupilot-sitl.tlog", other, 1.6, (10.0, -6.0), k_T, T_max, 1.0),
        ("ardupilot-sitl.bin", other, 1.6, (10.0, -6.0), k_T, T_max, 1.0),
        ("px4-sih-default.tlog", stock, 1.0, (0.0, 0.0), None, 5.0, 0.0),
        ("px4-sih-default.ulg", stock, 1.0, (0.0, 0.0), None, 5.0, 0.0),
    )
    yield "| log, thinned | rotors by | CG off, mm | k_T or T_max off, % | thrust curve off |"
    yield "|---|---|---|---|---|"
    for name, airframe, mass, cg, k_T, T_max, curve in known:
        for speeds in (True, False) if k_T else (False,):
            streams = streams_in(folder / name, airframe, speeds=speeds, thin=True)
            given = airframe.with_anchor("mass", mass)
            guess = GuessedAirframe(given, "known")
            told = health_of(streams, guess, HealthOptions(given), {})
            assert told.cg is not None
            assert told.scale is not None
            off = [1e3 * (q.value or 0.0) - v for q, v in zip(told.cg, cg, strict=True)]
            truth = k_T if speeds else T_max
            scale = 100.0 * ((told.scale[1].value or 0.0) / truth - 1.0)
            c = "-" if told.curve is None else f"{(told.curve.c.value or 0.0) - curve:+.3f}"
            kind = "speeds" if speeds else "commands"
            yield f"| {name} | {kind} | {off[0]:+.2f}, {off[1]:+.2f} | {scale:+.2f} | {c} |"


def repeated(folder: Path) -> Iterator[str]:
    """One real log in three parts: how far they agree, as flown and in the whole flight's wind."""
    log, arm, mass = folder / "real" / "quiver_00000087.bin", 0.75, 18.0
    if not log.exists():
        return
    airframe = load_airframe("ardupilot-quad-x").with_arm(arm).with_anchor("mass", mass)
    yield (
        f"| {log.name} | CG forward, mm | right, mm | forward, in one wind | right, in one wind "
        "| thrust shares, % | k_T, 1e-6 N s^2 |"
    )
    yield "|---|---|---|---|---|---|---|"
    t = hover_of(log, airframe, speeds=True).t
    ends = [t[0], *(t[len(t) * i // 3] for i in (1, 2)), t[-1] + 1.0]
    spans = [(0.0, np.inf), *((a, b - 1e-3) for a, b in pairwise(ends))]
    told = [ReadLog(log).health(HealthOptions(airframe), span) for span in spans]
    labels = ("all", "first", "second", "third")
    one_wind = [series.values for series in series_of(told[1:])[:2]]
    for i, (label, health) in enumerate(zip(labels, told, strict=True)):
        assert health.cg is not None
        assert health.scale is not None
        x, y = (1e3 * (place.value or 0.0) for place in health.cg)
        same = [""] * 2 if i == 0 else [f"{values[i - 1]:.1f}" for values in one_wind]
        shares = ", ".join(f"{100.0 * (r.thrust_share.value or 0.0):.1f}" for r in health.rotors)
        scale = 1e6 * (health.scale[1].value or 0.0)
        yield f"| {label} | {x:.1f} | {y:.1f} | {same[0]} | {same[1]} | {shares} | {scale:.1f} |"


def between(folder: Path) -> Iterator[str]:
    """Whether flights of one vehicle agree within their intervals, and no better than by chance."""
    yield "| flights | number | n | spread, std | interval's, std | chi-square per degree |"
    yield "|---|---|---|---|---|---|"
    for name, pattern, arm, mass in _FLEETS:
        given = HealthOptions(None, arm, mass)
        told = [ReadLog(log).health(given) for log in sorted(folder.rglob(pattern))]
        flights = [health for health in told if health.available]
        for number, pairs in _numbers(flights).items():
            value, std = np.array(pairs).T
            if len(value) < 3:
                continue
            yield (
                f"| {name} | {number} | {len(value)} | {value.std(ddof=1):.3g} "
                f"| {np.sqrt(np.mean(std**2)):.3g} | {between_flights(pairs):.2f} |"
            )


def _numbers(flights: Sequence[Health]) -> dict[str, list[tuple[float, float]]]:
    """Name -> of each flight that has it value and standard deviation without what is given."""
    out: dict[str, list[tuple[float, float]]] = {}
    for health in flights:
        cg = health.cg or (None, None)
        named = {
            "k_T or T_max": None if health.scale is None else health.scale[1],
            "thrust to weight": health.thrust_to_weight,
            "hover throttle": health.hover_throttle,
            "yaw imbalance": health.yaw_imbalance,
            "CG forward": cg[0],
            "CG right": cg[1],
            **{f"share of rotor {i}": r.thrust_share for i, r in enumerate(health.rotors, 1)},
            **{one.name: one.quantity for one in determined([health]) if one.name in _THRUST},
        }
        for name, q in named.items():
            if q is not None and q.value is not None and q.std:
                own = float(np.sqrt(max(q.std**2 - q.std_given**2, 0.0)))
                out.setdefault(name, []).append((q.value, own))
    return out


def every(folder: Path, mapping: Path | None = None) -> Iterator[str]:
    """All logs, as one has them; tables by a mapping file, where there is one."""
    yield "| log | s of hover | rotors by | CG forward, mm | right, mm | by rotors | layout |"
    yield "|---|---|---|---|---|---|---|"
    alarms: list[str] = []
    watched = told = count = 0
    seconds = 0.0
    suffixes = LOG_SUFFIXES | (TABLE_SUFFIXES if mapping is not None else frozenset())
    for file in sorted(path for path in folder.rglob("*") if path.suffix.lower() in suffixes):
        log = file if mapping is None else with_mapping(file, mapping)
        name = file.relative_to(folder)
        count += 1
        try:
            health = ReadLog(log).health(HealthOptions())
        except InputError as error:
            yield f"| {name} | | | | | | {error} |"
            continue
        if not health.available:
            yield f"| {name} | | | | | | {'; '.join(health.reasons)} |"
            continue
        told += 1
        watched += health.watched
        seconds += health.seconds
        if health.weakened is not None:
            alarms.append(f"{name}: rotor {(health.weakened.condition.rotor or 0) + 1}")
        assert health.cg is not None
        x, y = (f"{1e3 * (q.value or 0.0):+.1f} ± {1e3 * (q.half or 0.0):.1f}" for q in health.cg)
        layout = next(t for t in health.assumptions if t.startswith("airframe: "))[10:]
        share = "-" if health.explained is None else f"{100.0 * health.explained:.0f} %"
        row = f"| {name} | {health.seconds:.0f} | {health.rotor_input} | {x} | {y} | {share} "
        yield f"{row}| {layout} |"
    # Stretches overlap by half.
    hours = 0.5 * watched * TUNING.judged_by / 3600.0
    yield ""
    yield (
        f"{told} of {count} logs told, {seconds / 3600.0:.2f} h of hover; in {hours:.2f} h held "
        f"against the flights' own begin {len(alarms)} rotors called weak {', '.join(alarms)}"
    )


PARTS: dict[str, Callable[[Path], Iterator[str]]] = {
    "thinned": thinned_logs,
    "repeated": repeated,
    "between": between,
    "every": every,
}


def main() -> None:
    """Print the parts."""
    parser = arguments(__doc__)
    parser.add_argument("folder", type=Path, help="of recordings")
    parser.add_argument("--csv", type=Path, metavar="MAPPING", help="mapping file of tables")
    parser.add_argument("--part", choices=PARTS, action="append", help="default: all")
    options = parser.parse_args()
    for name in options.part or PARTS:
        lines = (
            every(options.folder, options.csv) if name == "every" else PARTS[name](options.folder)
        )
        for line in lines:
            print(line, flush=True)
        print()


if __name__ == "__main__":
    main()
