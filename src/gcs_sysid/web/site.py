"""The web server, in a thread of its own."""

import asyncio
import logging
import os
import sys
import threading
from concurrent.futures import Future
from importlib import resources
from typing import Protocol

from aiohttp import web

from gcs_sysid.errors import GcsSysidError, InputError, one_line
from gcs_sysid.report.page import asset as report_asset
from gcs_sysid.web.access import Access, Handler, Role, authority, present_role, refuse

_TYPES = {"html": "text/html", "css": "text/css", "js": "text/javascript"}
_ASSETS = ("page.css", "common.js", "analysis.js", "live.js")
_CHARTS = ("charts.css", "charts.js")
"""Those of the report."""


class SiteContent(Protocol):
    """What a site serves beside its fixed files."""

    page: str
    """Name of the page in `assets`."""

    def add_to(self, application: web.Application) -> None:
        """Add routes, and what is to be done at the end."""


class Site:
    """Serves pages.

    Args:
        host: address or name to listen on.
        port: 0 for any that is free.
        content: what is served.

    Attributes:
        access: who may look.
    """

    def __init__(self, host: str, port: int, content: SiteContent) -> None:
        self._host, self._port, self._content = host, port, content
        self.access = Access(host)
        self._bound: Future[int] = Future()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stopped = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="web", daemon=True)

    def start(self) -> None:
        """Begin.

        Raises:
            InputError: there is no listening there.
        """
        self._thread.start()
        try:
            self.access.port = self._bound.result()
        except (OSError, UnicodeError) as error:  # UnicodeError: no name of a host
            why = getattr(error, "strerror", None) or error
            raise InputError(
                f"cannot serve on {authority(self._host, self._port)}: {why}; "
                "give another port, such as 8001"
            ) from error

    def address(self, role: Role) -> str:
        """Where the page is for a pilot or a viewer, with the token."""
        return self.access.address(role)

    def stop(self) -> None:
        """End it; viewers are disconnected, their processes ended."""
        if self._loop is not None and self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._stopped.set)
        self._thread.join()

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except Exception as error:
            if self._bound.done():
                raise
            self._bound.set_exception(error)

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        # A viewer that leaves ends its work; aiohttp's log of that has no reader.
        runner = web.AppRunner(
            self._application(),
            access_log=None,
            logger=_silent(),
            shutdown_timeout=2.0,  # s that responses under way have to end
            handler_cancellation=True,
        )
        await runner.setup()
        try:
            await web.TCPSite(runner, self._host, self._port).start()
            self.access.port = runner.addresses[0][1]
            self._bound.set_result(self.access.port)
            await self._stopped.wait()
        finally:
            await runner.cleanup()

    def _application(self) -> web.Application:
        # Uploads are counted as they come.
        application = web.Application(
            middlewares=[self.access.middleware, _errors_in_a_line], client_max_size=64 << 10
        )
        application.on_response_prepare.append(self.access.prepare)
        page = asset(self._content.page)

        async def index(_: web.Request) -> web.StreamResponse:
            return web.Response(text=page, content_type="text/html")

        async def file(request: web.Request) -> web.StreamResponse:
            name = request.match_info["name"]
            if name not in (*_ASSETS, *_CHARTS):
                raise web.HTTPNotFound
            text = report_asset(name) if name in _CHARTS else asset(name)
            return web.Response(text=text, content_type=_TYPES[name.rpartition(".")[2]])

        async def role(_: web.Request) -> web.StreamResponse:
            return web.json_response({"role": present_role()})

        application.add_routes(
            [web.get("/", index), web.get("/assets/{name}", file), web.get("/role", role)]
        )
        self._content.add_to(application)
        return application


def asset(name: str) -> str:
    """A file of the pages, with the line ends of every system."""
    text = (resources.files("gcs_sysid.web") / "assets" / name).read_text(encoding="utf-8")
    return text.replace("\r\n", "\n")


@web.middleware
async def _errors_in_a_line(request: web.Request, handler: Handler) -> web.StreamResponse:
    """What is wrong with a request is said to who sent it; a defect is said here, too."""
    try:
        return await handler(request)
    except GcsSysidError as error:
        return refuse(400, str(error))
    except (web.HTTPException, ConnectionError):
        raise
    except Exception as error:
        if os.environ.get("GCS_SYSID_DEBUG"):
            raise
        text = one_line(f"internal error ({type(error).__name__}: {error})")
        print(f"gcs-sysid: web page: {text}; please report it", file=sys.stderr, flush=True)
        return refuse(500, text)


def _silent() -> logging.Logger:
    """A log that leads nowhere: garbage on the port is answered, and no news."""
    logger = logging.getLogger("gcs_sysid.web")
    logger.addHandler(logging.NullHandler())
    logger.propagate = False
    return logger
