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
from gcs_sysid.files import check_target, read_text, write_whole

_MAX_TRUTH_BYTES = 1_000_000


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
        InputError: the file cannot be written, or is there already and is not to be written over.
    """
    if path == "-":
        return sys.stdout
    try:
        return open(path, "w" if force or _is_device(path) else "x", encoding="utf-8")
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
    if path is not None and path != "-" and not _is_device(path):
        check_target(Path(path), replace=force)


def write_json(path: str | None, document: object, *, force: bool) -> None:
    """Write a document whole or not at all: to a file, to standard output for `-`; not for None.

    Raises:
        InputError: the file cannot be written, or is there already and is not to be written over.
    """
    if path is None:
        return
    text = json.dumps(document, indent=2, allow_nan=False) + "\n"
    if path == "-":
        print(text, end="")
    elif _is_device(path):
        with open_output(path, force=force) as file:
            file.write(text)
    else:
        write_whole(Path(path), text, replace=force)


def _is_device(path: str) -> bool:
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
