"""One log's analysis as a piece of work that any process on any machine can do, within limits.

Over the limit of time, an exception ends the analysis at its next step, and the process goes on
with other logs. Where one step does not end, as a loop in a library, the process is ended from a
thread that needs no leave of the interpreter.
"""

import contextlib
import ctypes
import dataclasses
import faulthandler
import hashlib
import json
import os
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gcs_sysid import __version__
from gcs_sysid.errors import InputError
from gcs_sysid.files import split_mapping, split_session
from gcs_sysid.health.whole_analysis import analyze_whole
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.session.chain import ChainOptions

FAILURE = "gcs-sysid/failure/1"
"""Schema of the document of a log that cannot be read."""

Document = dict[str, Any]


@dataclass(frozen=True)
class Job:
    """A log and how it is analyzed.

    Attributes:
        log: its path as it was found, for people.
        airframe: with a scale anchor.
        vehicle: system and perhaps component; None: the first autopilot in the log.
        offline: whether the estimate is the offline one.
    """

    log: Path
    airframe: Airframe
    vehicle: tuple[int, int | None] | None = None
    offline: bool = False

    def settings(self) -> dict[str, Any]:
        """All that the result depends on beside the log's content, as plain JSON values."""
        return {
            "version": __version__,
            "airframe": dataclasses.asdict(self.airframe),
            "vehicle": self.vehicle,
            "offline": self.offline,
        }


@dataclass(frozen=True)
class Task:
    """A job whose log's content is known.

    Attributes:
        job: what is to be done.
        path: of the log, absolute: a worker has another working folder.
        sha256: of its content.
        size: bytes.
    """

    job: Job
    path: str
    sha256: str
    size: int

    @property
    def key(self) -> str:
        """Equal for the same content and settings, whatever the log is called."""
        text = json.dumps([self.sha256, self.job.settings()], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def make_task(job: Job) -> Task:
    """Read a log's content through for its digest.

    Raises:
        OSError: it cannot be read.
    """
    table, mapping = split_mapping(job.log)
    path, session = (table, None) if mapping is not None else split_session(job.log)
    with open(path, "rb") as file:
        made = hashlib.file_digest(file, "sha256")
        size = file.tell()
    if mapping is not None:
        made.update(mapping.read_bytes())
    if session is not None:
        made.update(f"#{session}".encode())
    digest = made.hexdigest()
    return Task(job, str(job.log.absolute()), digest, size)


def analyze(task: Task) -> Document:
    """The result of one log, or why there is none, as the file that is kept.

    Raises:
        InputError: the log cannot be opened just now, or memory does not suffice; that says
            nothing of its content.
    """
    job = task.job
    made: Document
    try:
        options = ChainOptions(history_interval=None, offline=job.offline)
        log, name = Path(task.path), str(job.log)
        made = analyze_whole(log, job.airframe, job.vehicle, options, name=name).as_json()
    except InputError as error:
        if isinstance(error.__cause__, OSError | MemoryError):
            raise
        reason = str(error).replace(task.path, str(job.log))
        made = {"schema": FAILURE, "error": reason}
    about = {"sha256": task.sha256, "bytes": task.size, "settings": job.settings()}
    return {**made, "source": str(job.log), "log": about}


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
