"""Textual's driver, made to end when its terminal does.

A closed window, a killed tmux pane and a broken SSH connection hang the terminal up: writing to it
fails, reading returns nothing at once, and the kernel sends SIGHUP and SIGCONT, but to the first
process of the terminal alone. Where that is `make`, or any other parent that passes no signal on,
the program below it is never signaled. So the application asks at every turn whether its terminal
is still there.

Textual's writer thread ends with the first failed write, after which its queue of 30 fills and
blocks the application for good; its reader of keys turns a core on a terminal that is gone; its
handler of SIGCONT starts a second writer and a second reader, of which only one is stopped.
"""

import os
import sys
from types import FrameType
from typing import IO, Any

from textual.driver import Driver


class HangingUpFile:
    """A terminal's file to which writing never fails: once it is gone, output is discarded.

    Args:
        file: the terminal's.
    """

    def __init__(self, file: IO[str]) -> None:
        self._file = file
        self.gone = False
        """Whether writing has failed."""

    def write(self, text: str) -> int:
        """Write text, or discard it."""
        if not self.gone:
            try:
                return self._file.write(text)
            except (OSError, ValueError):  # ValueError: of a closed file
                self.gone = True
        return len(text)

    def flush(self) -> None:
        """Flush, or do nothing."""
        if not self.gone:
            try:
                self._file.flush()
            except (OSError, ValueError):
                self.gone = True

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def ending_with_its_terminal(base: type[Driver]) -> type[Driver]:
    """The driver of this platform, which a lost terminal does not block and which knows of it.

    Args:
        base: Textual's driver, whose `_file` is the terminal and whose `fileno` gives its keys.
    """

    class TerminalDriver(base):  # type: ignore[misc, valid-type]
        def __init__(self, *args: Any, **options: Any) -> None:
            super().__init__(*args, **options)
            terminal: IO[str] | None = getattr(self, "_file", None)
            if terminal is not None:
                if not terminal.isatty() and sys.__stdout__ is not None and sys.__stdout__.isatty():
                    terminal = sys.__stdout__  # what is said goes to a file, and no picture does
                self._file = HangingUpFile(terminal)
            keys: int | None = getattr(self, "fileno", None)
            self._keys = keys if keys is not None and os.isatty(keys) else None

        @property
        def is_gone(self) -> bool:
            """Whether the terminal has hung up: a descriptor of one that has is none any more."""
            return self._keys is not None and not os.isatty(self._keys)

        def _sigcont_application(self, number: int, frame: FrameType | None) -> None:
            # Only after the driver's own SIGTSTP is there anything to start again.
            if self._must_signal_resume:
                super()._sigcont_application(number, frame)

    return TerminalDriver
