"""Proposals of `params` for emulated vehicles: intervals that hold, and what is set wrongly.

    python -m benchmarks.params [--vehicles N] [--first N] [--flights FOLDER]

Vehicles of `benchmarks.health` fly as there, in logs with speeds and in logs without. Their
autopilots have parameters drawn about the truth, some right and some wrong, and their loads differ
from flight to flight by what the intervals assume. Counted are intervals that hold the truth, and
values set that are farther from it than the old ones.
"""

import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.health import misplaced
from gcs_sysid.health.airframe_guess import GuessedAirframe
from gcs_sysid.health.assessment import health_of
from gcs_sysid.health.autopilot_parameters import Proposal, determined
from gcs_sysid.health.hover_tuning import TUNING
from gcs_sysid.health.vehicle_health import HealthOptions
from gcs_sysid.model.airframe import USUAL, CommandRange
from gcs_sysid.model.rotor_input import RotorInput
from sim_bridge.sensor_faults import SensorFaults
from sim_bridge.simulated_vehicle import Vehicle
from testbed.hover_flights import LAYOUTS, ORDINARY, fly, pressure_in, streams_in, uneven
from testbed.study import arguments, markdown
from testbed.vehicles import draw

FLIGHTS, PASCALS = 2, 11.45
"""Of each vehicle, of which there is one proposal; of a meter, where the emulator flies."""


def truths(vehicle: Vehicle, full: float, proposals: tuple[Proposal, ...]) -> dict[str, float]:
    """True values: a hover's throttle is that by the curve that the autopilot has afterwards."""
    weight = vehicle.mass * 9.80665 / (len(vehicle.rotors) * vehicle.T_max)
    c = vehicle.thrust_curve
    command = RotorInput.COMMAND
    u = command.at_load(np.array(weight), np.array(c))
    curve = next(one for one in proposals if one.name in ("THR_MDL_FAC", "MOT_THST_EXPO"))
    after = c if curve.verdict == "set" else curve.now or 0.0
    found = {"THR_MDL_FAC": c, "MOT_THST_EXPO": c}
    hover = float(command.load(u, np.array(after)))
    found |= dict.fromkeys(("MPC_THR_HOVER", "MOT_THST_HOVER"), hover)
    found["EKF2_MCOEF"] = float(vehicle.linear_drag / vehicle.mass)
    slope, by = (1.0 - each + 2.0 * each * u for each in (c, after))
    found |= {"BARO1_THST_SCALE": full * slope / by, "SENS_BARO_K_T": full * slope / by / PASCALS}
    for i, rotor in enumerate(vehicle.rotors):
        found[f"CA_ROTOR{i}_PX"] = rotor.x - vehicle.cg_x
        found[f"CA_ROTOR{i}_PY"] = rotor.y - vehicle.cg_y
    return found


def of_vehicle(
    number: int, folder: Path, autopilot: str, *, speeds: bool
) -> tuple[tuple[Proposal, ...], dict[str, float]]:
    """What its flights propose, and the truth."""
    drawn = draw(number, LAYOUTS)
    random = np.random.default_rng([number, 0x4EA1])
    traits = uneven(drawn, random, USUAL.rotor_thrust.of(1.0))
    airframe = misplaced(drawn.airframe, random)
    airframe = replace(airframe, command=CommandRange(given=True))
    c, moved = float(drawn.vehicle.thrust_curve), random.standard_normal(2)
    now = dict.fromkeys(("THR_MDL_FAC", "MOT_THST_EXPO"), c)
    if random.random() < 0.7:
        now = {name: float(np.clip(c + 0.3 * moved[0], 0.0, 1.0)) for name in now}
    now |= dict.fromkeys(("MPC_THR_HOVER", "MOT_THST_HOVER"), 0.4 + 0.1 * moved[1])
    now |= {"EKF2_MCOEF": 0.15, "EKF2_BCOEF_X": 100.0, "EKF2_BCOEF_Y": 100.0}
    now |= dict.fromkeys(("BARO1_THST_SCALE", "SENS_BARO_K_T"), 0.0)
    for i, rotor in enumerate(drawn.vehicle.rotors):
        now |= {f"CA_ROTOR{i}_PX": rotor.x, f"CA_ROTOR{i}_PY": rotor.y}
    flights, full = [], float(150.0 * np.random.default_rng(number).standard_normal())
    for k in range(FLIGHTS):
        log = folder / f"{number}_{k}.tlog"
        load = 1.0 + TUNING.common_command * random.standard_normal()
        if not log.exists():
            flown = replace(drawn, vehicle=replace(drawn.vehicle, mass=drawn.vehicle.mass * load))
            faults = SensorFaults(thrust_pressure=full)
            fly(log, flown, ORDINARY, FLIGHTS * number + k, traits, sensor_faults=faults)
        pressure = {"pressure": pressure_in(log)}
        streams = replace(streams_in(log, airframe, speeds=speeds), extras=pressure)
        guess = GuessedAirframe(airframe, "given")
        health = health_of(streams, guess, HealthOptions(airframe), now)
        flights.append(replace(health, source=log.name, autopilot=autopilot, parameters=now))
    found = determined(flights)
    return found, truths(drawn.vehicle, full, found) if found else {}


def rows(numbers: range, folder: Path) -> Iterator[str]:
    """The table."""
    yield from markdown(" | intervals hold | set | of these farther from the truth | leave "
                        "| cannot tell")  # fmt: skip
    for autopilot in ("px4", "ardupilot"):
        for speeds in (True, False):
            counts: dict[str, Counter[str]] = {}
            for number in numbers:
                found, truth = of_vehicle(number, folder, autopilot, speeds=speeds)
                for one in found:
                    name = "CA_ROTORn_P" if one.name.startswith("CA_ROTOR") else one.name
                    _count(counts.setdefault(name, Counter()), one, truth.get(one.name))
            yield f"| **{autopilot}, {'speeds' if speeds else 'commands'}** | | | | | |"
            for name, kind in counts.items():
                if kind["all"]:
                    yield (
                        f"| {name} | {kind['held']} of {kind['known']} | {kind['set']} "
                        f"| {kind['farther']} | {kind['leave']} | {kind['cannot tell']} |"
                    )


def _count(kind: "Counter[str]", one: Proposal, truth: float | None) -> None:
    kind["all"] += 1
    kind[one.verdict] += 1
    if one.quantity is None or one.quantity.value is None or truth is None:
        return
    kind["known"] += 1
    kind["held"] += abs(one.quantity.value - truth) <= (one.quantity.half or 0.0)
    if one.verdict == "set" and one.now is not None:
        assert one.new is not None
        kind["farther"] += abs(one.new - truth) > abs(one.now - truth)


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--vehicles", type=int, default=40, help="drawn")
    parser.add_argument("--first", type=int, default=0, help="number of the first of them")
    parser.add_argument("--flights", type=Path, help="folder that keeps the flights for next time")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = options.flights or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        numbers = range(options.first, options.first + options.vehicles)
        print(*rows(numbers, folder), sep="\n", flush=True)


if __name__ == "__main__":
    main()
