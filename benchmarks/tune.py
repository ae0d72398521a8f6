"""Proposed gains against emulated vehicles: margins by injected sweeps, steps, first flights.

    python -m benchmarks.tune --vehicles 8
    python -m benchmarks.tune --vehicles 50 --keep build/tune.jsonl    # goes on where it stopped

A vehicle of 0.25 to 15 kg is drawn, flown and identified from its commands; `propose` makes gains
from the result alone, within its covariance. Then the emulator flies the autopilot's own rate
controller with these gains from the first second: a multisine is added to the torque of one axis
after the other and the loop transfer is read off at its tones; attitude set-points step, or those
of rates where no attitude is held. Once more with 20 % of payload and 80 % of the thrust, margins
must not be below those that the proposal is sure of. Predictions are those of the result, not of
the true vehicle. Phase in degrees, gain in dB.
"""

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gcs_sysid.api import Signals, identify
from gcs_sysid.control.loop_margins import (
    Margins,
    frequencies,
    hover_dynamics,
    margins_of,
    open_loops,
    step_response,
)
from gcs_sysid.control.rate_loops import AUTOPILOTS, Autopilot, RateLoop, read_loop
from gcs_sysid.control.tuning_study import (
    ASSUMED_DELAY,
    LIMITS,
    joined_vehicle,
    sure_margins,
    sure_proposal,
    with_delay,
)
from gcs_sysid.errors import GcsSysidError, InputError
from gcs_sysid.exports.exported_vehicle import ExportedVehicle, assemble, drawn_vehicles
from gcs_sysid.model.airframe import CommandRange
from gcs_sysid.model.parameters import AXES, GRAVITY
from sim_bridge.controller import Gains
from sim_bridge.doublets import ALL_MISSIONS
from sim_bridge.ensemble import fly_ensemble
from sim_bridge.missions import HEIGHT, Mission, Reference
from sim_bridge.rate_controllers import CONTROLLERS, LOOP_RATE
from sim_bridge.simulation import Simulation
from testbed.study import arguments, gone_on_with
from testbed.vehicles import Drawn, draw

LAYOUTS = ("quad-x", "hexa", "quad-h", "octo", "quad-plus")
DELAY_LOOPS = 2
DELAY = DELAY_LOOPS / LOOP_RATE
"""s from the gyro's sample to the rotors' command, as computing and a digital protocol take."""
STEP_US, CONTROL_STEPS = 1250, 2
SETTLE, PERIOD, TONES = 3.0, 8.0, 32
SWEEP_SHARE = 0.05
"""Largest change of a rotor's thrust command by the sweep, of full."""
ATTITUDE_ONLY = Gains(position=0.0, velocity=0.0)
"""Position is not held: its loop would act on what is measured."""
STEP_ANGLE = math.radians(3.0)


@dataclass(frozen=True)
class Steps:
    """A mission of one step of the attitude, or of the rate."""

    axis: int
    at: float
    name: str = "step"
    duration: float = 5.0
    turbulence: float = 0.0
    turning: bool = False

    def reference(self, t: float) -> Reference:
        """Level until the step, then turned about one axis, or turning."""
        at, zero, level = (0.0, 0.0, -HEIGHT), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
        x, y, z = np.eye(3)[self.axis] * (STEP_ANGLE if t >= self.at else 0.0)
        if self.turning:
            return Reference(at, zero, zero, level, level, (x, y, z), zero, zero)
        half = 0.5 * (x + y + z)
        turned = (math.cos(half), *(math.sin(0.5 * part) for part in (x, y, z)))
        tilt, heading = (turned, level) if self.axis < 2 else (level, turned)
        return Reference(at, zero, zero, heading, tilt, zero, zero, zero)


def identified(drawn: Drawn, seed: int) -> ExportedVehicle:
    """What a flight with speeds and commands tells; the commands reach the rotors late."""
    mission = ALL_MISSIONS["all-axes"]
    flight = fly_ensemble(drawn.vehicle, mission, 250.0, 60.0, seed).with_noise("mems", 0.0, [seed])
    signals = Signals(
        t=flight.t,
        gyro=flight.gyro[0],
        force=flight.specific_force[0],
        attitude=flight.quaternion[0],
        velocity=flight.velocity[0],
    )
    airframe = drawn.airframe
    speeds = identify(
        replace(signals, speeds=flight.speeds[0]), replace(airframe, rotor_input="speed")
    )
    commands = identify(
        replace(signals, commands=flight.commands[0], times={"commands": flight.t - DELAY}),
        replace(airframe, rotor_input="command", command=CommandRange(0.0, 1.0, given=True)),
    )
    return joined_vehicle(assemble(speeds), with_delay(assemble(commands)))


SLOW = {"looptime": 1e6 / LOOP_RATE, "gyro_lpf1_static_hz": 250.0, "dterm_lpf1_static_hz": 75.0}
"""At the emulator's rate, and with low-passes that do not follow the throttle."""
CURVES = ("THR_MDL_FAC", "MOT_THST_EXPO", "thrust_curve")
"""Parameters that hold the thrust curve; Betaflight and INAV invert none."""
RATE_MODE = {"p_level": 0.0, "mc_p_level": 0.0}


def loop_of(autopilot: Autopilot, ours: ExportedVehicle, drawn: Drawn) -> RateLoop:
    """The autopilot's settings before the tuning: the thrust curve as identified, else defaults."""
    curve = min(max(ours.get("thrust_curve") or 0.0, 0.0), 1.0)
    return read_loop(autopilot, {**SLOW, **dict.fromkeys(CURVES, curve)}, drawn.vehicle.rotors)


def flown(drawn: Drawn, loop: RateLoop, mission: Mission, gusts: float | None, *more: Any):
    """The emulator with the gains of a loop.

    Args:
        drawn: the vehicle.
        loop: its gains.
        mission: flown.
        gusts: rad/s rms of the body rates; in calm air rates are flown where no attitude is judged.
        more: gains of the outer loops and what is injected, of the controller.
    """
    settings = {**loop.as_parameters(), **dict.fromkeys(CURVES, loop.curve)}
    settings |= {} if gusts or loop.holds_attitude else RATE_MODE
    kind = CONTROLLERS[loop.autopilot]
    return Simulation(
        drawn.vehicle, mission, np.random.SeedSequence(1), gusts, step_us=STEP_US,
        control_steps=CONTROL_STEPS,
        controller=lambda vehicle, period: kind(vehicle, period, settings, DELAY_LOOPS, *more),
    )  # fmt: skip


def measured_loop(drawn: Drawn, loop: RateLoop, axis: int, crossover: float) -> Margins:
    """Margins of the loop transfer at the tones of a multisine on one torque.

    It begins at 1.2 rad/s, or at half of the crossover that is expected where that is lower.
    """
    grid = 2.0 * math.pi / PERIOD
    tones = np.unique(np.round(np.geomspace(min(1.2, 0.5 * crossover), 140.0, TONES) / grid)) * grid
    # Schroeder's phases keep the peak low.
    phases = math.pi * np.arange(len(tones)) ** 2 / len(tones)
    size = SWEEP_SHARE / np.abs(loop.mixer[:, axis]).max() / math.sqrt(len(tones))
    # Small where the vehicle answers most: at low frequencies.
    sizes = size * np.minimum(tones / 8.0, 1.0)

    def injection(t: float) -> tuple[float, float, float]:
        out = [0.0, 0.0, 0.0]
        out[axis] = float(sizes @ np.cos(tones * t + phases))
        return (out[0], out[1], out[2])

    sim = flown(drawn, loop, Steps(axis, at=math.inf), 0.0, ATTITUDE_ONLY, injection)
    controller = sim._controller
    rows = []
    for _ in range(round((SETTLE + PERIOD) / (STEP_US * 1e-6))):
        sim.step()
        if sim.tick % CONTROL_STEPS == 0:
            rows.append((sim.time, controller.asked[axis], controller.sent[axis]))
    t, asked, sent = np.array(rows)[-round(PERIOD * LOOP_RATE) :].T
    wave = np.exp(-1j * np.outer(tones, t))
    return margins_of(tones, -(wave @ asked)[None] / (wave @ sent))


def overshoot_of(drawn: Drawn, loop: RateLoop, axis: int) -> float:
    """Peak of a step beyond the step, over it: of the attitude, or of the rate in rate mode.

    Of the flight less the same one without the step, in which a trim that is a little off settles.
    """
    tracks = []
    for at in (1.0, math.inf):
        mission = Steps(axis, at, turning=not loop.holds_attitude)
        sim = flown(drawn, loop, mission, 0.0, ATTITUDE_ONLY)
        rows = []
        for _ in range(round(4.0 / (STEP_US * 1e-6))):
            sim.step()
            a, *parts = sim.state.quaternion
            angles = [2.0 * a * part for part in parts]
            rows.append(angles[axis] if loop.holds_attitude else sim.state.rates[axis])
        tracks.append(np.array(rows))
    return max(float((tracks[0] - tracks[1]).max() / STEP_ANGLE) - 1.0, 0.0)


def first_flight(drawn: Drawn, loop: RateLoop) -> bool:
    """Whether it holds attitude in gusts from the first second, position held."""
    sim = flown(drawn, loop, Steps(0, at=math.inf), 0.1)
    worst = 0.0
    for _ in range(round(12.0 / (STEP_US * 1e-6))):
        sim.step()
        _, b, c, _ = sim.state.quaternion
        worst = max(worst, b * b + c * c)
    return bool(worst < math.sin(math.radians(15.0)) ** 2)


@dataclass(frozen=True)
class Row:
    """One axis of one vehicle: predicted and measured; surely kept and with payload measured."""

    phase: tuple[float, float]
    gain: tuple[float, float]
    overshoot: tuple[float, float]
    crossover: float
    sure: tuple[float, float]
    laden: tuple[float, float]


def vehicle_rows(
    drawn: Drawn, ours: ExportedVehicle, autopilot: Autopilot
) -> tuple[list[Row], bool]:
    """Everything of one vehicle with one autopilot."""
    loop = loop_of(autopilot, ours, drawn)
    delay = ours.known.get("rotor_delay")
    # The emulator's own controller held its commands for 4 ms.
    late = ASSUMED_DELAY if delay is None else (max(-delay.value - 0.002, 0.0), delay.std or 0.0)
    draws = drawn_vehicles(ours, LIMITS.draws - 1, 1)
    dynamics = hover_dynamics([ours, *draws], loop, late, traded=delay is not None)
    found, said = sure_proposal(dynamics, loop, None, {})
    if found is None:
        raise InputError("; ".join(said))
    loop, sure = found, sure_margins(dynamics, found, {})
    omega, whole = frequencies(loop), loop.holds_attitude
    loops = open_loops(dynamics.first(1), loop, omega, attitude=whole)
    v = drawn.vehicle
    laden = replace(v, mass=1.2 * v.mass, T_max=0.8 * v.T_max)
    rows = []
    for axis in range(3):
        predicted = margins_of(omega, loops[:, :, axis])
        crossover = float(predicted.crossover[0])
        found = measured_loop(drawn, loop, axis, crossover)
        worn = measured_loop(replace(drawn, vehicle=laden), loop, axis, crossover)
        step = step_response(dynamics.first(1), loop, axis, of="attitude" if whole else "rate")
        rows.append(
            Row(
                (float(predicted.phase[0]), float(found.phase[0])),
                (float(predicted.gain[0]), float(found.gain[0])),
                (float(step.overshoot[0]), overshoot_of(drawn, loop, axis)),
                crossover,
                tuple(sure[axis].tolist()),
                worn.worst(),
            )
        )
    return rows, all(first_flight(replace(drawn, vehicle=one), loop) for one in (v, laden))


def main() -> None:
    """Print a line an axis, then the summary."""
    parser = arguments(__doc__)
    parser.add_argument("--vehicles", type=int, default=8)
    parser.add_argument("--most", type=int, default=1000, help="vehicles flown in this run")
    parser.add_argument("--keep", type=Path, help="file of what is done, to go on from")
    options = parser.parse_args()
    numbers = range(options.vehicles)
    done = gone_on_with(options.keep, "vehicle", numbers, one_vehicle, options.most)
    for entry in done:
        show(entry)
    summary(done)


def one_vehicle(seed: int) -> dict:
    """Every autopilot on one vehicle, as an entry of the file."""
    drawn = draw(seed, LAYOUTS)
    v = drawn.vehicle
    entry: dict = {
        "vehicle": seed, "layout": drawn.layout, "mass": v.mass, "lag": v.motor_lag,
        "thrust_to_weight": v.T_max * len(v.rotors) / v.mass / GRAVITY,
    }  # fmt: skip
    ours = identified(drawn, seed)
    for autopilot in AUTOPILOTS:
        try:
            rows, flew = vehicle_rows(drawn, ours, autopilot)
            entry[autopilot] = {"flew": flew, "axes": [asdict(row) for row in rows]}
        except GcsSysidError as error:
            entry[autopilot] = {"refused": str(error)}
    return entry


def show(entry: dict) -> None:
    """A vehicle's lines: predicted / measured."""
    print(
        f"{entry['vehicle']:3} {entry['layout']:9} {entry['mass']:5.2f} kg, motor lag "
        f"{1e3 * entry['lag']:.0f} ms, thrust to weight {entry['thrust_to_weight']:.1f}"
    )
    for autopilot in AUTOPILOTS:
        one = entry[autopilot]
        if "refused" in one:
            print(f"    {autopilot} refused: {one['refused']}")
            continue
        if not one["flew"]:
            print(f"    {autopilot} DID NOT FLY")
        for axis, row in zip(AXES, one["axes"], strict=True):
            phase, gain, over = row["phase"], row["gain"], row["overshoot"]
            print(
                f"    {autopilot:9} {axis:5} crossover {row['crossover']:5.1f} rad/s, phase "
                f"{phase[0]:5.1f} / {phase[1]:5.1f}, gain {gain[0]:5.1f} / {gain[1]:5.1f}, "
                f"overshoot {100 * over[0]:4.1f} / {100 * over[1]:4.1f} %, laden, low battery: "
                "{:.1f} deg, {:.1f} dB of {:.1f}, {:.1f}".format(*row["laden"], *row["sure"])
            )


def summary(entries: list[dict]) -> None:
    """The figures of docs/tune.md."""
    tunings = [entry[autopilot] for entry in entries for autopilot in AUTOPILOTS]
    given = [one for one in tunings if "axes" in one]
    rows = [row for one in given for row in one["axes"]]
    if not rows:
        print("no gains for any vehicle")
        return
    phase, gain, over = (np.array([row[n] for row in rows]) for n in ("phase", "gain", "overshoot"))
    finite = np.isfinite(gain).all(axis=1)
    off = [np.abs(np.diff(x)[:, 0]) for x in (phase, gain[finite], over)]
    masses = [entry["mass"] for entry in entries]
    below = sum(np.any(np.less(row["laden"], row["sure"])) for row in rows)
    print(
        f"\n{len(entries)} vehicles of {min(masses):.2f} to {max(masses):.1f} kg with all "
        f"autopilots: {len(tunings) - len(given)} of {len(tunings)} refused, "
        f"{sum(one['flew'] for one in given)} of {len(given)} flew first time"
        f"\nmeasured phase margin at least {phase[:, 1].min():.1f} deg, gain margin at least "
        f"{gain[:, 1].min():.1f} dB"
        f"\nmeasured less predicted, of {len(rows)} axes: phase at most {off[0].max():.1f} deg "
        f"({(off[0] <= 5.0).sum()} within 5), gain at most {off[1].max():.2f} dB "
        f"({(off[1] <= 1.0).sum()} within 1), overshoot at most {100 * off[2].max():.1f} % of the "
        f"step ({(off[2] <= 0.1).sum()} within 10)"
        f"\nladen, low battery: below what is surely kept on {below} of {len(rows)} axes"
    )


if __name__ == "__main__":
    main()
