"""Options of the flight coach and of the first minutes. Light: nothing heavy is loaded."""

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from gcs_sysid.argument_types import (
    AppendNamed,
    baud,
    between,
    not_negative,
    number,
    positive,
    split_prior,
)
from gcs_sysid.cli import arguments

if TYPE_CHECKING:
    from gcs_sysid.coach.manoeuvre_library import Limits
    from gcs_sysid.live.flight_coach import CoachOptions


def target(text: str) -> float:
    """An argparse type: per cent, with or without the sign, as a share."""
    try:
        value = float(text.strip().removesuffix("%"))
    except ValueError:
        value = math.nan
    if not 0.1 <= value <= 50.0:
        raise argparse.ArgumentTypeError(f"must lie between 0.1% and 50%, got {text!r}")
    return 0.01 * value


_tilt = between(5.0, 45.0, "degrees")
_turning = between(30.0, 600.0, "deg/s")


def _height(text: str) -> float:
    value = 0.0 if text.strip() in ("0", "0.0") else number(text)
    if value and not 0.2 <= value <= 1.0:
        raise argparse.ArgumentTypeError(f"must be 0 or lie between 0.2 and 1 m, got {text!r}")
    return value


def add_target(parser: "argparse.ArgumentParser | argparse._ArgumentGroup") -> None:
    """How well everything is to be known."""
    parser.add_argument(
        "--target",
        type=target,
        default=0.02,
        metavar="P%",
        help="target 95 %% interval, relative to the value (default 2%%)",
    )


def add_options(parser: argparse.ArgumentParser) -> None:
    """What the coach aims at, and what the pilot allows."""
    group = parser.add_argument_group("flight coach")
    add_target(group)
    group.add_argument(
        "--max-tilt",
        type=_tilt,
        default=20.0,
        metavar="DEG",
        help="roll and pitch limit (default 20)",
    )
    group.add_argument(
        "--max-rate",
        type=_turning,
        default=150.0,
        metavar="DEG_S",
        help="rate limit of each axis (default 150)",
    )
    group.add_argument(
        "--max-height",
        type=_height,
        default=1.0,
        metavar="M",
        help="climb and descent, 0.2 to 1; 0: none (default 1)",
    )


def add_plan(parser: argparse.ArgumentParser) -> None:
    """Options of `plan`, beside those of the airframe."""
    parser.add_argument(
        "--rotor-input",
        choices=("speed", "command"),
        help="rotor telemetry to plan for (default: the airframe's, else speed)",
    )
    parser.add_argument(
        "--json",
        nargs="?",
        const="-",
        metavar="FILE",
        help="print JSON instead of text, or also write it to FILE; sim-bridge --mission "
        "FILE flies it",
    )
    parser.add_argument("--svg", metavar="FILE", help="write a picture of the motion")
    parser.add_argument("--force", action="store_true", help="overwrite existing files")
    add_options(parser)


def limits_of(options: argparse.Namespace) -> "Limits":
    """What the pilot allows."""
    from gcs_sysid.coach.manoeuvre_library import Limits

    return Limits(
        math.radians(options.max_tilt), math.radians(options.max_rate), options.max_height
    )


def coach_options(options: argparse.Namespace) -> "CoachOptions":
    """Of a live session."""
    from gcs_sysid.live.flight_coach import CoachOptions

    return CoachOptions(options.target, limits_of(options))


LAYOUTS = (
    "px4-quad-x", "ardupilot-quad-x", "px4-quad-plus", "ardupilot-quad-plus",
    "px4-hexa-x", "ardupilot-hexa-x", "px4-hexa-plus", "ardupilot-hexa-plus",
    "px4-octo-x", "ardupilot-octo-x", "px4-octo-plus", "ardupilot-octo-plus",
    "betaflight-quad-x",
)  # fmt: skip
"""Names of `setup_help.layouts.LAYOUTS` (a test compares); not imported, to start fast."""

SHELLS = ("bash", "zsh", "fish", "powershell")


def add_doctor(parser: argparse.ArgumentParser) -> None:
    """Options of `doctor`."""
    parser.add_argument(
        "urls", nargs="*", metavar="URL", help="also listen here, such as /dev/ttyUSB0"
    )
    parser.add_argument("--baud", type=baud, metavar="N", help="baud rate of serial ports")
    parser.add_argument(
        "--duration",
        type=positive,
        default=3.0,
        metavar="S",
        help="listen for S seconds (default 3); nothing is sent",
    )
    parser.add_argument("--json", action="store_true", help="findings as JSON on standard output")


def add_airframe(parser: argparse.ArgumentParser) -> None:
    """Options of `airframe`, which has commands of its own."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    new = actions.add_parser(
        "new",
        help="write an airframe file, from questions or options",
        description="Writes an airframe file. Asks for what the options do not give; with "
        "--layout and --arm (or --rotor) and --output it asks nothing.",
    )
    new.add_argument("--layout", choices=LAYOUTS, metavar="NAME", help=", ".join(LAYOUTS[::2]))
    new.add_argument(
        "--arm",
        metavar="M",
        help="m from the center to each motor; X,Y for a quad X that is not square",
    )
    new.add_argument(
        "--rotor",
        action="append",
        default=[],
        metavar="SPIN:X,Y",
        help="a motor of a custom layout, such as cw:0.2,-0.2: m forward and right; repeat "
        "in motor "
        "order",
    )
    new.add_argument(
        "--spin", metavar="LIST", help="reversed, or the spin of each motor: ccw,ccw,cw,cw"
    )
    scale = new.add_mutually_exclusive_group()
    scale.add_argument("--mass", type=arguments.mass, metavar="KG", help="weighed mass")
    scale.add_argument("--k-t", type=positive, metavar="N_S2", help="known k_T")
    scale.add_argument("--t-max", type=positive, metavar="N", help="known thrust of a rotor")
    new.add_argument(
        "--imu",
        metavar="X,Y,Z",
        help="IMU position, m forward, right, down of the center: --imu=-0.02,0,0",
    )
    new.add_argument(
        "--prior",
        type=arguments.prior,
        action=AppendNamed,
        default=[],
        metavar="NAME=VALUE±STD",
        help="prior; may be repeated",
    )
    new.add_argument("--name", help="name of the vehicle (default: the file's name)")
    new.add_argument(
        "-o", "--output", metavar="FILE.toml", help="output file, must not exist; - is stdout"
    )
    check = actions.add_parser(
        "check",
        help="draw an airframe and check it",
        description="Draws the rotors of an airframe and lists what looks wrong.",
    )
    check.add_argument(
        "file", metavar="FILE", type=Path, help="airframe file, or a built-in airframe's name"
    )
    check.add_argument("--json", action="store_true", help="findings as JSON")


def add_completion(parser: argparse.ArgumentParser) -> None:
    """Options of `completion`."""
    parser.add_argument("shell", choices=SHELLS, metavar="|".join(SHELLS), help="shell")


def uncertain_setting(text: str) -> tuple[str, float, float]:
    """An argparse type: NAME=VALUE or NAME=VALUE±STD; +- and +/- do as well."""
    words = split_prior(text)
    try:
        if words:
            return words[0], number(words[1]), not_negative(words[2])
    except argparse.ArgumentTypeError:
        raise argparse.ArgumentTypeError(f"must be NAME=VALUE[±STD], got {text!r}") from None
    name, value = arguments.setting(text)
    return name, value, 0.0


def uncertain_delay(text: str) -> tuple[float, float]:
    """An argparse type: seconds, perhaps with ±STD."""
    _, value, std = uncertain_setting(f"delay={text}")
    if not 0.0 <= value <= 0.2:
        raise argparse.ArgumentTypeError(f"must be 0 to 0.2 s, got {text!r}")
    return value, std


def add_tune(parser: argparse.ArgumentParser) -> None:
    """Options of `tune`."""
    parser.add_argument("result", metavar="RESULT.json", help="written by --json")
    parser.add_argument(
        "parameters",
        nargs="?",
        metavar="LOG|PARAMETERS",
        help="log, .params or .param file with the autopilot's parameters: its gains and filters",
    )
    parser.add_argument(
        "--with",
        dest="beside",
        metavar="RESULT2.json",
        help="second result of the same flight, from commands if the first is from rotor speeds; "
        "supplies what the first lacks",
    )
    parser.add_argument("--autopilot", choices=("px4", "ardupilot"), help="default: the vehicle's")
    parser.add_argument(
        "--delay",
        type=uncertain_delay,
        metavar="S[±STD]",
        help="delay from gyro sample to rotor command (default: as identified, else 5 ms)",
    )
    parser.add_argument("--json", metavar="FILE", help="write margins and gains; - is stdout")
    parser.add_argument("--bode", metavar="FILE.svg", help="Bode diagram with the 95 %% band")
    parser.add_argument(
        "--to",
        choices=("px4-params", "ardupilot-param", "indi", "paparazzi"),
        help="format of -o: gains, or G1 and G2 of INDI (Indiflight, Paparazzi)",
    )
    parser.add_argument("-o", "--output", metavar="FILE", help="file for a ground station")
    parser.add_argument("--force", action="store_true", help="overwrite existing files")
    parser.add_argument(
        "--draws",
        type=arguments.draws,
        default=100,
        metavar="N",
        help="vehicles drawn (default 100)",
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of the draws (default 1)")
    parser.add_argument(
        "--vehicle",
        type=arguments.vehicle_address,
        metavar="SYSID[:COMPID]",
        help="whose parameters, if several are in the log",
    )
    arguments.add_vehicle_name(parser)
    arguments.add_other_values(
        parser, uncertain_setting, "NAME=VALUE[±STD]", "motor_lag=0.03+-0.005"
    )
