"""Parsing, what `gcs-sysid` alone shows, and errors turned into one line and an exit status.

Each command's module is imported only when that command runs, so that `--help` and `--version`
need neither NumPy nor Textual.
"""

import argparse
import errno
import importlib
import os
import sys
from collections.abc import Iterator, Sequence

from gcs_sysid import __version__
from gcs_sysid.argument_types import OneLineParser
from gcs_sysid.cli import arguments, option_groups
from gcs_sysid.cli.output import abandon_stdout, is_full, say, show
from gcs_sysid.errors import GcsSysidError
from gcs_sysid.files import never_fail_to_print
from gcs_sysid.sanitize import one_line

PROGRAM = "gcs-sysid"
DONE, NO_ANSWER, USAGE = 0, 1, 2
"""Exit statuses: done; the data do not allow an answer; wrong usage, unreadable input or a defect.
A command that Ctrl-C ended at once has 130; see also `output.BY_SIGNAL`."""


_BRITISH = {"analyse": "analyze"}
"""Commands that some spell otherwise."""


def build_parser() -> argparse.ArgumentParser:
    """The whole command line."""
    parser = OneLineParser(
        prog=PROGRAM,
        description="Identify a multirotor's mass properties and rotor coefficients from "
        "MAVLink: live, or from a recorded flight.",
        epilog=f"Start with:  {PROGRAM} demo",
    )
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")

    demo = commands.add_parser(
        "demo",
        help="fly the bundled emulator and identify it",
        description="Starts the emulator and identifies it live. Ends with estimate, truth and "
        "error for every parameter.",
    )
    arguments.add_demo(demo)
    live = commands.add_parser(
        "live",
        help="identify a vehicle while it flies",
        description="Identifies live from a MAVLink link, such as udpin:0.0.0.0:14550, "
        "udpout:HOST:PORT, tcp:HOST:PORT or /dev/ttyUSB0.",
    )
    arguments.add_live(live)
    analyze = commands.add_parser(
        "analyze",
        help="identify from recorded flights",
        description="Identifies from recordings: .tlog of a ground station, .ulg of PX4, .bin of "
        "ArduPilot, .bbl of Betaflight, INAV or Indiflight.",
    )
    arguments.add_analyze(analyze)
    replay = commands.add_parser(
        "replay",
        help="watch a recorded flight",
        description="Plays a recording (.tlog, .ulg, .bin, .bbl) on the live screen in real time, "
        "ten times as fast or as fast as possible, with pause and seek. The final numbers are "
        "those of analyze.",
    )
    arguments.add_replay(replay)
    inspect = commands.add_parser(
        "inspect",
        help="show what is in a log or on a link",
        description="Shows what is in a log (.tlog, .ulg, .bin, .bbl) or on a link: systems, "
        "messages, rates, gaps, clock, rotor input, motion, and whether the vehicle can be "
        "identified from it. On a link it requests streams as live does, and restores the rates.",
    )
    arguments.add_inspect(inspect)
    health = commands.add_parser(
        "health",
        help="show CG, rotor loads and margins of any flight with a hover",
        description="Shows center of gravity, thrust share of each rotor, margins and suitable "
        "autopilot parameters from any log with a hover, at any message rate. Without --airframe "
        "the rotor positions come from the log.",
    )
    arguments.add_health(health)
    plan = commands.add_parser(
        "plan",
        help="plan a flight",
        description="Plans a flight: maneuvers, duration and expected accuracy. Nothing is sent "
        "to a vehicle.",
    )
    arguments.add_plan(plan)
    export = commands.add_parser(
        "export",
        help="write an identified vehicle for a simulator, or a flight's signals",
        description="Writes a result as a file for a simulator (PX4's SIH, ArduPilot's SITL, "
        "Gazebo, MuJoCo, RotorPy, crazyflow, l2f), as URDF, or as effectiveness for INDI; also as "
        "an ensemble drawn from its covariance. With --signals, the aligned signals and residuals "
        "of a log as a table.",
    )
    arguments.add_export(export)
    tune = commands.add_parser(
        "tune",
        help="show margins of the autopilot's gains, and propose gains",
        description="Shows phase and gain margins of the present gains of PX4 or ArduPilot, over "
        "the uncertainty of the result, and proposes gains, as a file for QGroundControl or "
        "Mission Planner. Nothing is sent to a vehicle.",
    )
    option_groups.add_tune(tune)
    compare = commands.add_parser(
        "compare",
        help="test whether a vehicle has changed",
        description="Compares two results of one vehicle, parameter by parameter.",
    )
    arguments.add_compare(compare)
    twin = commands.add_parser(
        "twin",
        help="fly the identified model beside the vehicle",
        description="Flies the identified model with a log's inputs, from the measured state, over "
        "held-out stretches of 0.1, 0.3, 1 and 3 s, and compares its errors in rates, attitude and "
        "velocity with the predicted band and with constant rates. Without --airframe, vehicle "
        "and scale are those of the result.",
    )
    arguments.add_twin(twin)
    batch = commands.add_parser(
        "batch",
        help="identify from many logs",
        description="Identifies from every log in files and folders, in parallel: one result per "
        "log, and a Parquet table of all. Run again, it resumes. Without --airframe each "
        "log uses the nearest airframe.toml, beside it or in a folder above.",
    )
    arguments.add_batch(batch)
    trend = commands.add_parser(
        "trend",
        help="show how a fleet changes from flight to flight",
        description="Writes an HTML page of a batch: the parameters of every vehicle over its "
        "flights, and where they changed.",
    )
    arguments.add_trend(trend)
    web = commands.add_parser(
        "web",
        help="analyze logs on a page in the browser",
        description="Serves a page: drop a log on it, check the proposed airframe, enter the "
        "mass, read the report; compare two results. Works offline. Prints the address, which "
        "contains the access token.",
    )
    arguments.add_web(web)
    airframe = commands.add_parser(
        "airframe",
        help="write or check the airframe file of a vehicle",
        description="Writes or checks an airframe file, which holds the rotor positions.",
    )
    option_groups.add_airframe(airframe)
    doctor = commands.add_parser(
        "doctor",
        help="check this computer and listen for MAVLink vehicles",
        description="Checks versions, ports, serial devices, terminal and recording folder, and "
        "listens for vehicles. Sends nothing. Exit status 1 if there is a problem.",
    )
    option_groups.add_doctor(doctor)
    completion = commands.add_parser(
        "completion",
        help="tab completion for bash, zsh, fish and PowerShell",
        description='Prints a script for the shell. bash: eval "$(gcs-sysid completion bash)" '
        "in ~/.bashrc; zsh: the same in ~/.zshrc, after compinit; fish: gcs-sysid completion "
        "fish > ~/.config/fish/completions/gcs-sysid.fish; PowerShell, in $PROFILE: "
        "gcs-sysid completion powershell | Out-String | Invoke-Expression",
    )
    option_groups.add_completion(completion)
    return parser


def run(argv: Sequence[str]) -> int:
    """Parse and run; errors become one line on standard error and a status."""
    never_fail_to_print()
    try:
        status = _run(argv)
        sys.stdout.flush()
        return status
    except GcsSysidError as error:
        say(f"{PROGRAM}: error: {error}")
        return USAGE
    except KeyboardInterrupt:
        return 130
    except Exception as error:
        if _reader_has_gone(error):
            abandon_stdout()
            return DONE
        if is_full(error):
            where = "standard output: " if _stdout_is_full() else ""
            say(f"{PROGRAM}: error: {where}cannot write: {error.strerror}")
            return USAGE
        if isinstance(error, MemoryError):
            say(f"{PROGRAM}: error: not enough memory for this")
            return USAGE
        if isinstance(error, ModuleNotFoundError) and error.name and _is_foreign(error.name):
            say(
                f"{PROGRAM}: error: the Python package {error.name} is not installed; "
                f"pip install {PROGRAM} brings it (--headless and notebooks need no screen)"
            )
            return USAGE
        # A defect. The user gets one line; GCS_SYSID_DEBUG gives the traceback.
        if os.environ.get("GCS_SYSID_DEBUG"):
            raise
        if isinstance(error, OSError) and error.filename is not None:
            # The machine's: a folder that may not be looked into, a name that is too long.
            said = one_line(f"{error.filename}: {error.strerror}")
            say(f"{PROGRAM}: error: {said}")
            return USAGE
        kind = type(error).__name__
        say(
            f"{PROGRAM}: error: internal error ({kind}: {one_line(str(error))}); "
            "please report it, with GCS_SYSID_DEBUG=1 set"
        )
        return USAGE


def _is_foreign(module: str) -> bool:
    """Whether a module is another project's, which an installation may lack."""
    return module.partition(".")[0] not in ("gcs_sysid", "sim_bridge")


def _stdout_is_full() -> bool:
    """Whether something waits there that cannot be written; it is given up."""
    try:
        sys.stdout.flush()
    except OSError:
        abandon_stdout()
        return True
    return False


def _run(argv: Sequence[str]) -> int:
    parser = build_parser()
    try:
        options = parser.parse_args([_BRITISH.get(argv[0], argv[0]), *argv[1:]] if argv else argv)
    except SystemExit as stop:  # argparse has printed its line
        return stop.code if isinstance(stop.code, int) else USAGE
    options.argv = (PROGRAM, *argv)
    if options.command is None:
        show(welcome(parser))
        return DONE
    arguments.with_mappings(options)
    command = importlib.import_module(f"gcs_sysid.cli.{options.command}_command")
    status: int = command.run(options)
    return status


def _reader_has_gone(error: Exception) -> bool:
    """Whether standard output leads nowhere any more; Windows has another error for it."""
    if isinstance(error, BrokenPipeError):
        return True
    if type(error) is OSError and error.errno == errno.EIO and error.filename is None:
        return True  # a terminal that was closed
    return os.name == "nt" and type(error) is OSError and error.errno == errno.EINVAL


def welcome(parser: argparse.ArgumentParser) -> str:
    """One screen of 80 columns.

    Args:
        parser: the whole command line; its commands are listed.
    """
    commands = "\n".join(f"  {name:<12}{what}" for name, what in commands_of(parser))
    return f"""\
gcs-sysid {__version__} identifies a multirotor from MAVLink, in flight or recorded.
Try the emulator, then your vehicle (--arm: m, center to motor; --mass: kg):
  gcs-sysid demo
  gcs-sysid live udpin:0.0.0.0:14550 --airframe px4-quad-x --arm 0.25 --mass 1.5
Commands
{commands}

Options: gcs-sysid COMMAND --help. No vehicle found? gcs-sysid doctor"""


def commands_of(parser: argparse.ArgumentParser) -> Iterator[tuple[str, str]]:
    """Name and one line of every command of a parser, in the order of its help."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for entry in action._choices_actions:
                yield entry.dest, entry.help or ""
