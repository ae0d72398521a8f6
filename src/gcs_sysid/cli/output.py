"""What commands read and write beside their results: truth files, JSON, progress."""

import contextlib
import io
import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TextIO

from gcs_sysid.errors import InputError

_MAX_TRUTH_BYTES = 1_000_000


def read_truth(path: str) -> dict[str, float]:
    """True parameters of an emulated vehicle, for display beside the estimates only.

    Raises:
        InputError: the file cannot be read or is no such JSON.
    """
    try:
        file = Path(path)
        if file.stat().st_size > _MAX_TRUTH_BYTES:
            raise InputError(f"{path}: too large for a truth file")
        table = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot read the truth file: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"{path}: not valid JSON: {error}") from error
    if not isinstance(table, dict):
        raise InputError(f"{path}: must be a JSON object of parameter names and numbers")
    return {
        name: float(value)
        for name, value in table.items()
        if isinstance(value, int | float) and not isinstance(value, bool)
    }


def open_output(path: str) -> TextIO:
    """A text file for writing, or standard output for `-`.

    Raises:
        InputError: the file cannot be written.
    """
    if path == "-":
        return sys.stdout
    try:
        return open(path, "w", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot write: {error.strerror}") from error


def save(path: Path, text: str, *, force: bool) -> None:
    """Write a file; over another one only if forced.

    Raises:
        InputError: it cannot be written, or is there already.
    """
    try:
        with open(path, "w" if force else "x", encoding="utf-8", newline="\n") as file:
            file.write(text)
    except FileExistsError as error:
        raise InputError(f"{path} exists already; --force writes over it") from error
    except (OSError, ValueError) as error:  # ValueError: a name with a null character
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot write: {reason}") from error


def print_file(text: str) -> None:
    """Print a file's text as the file has it, whatever a pipe on Windows would make of it."""
    if isinstance(sys.stdout, io.TextIOWrapper) and not sys.stdout.isatty():
        sys.stdout.reconfigure(encoding="utf-8", newline="\n")
    print(text, end="")


def terminal_width() -> int | None:
    """Columns of the terminal that standard output is; None where it is none."""
    return shutil.get_terminal_size((80, 24)).columns if sys.stdout.isatty() else None


def say(text: str) -> None:
    """A line on standard error; a terminal that is gone costs no flight."""
    with contextlib.suppress(OSError, ValueError):
        print(text, file=sys.stderr, flush=True)


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
