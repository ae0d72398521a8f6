"""Parsing, what `gcs-sysid` alone shows, and errors turned into one line and an exit status."""

import argparse
import errno
import importlib
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from gcs_sysid import __version__
from gcs_sysid.cli.commands import COMMANDS, PROGRAM, build_parser
from gcs_sysid.cli.output import abandon_stdout, is_full, say, show
from gcs_sysid.errors import GcsSysidError, InputError
from gcs_sysid.files import never_fail_to_print, with_mapping
from gcs_sysid.sanitize import one_line

DONE, NO_ANSWER, USAGE = 0, 1, 2
"""Exit statuses: done; the data do not allow an answer; wrong usage, unreadable input or a defect.
A command that Ctrl-C ended at once has 130; see also `output.BY_SIGNAL`."""


_BRITISH = {"analyse": "analyze"}
"""Commands that some spell otherwise."""


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
        show(welcome())
        return DONE
    _name_mappings(options)
    command = importlib.import_module(f"gcs_sysid.cli.{options.command}_command")
    status: int = command.run(options)
    return status


def _name_mappings(options: argparse.Namespace) -> None:
    """Name the mapping of `--csv` with each table among the logs."""
    if getattr(options, "csv", None) is None:
        return
    mapping = Path(options.csv)
    if not mapping.is_file():
        raise InputError(f"--csv {mapping}: no such file")
    for name in ("logs", "log", "target", "result"):
        given = getattr(options, name, None)
        if isinstance(given, list):
            setattr(options, name, [str(with_mapping(Path(log), mapping)) for log in given])
        elif given:
            setattr(options, name, str(with_mapping(Path(given), mapping)))


def _reader_has_gone(error: Exception) -> bool:
    """Whether standard output leads nowhere any more; Windows has another error for it."""
    if isinstance(error, BrokenPipeError):
        return True
    if type(error) is OSError and error.errno == errno.EIO and error.filename is None:
        return True  # a terminal that was closed
    return os.name == "nt" and type(error) is OSError and error.errno == errno.EINVAL


def welcome() -> str:
    """One screen of 80 columns."""
    commands = "\n".join(f"  {command.name:<12}{command.summary}" for command in COMMANDS)
    return f"""\
gcs-sysid {__version__} identifies a multirotor from MAVLink, in flight or recorded.
Try the emulator, then your vehicle (--arm: m, center to motor; --mass: kg):
  gcs-sysid demo
  gcs-sysid live udpin:0.0.0.0:14550 --airframe px4-quad-x --arm 0.25 --mass 1.5
Commands
{commands}

Options: gcs-sysid COMMAND --help. No vehicle found? gcs-sysid doctor"""
