"""What commands read and write beside their results: truth files, JSON and lines of it, progress;
and the signals that end a command before its time.
"""

import contextlib
import errno
import functools
import io
import os
import shutil
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, TextIO, TypeGuard

from gcs_sysid.errors import InputError
from gcs_sysid.files import (
    cannot_write,
    check_target,
    log_file,
    read_text,
    real_number,
    write_whole,
)
from gcs_sysid.strict_json import json_text, parse_json

if TYPE_CHECKING:
    from gcs_sysid.results.result import Result
    from gcs_sysid.web.site import Site

BY_SIGNAL = 128
"""Added to the signal's number: the exit status of a command that was ended at once."""
_AGAIN = ("SIGINT", "SIGBREAK")
"""A user at the keyboard insists. Other signals come twice by themselves: a terminal that closes,
or a service that is stopped, may send several."""


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

    def give_json(
        self, documents: Sequence[object], logs: Sequence[str], target: str | None, *, force: bool
    ) -> None:
        """Write the content of each log that had one: alone for one log, else a list."""
        if documents and target is not None:
            text = as_json(documents[0] if len(logs) == 1 else documents)
            self.give(lambda: write_text(target, text, force=force))

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
        raise cannot_write("standard output", error) from error


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
    table = parse_json(read_text(Path(path), "the truth file"), path)
    if not isinstance(table, dict):
        raise InputError(f"{path}: must be a JSON object of parameter names and numbers")
    return {
        name: real_number(value, f"{path}: {name}")
        for name, value in table.items()
        if isinstance(value, int | float) and not isinstance(value, bool)
    }


def open_output(path: str, *, force: bool) -> TextIO:
    """A text file to be written line by line, or standard output for `-`.

    Raises:
        InputError: the file cannot be written, or is there already and must not be overwritten.
    """
    if path == "-":
        return sys.stdout
    try:
        return open(path, "w" if force or is_device(path) else "x", encoding="utf-8")
    except (OSError, ValueError) as error:
        raise cannot_write(path, error) from error


def check_outputs(*paths: str | None, force: bool, sources: Iterable[str] = ()) -> None:
    """See beforehand whether `write_text` can write there.

    A path of None is none; `sources`, the logs and results read, are never replaced.

    Raises:
        InputError: as of `write_text`.
    """
    inputs = tuple(log_file(Path(source)) for source in sources)
    for path in paths:
        if path is not None and path != "-" and not is_device(path):
            check_target(Path(path), replace=force, sources=inputs)


def deliver(text: str, *files: tuple[str | None, Callable[[], str]], force: bool) -> None:
    """Give all that a command has: a text, unless a file goes to standard output, and files.

    Of files: path, `-` for standard output or None for none, and what makes the content.

    Raises:
        InputError: something cannot be written; the rest is.
        OSError: who read it has gone.
    """
    deliveries = Deliveries()
    if text and all(path != "-" for path, _ in files):
        deliveries.give(lambda: show(text))
    for path, content in files:
        if path is not None:
            deliveries.give(functools.partial(write_text, path, content(), force=force))
    deliveries.check()


def as_json(document: object) -> str:
    """A document as the text of a file."""
    return json_text(document, 2) + "\n"


def write_text(path: str, text: str, *, force: bool) -> None:
    """Write a text whole or not at all: to a file, or to standard output for `-`.

    Raises:
        InputError: the file cannot be written, or is there already and is not to be overwritten.
    """
    if path == "-":
        print_file(text)
    elif is_device(path):
        try:
            with open_output(path, force=force) as file:
                file.write(text)
        except OSError as error:
            if isinstance(error, BrokenPipeError):
                raise
            raise cannot_write(path, error) from error
    else:
        write_whole(Path(path), text, replace=force)


def is_device(path: str) -> bool:
    """Whether it is there and no file, as a pipe or /dev/null: nothing takes the place of those."""
    place = Path(path)
    return place.exists() and not place.is_file() and not place.is_dir()


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


def say_addresses(site: "Site", host: str) -> None:
    """Where a page is, for who may do things and for who may only look."""
    from gcs_sysid.web.site import is_loopback

    far = "" if is_loopback(host) else "; not encrypted: use a network that you trust"
    say(f"open {site.access.address('pilot')} in a browser (Ctrl-C ends){far}")
    say(f"for viewers, who can only look: {site.access.address('viewer')}")


def wait_for(stopped: threading.Event) -> None:
    """Wait until something is stopped; Windows delivers Ctrl-C only between two looks."""
    while not stopped.wait(0.5):
        pass


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


def part_of(
    bar: Callable[[float], None] | None, start: float, end: float
) -> Callable[[float], None] | None:
    """The part of a progress line, shares of it, that one of several passes takes."""
    return None if bar is None else lambda share: bar(start + share * (end - start))


@contextlib.contextmanager
def on_signals(stop: Callable[[], None]) -> Iterator[None]:
    """Ctrl-C, SIGTERM and a lost terminal end the work cleanly, with its result.

    A second Ctrl-C does not wait for that, and ends the process at once.
    """
    insist = {getattr(signal, name, None) for name in _AGAIN}
    stopping = False

    def act(number: int, _frame: FrameType | None) -> None:
        nonlocal stopping
        if stopping and number in insist:
            # Not an exception: what it would unwind is what takes so long.
            os._exit(BY_SIGNAL + number)
        stopping = True
        stop()

    # Windows has no SIGHUP: a closed window and Ctrl-Break are SIGBREAK there.
    names = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
    numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
    before = {number: signal.signal(number, act) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class JsonLines:
    """Writes results as JSON, one a line, in a thread of its own; nothing without a path.

    Args:
        path: file, `-` for standard output, or None.
        force: whether a file that is there may be overwritten.

    Attributes:
        when_gone: is called, in that thread, when the reader of a pipe has gone away.

    Raises:
        InputError: the file cannot be written, or is there already.
    """

    def __init__(self, path: str | None, *, force: bool) -> None:
        self.to_stdout = path == "-"
        self.when_gone: Callable[[], None] = lambda: None
        self._name = "standard output" if self.to_stdout else str(path)
        self._file: TextIO | None = open_output(path, force=force) if path else None
        # Of those that wait for a slow reader the oldest goes: it is the one least missed.
        self._waiting: deque[Result] = deque(maxlen=64)
        self._wake = threading.Condition()
        self._closing = False
        self._error: OSError | None = None
        self._thread = threading.Thread(target=self._run, name="results", daemon=True)
        if self._file is not None:
            self._thread.start()

    def write(self, result: "Result") -> None:
        """Have a line written; returns at once."""
        if self._file is not None and self._error is None:
            with self._wake:
                self._waiting.append(result)
                self._wake.notify()

    def close(self) -> None:
        """Wait until all lines are written, and close the file (not standard output).

        Raises:
            BrokenPipeError: who read them has gone.
            InputError: they could not be written.
        """
        with self._wake:
            self._closing = True
            self._wake.notify()
        if self._file is None:
            return
        self._thread.join()
        if isinstance(self._error, BrokenPipeError):
            raise self._error
        if self._error is not None:
            raise self._problem(self._error) from self._error

    def _run(self) -> None:
        assert self._file is not None
        try:
            while True:
                with self._wake:
                    self._wake.wait_for(lambda: self._waiting or self._closing)
                    if not self._waiting:
                        break
                    result = self._waiting.popleft()
                print(result.dumps(indent=None), file=self._file, flush=True)
            if not self.to_stdout:
                self._file.close()
        except OSError as error:
            self._error = error
            if isinstance(error, BrokenPipeError):
                self.when_gone()
            else:
                say(f"{self._problem(error)}; the session continues")

    def _problem(self, error: OSError) -> InputError:
        return cannot_write(self._name, error)
