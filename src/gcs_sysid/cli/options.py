"""Every option and argument of the command line, as data.

An `Option` holds what the parser needs of it. Those that several commands have stand here once;
what a command says differently it says with `but`, in `commands`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gcs_sysid.argument_types import (
    GIVEN,
    AppendNamed,
    baud,
    between,
    climb,
    count,
    not_negative,
    percentage,
    positive,
    prior,
    vehicle_address,
    web_address,
)


@dataclass(frozen=True)
class Option:
    """An option, or an argument without dashes.

    Attributes:
        names: as typed: `-o`, `--output`; of an argument, the name that its value goes by.
        settings: the rest of what `ArgumentParser.add_argument` takes: type, default, help ...
    """

    names: tuple[str, ...]
    settings: Mapping[str, Any]

    def but(self, **settings: Any) -> "Option":
        """The same with other settings."""
        return Option(self.names, {**self.settings, **settings})


def option(*names: str, **settings: Any) -> Option:
    """An option with its settings."""
    return Option(names, settings)


@dataclass(frozen=True)
class OneOf:
    """Options of which at most one may be given."""

    options: tuple[Option, ...]


@dataclass(frozen=True)
class Group:
    """Options under a title of their own."""

    title: str
    options: tuple[Option | OneOf, ...]


LOCAL_PAGE = ("127.0.0.1", 8000)
"""Where a page is served by default."""

# What is read.
LOG = option("log", metavar="LOG", help="a .tlog, .ulg, .bin, .bbl or .csv file")
LOGS = option("logs", nargs="+", metavar="LOG")
RESULT = option("result", metavar="RESULT.json", help="written by --json")
CSV = option(
    "--csv",
    metavar="MAPPING.toml",
    help="what the columns of .csv and .parquet LOGs mean (default: columns.toml beside them)",
)
VEHICLE = option(
    "--vehicle",
    type=vehicle_address,
    metavar="SYSID[:COMPID]",
    help="if there are several (default: the first autopilot received)",
)
TRUTH = option("--truth", metavar="FILE", help="true parameters, shown beside the estimates")
BASELINE = option(
    "--baseline", metavar="RESULT.json", help="earlier result to compare with on the screen"
)

# What is written.
JSON = option("--json", metavar="FILE", help="write the result; - is stdout")
JSON_INSTEAD = option(
    "--json",
    nargs="?",
    const="-",
    metavar="FILE",
    help="print JSON instead of text, or also write it to FILE",
)
FORCE = option("--force", action="store_true", help="overwrite existing files")
OUTPUT = option("-o", "--output", metavar="FILE", help="output file; - is stdout")
RECORD = option("--record", metavar="FILE", help="default: a dated .tlog under logs/")

# The vehicle and its scale.
AIRFRAME = option("--airframe", metavar="NAME|FILE")
ARM = option(
    "--arm",
    type=GIVEN["arm"],
    metavar="M[±STD]",
    help="mean distance of the rotors from the center, m; here and below "
    "+- adds a standard deviation: 0.25+-0.003 or 0.25+-1%% (default 1%%)",
)
MASS = option(
    "--mass",
    type=GIVEN["mass"],
    metavar="KG[±STD]",
    help="weighed mass as the scale (default +-0.5%%)",
)
K_T = option(
    "--k-t",
    type=GIVEN["k_T"],
    metavar="N_S2[±STD]",
    help="known k_T as the scale (default +-2%%)",
)
T_MAX = option(
    "--t-max",
    type=GIVEN["T_max"],
    metavar="N[±STD]",
    help="known thrust of a rotor at full command (default +-2%%)",
)
PRIOR = option(
    "--prior",
    type=prior,
    action=AppendNamed,
    default=[],
    metavar="NAME=VALUE±STD",
    help="prior, such as k_M=6.1e-6+-1e-7 from a bench test; may be repeated",
)
NAME = option("--name", metavar="NAME", help="name of the vehicle (default: the airframe's)")


def layout(unnamed: str = "", default: str | None = None, *more: Option) -> Group:
    """Options of the airframe and its scale.

    Args:
        unnamed: what the command does without an airframe, in words.
        default: the airframe that it takes.
        more: of the same group.
    """
    words = "built-in name (paper, px4-quad-x, ...) or .toml file"
    words += f" ({unnamed})" if unnamed else ""
    airframe = AIRFRAME.but(default=default, help=words)
    return Group("vehicle and scale", (airframe, ARM, OneOf((MASS, K_T, T_MAX)), *more))


def airframe(unnamed: str = "", default: str | None = None) -> Group:
    """The same with priors."""
    return layout(unnamed, default, PRIOR)


REPORTED = "default auto: the layout in the vehicle's parameters"
"""What `airframe` says of commands that take the layout from the vehicle."""


def other_values(setting: Option) -> Group:
    """Options for what a result does not have."""
    return Group(
        "values that the flight did not identify",
        (
            setting,
            AIRFRAME.but(help="supplies [prior], scale, and rotors if the result has none"),
            ARM.but(
                type=positive, metavar="M", help="mean distance of the rotors from the center, m"
            ),
        ),
    )


SET = option("--set", action=AppendNamed, default=[])

# A link.
BAUD = option("--baud", type=baud, metavar="N", help="baud rate of serial ports")
RATE = option(
    "--rate",
    type=between(1.0, 2000.0, "Hz"),
    default=250.0,
    metavar="HZ",
    help="message rate to request (default 250)",
)
LINK = (
    BAUD.but(help="serial baud rate (default 115200); limits the message rates"),
    option("--listen-only", action="store_true", help="send nothing"),
    RATE,
    option(
        "--signing-key",
        metavar="FILE",
        help="MAVLink 2 signing: 32 bytes, 64 hexadecimal digits or a line with the passphrase; "
        "unsigned frames are rejected",
    ),
)
DURATION = option("--duration", type=positive, metavar="S", help="stop after S seconds")

# A session: where it is shown, what its coach aims at.
DISPLAY = (
    option("--headless", action="store_true", help="print instead of the screen"),
    option("--pilot", action="store_true", help="begin with the coach in large print"),
    OneOf(
        (
            option(
                "--speak",
                action="store_true",
                help="announce maneuvers, link and verdict by spd-say, espeak-ng or say, else the "
                "bell",
            ),
            option("--bell", action="store_true", help="ring the terminal's bell for them"),
        )
    ),
    option(
        "--web",
        nargs="?",
        type=web_address,
        const=LOCAL_PAGE,
        metavar="[HOST:]PORT",
        help="serve a page for browsers (default 8000, this machine only)",
    ),
    JSON.but(help="snapshots, one per line; - is stdout"),
    FORCE,
    BASELINE,
)
TARGET = option(
    "--target",
    type=percentage,
    default=0.02,
    metavar="P%",
    help="target 95 %% interval, relative to the value (default 2%%)",
)
COACH = Group(
    "flight coach",
    (
        TARGET,
        option(
            "--max-tilt",
            type=between(5.0, 45.0, "degrees"),
            default=20.0,
            metavar="DEG",
            help="roll and pitch limit (default 20)",
        ),
        option(
            "--max-rate",
            type=between(30.0, 600.0, "deg/s"),
            default=150.0,
            metavar="DEG_S",
            help="rate limit of each axis (default 150)",
        ),
        option(
            "--max-height",
            type=climb,
            default=1.0,
            metavar="M",
            help="climb and descent, 0.2 to 1; 0: none (default 1)",
        ),
    ),
)

# How something is computed.
SPEED = option("--speed", default="1")
SEED = option("--seed", type=int, default=1)
DRAWS = count(1, 10_000)
"""Parse function of how many vehicles are drawn from a covariance."""
SPAN = (
    option(
        "--start",
        type=not_negative,
        default=0.0,
        metavar="S",
        help="use the log from S seconds after its beginning (default 0)",
    ),
    option(
        "--end",
        type=positive,
        default=math.inf,
        metavar="S",
        help="use the log up to S seconds after its beginning (default: all of it)",
    ),
)
OFFLINE = option("--offline", action="store_true")
