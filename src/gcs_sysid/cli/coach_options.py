"""Options of the flight coach, for the commands that have one. Light: nothing heavy is loaded."""

import argparse
import math
from typing import TYPE_CHECKING

from gcs_sysid.argument_types import between, number

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
        help="every 95 %% interval within so much of the value (default 2%%)",
    )


def add_options(parser: argparse.ArgumentParser) -> None:
    """What the coach aims at, and what the pilot allows."""
    group = parser.add_argument_group("flight coach")
    add_target(group)
    group.add_argument(
        "--max-tilt", type=_tilt, default=20.0, metavar="DEG", help="of roll and pitch (default 20)"
    )
    group.add_argument(
        "--max-rate",
        type=_turning,
        default=150.0,
        metavar="DEG_S",
        help="about each axis (default 150)",
    )
    group.add_argument(
        "--max-height",
        type=_height,
        default=1.0,
        metavar="M",
        help="up and down, 0.2 to 1; 0: no climbs (default 1)",
    )


def add_plan(parser: argparse.ArgumentParser) -> None:
    """Options of `plan`, beside those of the airframe."""
    parser.add_argument(
        "--rotor-input",
        choices=("speed", "command"),
        help="what will be telemetered (default: the airframe's, else speed)",
    )
    parser.add_argument(
        "--json",
        nargs="?",
        const="-",
        metavar="FILE",
        help="as JSON: instead of the text, or to "
        "FILE beside it; sim-bridge --mission FILE flies it",
    )
    parser.add_argument("--svg", metavar="FILE", help="a picture of the motion, for print")
    parser.add_argument("--force", action="store_true", help="write over FILE if it exists")
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
