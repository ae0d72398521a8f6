"""Signals that end a command before its time."""

import contextlib
import os
import signal
from collections.abc import Callable, Iterator
from types import FrameType

BY_SIGNAL = 128
"""Added to the signal's number: the exit status of a command that was ended at once."""
_AGAIN = ("SIGINT", "SIGBREAK")
"""A user at the keyboard insists. Other signals come twice by themselves: a terminal that closes,
or a service that is stopped, may send several."""


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
