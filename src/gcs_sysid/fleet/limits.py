"""Limits of time and memory within which one log of a batch is analyzed.

Over the time limit, an exception ends the analysis at its next step, and the process goes on with
other logs. Where one step does not end, as a loop in a library, the process is ended from a
thread that needs no leave of the interpreter.
"""

import contextlib
import ctypes
import faulthandler
import os
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from gcs_sysid.errors import InputError
from gcs_sysid.fleet.jobs import Document, Task, analyze

MEGABYTE = 1_000_000
_GRACE = 10.0
"""s beyond the time limit after which the process is ended."""


@dataclass(frozen=True)
class LogLimits:
    """Of one log.

    Attributes:
        seconds: that the analysis may take.
        megabytes: that it may take beside what the program needs; on Linux.
    """

    seconds: float = 1800.0
    megabytes: float = 4000.0


class OverTime(BaseException):
    """Thrown into an analysis that takes too long: no handler of its errors is to take it."""


def analyze_within(
    limits: LogLimits, task: Task, work: Callable[[Task], Document] = analyze
) -> Document:
    """As `analyze`, within limits.

    Raises:
        InputError: as `analyze`, or the log is over a limit: which says nothing of its content.
    """
    log = task.job.log
    memory = InputError(
        f"{log}: needs more than {limits.megabytes:g} MB of memory; --log-memory MB allows more"
    )
    try:
        with within(limits):
            return work(task)
    except OverTime:
        raise InputError(
            f"{log}: not done after {limits.seconds:g} s; --log-timeout S gives it more"
        ) from None
    except MemoryError:
        raise memory from None
    except InputError as error:
        if isinstance(error.__cause__, MemoryError):
            raise memory from None
        raise


@contextlib.contextmanager
def within(limits: LogLimits) -> Iterator[None]:
    """Have what is done meanwhile end in `OverTime` or `MemoryError` beyond the limits."""
    with _within_memory(limits.megabytes), _within_time(limits.seconds):
        yield


@contextlib.contextmanager
def _within_time(seconds: float) -> Iterator[None]:
    """Throw `OverTime` into this thread after a time."""
    thread = threading.get_ident()
    lock, done = threading.Lock(), threading.Event()

    def throw() -> None:
        with lock:
            if not done.is_set():
                _raise_in(thread, OverTime)

    timer = threading.Timer(seconds, throw)
    timer.daemon = True
    alone = threading.current_thread() is threading.main_thread()
    with contextlib.ExitStack() as stack:
        if alone:  # else other logs are analyzed in this process, as by Dask
            nowhere = stack.enter_context(open(os.devnull, "w"))
            faulthandler.dump_traceback_later(seconds + _GRACE, exit=True, file=nowhere)
            stack.callback(faulthandler.cancel_dump_traceback_later)
        timer.start()
        try:
            yield
        finally:
            timer.cancel()
            with lock:
                done.set()
                _raise_in(thread, None)  # what was thrown and has not arrived


def _raise_in(thread: int, kind: type[BaseException] | None) -> None:
    """Have an exception raised in a thread as soon as it runs Python; None takes it back."""
    ctypes.pythonapi.PyThreadState_SetAsyncExc(
        ctypes.c_ulong(thread), None if kind is None else ctypes.py_object(kind)
    )


@contextlib.contextmanager
def _within_memory(megabytes: float) -> Iterator[None]:
    """Let allocations fail beyond a limit, where the system counts them and we are alone."""
    try:
        import resource
    except ImportError:  # Windows
        yield
        return
    if sys.platform != "linux" or threading.current_thread() is not threading.main_thread():
        yield
        return
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + round(megabytes * MEGABYTE)
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    known = [limit for limit in (soft, hard) if limit != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min([most, *known]), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
