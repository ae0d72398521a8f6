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
from gcs_sysid.telemetry.log_formats import usual_endings


@dataclass(frozen=True)
class Option:
    """An option, or an argument without dashes.

    Attributes:
        names: as typed: `-o`, `--output`; of an argument, the name that its value goes by.
        settings: the rest of what `ArgumentParser.add_argument` takes: type, default, help ...
    """

    names: tuple[str, ...]
    settings: Mapping[str, Any]

    def but(self, help: str | None = None, **settings: Any) -> "Option":
        """The same with another help or other settings."""
        if help is not None:
            settings["help"] = help
        return Option(self.names, {**self.settings, **settings})


def option(names: str, metavar: str | None, help: str, **settings: Any) -> Option:
    """An option.

    Args:
        names: as typed, such as "-o, --output"; of an argument, the name that its value goes by.
        metavar: what stands for its value in the help; None: its name or choices.
        help: in a phrase.
        settings: the rest of what `ArgumentParser.add_argument` takes.
    """
    if metavar is not None:
        settings["metavar"] = metavar
    return Option(tuple(names.split(", ")), {"help": help, **settings})


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
LOG = option("log", "LOG", f"a {usual_endings()} or .csv file")
LOGS = option("logs", "LOG", "", nargs="+")
RESULT = option("result", "RESULT.json", "written by --json")
CSV = option(
    "--csv",
    "MAPPING.toml",
    "what the columns of .csv and .parquet LOGs mean (default: columns.toml beside them)",
)
VEHICLE = option(
    "--vehicle",
    "SYSID[:COMPID]",
    "if there are several (default: the first autopilot received)",
    type=vehicle_address,
)
TRUTH = option("--truth", "FILE", "true parameters, shown beside the estimates")
BASELINE = option("--baseline", "RESULT.json", "earlier result to compare with on the screen")

# What is written.
JSON = option("--json", "FILE", "write the result; - is stdout")
JSON_INSTEAD = option(
    "--json", "FILE", "print JSON instead of text, or also write it to FILE", nargs="?", const="-"
)
FORCE = option("--force", None, "overwrite existing files", action="store_true")
OUTPUT = option("-o, --output", "FILE", "output file; - is stdout")
RECORD = option("--record", "FILE", "default: a dated .tlog under logs/")

# The vehicle and its scale.
AIRFRAME = option("--airframe", "NAME|FILE", "")
ARM = option(
    "--arm",
    "M[±STD]",
    "mean distance of the rotors from the center, m (or 110mm); here and below "
    "+- adds a standard deviation: 0.25+-0.003 or 0.25+-1%% (default 1%%)",
    type=GIVEN["arm"],
)
MASS = option(
    "--mass", "KG[±STD]", "weighed mass as the scale (default +-0.5%%)", type=GIVEN["mass"]
)
K_T = option("--k-t", "N_S2[±STD]", "known k_T as the scale (default +-2%%)", type=GIVEN["k_T"])
T_MAX = option(
    "--t-max",
    "N[±STD]",
    "known thrust of a rotor at full command (default +-2%%)",
    type=GIVEN["T_max"],
)
PRIOR = option(
    "--prior",
    "NAME=VALUE±STD",
    "prior, such as k_M=6.1e-6+-1e-7 from a bench test; may be repeated",
    type=prior,
    action=AppendNamed,
    default=[],
)
NAME = option("--name", "NAME", "name of the vehicle (default: the airframe's)")


def layout(unnamed: str = "", default: str | None = None, *more: Option) -> Group:
    """Options of the airframe and its scale.

    Args:
        unnamed: what the command does without an airframe, in words.
        default: the airframe that it takes.
        more: of the same group.
    """
    words = "built-in name (paper, px4-quad-x, ...) or .toml file"
    words += f" ({unnamed})" if unnamed else ""
    airframe = AIRFRAME.but(words, default=default)
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
            AIRFRAME.but("supplies [prior], scale, and rotors if the result has none"),
            ARM.but("mean distance of the rotors from the center, m", type=positive, metavar="M"),
        ),
    )


SET = option("--set", None, "", action=AppendNamed, default=[])

# A link.
BAUD = option("--baud", "N", "baud rate of serial ports", type=baud)
RATE = option(
    "--rate",
    "HZ",
    "message rate to request (default 250)",
    type=between(1.0, 2000.0, "Hz"),
    default=250.0,
)
SIGNING_KEY = option(
    "--signing-key",
    "FILE",
    "MAVLink 2 signing: 32 bytes, 64 hexadecimal digits or a line with the passphrase; "
    "unsigned frames are rejected",
)
LINK = (
    BAUD.but("serial baud rate (default 115200); limits the message rates"),
    option("--listen-only", None, "send nothing", action="store_true"),
    RATE,
    SIGNING_KEY,
)
DURATION = option("--duration", "S", "stop after S seconds", type=positive)

# A session: where it is shown, what its coach aims at.
DISPLAY = (
    option("--headless", None, "print instead of the screen", action="store_true"),
    option("--pilot", None, "begin with the coach in large print", action="store_true"),
    OneOf(
        (
            option(
                "--speak",
                None,
                "announce maneuvers, link and verdict by spd-say, espeak-ng or say, else the bell",
                action="store_true",
            ),
            option("--bell", None, "ring the terminal's bell for them", action="store_true"),
        )
    ),
    option(
        "--web",
        "[HOST:]PORT",
        "serve a page for browsers (default 8000, this machine only)",
        nargs="?",
        type=web_address,
        const=LOCAL_PAGE,
    ),
    JSON.but("snapshots, one per line; - is stdout"),
    FORCE,
    BASELINE,
)
TARGET = option(
    "--target",
    "P%",
    "target 95 %% interval, relative to the value (default 2%%)",
    type=percentage,
    default=0.02,
)
COACH = Group(
    "flight coach",
    (
        TARGET,
        option(
            "--max-tilt",
            "DEG",
            "roll and pitch limit (default 20)",
            type=between(5.0, 45.0, "degrees"),
            default=20.0,
        ),
        option(
            "--max-rate",
            "DEG_S",
            "rate limit of each axis (default 150)",
            type=between(30.0, 600.0, "deg/s"),
            default=150.0,
        ),
        option(
            "--max-height",
            "M",
            "climb and descent, 0.2 to 1; 0: none (default 1)",
            type=climb,
            default=1.0,
        ),
    ),
)

# How something is computed.
SPEED = option("--speed", None, "", default="1")
SEED = option("--seed", None, "", type=int, default=1)
DRAWS = count(1, 10_000)
"""Parse function of how many vehicles are drawn from a covariance."""
SPAN = (
    option(
        "--start",
        "S",
        "use the log from S seconds after its beginning (default 0)",
        type=not_negative,
        default=0.0,
    ),
    option(
        "--end",
        "S",
        "use the log up to S seconds after its beginning (default: all of it)",
        type=positive,
        default=math.inf,
    ),
)
OFFLINE = option("--offline", None, "", action="store_true")
