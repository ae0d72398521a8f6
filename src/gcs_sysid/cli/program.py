"""Parsing, what `gcs-sysid` alone shows, and errors turned into one line and an exit status."""

import argparse
import importlib
import sys
from collections.abc import Sequence
from pathlib import Path

from gcs_sysid import __version__
from gcs_sysid.cli.commands import COMMANDS, PROGRAM, build_parser
from gcs_sysid.cli.failures import failure_line, is_debugged, reader_has_gone
from gcs_sysid.cli.output import abandon_stdout, say, show
from gcs_sysid.errors import InputError
from gcs_sysid.files import TABLE_SUFFIXES, log_file, never_fail_to_print, with_mapping
from gcs_sysid.telemetry.log_formats import ANY_SUFFIX

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
    except KeyboardInterrupt:
        return 130
    except Exception as error:
        if reader_has_gone(error):
            abandon_stdout()
            return DONE
        if is_debugged(error):
            raise
        say(failure_line(error))
        return USAGE


def _run(argv: Sequence[str]) -> int:
    parser = build_parser()
    try:
        options = parser.parse_args(with_command(argv))
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


def with_command(argv: Sequence[str]) -> list[str]:
    """The words with their command: a log alone is to be checked."""
    if not argv:
        return []
    first = _BRITISH.get(argv[0], argv[0])
    if first in {command.name for command in COMMANDS}:
        return [first, *argv[1:]]
    # What is no log at the front is a misspelt command.
    alone = any(map(_is_log, argv)) if argv[0].startswith("-") else _is_log(argv[0])
    return ["check", *argv] if alone else [first, *argv[1:]]


def _is_log(word: str) -> bool:
    """Whether a word is a file or folder, or was meant to be a log."""
    path = log_file(Path(word))
    return path.exists() or path.suffix.lower() in ANY_SUFFIX | TABLE_SUFFIXES


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


def welcome() -> str:
    """One screen of 80 columns."""
    commands = "\n".join(f"  {command.name:<12}{command.summary}" for command in COMMANDS)
    return f"""\
gcs-sysid {__version__} identifies a multirotor from MAVLink, in flight or recorded.
Try demo, then a log of yours and your vehicle (m from center to motor, kg):
  gcs-sysid flight.bin --arm 0.25 --mass 1.5
  gcs-sysid live udpin:0.0.0.0:14550 --airframe px4-quad-x --arm 0.25 --mass 1.5
Commands (options: gcs-sysid COMMAND --help; no vehicle found: gcs-sysid doctor)
{commands}"""
