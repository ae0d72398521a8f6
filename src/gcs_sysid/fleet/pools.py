"""The processes that analyze: of this machine, or of a Dask cluster."""

import contextlib
import logging
import multiprocessing
import signal
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
from multiprocessing.connection import Connection
from typing import Any, Protocol

from gcs_sysid import __version__
from gcs_sysid.errors import InputError
from gcs_sysid.fleet.jobs import Document, Task, analyze
from gcs_sysid.processes import compute_in_one_thread, end_after

_GONE = "the Dask scheduler is gone; run the same command again for the rest"


class Pool(Protocol):
    """Processes that do tasks."""

    @property
    def capacity(self) -> int:
        """How many tasks keep it busy."""

    def submit(self, task: Task) -> Future[Document]:
        """Have a task done."""

    def close(self) -> None:
        """Give up what is under way, at once."""


class LocalPool:
    """Processes of this machine, started when there is work.

    They end when this process does, however it ends, and leave Ctrl-C to it.

    Args:
        workers: how many.
        work: what is done with a task.
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
        """As `Pool` says: one more than there are processes, so that none waits for us."""
        return self._workers + 1

    def submit(self, task: Any) -> Future[Any]:
        """As `Pool` says; where a process has died, with new ones."""
        if self._executor is not None:
            try:
                return self._executor.submit(self._work, task)
            except BrokenExecutor:
                self.close()
        self._executor = self._start()
        return self._executor.submit(self._work, task)

    def close(self) -> None:
        """As `Pool` says."""
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

    Args:
        address: of the scheduler, such as tcp://10.0.0.1:8786.
        work: what is done with a task.

    Raises:
        InputError: Dask is not installed, there is no scheduler, or its workers cannot do it.
    """

    def __init__(self, address: str, work: Callable[[Task], Document] = analyze) -> None:
        self._work = work
        try:
            import distributed
        except ImportError as error:
            raise InputError("--scheduler needs Dask: pip install distributed pyarrow") from error
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
        """As `Pool` says: workers come and go.

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
        """As `Pool` says; Dask itself tries again where a worker dies.

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
        """As `Pool` says."""
        self._executor.shutdown(wait=False)
        self._client.close()


def _version() -> str:
    return __version__


Done = tuple[Task, Document | BaseException]


def complete(pool: Pool, tasks: Iterator[Task], stopped: Callable[[], bool]) -> Iterator[Done]:
    """Do tasks side by side.

    When a process dies, all tasks under way in the pool are lost, and which one killed it is
    unknown. Each of them is tried again, alone: one that dies twice was the cause.

    Args:
        pool: does them.
        tasks: taken one by one, when there is room.
        stopped: asked now and then whether to leave it.

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
    kind: Any = type(error)
    if isinstance(error, BrokenExecutor) or kind.__name__ == "KilledWorker":
        return "its process died twice (out of memory or time?)"
    if isinstance(error, InputError):
        return str(error)
    if isinstance(error, CancelledError):
        return "the cluster gave up on it"
    if isinstance(error, MemoryError):
        return "not enough memory for it"
    text = " ".join(str(error).split())
    return f"internal error ({kind.__name__}: {text}); please report it"
