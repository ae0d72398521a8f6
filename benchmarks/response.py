"""Measured frequency responses of emulated vehicles: bands, phase margins, objections.

    python -m benchmarks.response --vehicles 4
    python -m benchmarks.response --vehicles 30 --keep build/response.jsonl   # goes on

A vehicle of 0.25 to 15 kg flies PX4's or ArduPilot's loops with gains for it while a pilot steps
attitude and heading at random, in calm air without a position loop, and in gusts with one. The
response of each axis, of torques, gyro and set-points of a minute, is compared with the true
vehicle's linear one where it is claimed; the phase margin by it with that of a multisine injected
in calm air. Objections are raised against the true model, each parameter known to 1 %, one with a
third more inertia, and the true one without the gyro's low-pass.
"""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.tune import (
    ATTITUDE_ONLY,
    CONTROL_STEPS,
    DELAY,
    LAYOUTS,
    SETTLE,
    STEP_US,
    flown,
    loop_of,
    measured_loop,
)
from gcs_sysid.control.frequency_response import (
    FlownSignals,
    measured_axes,
    measured_margins,
    smooth_ratio,
)
from gcs_sysid.control.loop_margins import HoverDynamics, hover_dynamics
from gcs_sysid.control.rate_loops import AUTOPILOTS, RateLoop
from gcs_sysid.control.tuning_study import LIMITS, late_objections, propose
from gcs_sysid.exports.exported_vehicle import ExportedVehicle, KnownEstimate, drawn_vehicles
from gcs_sysid.judgement.prediction import parted
from gcs_sysid.model.parameters import AXES
from gcs_sysid.results.result import Result
from sim_bridge.missions import HEIGHT, Reference
from sim_bridge.rate_controllers import LOOP_RATE
from sim_bridge.simulated_vehicle import Vehicle
from testbed.study import arguments, gone_on_with
from testbed.vehicles import Drawn, draw

SECONDS, GUSTS, GYRO_NOISE = 62.0, 0.1, 0.005
"""s; rad/s rms; rad/s."""


class Pilot:
    """Attitude steps at random, 0.8 s apart on average, on each axis by itself.

    Args:
        seed: of the steps.
        sizes: rad, of roll, pitch and heading at most. Heading steps of 0.2 saturate rotors: the
            response at that size is not the linear one.
    """

    name, duration, turbulence = "pilot", SECONDS, 0.0
    _SLOT = 0.05

    def __init__(self, seed: int, sizes: tuple[float, float, float] = (0.12, 0.12, 0.06)) -> None:
        random = np.random.default_rng([seed, 0x50])
        slots = round(2.0 * SECONDS / self._SLOT)
        steps = random.random((slots, 3)) < self._SLOT / 0.8
        last = np.maximum.accumulate(np.where(steps, np.arange(slots)[:, None], 0), axis=0)
        self._angles = np.take_along_axis(random.uniform(-1.0, 1.0, (slots, 3)) * sizes, last, 0)

    def reference(self, t: float) -> Reference:
        """Over the starting point, turned as the pilot asks."""
        zero = (0.0, 0.0, 0.0)
        x, y, z = 0.5 * self._angles[int(t / self._SLOT)]
        tilt = np.array([1.0, x, y, 0.0]) / math.sqrt(1.0 + x * x + y * y)
        heading = (math.cos(z), 0.0, 0.0, math.sin(z))
        return Reference(
            (0.0, 0.0, -HEIGHT), zero, zero, heading, tuple(tilt.tolist()), zero, zero, zero
        )


def true_vehicle(vehicle: Vehicle, inertia: float = 1.0) -> ExportedVehicle:
    """An emulated vehicle as if identified, each parameter to 1 %; inertia by a factor."""
    names = (
        "mass", "Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Ixz", "cg_x", "cg_y", "k_T", "T_max",
        "motor_lag", "rotational_damping", "rotor_inertia", "thrust_curve", "moment_ratio",
    )  # fmt: skip
    values = {n: getattr(vehicle, n) * (inertia if n.startswith("I") else 1.0) for n in names}
    known = {
        n: KnownEstimate(v, 0.01 * abs(v) or None, origin="identified") for n, v in values.items()
    }
    result = Result("identified", (), "", {}, None, "command", {})
    return ExportedVehicle("true", vehicle.rotors, known, result)


def flown_by_pilot(
    drawn: Drawn, loop: RateLoop, gusts: float, seed: int, mission=None, *more
) -> FlownSignals:
    """What a log would hold of the flight, of a pilot or another; with gusts position is held."""
    more = more if gusts else (ATTITUDE_ONLY,)
    sim = flown(drawn, loop, mission or Pilot(seed), gusts, *more)
    rows = []
    for _ in range(round(SECONDS / (1e-6 * STEP_US))):
        sim.step()
        if sim.tick % CONTROL_STEPS == 0 and sim.time > SETTLE:
            own = sim._controller
            gyro = sim.state.rates if loop.logs_raw_gyro else own._gyro
            rows.append((*own.sent, *gyro, *own.targets))
    signals = np.array(rows)
    signals[:, 3:6] += GYRO_NOISE * np.random.default_rng(seed).standard_normal((len(rows), 3))
    return FlownSignals((signals,), 1.0 / LOOP_RATE, 2.0 * np.pi * 25.0)


def outcome(
    flight: FlownSignals, dynamics: list[HoverDynamics], loop: RateLoop, sweeps: list[float]
) -> dict:
    """Compare a flight with the truth.

    Args:
        flight: signals.
        dynamics: true, and wrong.
        loop: that flew.
        sweeps: deg, phase margin of each axis by an injected multisine.

    Returns:
        Magnitudes and phases claimed, and those whose band holds the truth; phase margins measured,
        half their interval, and the sweep's, deg; objections to either.
    """
    claimed = inside = 0
    margins = []
    for name, one in measured_axes(flight, dynamics[0], loop).items():
        found, axis = one.torque, AXES.index(name)
        ratio = (found.values / one.model[0])[found.claimed]
        half = found.half_width[found.claimed]
        right = (np.abs(1.0 / np.abs(ratio) - 1.0) <= half, np.abs(np.angle(ratio)) <= np.arcsin(
            np.minimum(half, 1.0)))  # fmt: skip
        claimed, inside = claimed + 2 * len(half), inside + int(np.sum(right))
        by = measured_margins(one, dynamics[0], loop, axis)
        if by is not None:
            low, high = np.percentile(by.phase[np.isfinite(by.phase)], (2.5, 97.5))
            margins.append((float(by.phase[0]), float(0.5 * (high - low)), sweeps[axis]))
    objected = []
    cases = [*((each, loop) for each in dynamics), (dynamics[0], replace(loop, gyro_cutoff=0.0))]
    for each, given in cases:
        measured = measured_axes(flight, each, given)
        smooth = {name: smooth_ratio(one.torque, one.model) for name, one in measured.items()}
        departures = {name: one.departure() for name, one in smooth.items() if one is not None}
        late = late_objections(each, given, measured)
        objected.append(any((*late, *parted(departures, LIMITS.unmodeled))))
    return {"claimed": claimed, "inside": inside, "margins": margins, "objections": objected}


def one_vehicle(seed: int) -> dict:
    """A vehicle with PX4 or ArduPilot, calm and in gusts, as an entry of the file."""
    drawn, autopilot = draw(seed, LAYOUTS), AUTOPILOTS[seed % 2]
    true, wrong = (true_vehicle(drawn.vehicle, factor) for factor in (1.0, 4.0 / 3.0))
    loop = loop_of(autopilot, true, drawn)
    both = [
        hover_dynamics([v, *drawn_vehicles(v, 50, 1)], loop, (DELAY, 0.001)) for v in (true, wrong)
    ]
    loop = replace(propose(both[0].first(1), loop), assumed=())
    sweeps = [float(measured_loop(drawn, loop, axis, 10.0).phase[0]) for axis in range(3)]
    flights = {
        name: outcome(flown_by_pilot(drawn, loop, gusts, seed), both, loop, sweeps)
        for name, gusts in (("calm", 0.0), ("gusts", GUSTS))
    }
    return {"vehicle": seed, "layout": drawn.layout, "autopilot": autopilot, **flights}


def main() -> None:
    """Print a line a flight, then the summary."""
    parser = arguments(__doc__)
    parser.add_argument("--vehicles", type=int, default=4)
    parser.add_argument("--keep", type=Path, help="file of what is done, to go on from")
    options = parser.parse_args()
    done = gone_on_with(options.keep, "vehicle", range(options.vehicles), one_vehicle)
    for kind in ("calm", "gusts"):
        flights = [entry[kind] for entry in done]
        claimed, inside = (sum(f[name] for f in flights) for name in ("claimed", "inside"))
        margins = np.array([m for f in flights for m in f["margins"]]).reshape(-1, 3)
        off = np.abs(margins[:, 0] - margins[:, 2])
        right, wrong, without = np.array([f["objections"] for f in flights]).sum(axis=0)
        print(
            f"{kind}: {len(flights)} vehicles, truth inside the 95 % band in {inside} of {claimed} "
            f"({100.0 * inside / max(claimed, 1):.1f} %)\n  phase margin on {len(margins)} of "
            f"{3 * len(flights)} axes, within 3 deg of the sweep's on {(off <= 3.0).sum()}, "
            f"{off.max(initial=0.0):.1f} deg off at most\n  objections: {right} to the true model, "
            f"{wrong} to one with a third more inertia, {without} to one without a low-pass"
        )


if __name__ == "__main__":
    main()
