"""Parsing, what `gcs-sysid` alone shows, and errors turned into one line and an exit status.

Of the logs of one call, none takes the others with it.
"""

import argparse
import contextlib
import errno
import importlib
import os
import sys
from collections.abc import Iterator, Sequence, Sized
from pathlib import Path

from gcs_sysid import __version__
from gcs_sysid.cli.commands import COMMANDS, PROGRAM, build_parser
from gcs_sysid.cli.output import abandon_stdout, is_full, say, show
from gcs_sysid.errors import GcsSysidError, InputError, in_words, one_line
from gcs_sysid.files import TABLE_SUFFIXES, log_file, never_fail_to_print, with_mapping
from gcs_sysid.telemetry.log_formats import ANY_SUFFIX


def failure_line(error: Exception, log: str = "") -> str:
    """The line that reports a failure to a user.

    Args:
        error: a refusal, what the machine lacks, or a defect.
        log: it happened with; a refusal names it itself.
    """
    if isinstance(error, GcsSysidError):
        return f"{PROGRAM}: error: {error}"
    where = f"{log}: " if log else ""
    if is_full(error):
        stream = "standard output: " if _stdout_is_full() else ""
        return f"{PROGRAM}: error: {stream}cannot write: {error.strerror}"
    if isinstance(error, MemoryError):
        return f"{PROGRAM}: error: {where}not enough memory for this"
    if isinstance(error, ModuleNotFoundError) and error.name and _is_foreign(error.name):
        return (
            f"{PROGRAM}: error: the Python package {error.name} is not installed; "
            f"pip install {PROGRAM} brings it (--headless and notebooks need no screen)"
        )
    if isinstance(error, OSError) and error.filename is not None:
        # The machine's: a folder that may not be looked into, a name that is too long.
        return f"{PROGRAM}: error: " + one_line(f"{error.filename}: {error.strerror}")
    report = "please report it, with GCS_SYSID_DEBUG=1 set"
    return f"{PROGRAM}: error: {where}{in_words(error)}; {report}"


def is_debugged(error: Exception) -> bool:
    """Whether a traceback is wanted: of a defect, where GCS_SYSID_DEBUG asks for it."""
    refused = isinstance(error, GcsSysidError | MemoryError) or is_full(error)
    return not refused and bool(os.environ.get("GCS_SYSID_DEBUG"))


def reader_has_gone(error: Exception) -> bool:
    """Whether standard output leads nowhere any more; Windows has another error for it."""
    if isinstance(error, BrokenPipeError):
        return True
    if type(error) is OSError and error.errno == errno.EIO and error.filename is None:
        return True  # a terminal that was closed
    return os.name == "nt" and type(error) is OSError and error.errno == errno.EINVAL


class OneByOne:
    """The logs of a call: what fails with one of several is a line, and the others go on.

    Args:
        logs: all of them; a failure with the only one is the call's.

    Attributes:
        failed: how many had no result.
    """

    def __init__(self, logs: Sized) -> None:
        self.failed = 0
        self._alone = len(logs) == 1

    @contextlib.contextmanager
    def attempt(self, log: object) -> Iterator[None]:
        """What is done with one log.

        Raises:
            Exception: the log is the only one, or nothing can be printed any more.
        """
        try:
            yield
        except Exception as error:
            unprintable = reader_has_gone(error) or is_full(error)
            if self._alone or unprintable or is_debugged(error):
                raise
            say(failure_line(error, str(log)))
            self.failed += 1


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
    if argv[0].startswith("-"):
        return ["check", *argv] if any(map(_is_log, argv)) else [first, *argv[1:]]
    # What is no log at the front is a misspelt command, which has no ending.
    alone = _is_log(argv[0]) or Path(argv[0]).suffix[1:].isalnum()
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
gcs-sysid {__version__} identifies a multirotor. Try demo, then (arm in m, mass in kg):
  gcs-sysid flight.bin --arm 0.25 --mass 1.5
  gcs-sysid live udpin:0.0.0.0:14550 --airframe px4-quad-x --arm 0.25 --mass 1.5
Commands (options: gcs-sysid COMMAND --help; no vehicle found: gcs-sysid doctor)
{commands}"""
