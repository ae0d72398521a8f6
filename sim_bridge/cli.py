"""The command line of the emulator."""

import argparse
import math
import signal
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from types import FrameType

import numpy as np

from gcs_sysid import __version__
from gcs_sysid.errors import GcsSysidError, InputError
from gcs_sysid.usage import OneLineParser, not_negative, positive
from sim_bridge.links import Link, TlogLink, open_link
from sim_bridge.missions import MISSIONS
from sim_bridge.px4 import Px4
from sim_bridge.sensors import NOISE_MODELS
from sim_bridge.server import TruthFile, fly
from sim_bridge.simulation import Change, Simulation, mass_step
from sim_bridge.vehicle_files import load_vehicle

DEFAULT_CONNECT = "udpout:127.0.0.1:14550"


def _rate(text: str) -> float:
    value = positive(text)
    if value > 1000.0:
        raise argparse.ArgumentTypeError(f"at most 1000 Hz, the rate of the physics; got {text!r}")
    return value


def _speed(text: str) -> float:
    return math.inf if text == "max" else positive(text)


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
    return mass_step(not_negative(time), positive(factor))


def make_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = OneLineParser(
        prog="sim-bridge",
        description="Emulate a multirotor that speaks MAVLink 2 as PX4 does.",
        allow_abbrev=False,
    )
    add = parser.add_argument
    add("--version", action="version", version=f"sim-bridge {__version__}")
    vehicle = parser.add_argument_group("what flies")
    add = vehicle.add_argument
    add(
        "--airframe",
        default="paper",
        metavar="NAME|FILE.toml",
        help="built-in airframe, or a file with a [simulation] table (default: paper)",
    )
    add("--arm", type=positive, metavar="M", help="scale the layout to this mean arm, in m")
    add("--autopilot", choices=("px4", "ardupilot"), default="px4", help="default: px4")
    add("--mission", choices=sorted(MISSIONS), default="paper", help="default: paper")
    add("--duration", type=positive, metavar="S", help="s (default: the mission's length)")
    add(
        "--mass-step",
        type=_mass_step,
        action="append",
        default=[],
        metavar="T:FACTOR",
        help="multiply the mass at time T; may be given again",
    )
    add(
        "--turbulence",
        type=not_negative,
        metavar="W",
        help="body-rate wobble from gusts, rad/s rms (default: 0.02 in hover, else 0)",
    )
    sensing = parser.add_argument_group("what is measured")
    add = sensing.add_argument
    add("--noise", choices=NOISE_MODELS, default="mems", help="sensor noise (default: mems)")
    add(
        "--sigma",
        type=not_negative,
        default=0.02,
        metavar="X",
        help="of paper and white noise, rad and rad/s (default: 0.02)",
    )
    add("--seed", type=_seed, default=0, metavar="N", help="of all randomness (default: 0)")
    add("--rate", type=_rate, default=250.0, metavar="HZ", help="IMU and rotors (default: 250)")
    link = parser.add_argument_group("where to")
    add = link.add_argument
    add(
        "--connect",
        metavar="URL",
        help="udpout:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT or a serial "
        f"device (default: {DEFAULT_CONNECT}, or none with --tlog)",
    )
    add("--baud", type=int, default=115200, help="of a serial device (default: 115200)")
    add(
        "--speed",
        type=_speed,
        default=None,
        metavar="1|max",
        help="times real time, or max (default: 1; max when only a file is written)",
    )
    add("--tlog", type=Path, metavar="FILE", help="write the flight straight to a .tlog")
    add("--truth", type=Path, metavar="FILE", help="write the true parameters as JSON")
    # However a program that starts this one ends, its pipe closes.
    parser.add_argument(
        "--until-stdin-closes",
        action="store_true",
        help="end with standard input too, for programs that start this one",
    )
    return parser


def run(args: argparse.Namespace) -> None:
    """Fly what the command line asks for.

    Raises:
        GcsSysidError: something in it cannot be used.
    """
    if args.autopilot != "px4":
        raise InputError("--autopilot ardupilot is not there yet; use --autopilot px4")
    vehicle = load_vehicle(args.airframe, args.arm)
    mission = MISSIONS[args.mission]
    duration = args.duration or mission.duration
    # One seed, independent generators: what one draws never moves the other.
    gusts, sensors = np.random.SeedSequence(args.seed).spawn(2)
    simulation = Simulation(vehicle, mission, gusts, args.turbulence, args.mass_step)
    autopilot = Px4(simulation, args.noise, args.sigma, args.rate, sensors)
    truth = TruthFile(args.truth, simulation)
    links: list[Link] = []
    try:
        if args.tlog is not None:
            links.append(TlogLink(args.tlog))
        if args.connect is not None or args.tlog is None:
            links.append(open_link(args.connect or DEFAULT_CONNECT, args.baud))
        speed = args.speed or (1.0 if args.connect or args.tlog is None else math.inf)
        fly(simulation, autopilot, links, duration, speed, truth)
    finally:
        for link in links:
            link.close()


def _end_with_stdin() -> None:
    sys.stdin.buffer.read()
    signal.raise_signal(signal.SIGTERM)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; the exit status. For the main thread: it takes SIGTERM while it runs."""
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
