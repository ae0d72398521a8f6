"""What went wrong, in one line; and logs of one call, of which none takes the others with it."""

import contextlib
import errno
import os
import sys
from collections.abc import Iterator, Sized

from gcs_sysid.cli.commands import PROGRAM
from gcs_sysid.cli.output import abandon_stdout, is_full, say
from gcs_sysid.errors import GcsSysidError, one_line


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
    kind = type(error).__name__
    return (
        f"{PROGRAM}: error: {where}internal error ({kind}: {one_line(str(error))}); "
        "please report it, with GCS_SYSID_DEBUG=1 set"
    )


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
