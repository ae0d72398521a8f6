"""The command line of the emulator."""

import argparse
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from gcs_sysid import __version__
from gcs_sysid.argument_types import OneLineParser, baud, between, not_negative, number, positive
from gcs_sysid.errors import GcsSysidError, InputError
from gcs_sysid.files import never_fail_to_print, read_bytes
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.tlog import TlogReader
from sim_bridge import ardupilot
from sim_bridge.answering import AnsweringAutopilot
from sim_bridge.ardupilot import ArduPilot
from sim_bridge.autopilot import BOOT_US, EPOCH_US
from sim_bridge.bad_line import BadLine
from sim_bridge.choices import message_number, moment
from sim_bridge.doublets import ALL_MISSIONS
from sim_bridge.ground_cycle import GroundCycle
from sim_bridge.line_faults import fault_help, make_faults, parse_fault
from sim_bridge.links import Link, TlogLink, open_link
from sim_bridge.log_server import LogServer
from sim_bridge.missions import Mission
from sim_bridge.physics import make_physics, parse_physics, physics_help
from sim_bridge.playback import play, wait_for_somebody
from sim_bridge.px4 import Px4
from sim_bridge.rate_controllers import rate_controller
from sim_bridge.sensor_faults import (
    SensorFaults,
    make_sensor_faults,
    parse_sensor_fault,
    sensor_fault_help,
)
from sim_bridge.sensors import NOISE_MODELS
from sim_bridge.server import Pace, TruthFile, fly
from sim_bridge.simulation import Change, Simulation, mass_step
from sim_bridge.swings import read_plan
from sim_bridge.vehicle_files import check_hover, load_vehicle
from sim_bridge.wire import FrameWriter, Signer

DEFAULT_CONNECT = "udpout:127.0.0.1:14550"

_NOT_SENT = {
    "speed": ("ACTUATOR_OUTPUT_STATUS", "SERVO_OUTPUT_RAW"),
    "command": ("ESC_STATUS", "ESC_INFO", "ESC_TELEMETRY_1_TO_4"),
    "both": (),
}
"""Messages left out for each --rotor-input."""

_LINE = 0x11FE
"""Sets the line's randomness apart from that of the flight, which stays what it is without."""


def _rate(text: str) -> float:
    value = positive(text)
    if value > 1000.0:
        raise argparse.ArgumentTypeError(f"at most 1000 Hz, the rate of the physics; got {text!r}")
    return value


def _speed(text: str) -> float:
    return math.inf if text == "max" else between(1e-3, 1e6, "times real time")(text)


def _seed(text: str) -> int:
    try:
        value = int(text)
    except ValueError:
        value = -1
    if value < 0:
        raise argparse.ArgumentTypeError(f"must be a whole number from 0, got {text!r}")
    return value


def _mass_step(text: str) -> Change:
    time, colon, factor = text.partition(":")
    if not colon:
        raise argparse.ArgumentTypeError(f"write T:FACTOR, such as 30:1.2, got {text!r}")
    return mass_step(not_negative(time), between(0.01, 100.0, "times the mass")(factor))


def _mission(text: str) -> str:
    if text not in ALL_MISSIONS and not text.endswith(".json"):
        names = ", ".join(sorted(ALL_MISSIONS))
        raise argparse.ArgumentTypeError(
            f"invalid choice: {text!r} (choose from {names}, or a plan's file NAME.json)"
        )
    return text


def _parameter(text: str) -> tuple[str, float]:
    name, equals, value = text.partition("=")
    if not equals:
        raise argparse.ArgumentTypeError(f"write NAME=VALUE, got {text!r}")
    return name, number(value)


def _stream(text: str) -> tuple[int, float]:
    name, equals, value = text.partition("=")
    if not equals:
        raise argparse.ArgumentTypeError(f"write MESSAGE=HZ, such as ATTITUDE=15, got {text!r}")
    return message_number(name), between(0.0, 1000.0, "Hz")(value)


def make_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = OneLineParser(
        prog="sim-bridge",
        description="Emulate a multirotor with the MAVLink interface of PX4 or ArduPilot.",
        epilog=(
            f"effects (usual value in brackets):\n{physics_help()}\n\n"
            f"traps (usual value in brackets):\n{sensor_fault_help()}\n\n"
            f"faults (usual value in brackets):\n{fault_help()}"
        ).replace("%", "%%"),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add = parser.add_argument
    add("--version", action="version", version=f"sim-bridge {__version__}")
    vehicle = parser.add_argument_group("vehicle and flight")
    add = vehicle.add_argument
    add(
        "--airframe",
        default="paper",
        metavar="NAME|FILE.toml",
        help="built-in airframe, or a file with a [simulation] table (default: paper)",
    )
    add("--arm", type=positive, metavar="M", help="scale the layout to this mean arm, in m")
    add("--autopilot", choices=("px4", "ardupilot"), default="px4", help="default: px4")
    add(
        "--mission",
        type=_mission,
        default="paper",
        metavar="NAME|PLAN.json",
        help=f"{', '.join(ALL_MISSIONS)}, or a plan of gcs-sysid plan --json (default: paper)",
    )
    add("--duration", type=moment, metavar="S", help="s (default: the mission's length)")
    add(
        "--mass-step",
        type=_mass_step,
        action="append",
        default=[],
        metavar="T:FACTOR",
        help="multiply the mass by FACTOR at time T; may be repeated",
    )
    add(
        "--gains",
        metavar="FILE|default",
        help="fly the autopilot's own rate controller, with gains from a .params or .param file or "
        "its defaults (otherwise a controller that knows the vehicle)",
    )
    add(
        "--turbulence",
        type=between(0.0, 10.0, "rad/s"),
        metavar="W",
        help="body-rate wobble from gusts, rad/s rms (default: 0.02 in hover, else 0)",
    )
    add(
        "--physics",
        type=parse_physics,
        action="append",
        default=[],
        metavar="NAME[=VALUE]",
        help="add effects of real vehicles, see below; may be repeated",
    )
    sensing = parser.add_argument_group("sensors and telemetry")
    add = sensing.add_argument
    add("--noise", choices=NOISE_MODELS, default="mems", help="sensor noise (default: mems)")
    add(
        "--sigma",
        type=between(0.0, 100.0, "rad"),
        default=0.02,
        metavar="X",
        help="of paper and white noise, rad and rad/s (default: 0.02)",
    )
    add("--seed", type=_seed, default=0, metavar="N", help="of all randomness (default: 0)")
    add("--rate", type=_rate, default=250.0, metavar="HZ", help="IMU and rotors (default: 250)")
    add(
        "--rotor-input",
        choices=tuple(_NOT_SENT),
        default="both",
        help="send rotor speeds, commands (actuator outputs) or both (default: both)",
    )
    add(
        "--param",
        type=_parameter,
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="set a parameter of the autopilot, such as INS_GYRO_FILTER=40; may be repeated",
    )
    add(
        "--stream",
        type=_stream,
        action="append",
        default=[],
        metavar="MESSAGE=HZ",
        help="initial rate of a message, as if another ground station had requested it; 0: never",
    )
    add(
        "--trap",
        type=parse_sensor_fault,
        action="append",
        default=[],
        metavar="NAME[=VALUE]",
        help="add sensor and autopilot faults, see below; may be repeated",
    )
    link = parser.add_argument_group("output")
    add = link.add_argument
    add(
        "--log",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="a log on board, for who asks for it; may be repeated",
    )
    add(
        "--fault",
        type=parse_fault,
        action="append",
        default=[],
        metavar="NAME[=VALUE]",
        help="add line faults, in --tlog too, see below; may be repeated",
    )
    add("url", nargs="?", metavar="URL", help="the same as --connect URL")
    add(
        "--connect",
        metavar="URL",
        help="udpout:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT or a serial "
        f"device (default: {DEFAULT_CONNECT}, or none with --tlog)",
    )
    add("--baud", type=baud, default=115200, help="of a serial device (default: 115200)")
    add(
        "--speed",
        type=_speed,
        default=None,
        metavar="X|max",
        help="times real time, or max (default: 1; max when only a file is written)",
    )
    add("--mavlink", type=int, choices=(1, 2), default=2, help="version (default: 2)")
    add(
        "--signing-key",
        type=Path,
        metavar="FILE",
        help="sign with this key, and obey signed commands only: 32 bytes, or 64 hexadecimal "
        "digits",
    )
    add(
        "--play",
        type=Path,
        metavar="LOG.tlog",
        help="replay the frames of this recording, at its own pace times --speed",
    )
    add("--tlog", type=Path, metavar="FILE", help="write the flight to a .tlog")
    add("--force", action="store_true", help="overwrite existing files")
    add("--truth", type=Path, metavar="FILE", help="write the true parameters as JSON")
    # However a program that starts this one ends, its pipe closes.
    parser.add_argument(
        "--until-stdin-closes",
        action="store_true",
        help="end when standard input closes, for programs that start this one",
    )
    return parser


def run(args: argparse.Namespace) -> None:
    """Fly what the command line asks for.

    Raises:
        GcsSysidError: something in it cannot be used.
    """
    if args.url is not None:
        if args.connect is not None:
            raise InputError("give the URL once: alone, or with --connect")
        args.connect = args.url
    if args.play is not None:
        _play(args)
        return
    vehicle = load_vehicle(args.airframe, args.arm)
    sensor_faults = _sensor_faults(args)
    faults = make_faults(args.fault)
    mission: Mission = ALL_MISSIONS.get(args.mission) or read_plan(Path(args.mission))
    if sensor_faults.ground or sensor_faults.flights > 1:
        mission = GroundCycle(mission, sensor_faults.ground, sensor_faults.flights)
    duration = args.duration or mission.duration
    # One seed, independent generators: what one draws never moves the other.
    gusts, sensors = np.random.SeedSequence(args.seed).spawn(2)
    loop: dict[str, Any] = {}
    if args.autopilot == "ardupilot":
        loop = {"step_us": ardupilot.STEP_US, "control_steps": ardupilot.LOOP_STEPS}
    if args.gains is not None:
        loop["controller"] = rate_controller(args.autopilot, args.gains)
    physics = make_physics(args.physics)
    simulation = Simulation(
        vehicle, mission, gusts, args.turbulence, args.mass_step, physics=physics, **loop
    )
    check_hover(simulation.vehicle, "--physics")
    autopilot = _autopilot(args, simulation, sensor_faults, sensors)
    for name, value in args.param:
        try:
            autopilot.set_parameter(name, value)
        except KeyError:
            raise InputError(f"--param: {args.autopilot} here has no {name!r}") from None
    for msgid, hertz in args.stream:
        try:
            autopilot.set_rate(msgid, hertz)
        except KeyError:
            name = mavlink.mavlink_map[msgid].msgname
            raise InputError(f"--stream: {args.autopilot} here sends no {name}") from None
    if args.log:
        autopilot.serve(LogServer(args.log, autopilot.writer))
    _check_truth(args)
    truth = TruthFile(args.truth, simulation, autopilot)
    links: list[Link] = []
    try:
        if args.tlog is not None:
            autopilot.show_parameters()
            links.append(TlogLink(args.tlog, args.force, recorded=faults.any))
        if args.connect is not None or args.tlog is None:
            links.append(open_link(args.connect or DEFAULT_CONNECT, args.baud))
        if faults.any:
            links[:] = [
                BadLine(link, faults, np.random.SeedSequence([args.seed, _LINE])) for link in links
            ]
        speed = args.speed or (1.0 if args.connect or args.tlog is None else math.inf)
        fly(simulation, autopilot, links, duration, Pace(speed), truth)
    finally:
        for link in links:
            link.close()


def _check_truth(args: argparse.Namespace) -> None:
    """See that the truth file takes no other file's place unasked."""
    if args.truth is None:
        return
    if args.tlog is not None and args.truth.resolve() == args.tlog.resolve():
        raise InputError("--tlog and --truth name the same file")
    if args.truth.exists() and not args.force:
        raise InputError(f"{args.truth} exists; --force replaces it")


def _play(args: argparse.Namespace) -> None:
    for name in ("tlog", "truth", "signing_key"):
        if getattr(args, name) is not None:
            raise InputError(f"--play and --{name.replace('_', '-')} exclude each other")
    if args.fault:
        raise InputError("--play and --fault exclude each other")
    recording = TlogReader(args.play)
    link = open_link(args.connect or DEFAULT_CONNECT, args.baud)
    try:
        wait_for_somebody(link)
        count = play(recording, link, Pace(args.speed or 1.0))
    finally:
        link.close()
    print(f"played {count} frames of {args.play}", file=sys.stderr)


def _sensor_faults(args: argparse.Namespace) -> SensorFaults:
    unsent = [("never_sent", (message_number(name),)) for name in _NOT_SENT[args.rotor_input]]
    return make_sensor_faults([*args.trap, *unsent])


def _autopilot(
    args: argparse.Namespace,
    simulation: Simulation,
    sensor_faults: SensorFaults,
    seed: np.random.SeedSequence,
) -> AnsweringAutopilot:
    """Autopilot and its version of MAVLink."""
    only_file = args.tlog is not None and args.connect is None
    signer = None
    if args.signing_key is not None:
        if args.mavlink == 1:
            raise InputError("--signing-key needs --mavlink 2: version 1 has no signatures")
        # A reader on a live link compares with the clock on its wall; a file must repeat.
        switched_on = EPOCH_US if only_file else round(time.time() * 1e6) - BOOT_US
        signer = Signer(
            read_key(args.signing_key),
            lambda: switched_on + BOOT_US + simulation.tick * simulation.step_us,
        )
    writer = FrameWriter(1, 1, args.mavlink, signer)
    if args.autopilot == "ardupilot":
        # A file carries no requests, so the messages that a recording needs are enabled beforehand.
        asked = ardupilot.recorder_rates(args.rate) if only_file else None
        return ArduPilot(simulation, args.noise, args.sigma, seed, sensor_faults, writer, asked)
    return Px4(simulation, args.noise, args.sigma, args.rate, seed, sensor_faults, writer)


def read_key(path: Path) -> bytes:
    """The 32 bytes of a signing key, raw or as 64 hexadecimal digits.

    Raises:
        InputError: the file cannot be read or holds neither.
    """
    data = read_bytes(path, "the signing key", 4096)
    if len(data) == 32:
        return data
    try:
        key = bytes.fromhex(data.decode("ascii").strip())
    except ValueError:
        key = b""
    if len(key) != 32:
        raise InputError(f"{path} is no signing key: 32 bytes or 64 hexadecimal digits are needed")
    return key


def _end_with_stdin() -> None:
    # Not through the buffer: its lock, held at exit, aborts the interpreter.
    while os.read(sys.stdin.fileno(), 4096):
        pass
    signal.raise_signal(signal.SIGTERM)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; the exit status. For the main thread: it takes SIGTERM while it runs."""
    never_fail_to_print()
    args = make_parser().parse_args(argv)

    def stop(signum: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    if args.until_stdin_closes:
        threading.Thread(target=_end_with_stdin, daemon=True).start()
    try:
        run(args)
    except KeyboardInterrupt:
        return 0
    except (GcsSysidError, OSError) as error:
        print(f"sim-bridge: error: {error}", file=sys.stderr)
        return 2
    finally:
        signal.signal(signal.SIGTERM, before)
    return 0
