"""The options of `doctor`, `airframe` and `completion`."""

import argparse
from pathlib import Path

from gcs_sysid.argument_types import positive
from gcs_sysid.cli import arguments

LAYOUTS = (
    "px4-quad-x", "ardupilot-quad-x", "px4-quad-plus", "ardupilot-quad-plus",
    "px4-hexa-x", "ardupilot-hexa-x", "px4-hexa-plus", "ardupilot-hexa-plus",
    "px4-octo-x", "ardupilot-octo-x", "px4-octo-plus", "ardupilot-octo-plus",
)  # fmt: skip
"""Names of `setup_help.layouts.LAYOUTS` (a test compares); not imported, to start fast."""

SHELLS = ("bash", "zsh", "fish")


def add_doctor(parser: argparse.ArgumentParser) -> None:
    """Options of `doctor`."""
    parser.add_argument(
        "urls", nargs="*", metavar="URL", help="listen there too, such as /dev/ttyUSB0"
    )
    parser.add_argument("--baud", type=int, metavar="N", help="of serial ports among them")
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
        help="describe a vehicle, by questions or by options",
        description="Writes an airframe file. Asks on the terminal for what no option tells; "
        "with --layout and --arm (or --rotor) and --output it asks nothing.",
    )
    new.add_argument("--layout", choices=LAYOUTS, metavar="NAME", help=", ".join(LAYOUTS[::2]))
    new.add_argument(
        "--arm", metavar="M", help="m from the centre to each motor; X,Y: a quad X not square"
    )
    new.add_argument(
        "--rotor",
        action="append",
        default=[],
        metavar="SPIN:X,Y",
        help="a motor of an own layout, such as cw:0.2,-0.2: m forward and right; repeated, in "
        "the autopilot's order",
    )
    new.add_argument("--spin", metavar="LIST", help="reversed, or one of each motor: ccw,ccw,cw,cw")
    scale = new.add_mutually_exclusive_group()
    scale.add_argument("--mass", type=arguments.mass, metavar="KG", help="weighed mass")
    scale.add_argument("--k-t", type=positive, metavar="N_S2", help="known k_T")
    scale.add_argument("--t-max", type=positive, metavar="N", help="known thrust of a rotor")
    new.add_argument(
        "--imu", metavar="X,Y,Z", help="m forward, right, down from the centre; --imu=-0.02,0,0"
    )
    new.add_argument(
        "--prior",
        type=arguments.prior,
        action="append",
        default=[],
        metavar="NAME=VALUE±STD",
        help="a value known beforehand; may be repeated",
    )
    new.add_argument("--name", help="of the vehicle (default: the file's name)")
    new.add_argument(
        "-o", "--output", metavar="FILE.toml", help="to write, if it is not there; - is stdout"
    )
    check = actions.add_parser(
        "check",
        help="draw an airframe and look for slips",
        description="Draws an airframe's rotors, and says what looks wrong.",
    )
    check.add_argument(
        "file", metavar="FILE", type=Path, help="airframe file, or a built-in airframe's name"
    )
    check.add_argument("--json", action="store_true", help="findings as JSON")


def add_completion(parser: argparse.ArgumentParser) -> None:
    """Options of `completion`."""
    parser.add_argument("shell", choices=SHELLS, metavar="|".join(SHELLS), help="for which shell")
