"""Results as lines of JSON, written without waiting for the reader."""

import threading
from collections import deque
from collections.abc import Callable
from typing import TextIO

from gcs_sysid.cli.output import open_output, say
from gcs_sysid.errors import InputError
from gcs_sysid.results.result import Result

_MOST_WAITING = 64
"""Results that wait for a slow reader; then the oldest goes, which is the one least missed."""


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
        self._path = path
        self._file: TextIO | None = open_output(path, force=force) if path else None
        self._waiting: deque[Result] = deque(maxlen=_MOST_WAITING)
        self._wake = threading.Condition()
        self._closing = False
        self._error: OSError | None = None
        self._thread = threading.Thread(target=self._run, name="results", daemon=True)
        if self._file is not None:
            self._thread.start()

    def write(self, result: Result) -> None:
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
            raise InputError(self._problem(self._error)) from self._error

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

    def _problem(self, error: OSError) -> str:
        name = "standard output" if self.to_stdout else self._path
        return f"{name}: cannot write: {error.strerror}"
