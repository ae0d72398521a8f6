"""Logs that are dropped on the page, what is made of them, and the comparison of two results.

A log is analyzed in a process of its own, a worker: it is started, its messages are passed on, and
it is ended when it is no longer needed.
"""

import asyncio
import contextlib
import json
import secrets
import shutil
import sys
import tempfile
from collections.abc import AsyncGenerator, AsyncIterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

from aiohttp import web

from gcs_sysid.errors import InputError
from gcs_sysid.files import MOST_BYTES_OF_LOG
from gcs_sysid.model.airframe import builtin_names, load_airframe
from gcs_sysid.processes import one_thread_environment
from gcs_sysid.results.comparison import compare
from gcs_sysid.results.result import Result
from gcs_sysid.results.result_file import parse_result, read_result
from gcs_sysid.telemetry.log_formats import ANY_SUFFIX, usual_endings
from gcs_sysid.web.log_request import PICTURE, REPORT, RESULT, file_name, parse_request
from gcs_sysid.web.page_json import comparison_rows, result_rows, verdict_view, why_no_health
from gcs_sysid.web.site import json_of, refuse

T = TypeVar("T")


class WorkerPool:
    """A few processes at once; later jobs wait."""

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


MOST_LOG = 2 << 30
"""Bytes of a log."""
MOST_KEPT = 24
"""Logs and results at once; the oldest go."""
MOST_BYTES = MOST_BYTES_OF_LOG
"""Of all of them."""
_SANDBOX = {
    # The report brings a policy of its own, by the hashes of its script and style.
    "Content-Security-Policy": "sandbox allow-scripts; frame-ancestors 'self'",
    "X-Frame-Options": "SAMEORIGIN",
}
PICTURE_HEADERS = {"Content-Security-Policy": "default-src 'none'; sandbox"}


@dataclass
class Item:
    """A log or a result.

    Attributes:
        key: in addresses; not to be guessed.
        name: of the file where it came from.
        kind: what it is.
        folder: of its own.
        size: bytes of the upload.
        results: folder of the newest result and of all that belongs to it; None before one.
        busy: processes and requests that need it.
    """

    key: str
    name: str
    kind: Literal["log", "result"]
    folder: Path
    size: int = 0
    results: Path | None = None
    busy: int = 0

    @property
    def upload(self) -> Path:
        """The file as it came."""
        return self.folder / f"upload{Path(self.name).suffix.lower()}"

    def as_json(self) -> dict[str, Any]:
        """For the page."""
        analyzed = self.results is not None
        return {"id": self.key, "name": self.name, "kind": self.kind, "analyzed": analyzed}

    def set_results(self, folder: Path) -> None:
        """Have the results of one run take the place of those before, all of them."""
        before, self.results = self.results, folder
        if before is not None:
            shutil.rmtree(before, ignore_errors=True)


class Workbench:
    """Takes logs, has them analyzed, gives reports. Everything goes when the server does."""

    page = "analysis.html"

    def __init__(self) -> None:
        self._items: dict[str, Item] = {}
        self._uploads = 0
        self._folder = Path()
        self._pool: WorkerPool | None = None

    def add_to(self, application: web.Application) -> None:
        """As `SiteContent` says."""
        application.add_routes(
            [
                web.get("/airframes", self._airframes),
                web.get("/items", self._list),
                web.put("/items", self._upload),
                web.delete("/items/{id}", self._drop),
                web.post("/items/{id}/look", self._look),
                web.post("/items/{id}/analysis", self._analyze),
                web.get("/items/{id}/result", self._result),
                web.get(f"/items/{{id}}/{REPORT}", self._report),
                web.get(f"/items/{{id}}/{RESULT}", self._result_file),
                web.get(f"/items/{{id}}/{PICTURE}", self._picture),
                web.get("/comparison", self._compare),
            ]
        )
        application.cleanup_ctx.append(self._life)

    async def _life(self, _: web.Application) -> AsyncIterator[None]:
        self._pool = WorkerPool(2)
        with tempfile.TemporaryDirectory(prefix="gcs-sysid-", ignore_cleanup_errors=True) as folder:
            self._folder = Path(folder)
            yield
            await self._pool.ended()

    # -- what is there

    async def _airframes(self, _: web.Request) -> web.StreamResponse:
        return web.json_response(
            [
                {
                    "name": name,
                    "rotors": (airframe := load_airframe(name)).as_json()["rotors"],
                    "arm": airframe.arm if airframe.arm_known else None,
                }
                for name in builtin_names()
            ]
        )

    async def _list(self, _: web.Request) -> web.StreamResponse:
        return web.json_response([item.as_json() for item in self._items.values()])

    def _item(self, request: web.Request) -> Item:
        item = self._items.get(request.match_info["id"])
        if item is None:
            raise InputError("that file is no longer here: drop it again")
        return item

    def _finished(self, key: str) -> tuple[Item, Path]:
        """A log or result, and the folder of what was found."""
        item = self._items.get(key)
        if item is None or item.results is None:
            raise InputError("no result there: analyze the log first")
        return item, item.results

    # -- uploads

    async def _upload(self, request: web.Request) -> web.StreamResponse:
        """Take a log, or a result that was saved before, piece by piece."""
        name = file_name(request.query.get("name", ""))
        suffix = Path(name).suffix.lower()
        if suffix not in (*ANY_SUFFIX, ".json"):
            raise InputError(f"{name}: drop a {usual_endings(' or ')} log, or a result (.json)")
        kind: Literal["log", "result"] = "result" if suffix == ".json" else "log"
        most = (8 << 20) if kind == "result" else MOST_LOG
        too_large = f"{name}: too large, more than {most >> 20} MB"
        if (request.content_length or 0) > most:
            return refuse(413, too_large)
        if self._uploads >= 4:
            return refuse(503, "too many uploads at once: try again in a moment")
        item = Item(secrets.token_hex(8), name, kind, self._folder / secrets.token_hex(8))
        item.folder.mkdir()
        self._uploads += 1
        try:
            if not await self._receive(request, item, most):
                return refuse(413, too_large)
            if kind == "result":
                await asyncio.to_thread(_accept_result, item)
        except BaseException:
            shutil.rmtree(item.folder, ignore_errors=True)
            raise
        finally:
            self._uploads -= 1
        self._items[item.key] = item
        self._make_room()
        return web.json_response(item.as_json())

    async def _receive(self, request: web.Request, item: Item, most: int) -> bool:
        """Write what comes; whether it was not too much."""
        with open(item.upload, "wb") as file:
            async for piece in request.content.iter_chunked(1 << 18):
                item.size += len(piece)
                if item.size > most:
                    break
                if shutil.disk_usage(self._folder).free < (1 << 30):
                    raise InputError("the server's disk is full: remove logs first")
                file.write(piece)
        if item.size > most:
            shutil.rmtree(item.folder, ignore_errors=True)
            return False
        if item.size == 0:
            raise InputError(f"{item.name}: the file is empty")
        return True

    def _make_room(self) -> None:
        idle = [item for item in self._items.values() if not item.busy]
        while idle and (
            len(self._items) > MOST_KEPT
            or sum(item.size for item in self._items.values()) > MOST_BYTES
        ):
            self._remove(idle.pop(0))

    def _remove(self, item: Item) -> None:
        self._items.pop(item.key, None)
        shutil.rmtree(item.folder, ignore_errors=True)

    async def _drop(self, request: web.Request) -> web.StreamResponse:
        item = self._item(request)
        if item.busy:
            return refuse(409, f"{item.name} is being analyzed")
        self._remove(item)
        return web.json_response({})

    # -- analysis

    async def _look(self, request: web.Request) -> web.StreamResponse:
        item = self._item(request)
        job = {"do": "look", "log": str(item.upload), "name": item.name}
        return await self._stream(request, item, job)

    async def _analyze(self, request: web.Request) -> web.StreamResponse:
        item = self._item(request)
        document = await json_of(request)
        parse_request(document)  # refused before a process is started
        if item.kind != "log":
            raise InputError(f"{item.name} is a result, not a log")
        # A new name for each run: browsers show a picture again whose address they know.
        results = item.folder / secrets.token_hex(8)
        results.mkdir()
        job = {
            "do": "analyze",
            "log": str(item.upload),
            "name": item.name,
            "request": document,
            "folder": str(results),
        }
        return await self._stream(request, item, job)

    async def _stream(
        self, request: web.Request, item: Item, job: dict[str, Any]
    ) -> web.StreamResponse:
        """Pass on a worker's progress, a line of JSON each; a browser that goes ends it."""
        assert self._pool is not None
        response = web.StreamResponse(headers={"Content-Type": "application/x-ndjson"})
        item.busy += 1
        try:
            await response.prepare(request)
            async with contextlib.aclosing(self._pool.run(job)) as said:
                async for one in said:
                    if "done" in one and job["do"] == "analyze":
                        item.set_results(Path(job["folder"]))
                    await response.write(json.dumps(one).encode() + b"\n")
            await response.write_eof()
        finally:
            item.busy -= 1
        return response

    # -- results

    async def _result(self, request: web.Request) -> web.StreamResponse:
        item, results = self._finished(request.match_info["id"])
        text = await asyncio.to_thread((results / RESULT).read_text, encoding="utf-8")
        document = json.loads(text)
        result = parse_result(document, RESULT)
        verdict = verdict_view(result)
        verdict["reasons"] += why_no_health(document)
        return web.json_response(
            {
                **item.as_json(),
                "verdict": verdict,
                "answer": document.get("summary"),
                "parameters": result_rows(result),
                "run": results.name,
                "health": (results / PICTURE).exists(),
                "report": (results / REPORT).exists(),
            }
        )

    def _file(self, request: web.Request, name: str) -> Path:
        path = self._finished(request.match_info["id"])[1] / name
        if not path.exists():
            raise InputError(f"no {name} of that flight")
        return path

    async def _report(self, request: web.Request) -> web.StreamResponse:
        text = await asyncio.to_thread(self._file(request, REPORT).read_text, encoding="utf-8")
        return web.Response(text=text, content_type="text/html", headers=_SANDBOX)

    async def _picture(self, request: web.Request) -> web.StreamResponse:
        text = await asyncio.to_thread(self._file(request, PICTURE).read_text, encoding="utf-8")
        return web.Response(text=text, content_type="image/svg+xml", headers=PICTURE_HEADERS)

    async def _result_file(self, request: web.Request) -> web.StreamResponse:
        item, _ = self._finished(request.match_info["id"])
        data = await asyncio.to_thread(self._file(request, RESULT).read_bytes)
        name = "".join(c if c.isascii() and c.isalnum() else "-" for c in Path(item.name).stem)
        return web.Response(
            body=data,
            content_type="application/json",
            headers={"Content-Disposition": f'attachment; filename="{name}.json"'},
        )

    async def _compare(self, request: web.Request) -> web.StreamResponse:
        chosen = [self._finished(request.query.get(key, "")) for key in ("before", "after")]

        def made() -> dict[str, Any]:
            before, after = (read_result(results / RESULT) for _, results in chosen)
            return comparison_rows(compare(before, after))

        names = {"before": chosen[0][0].name, "after": chosen[1][0].name}
        return web.json_response({**names, **await asyncio.to_thread(made)})


def _accept_result(item: Item) -> Result:
    """Take a result that was saved before.

    Raises:
        InputError: it is none.
    """
    try:
        result = read_result(item.upload)
    except InputError as error:
        raise InputError(str(error).replace(str(item.upload), item.name)) from None
    results = item.folder / secrets.token_hex(8)
    results.mkdir()
    item.upload.rename(results / RESULT)
    item.set_results(results)
    return result
