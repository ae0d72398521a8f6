"""The web server: a page with a terminal in it, and a viewer's process for each that opens it.

The page is ours, so that nothing is loaded from elsewhere; terminal, fonts and the way between
browser and viewer are textual-serve's.
"""

import asyncio
import ipaddress
import os
import shlex
import subprocess
import sys
import threading
from concurrent.futures import Future
from importlib import resources
from urllib.parse import urlsplit

from aiohttp import web
from aiohttp.typedefs import Handler
from textual_serve.server import Server

from gcs_sysid.errors import InputError
from gcs_sysid.web.share import VARIABLE, Door

MOST_VIEWERS = 16
"""Each is a process of some 60 MB."""
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'self'; script-src 'self' 'unsafe-inline'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data:; connect-src 'self' ws: wss:; "
    "frame-ancestors 'none'",
}


class Site:
    """Serves the screen, in a thread of its own.

    Args:
        host: address or name to listen on.
        port: 0 for any that is free.
        door: of the `Share` that viewers look at.
    """

    def __init__(self, host: str, port: int, door: Door) -> None:
        self._host, self._port, self._door = host, port, door
        self._viewers = 0
        self._bound: Future[int] = Future()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stopped = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="web", daemon=True)

    def start(self) -> str:
        """Begin; returns the page's address.

        Raises:
            InputError: there is no listening there.
        """
        self._thread.start()
        try:
            port = self._bound.result()
        except (OSError, UnicodeError) as error:  # UnicodeError: no name of a host
            why = getattr(error, "strerror", None) or error
            raise InputError(
                f"cannot serve on {_authority(self._host, self._port)}: {why}; "
                "give another port, such as --web 8001"
            ) from error
        os.environ[VARIABLE] = str(self._door)
        return f"http://{_authority(self._host, port)}"

    def stop(self) -> None:
        """End it; viewers must have been sent away, else it waits for them a little."""
        os.environ.pop(VARIABLE, None)
        if self._loop is not None:
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
        runner = web.AppRunner(self._application(), access_log=None, shutdown_timeout=2.0)
        await runner.setup()
        try:
            await web.TCPSite(runner, self._host, self._port).start()
            self._bound.set_result(runner.addresses[0][1])
            await self._stopped.wait()
        finally:
            await runner.cleanup()

    def _application(self) -> web.Application:
        words = [sys.executable, "-P", "-m", "gcs_sysid.web.viewer"]
        command = subprocess.list2cmdline(words) if os.name == "nt" else shlex.join(words)
        terminals = Server(command, self._host, self._port)
        page = resources.files("gcs_sysid.web").joinpath("page.html").read_text(encoding="utf-8")

        async def index(_: web.Request) -> web.StreamResponse:
            return web.Response(text=page, content_type="text/html", headers=_HEADERS)

        async def terminal(request: web.Request) -> web.StreamResponse:
            if self._viewers >= MOST_VIEWERS:
                raise web.HTTPServiceUnavailable(text=f"{MOST_VIEWERS} viewers already")
            self._viewers += 1
            try:
                return await terminals.handle_websocket(request)
            finally:
                self._viewers -= 1

        @web.middleware
        async def only_own(request: web.Request, handler: Handler) -> web.StreamResponse:
            if not is_own(request.headers.get("Host"), request.headers.get("Origin"), self._host):
                raise web.HTTPForbidden(text="requested by another page or under another host name")
            return await handler(request)

        application = web.Application(middlewares=[only_own])
        application.add_routes(
            [
                web.get("/", index),
                web.get("/ws", terminal),
                web.get("/download/{key}", terminals.handle_download),
                web.static("/static", terminals.statics_path),
            ]
        )
        return application


def is_own(host: str | None, origin: str | None, own: str) -> bool:
    """Whether a request comes from the page itself, or from the browser's address line.

    Any page on the web may have the browser ask here; it gives itself away by its origin, or, where
    its name was made to point here, by that name.

    Args:
        host: the request's `Host`.
        origin: its `Origin`, None when it has none.
        own: host that is served.
    """
    if not host:
        return False
    if origin is not None and urlsplit(origin).netloc != host:
        return False
    name = urlsplit(f"//{host}").hostname or ""
    if name == own.lower() or "." not in name or name.endswith(".local"):
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def is_loopback(host: str) -> bool:
    """Whether nobody from other machines reaches what listens there."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _authority(host: str, port: int) -> str:
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
