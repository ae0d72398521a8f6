"""What commands read and write beside their results: truth files, JSON, progress."""

import contextlib
import errno
import io
import json
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TextIO, TypeGuard

from gcs_sysid.errors import InputError
from gcs_sysid.files import check_target, read_text, write_whole

_MAX_TRUTH_BYTES = 1_000_000


class Deliveries:
    """What a command gives at its end: each part is tried, whatever becomes of the others."""

    def __init__(self) -> None:
        self._errors: list[Exception] = []

    def give(self, part: Callable[[], object]) -> bool:
        """Try one part; whether it was delivered."""
        try:
            part()
        except (OSError, InputError) as error:
            reported = InputError(f"cannot write: {error.strerror}") if is_full(error) else error
            self._errors.append(reported)
            return False
        return True

    @property
    def unread(self) -> bool:
        """Whether all that was not delivered has a reader that has gone."""
        return all(isinstance(error, BrokenPipeError) for error in self._errors)

    def check(self) -> None:
        """Report output that could not be written.

        Raises:
            InputError: the first of them; others are lines on standard error, unless they are
                of the same kind: one full disk is one line.
            OSError: the same; BrokenPipeError where a reader has gone and nothing else is wrong.
        """
        lost = [error for error in self._errors if not isinstance(error, BrokenPipeError)]
        for error in lost[1:]:
            if _kind(error) != _kind(lost[0]):
                say(f"gcs-sysid: error: {error}")
        for error in (lost or self._errors)[:1]:
            raise error


def show(text: str) -> None:
    """Print at once, so that what cannot be printed is known here.

    Raises:
        InputError: standard output takes no more, as on a full disk.
        OSError: who read it has gone.
    """
    try:
        print(text, flush=True)
    except OSError as error:
        if not is_full(error):
            raise
        abandon_stdout()
        raise InputError(f"standard output: cannot write: {error.strerror}") from error


def _kind(error: Exception) -> str:
    return str(error).rpartition(": ")[2]


def is_full(error: Exception) -> TypeGuard[OSError]:
    """Whether a file without a name, as standard output is, could not be written."""
    return (
        isinstance(error, OSError)
        and error.filename is None
        and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)
    )


def abandon_stdout() -> None:
    """What waits there goes nowhere, and Python does not complain of it at exit."""
    with contextlib.suppress(OSError, ValueError):  # ValueError: it is no file, as in tests
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def read_truth(path: str) -> dict[str, float]:
    """True parameters of an emulated vehicle, for display beside the estimates only.

    Raises:
        InputError: the file cannot be read or is no such JSON.
    """
    try:
        table = json.loads(read_text(Path(path), _MAX_TRUTH_BYTES, "the truth file"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not valid JSON: {error}") from error
    if not isinstance(table, dict):
        raise InputError(f"{path}: must be a JSON object of parameter names and numbers")
    numbers = {
        name: value
        for name, value in table.items()
        if isinstance(value, int | float) and not isinstance(value, bool)
    }
    for name, value in numbers.items():
        if not abs(value) <= sys.float_info.max:  # whole numbers of JSON have no limit
            raise InputError(f"{path}: {name} must be a finite number")
    return {name: float(value) for name, value in numbers.items()}


def open_output(path: str, *, force: bool) -> TextIO:
    """A text file to be written line by line, or standard output for `-`.

    Raises:
        InputError: the file cannot be written, or is there already and must not be overwritten.
    """
    if path == "-":
        return sys.stdout
    try:
        return open(path, "w" if force or is_device(path) else "x", encoding="utf-8")
    except FileExistsError as error:
        raise InputError(f"{path} exists; --force overwrites it") from error
    except (OSError, ValueError) as error:  # ValueError: a name with a null character
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot write: {reason}") from error


def check_json(path: str | None, *, force: bool) -> None:
    """See beforehand whether `write_json` can write.

    Raises:
        InputError: as of `write_json`.
    """
    if path is not None and path != "-" and not is_device(path):
        check_target(Path(path), replace=force)


def write_json(path: str | None, document: object, *, force: bool) -> None:
    """Write a document whole or not at all: to a file, to standard output for `-`; not for None.

    Raises:
        InputError: the file cannot be written, or is there already and must not be overwritten.
    """
    if path is None:
        return
    write_text(path, json.dumps(document, indent=2, allow_nan=False) + "\n", force=force)


def write_text(path: str, text: str, *, force: bool) -> None:
    """Write a text whole or not at all: to a file, or to standard output for `-`.

    Raises:
        InputError: the file cannot be written, or is there already and is not to be overwritten.
    """
    if path == "-":
        show(text.rstrip("\n"))
    elif is_device(path):
        try:
            with open_output(path, force=force) as file:
                file.write(text)
        except OSError as error:
            if isinstance(error, BrokenPipeError):
                raise
            raise InputError(f"{path}: cannot write: {error.strerror}") from error
    else:
        write_whole(Path(path), text, replace=force)


def is_device(path: str) -> bool:
    """Whether it is there and no file, as a pipe or /dev/null: nothing takes the place of those."""
    place = Path(path)
    return place.exists() and not place.is_file() and not place.is_dir()


def save(path: Path, text: str, *, force: bool) -> None:
    """Write a file; over another one only if forced.

    Raises:
        InputError: it cannot be written, or is there already.
    """
    write_whole(path, text, replace=force)


def print_file(text: str) -> None:
    """Print a file's text as the file has it, whatever the encoding of a pipe on Windows."""
    if isinstance(sys.stdout, io.TextIOWrapper) and not sys.stdout.isatty():
        sys.stdout.reconfigure(encoding="utf-8", newline="\n")
    show(text.removesuffix("\n"))


def terminal_width() -> int | None:
    """Columns of the terminal that standard output is; None where it is none."""
    return shutil.get_terminal_size((80, 24)).columns if sys.stdout.isatty() else None


def say(text: str) -> None:
    """A line on standard error; a terminal that is gone costs no flight."""
    with contextlib.suppress(OSError, ValueError):
        print(text, file=sys.stderr, flush=True)


def offline_progress() -> Callable[[str, float], None] | None:
    """What the offline estimator does, on standard error, if that is a terminal."""
    if not sys.stderr.isatty():
        return None
    bars: dict[str, Callable[[float], None] | None] = {}

    def show(what: str, share: float) -> None:
        bar = bars.setdefault(what, progress_bar(what))
        if bar is not None:
            bar(share)

    return show


def progress_bar(what: str) -> Callable[[float], None] | None:
    """A progress line on standard error, if that is a terminal."""
    if not sys.stderr.isatty():
        return None

    def show(share: float) -> None:
        line = f"{what}: {100.0 * min(share, 1.0):3.0f} %"
        # Blanks, not an escape sequence: older consoles of Windows print those.
        end = f"\r{' ' * len(line)}\r" if share >= 1.0 else ""
        print(f"\r{line}{end}", end="", file=sys.stderr, flush=True)

    return show
