"""The command line as data: what each command is for, and which options it has.

An `Option` holds what the parser needs of it. Those that several commands have stand first, once;
what a command says differently it says with `but`.

Parser, help, completion and the reference of the documentation follow from here. A command NAME
is run by `run` of the module `NAME_command`, which is imported only then: `--help` and `--version`
need neither NumPy nor Textual. To add a command: its row here, its module, its tests.
"""

import argparse
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gcs_sysid import __version__
from gcs_sysid.argument_types import (
    GIVEN,
    AppendNamed,
    OneLineParser,
    baud,
    between,
    change,
    climb,
    count,
    mass,
    not_negative,
    percentage,
    positive,
    prior,
    setting,
    uncertain_delay,
    uncertain_setting,
    vehicle_address,
    web_address,
)
from gcs_sysid.telemetry.log_formats import FORMATS, usual_endings


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

    `unnamed` is what the command does without an airframe, in words.
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


PROGRAM = "gcs-sysid"

ARTICLE_METHODS = ("article", "article-usual-td", "article-stepwise", "central-difference")
"""Names of `estimation.record.article_estimator.Method`; these and the next three are not
imported, to start fast (tests compare)."""
EXPORT_TARGETS = (
    "px4-sih", "px4-sih-1.17", "gazebo-sdf", "urdf", "mjcf", "rotorpy", "ardupilot-sitl",
    "crazyflow", "l2f", "indiflight", "paparazzi",
)  # fmt: skip
"""Names of `exports.FORMATS`."""
LAYOUTS = (
    "px4-quad-x", "ardupilot-quad-x", "px4-quad-plus", "ardupilot-quad-plus",
    "px4-hexa-x", "ardupilot-hexa-x", "px4-hexa-plus", "ardupilot-hexa-plus",
    "px4-octo-x", "ardupilot-octo-x", "px4-octo-plus", "ardupilot-octo-plus",
    "betaflight-quad-x",
)  # fmt: skip
"""Names of `setup_help.airframe_file.LAYOUTS`."""
ROTOR_INPUTS = ("speed", "command")
"""Values of `model.rotor_input.RotorInput`."""
SHELLS = ("bash", "zsh", "fish", "powershell")


@dataclass(frozen=True)
class Command:
    """A command, or an action of one.

    Attributes:
        name: as typed.
        summary: one line of the list of commands.
        description: what `--help` says.
        options: in the order of the help.
        actions: of a command that has some.
    """

    name: str
    summary: str
    description: str
    options: tuple[Option | OneOf | Group, ...] = ()
    actions: tuple["Command", ...] = ()


_AS_ANALYZE = "as for analyze"
BATTERY_MASS = option(
    "--battery-mass",
    "KG",
    "battery mass: shows how far to move it to center the CG",
    type=mass,
)
BASELINE_FLIGHT = BASELINE.but(
    "earlier flight, written by --json, to find a rotor that has weakened since "
    "(default: the first of several logs)",
    metavar="HEALTH.json",
)
UNCHANGED = option(
    "--unchanged",
    None,
    "nothing was moved or loaded since the baseline: a weak rotor is detected sooner",
    action="store_true",
)
HOVER_LOGS = (
    LOGS.but(f"{usual_endings()}, .csv; several: of one vehicle"),
    CSV,
    layout("default: by the vehicle's parameters or type", None, BATTERY_MASS),
    VEHICLE,
    BASELINE_FLIGHT,
    UNCHANGED,
)
"""Flights of one vehicle, and what is known of it."""
OF_HOVER = (*HOVER_LOGS, JSON.but("write the findings; - is stdout"))
"""What check and health ask for."""

COMMANDS = (
    Command(
        "demo",
        "fly the bundled emulator and identify it",
        "Starts the emulator and identifies it live. Ends with estimate, truth and error for every "
        "parameter.",
        (
            airframe("default paper", "paper"),
            SPEED.but("1: real time; max: as fast as possible", choices=("1", "max")),
            option(
                "--mission",
                None,
                "what the emulator flies: the article's maneuvers, every axis at once, or "
                "hover alone (default all-axes)",
                choices=("paper", "all-axes", "hover"),
                default="all-axes",
            ),
            option(
                "--noise",
                None,
                "sensor noise (default mems)",
                choices=("none", "paper", "white", "mems"),
                default="mems",
            ),
            option("--sigma", None, "noise of paper and white, rad and rad/s", type=not_negative),
            RATE.but("message rate of IMU and rotors (default 250)"),
            SEED.but("seed of all randomness (default 1)", metavar="N"),
            DURATION.but("length of the flight"),
            option("--mass-step", "T:FACTOR", "change the mass in flight"),
            RECORD.but("record the flight to a .tlog"),
            *DISPLAY,
            COACH,
        ),
    ),
    Command(
        "check",
        "LOG alone does: is it all right, what can be had?",
        "Says in one line whether the vehicle is all right, what to look at first, and what the "
        "flight shows; with --arm and --mass also the identification, where it carries one. "
        "gcs-sysid LOG is the same.",
        (
            *OF_HOVER,
            FORCE,
        ),
    ),
    Command(
        "live",
        "identify a vehicle while it flies",
        "Identifies live from a MAVLink link, such as udpin:0.0.0.0:14550, udpout:HOST:PORT, "
        "tcp:HOST:PORT or /dev/ttyUSB0.",
        (
            option("url", "URL", "such as udpin:0.0.0.0:14550"),
            airframe(REPORTED),
            RECORD,
            option("--no-record", None, "do not record", action="store_true"),
            *LINK,
            VEHICLE,
            DURATION,
            TRUTH,
            *DISPLAY,
            COACH,
        ),
    ),
    Command(
        "fetch",
        "copy a log from the vehicle",
        "Copies a log from PX4 or ArduPilot over a MAVLink link, by LOG_REQUEST_DATA or MAVLink "
        "FTP. The same command continues a transfer that was cut off. Nothing on the vehicle is "
        "changed.",
        (
            option("url", "URL", "such as /dev/ttyACM0 or udpin:0.0.0.0:14550"),
            OneOf(
                (
                    option("number", "NUMBER", "of the log", nargs="?", type=count(0, 65535)),
                    option("--last", None, "the latest log (default)", action="store_true"),
                    option("--list", None, "show which logs there are", action="store_true"),
                )
            ),
            option("-o, --output", "FILE", "default: named by number and time"),
            FORCE,
            BAUD.but("serial baud rate (default 115200)"),
            SIGNING_KEY,
            VEHICLE,
        ),
    ),
    Command(
        "analyze",
        "identify from recorded flights",
        f"Identifies from recordings: {'; '.join(row.words for row in FORMATS)}.",
        (
            LOGS.but(f"{usual_endings()}, .csv or .parquet file; several: each by itself"),
            CSV,
            airframe(REPORTED),
            JSON,
            option("--report", "FILE.html", "write an HTML report with figures"),
            FORCE,
            *SPAN,
            VEHICLE,
            TRUTH,
            option(
                "--added-mass",
                "KG",
                "set the scale from two flights, the second with KG of added mass",
                type=mass,
            ),
            OFFLINE.but(
                "prediction error over the whole record, with the Cramer-Rao bound (slower)"
            ),
            option(
                "--method",
                None,
                "forward: whitened rows, or the window for slow data (default); forward-td, "
                "forward-window: a tracking differentiator or the window throughout; others: the "
                "article's method and variants, for study",
                choices=("forward", "forward-td", "forward-window", *ARTICLE_METHODS),
                default="forward",
            ),
        ),
    ),
    Command(
        "replay",
        "watch a recorded flight",
        f"Plays a recording ({usual_endings()}) on the live screen in real time, ten times as "
        "fast or as fast as possible, with pause and seek. The final numbers are those of analyze.",
        (
            LOG,
            CSV,
            airframe(),
            VEHICLE,
            SPEED.but("initial speed (default 1)", choices=("1", "10", "max")),
            TRUTH,
            TARGET,
            *DISPLAY,
        ),
    ),
    Command(
        "inspect",
        "show what is in a log or on a link",
        f"Shows what is in a log ({usual_endings()}) or on a link: systems, messages, rates, "
        "gaps, clock, rotor input, motion, and whether the vehicle can be identified from it. On a "
        "link it requests streams as live does, and restores the rates.",
        (
            # Left out by `inspect --json LOG`, see the command.
            option("target", "LOG|URL", "a log, or a link such as udpin:0.0.0.0:14550", nargs="?"),
            CSV,
            JSON_INSTEAD,
            FORCE,
            VEHICLE,
            layout(
                "default: the rotors by the vehicle's type",
                None,
                option(
                    "--rotors",
                    "N",
                    "number of rotors, if neither --airframe nor the vehicle type defines it",
                    type=count(3, 32),
                ),
            ),
            Group(
                "link",
                (
                    DURATION.but(
                        "listen for S seconds after the first message of the vehicle (default 10)",
                        default=10.0,
                    ),
                    *LINK,
                ),
            ),
        ),
    ),
    Command(
        "health",
        "show CG, rotor loads and margins of any flight with a hover",
        "Shows center of gravity, thrust share of each rotor, margins and suitable autopilot "
        "parameters from any log with a hover, at any message rate. Without --airframe the rotor "
        "positions come from the log.",
        (
            *OF_HOVER,
            option(
                "--params",
                "FILE",
                "autopilot parameters to set, as `params -o` writes them; nothing is sent",
            ),
            option("--picture", "FILE.svg", "the vehicle from above, on a page"),
            FORCE,
        ),
    ),
    Command(
        "params",
        "say which autopilot parameters to set, and which to leave",
        "Says of every autopilot parameter that flights of one vehicle show what it was, what it "
        "should be, and whether to set it or to leave it, or what to fly to know. It is set only "
        "where the truth is surely nearer to the new value. Nothing is sent to a vehicle.",
        (
            *HOVER_LOGS,
            JSON.but("write the proposals; - is stdout"),
            OUTPUT.but(
                "what is to be set, to load by hand: .params for QGroundControl, .param for "
                "Mission Planner, .txt for Betaflight's command line",
                metavar="FILE",
            ),
            FORCE,
        ),
    ),
    Command(
        "plan",
        "plan a flight",
        "Plans a flight: maneuvers, duration and expected accuracy. Nothing is sent to a vehicle.",
        (
            airframe(),
            option(
                "--rotor-input",
                None,
                "rotor telemetry to plan for (default: the airframe's, else speed)",
                choices=ROTOR_INPUTS,
            ),
            JSON_INSTEAD.but(
                "print JSON instead of text, or also write it to FILE; sim-bridge --mission "
                "FILE flies it"
            ),
            option("--svg", "FILE", "write a picture of the motion"),
            FORCE,
            COACH,
        ),
    ),
    Command(
        "export",
        "write an identified vehicle for a simulator, or a flight's signals",
        "Writes a result as a file for a simulator (PX4's SIH, ArduPilot's SITL, Gazebo, MuJoCo, "
        "RotorPy, crazyflow, l2f), as URDF, or as effectiveness for INDI; also as an ensemble "
        "drawn from its covariance. With --signals, the aligned signals and residuals of a log as "
        "a table.",
        (
            RESULT.but("written by --json; with --signals, a log", metavar="RESULT.json|LOG"),
            option("--to", None, "target format", choices=EXPORT_TARGETS),
            OUTPUT,
            option(
                "--along",
                "LOG",
                "with px4-sih or ardupilot-sitl: also the way of this log's flight as a mission, "
                "FILE with the ending .plan, to be flown there",
            ),
            FORCE.but("overwrite FILE"),
            Group(
                "signals of a flight, instead of a vehicle",
                (
                    option(
                        "--signals",
                        "FILE",
                        "write aligned signals and residuals of LOG, as .csv, .parquet or "
                        ".mcap, for PlotJuggler, Foxglove or MATLAB; needs --airframe and a scale",
                    ),
                    CSV,
                    VEHICLE,
                    OneOf(tuple(each.but(_AS_ANALYZE) for each in (MASS, K_T, T_MAX))),
                ),
            ),
            NAME,
            option(
                "--ensemble",
                "N",
                "N vehicles drawn from the covariance, as FILE-001, FILE-002, ...",
                type=DRAWS,
            ),
            SEED.but("seed of --ensemble (default 1)"),
            other_values(
                SET.but(
                    "a value from elsewhere, SI, such as rotor_speed_max=900 or Ixy=0; may be "
                    "repeated",
                    type=setting,
                    metavar="NAME=VALUE",
                )
            ),
        ),
    ),
    Command(
        "tune",
        "show margins of the autopilot's gains, and propose gains",
        "Shows phase and gain margins of the present gains of PX4, ArduPilot, Betaflight or INAV, "
        "over the uncertainty of the result, and proposes gains, as a file for QGroundControl or "
        "Mission Planner, or for a CLI. Nothing is sent to a vehicle.",
        (
            RESULT,
            option(
                "parameters",
                "LOG|PARAMETERS",
                "log, .params or .param file with the autopilot's parameters: its gains and "
                "filters; the response of a log's flight is compared with the model",
                nargs="?",
            ),
            option(
                "--with",
                "RESULT2.json",
                "second result of the same flight, from commands if the first is from rotor "
                "speeds; supplies what the first lacks",
                dest="beside",
            ),
            option(
                "--autopilot",
                None,
                "default: the vehicle's",
                choices=("px4", "ardupilot", "betaflight", "inav", "betaflight-adrc"),
            ),
            option(
                "--delay",
                "S[±STD]",
                "delay from gyro sample to rotor command (default: as identified, else 5 ms)",
                type=uncertain_delay,
            ),
            JSON.but("write margins and gains; - is stdout"),
            option(
                "--what-if",
                "CHANGE",
                "try along the log's rate set-points: payload=KG[@X,Y,Z] (m forward, right, below "
                "the CG), thrust=SHARE, gains=FILE or gains=proposed (default); may be repeated",
                type=change,
                action=AppendNamed,
                default=[],
            ),
            option("--bode", "FILE.svg", "Bode diagram and what-if with the 95 %% band"),
            option(
                "--to",
                None,
                "format of -o: gains, G1 and G2 of INDI (Indiflight, Paparazzi), or the measured "
                "response as a table",
                choices=(
                    "px4-params",
                    "ardupilot-param",
                    "betaflight-cli",
                    "inav-cli",
                    "indi",
                    "paparazzi",
                    "betaflight-adrc",
                    "frequency-response",
                ),
            ),
            OUTPUT.but("file for a ground station, or .csv"),
            FORCE,
            option("--draws", "N", "vehicles drawn (default 100)", type=DRAWS, default=100),
            SEED.but("seed of the draws (default 1)"),
            VEHICLE.but("whose parameters, if several are in the log"),
            NAME,
            other_values(
                SET.but(
                    "a value from elsewhere, SI, such as motor_lag=0.03+-0.005; may be repeated",
                    type=uncertain_setting,
                    metavar="NAME=VALUE[±STD]",
                )
            ),
        ),
    ),
    Command(
        "compare",
        "test whether a vehicle has changed",
        "Compares two results of one vehicle, parameter by parameter.",
        (
            option("before", "A.json", "result written by --json"),
            option("after", "B.json", "another result of the same vehicle"),
            JSON.but("write the comparison; - is stdout"),
            FORCE,
        ),
    ),
    Command(
        "twin",
        "fly the identified model beside the vehicle",
        "Flies the identified model with a log's inputs, from the measured state, over held-out "
        "stretches of 0.1, 0.3, 1 and 3 s, and compares its errors in rates, attitude and velocity "
        "with the predicted band and with constant rates. Without --airframe, vehicle and scale "
        "are those of the result.",
        (
            RESULT.but("result written by --json, or another log of the vehicle", metavar="RESULT"),
            LOG.but("flight to fly the model along"),
            JSON.but("write the errors; - is stdout"),
            option("--picture", "FILE.svg", "draw how the errors grow"),
            FORCE,
            airframe("default: the result's; auto: the layout in the vehicle's parameters"),
            VEHICLE,
            SEED.but(
                "seed of the vehicles drawn from the covariance (default 0)", default=0, metavar="N"
            ),
        ),
    ),
    Command(
        "batch",
        "identify from many logs",
        "Identifies from every log in files and folders, in parallel: one result per log, and a "
        "Parquet table of all. Run again, it resumes. Without --airframe each log uses the nearest "
        "airframe.toml, beside it or in a folder above.",
        (
            LOGS.but("a log, or a folder searched for logs", metavar="PATH"),
            CSV,
            OUTPUT.but("folder for results and table", metavar="DIR", required=True),
            FORCE.but("redo every log and overwrite existing files"),
            OneOf(
                (
                    option(
                        "--workers",
                        "N",
                        "number of processes (default: one per processor)",
                        type=count(1, 1024),
                    ),
                    option(
                        "--scheduler", "URL", "run on a Dask cluster, such as tcp://10.0.0.1:8786"
                    ),
                )
            ),
            option(
                "--log-timeout",
                "S",
                "time limit for one log (default 1800)",
                type=between(0.01, 1e6, "s"),
                default=1800.0,
            ),
            option(
                "--log-memory",
                "MB",
                "memory limit for one log, on Linux (default 4000)",
                type=between(10.0, 1e6, "MB"),
                default=4000.0,
            ),
            airframe("default: the nearest airframe.toml"),
            VEHICLE,
            OFFLINE.but("prediction error over whole records (slower)"),
        ),
    ),
    Command(
        "trend",
        "show how a fleet changes from flight to flight",
        "Writes an HTML page of a batch: the parameters of every vehicle over its flights, and "
        "where they changed.",
        (
            option("fleet", "DIR|FILE.parquet", "output of batch"),
            OUTPUT.but("output file", metavar="FILE.html", required=True),
            FORCE.but("overwrite FILE"),
        ),
    ),
    Command(
        "web",
        "analyze logs on a page in the browser",
        "Serves a page: drop a log on it, check the proposed airframe, enter the mass, read the "
        "report; compare two results. Works offline. Prints the address, which contains the access "
        "token.",
        (
            option(
                "address",
                "[HOST:]PORT",
                "address to serve on (default 8000, this machine only)",
                nargs="?",
                type=web_address,
                default=LOCAL_PAGE,
            ),
        ),
    ),
    Command(
        "airframe",
        "write or check the airframe file of a vehicle",
        "Writes or checks an airframe file, which holds the rotor positions.",
        actions=(
            Command(
                "new",
                "write an airframe file, from questions or options",
                "Writes an airframe file. Asks for what the options do not give; with --layout and "
                "--arm (or --rotor) and --output it asks nothing.",
                (
                    option("--layout", "NAME", ", ".join(LAYOUTS[::2]), choices=LAYOUTS),
                    ARM.but(
                        "m from the center to each motor; X,Y for a quad X that is not square",
                        type=None,
                        metavar="M",
                    ),
                    option(
                        "--rotor",
                        "SPIN:X,Y",
                        "a motor of a custom layout, such as cw:0.2,-0.2: m forward and "
                        "right; repeat in motor order",
                        action="append",
                        default=[],
                    ),
                    option("--spin", "LIST", "reversed, or the spin of each motor: ccw,ccw,cw,cw"),
                    OneOf(
                        (
                            MASS.but("weighed mass", type=mass, metavar="KG"),
                            K_T.but("known k_T", type=positive, metavar="N_S2"),
                            T_MAX.but("known thrust of a rotor", type=positive, metavar="N"),
                        )
                    ),
                    option(
                        "--imu",
                        "X,Y,Z",
                        "IMU position, m forward, right, down of the center: --imu=-0.02,0,0",
                    ),
                    PRIOR.but("prior; may be repeated"),
                    NAME.but("name of the vehicle (default: the file's name)", metavar=None),
                    OUTPUT.but(metavar="FILE.toml"),
                    FORCE,
                ),
            ),
            Command(
                "check",
                "draw an airframe and check it",
                "Draws the rotors of an airframe and lists what looks wrong.",
                (
                    option(
                        "file", "FILE", "airframe file, or a built-in airframe's name", type=Path
                    ),
                    option("--json", None, "findings as JSON", action="store_true"),
                ),
            ),
        ),
    ),
    Command(
        "doctor",
        "check this computer and listen for MAVLink vehicles",
        "Checks versions, ports, serial devices, terminal and recording folder, and listens for "
        "vehicles. Sends nothing. Exit status 1 if there is a problem.",
        (
            option("urls", "URL", "also listen here, such as /dev/ttyUSB0", nargs="*"),
            BAUD,
            DURATION.but("listen for S seconds (default 3); nothing is sent", default=3.0),
            option("--json", None, "findings as JSON on standard output", action="store_true"),
        ),
    ),
    Command(
        "completion",
        "tab completion for bash, zsh, fish and PowerShell",
        'Prints a script for the shell. bash: eval "$(gcs-sysid completion bash)" in ~/.bashrc; '
        "zsh: the same in ~/.zshrc, after compinit; fish: gcs-sysid completion fish > "
        "~/.config/fish/completions/gcs-sysid.fish; PowerShell, in $PROFILE: gcs-sysid completion "
        "powershell | Out-String | Invoke-Expression",
        (option("shell", "|".join(SHELLS), "shell", choices=SHELLS),),
    ),
)


def build_parser() -> argparse.ArgumentParser:
    """The whole command line."""
    parser = OneLineParser(
        prog=PROGRAM,
        description="Identify a multirotor's mass properties and rotor coefficients from "
        "MAVLink: live, or from a recorded flight.",
        epilog=f"Start with:  {PROGRAM} demo",
    )
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {__version__}")
    _add_commands(parser.add_subparsers(dest="command", metavar="COMMAND"), COMMANDS)
    return parser


def _add_commands(parsers: "argparse._SubParsersAction[Any]", commands: Iterable[Command]) -> None:
    for command in commands:
        parser = parsers.add_parser(
            command.name, help=command.summary, description=command.description
        )
        _add_options(parser, command.options)
        if command.actions:
            actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
            _add_commands(actions, command.actions)


def _add_options(
    place: argparse._ActionsContainer, options: Iterable[Option | OneOf | Group]
) -> None:
    for each in options:
        if isinstance(each, Option):
            place.add_argument(*each.names, **each.settings)
        elif isinstance(each, OneOf):
            _add_options(place.add_mutually_exclusive_group(), each.options)
        else:
            _add_options(place.add_argument_group(each.title), each.options)
