"""Starts a worker, passes on its messages, and ends it when it is no longer needed."""

import asyncio
import contextlib
import json
import sys
from collections.abc import AsyncGenerator, Mapping
from typing import Any, TypeVar

from gcs_sysid.processes import one_thread_environment

T = TypeVar("T")


class WorkerPool:
    """A few processes at once; later jobs wait.

    Args:
        most: processes at once.
    """

    def __init__(self, most: int) -> None:
        self._free = asyncio.Semaphore(most)
        self._users: set[asyncio.Task[Any]] = set()

    async def ended(self) -> None:
        """Wait until cancelled jobs have ended their processes."""
        if self._users:
            await asyncio.wait(self._users)

    async def run(self, job: Mapping[str, Any]) -> AsyncGenerator[dict[str, Any], None]:
        """What a worker says about a job, the last of it `done` or `error`.

        The process is ended when the iterator is closed or its task cancelled, as it is when the
        browser that wanted it goes.
        """
        if (user := asyncio.current_task()) is not None:
            self._users.add(user)
            user.add_done_callback(self._users.discard)
        if self._free.locked():
            yield {"progress": 0.0, "stage": "waiting for another analysis"}
        async with self._free:
            starting = asyncio.ensure_future(
                asyncio.create_subprocess_exec(
                    *(sys.executable, "-P", "-m", "gcs_sysid.web.log_worker"),
                    stdin=asyncio.subprocess.PIPE,
                    stdout=asyncio.subprocess.PIPE,
                    stderr=asyncio.subprocess.DEVNULL,
                    limit=1 << 20,
                    env=one_thread_environment(),
                )
            )
            try:
                process = await asyncio.shield(starting)
            except asyncio.CancelledError:
                await _end(await _settled(starting))
                raise
            assert process.stdin is not None
            assert process.stdout is not None
            ended = False
            try:
                process.stdin.write(json.dumps(job).encode() + b"\n")
                with contextlib.suppress(ConnectionError):
                    await process.stdin.drain()
                said: dict[str, Any] = {}
                async for line in process.stdout:
                    said = json.loads(line)
                    yield said
                if not said.keys() & {"done", "error"}:
                    yield {"error": "the analysis ended unexpectedly; is there enough memory?"}
                ended = True
            finally:
                await _end(process, kill=not ended)


async def _end(process: asyncio.subprocess.Process, *, kill: bool = True) -> None:
    """Leave neither the process nor its pipes behind."""
    if process.stdin is not None:
        process.stdin.close()
    if kill:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
    await _settled(asyncio.ensure_future(process.communicate()))
    await asyncio.sleep(0)  # the pipes are closed by the loop


async def _settled(future: "asyncio.Future[T]") -> T:
    """What becomes of a future, however often the wait for it is cancelled."""
    while not future.done():
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.shield(future)
    return future.result()
