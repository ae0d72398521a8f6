"""One log's analysis as a piece of work that any process on any machine can do, within limits.

Over the limit of time, an exception ends the analysis at its next step, and the process goes on
with other logs. Where one step does not end, as a loop in a library, the process is ended from a
thread that needs no leave of the interpreter.

The processes are of this machine, or of a Dask cluster.
"""

import contextlib
import ctypes
import dataclasses
import faulthandler
import hashlib
import json
import logging
import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Future,
    ProcessPoolExecutor,
    wait,
)
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from gcs_sysid import __version__
from gcs_sysid.argument_types import GIVEN_OPTIONS, GivenName, given_words, with_given
from gcs_sysid.errors import InputError, in_words, needed
from gcs_sysid.files import digest_of, split_log
from gcs_sysid.health.assessment import ReadLog
from gcs_sysid.health.health_trend import series_of
from gcs_sysid.health.whole_analysis import analyze_whole
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.processes import compute_in_one_thread, end_after
from gcs_sysid.session.chain import ChainOptions
from gcs_sysid.session.reported_layout import ReportedLayout, airframe_of_layout
from gcs_sysid.telemetry.vehicles import GIVE_MULTIROTOR, MavlinkSystem

FAILURE = "gcs-sysid/failure/1"
"""Schema of the document of a log that cannot be read."""

Document = dict[str, Any]


@dataclass(frozen=True)
class Job:
    """A log and how it is analyzed.

    Attributes:
        log: its path as it was found, for people.
        airframe: with a scale anchor; None: the layout that the log shows, of `given`.
        vehicle: system and perhaps component; None: the first autopilot in the log.
        offline: whether the estimate is the offline one.
        given: arm and scale of the log's own layout, as parsed; priors are of airframes.
    """

    log: Path
    airframe: Airframe | None
    vehicle: tuple[int, int | None] | None = None
    offline: bool = False
    given: tuple[tuple[GivenName, float], ...] = ()

    @property
    def airframe_name(self) -> str:
        """The airframe's name; of a layout that the log shows, that of the log's folder."""
        return self.log.absolute().parent.name if self.airframe is None else self.airframe.name

    def settings(self) -> dict[str, Any]:
        """All that the result depends on beside the log's content, as plain JSON values."""
        own = dict(given_words(*each) for each in self.given)
        return {
            "version": __version__,
            "airframe": own if self.airframe is None else dataclasses.asdict(self.airframe),
            "vehicle": self.vehicle,
            "offline": self.offline,
        }

    def of_layout(self, layout: ReportedLayout | None, vehicle: MavlinkSystem | None) -> Airframe:
        """The airframe of a layout that the log of a vehicle shows.

        Raises:
            InputError: it shows none, or no size; or the vehicle is no multirotor.
        """
        if vehicle is not None and vehicle.no_multirotor:
            raise InputError(f"{self.log}: {vehicle.no_multirotor}", GIVE_MULTIROTOR)
        if layout is None:
            raise InputError(
                f"{self.log}: neither its parameters nor the flight show where the rotors are",
                "give --airframe FILE.toml",
            )
        airframe = airframe_of_layout(layout, dict(self.given).get("arm"))
        for name, value in self.given:
            airframe = with_given(airframe, name, value, GIVEN_OPTIONS[name])
        return dataclasses.replace(airframe, name=self.airframe_name)


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
    path, session, mapping = split_log(job.log)
    more = b"" if mapping is None else mapping.read_bytes()
    more += b"" if session is None else f"#{session}".encode()
    digest, size = digest_of(path, more)
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
        options = ChainOptions(offline=job.offline)
        log, name = Path(task.path), str(job.log)
        airframe, opened = job.airframe, None
        if airframe is None:
            read = ReadLog(log, job.vehicle)
            airframe, opened = job.of_layout(read.layout(), read.log.vehicle), read.again()
        found = analyze_whole(log, airframe, job.vehicle, options, name=name, opened=opened)
        hover = [
            {"name": one.name, "unit": one.unit, "value": one.values[0], "std": one.stds[0]}
            for one in series_of([found.health])
        ]
        made = {**found.as_json(), "hover": hover}
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


_GONE = "the Dask scheduler is gone; run the same command again for the rest"


class LocalPool:
    """Processes of this machine, started when there is work.

    They end when this process does, however it ends, and leave Ctrl-C to it. `work` is what is done
    with a task.
    """

    def __init__(self, workers: int, work: Callable[[Any], Any] = analyze) -> None:
        self._workers, self._work = workers, work
        self._context = multiprocessing.get_context("spawn")
        self._executor: ProcessPoolExecutor | None = None
        self._leash: Connection | None = None

    def _start(self) -> ProcessPoolExecutor:
        compute_in_one_thread()
        ours, self._leash = self._context.Pipe(duplex=False)
        executor = ProcessPoolExecutor(
            self._workers, self._context, initializer=_obey, initargs=(ours,)
        )
        # They start now, and inherit that Ctrl-C is not for them; signals are the main thread's.
        with contextlib.ExitStack() as stack:
            if threading.current_thread() is threading.main_thread():
                before = signal.signal(signal.SIGINT, signal.SIG_IGN)
                stack.callback(signal.signal, signal.SIGINT, before)
            for _ in range(self._workers):
                executor.submit(int)
        return executor

    @property
    def capacity(self) -> int:
        """How many tasks keep it busy: one more than there are processes, so that none waits."""
        return self._workers + 1

    def submit(self, task: Any) -> Future[Any]:
        """Have a task done; where a process has died, by new ones."""
        if self._executor is not None:
            try:
                return self._executor.submit(self._work, task)
            except BrokenExecutor:
                self.close()
        self._executor = self._start()
        return self._executor.submit(self._work, task)

    def close(self) -> None:
        """Give up what is under way, at once."""
        if self._leash is None or self._executor is None:
            return
        self._leash.close()
        self._executor.shutdown(wait=True, cancel_futures=True)
        self._executor = None


def _obey(leash: Connection) -> None:
    """Make a new process end as soon as the other end of the leash is closed or gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Windows does not inherit that
    end_after(leash.recv)


class ClusterPool:
    """Workers of a Dask cluster, which must see the logs under the same paths.

    The address is the scheduler's, such as tcp://10.0.0.1:8786.

    Raises:
        InputError: Dask is not installed, there is no scheduler, or its workers cannot do it.
    """

    def __init__(self, address: str, work: Callable[[Task], Document] = analyze) -> None:
        self._work = work
        distributed = needed("distributed", "--scheduler")
        try:
            self._client = distributed.Client(address, timeout=10, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(f"{address}: no Dask scheduler answers there") from error
        try:
            self._check(address)
        except InputError:
            self._client.close()
            raise
        self._executor = self._client.get_executor(pure=False)
        # It logs tracebacks where a scheduler goes; that one has gone is said by `submit`.
        for name in [*logging.root.manager.loggerDict]:
            if name.partition(".")[0] == "distributed":
                logging.getLogger(name).setLevel(logging.CRITICAL)

    def _check(self, address: str) -> None:
        try:
            versions = set(self._client.run(_version).values())
        except ImportError as error:
            raise InputError(f"{address}: a worker has no gcs-sysid: {error}") from error
        if not versions:
            raise InputError(f"{address}: the scheduler has no workers yet")
        if versions != {__version__}:
            others = ", ".join(sorted(versions - {__version__}))
            raise InputError(
                f"{address}: workers run gcs-sysid {others}, this is {__version__}; "
                "results of one batch must come from one version"
            )

    @property
    def capacity(self) -> int:
        """How many tasks keep it busy: workers come and go.

        Raises:
            InputError: the scheduler is gone.
        """
        self._check_running()
        try:
            threads: int = sum(self._client.nthreads().values())
        except OSError as error:
            raise InputError(_GONE) from error
        return max(2 * threads, 2)

    def submit(self, task: Task) -> Future[Document]:
        """Have a task done; Dask itself tries again where a worker dies.

        Raises:
            InputError: the scheduler is gone.
        """
        self._check_running()
        future: Future[Document] = self._executor.submit(self._work, task)
        return future

    def _check_running(self) -> None:
        if self._client.status != "running":
            raise InputError(_GONE)

    def close(self) -> None:
        """Give up what is under way, at once."""
        self._executor.shutdown(wait=False)
        self._client.close()


Pool = LocalPool | ClusterPool
"""Processes that do tasks."""


def _version() -> str:
    return __version__


Done = tuple[Task, Document | BaseException]


def complete(pool: Pool, tasks: Iterator[Task], stopped: Callable[[], bool]) -> Iterator[Done]:
    """Do tasks side by side.

    When a process dies, all tasks under way in the pool are lost, and which one killed it is
    unknown. Each of them is tried again, alone: one that dies twice was the cause. `stopped` is
    asked now and then whether to leave it.

    Yields:
        Each task with its document or the exception that it ended with, in the order of ending.
    """
    flying: dict[Future[Document], Task] = {}
    suspects: deque[Task] = deque()
    alone: Task | None = None
    while not stopped():
        while not suspects and alone is None and len(flying) < pool.capacity:
            task = next(tasks, None)
            if task is None:
                break
            flying[pool.submit(task)] = task
        if suspects and not flying:
            alone = suspects.popleft()
            flying[pool.submit(alone)] = alone
        if not flying:
            return
        done, _ = wait(flying, timeout=0.2, return_when=FIRST_COMPLETED)
        for future in done:
            task = flying.pop(future)
            error = CancelledError() if future.cancelled() else future.exception()
            if isinstance(error, BrokenExecutor) and task is not alone:
                suspects.append(task)
                continue
            if task is alone:
                alone = None
            yield task, error if error is not None else future.result()


def reason(error: BaseException) -> str:
    """In a line, why a task has no document."""
    if isinstance(error, BrokenExecutor) or type(error).__name__ == "KilledWorker":
        return "its process died twice (out of memory or time?)"
    if isinstance(error, InputError):
        return str(error)
    if isinstance(error, CancelledError):
        return "the cluster gave up on it"
    if isinstance(error, MemoryError):
        return "not enough memory for it"
    return f"{in_words(error)}; please report it"
