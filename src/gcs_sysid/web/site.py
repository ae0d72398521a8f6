"""The web server, in a thread of its own; who may ask, and for what.

Three checks, each of which alone stops another page of the same browser: the host name must be
one that this server has (against DNS rebinding), the origin must be the page's own (against
forged requests), and a secret must come with the request: in the address at the first visit, as
a cookie afterwards. There are two secrets: who has the viewer's can change nothing.
"""

import asyncio
import hmac
import ipaddress
import json
import logging
import os
import secrets
import socket
import sys
import threading
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from contextvars import ContextVar
from typing import Any, Literal, Protocol

from aiohttp import web

from gcs_sysid.errors import GcsSysidError, InputError, authority, in_words, one_line
from gcs_sysid.report.parts import asset

Role = Literal["pilot", "viewer"]
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]

_ROLE: ContextVar[Role] = ContextVar("role", default="viewer")

TOKEN_BYTES = 16
"""128 bits: not to be guessed over a network."""
_READING = ("GET", "HEAD")
_WILDCARDS = ("0.0.0.0", "::")
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' data:; connect-src 'self'; frame-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=(), payment=(), usb=()",
    "Referrer-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
"""Of every response that does not set its own."""


def present_role() -> Role:
    """Role of the sender of the request in progress."""
    return _ROLE.get()


def refuse(status: int, text: str) -> web.Response:
    """A refusal in one line of plain text."""
    return web.Response(status=status, text=one_line(text) + "\n")


async def json_of(request: web.Request) -> Any:
    """The JSON of a request's body.

    Raises:
        InputError: it is none.
    """
    try:
        return json.loads(await request.text())
    except (ValueError, RecursionError, LookupError) as error:  # LookupError: an unknown charset
        raise InputError(f"not valid JSON: {one_line(str(error))}") from None


class Access:
    """Checks requests to one server.

    Attributes:
        port: that it listens on, once that is known.
    """

    def __init__(self, host: str) -> None:
        self._host = host.lower()
        self.port = 0
        self._tokens: dict[Role, str] = {
            "pilot": secrets.token_hex(TOKEN_BYTES),
            "viewer": secrets.token_hex(TOKEN_BYTES),
        }

    def address(self, role: Role) -> str:
        """The page's address for a role, with its token."""
        host = self._host
        if host in _WILDCARDS:
            host = outward_address(host) or ("127.0.0.1" if host == "0.0.0.0" else "::1")
        return f"http://{authority(host, self.port)}/?token={self._tokens[role]}"

    @property
    def cookie(self) -> str:
        """Name of the cookie. Cookies know no ports, and several servers may run."""
        return f"gcs-sysid-{self.port}"

    def hosts(self, reached: str) -> frozenset[str]:
        """Values of `Host` under which this server is meant.

        Args:
            reached: own address that the request's connection came to.
        """
        names = {self._host} - set(_WILDCARDS)
        if self._host in _WILDCARDS:
            own = socket.gethostname().lower()
            names |= {reached, own, f"{own}.local"}
        if is_loopback(reached) or is_loopback(self._host):
            names |= {"localhost", "127.0.0.1", "::1"}
        out = {authority(name, self.port) for name in names}
        return frozenset(out | names if self.port == 80 else out)

    def role_of(self, request: web.Request) -> Role | None:
        """Role by the token of a request; None: no valid one."""
        given = request.query.get("token") or request.cookies.get(self.cookie, "")
        found: Role | None = None
        for role, token in self._tokens.items():  # both, always: timing reveals nothing
            if hmac.compare_digest(given.encode("utf-8", "replace"), token.encode()):
                found = role
        return found

    def why_not(self, request: web.Request) -> str:
        """Why a request is not from our own page; empty where it is one."""
        reached = ""
        if request.transport is not None:
            reached = str((request.transport.get_extra_info("sockname") or ("",))[0])
        host = request.headers.get("Host", "").lower()
        if host not in self.hosts(reached):
            return "unknown host name in the address: open the one that gcs-sysid printed"
        origin = request.headers.get("Origin")
        if origin is not None and origin.lower() != f"http://{host}":
            return "requested by another page"
        if origin is None and request.method not in _READING:
            return "no Origin: only the page itself may send this"
        fetched = request.headers.get("Sec-Fetch-Site", "none")
        navigation = request.headers.get("Sec-Fetch-Mode") == "navigate"
        if fetched not in ("same-origin", "none") and not (
            navigation and request.method in _READING
        ):
            return "requested by another page"
        return ""

    @web.middleware
    async def middleware(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Let through what is allowed, with its role as `present_role`; set the cookie."""
        why = self.why_not(request)
        if why:
            return refuse(403, why)
        role = self.role_of(request)
        if role is None:
            return refuse(403, "no valid token: open the whole address that gcs-sysid printed")
        if role != "pilot" and request.method not in _READING:
            return refuse(403, "viewers can only look; the pilot's link allows this")
        _ROLE.set(role)
        try:
            response = await handler(request)
        except web.HTTPException as error:
            return refuse(error.status, f"{error.reason}: {request.method} {request.path}")
        if "token" in request.query and not response.prepared:
            response.set_cookie(
                self.cookie, request.query["token"], path="/", httponly=True, samesite="Strict"
            )
        return response

    async def prepare(self, request: web.Request, response: web.StreamResponse) -> None:
        """Security headers of every response, whatever became of its request."""
        response.headers["Server"] = "gcs-sysid"
        for name, value in HEADERS.items():
            response.headers.setdefault(name, value)


def is_loopback(host: str) -> bool:
    """Whether what listens there is unreachable from other machines."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def outward_address(wildcard: str) -> str | None:
    """Address of the machine on its network, for the printed URL; nothing is sent."""
    family, far = (
        (socket.AF_INET6, "2001:db8::1") if ":" in wildcard else (socket.AF_INET, "192.0.2.1")
    )
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.connect((far, 9))
            return str(probe.getsockname()[0])
    except OSError:  # no network, no route
        return None


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

    With port 0 on any that is free.

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
        page = asset(self._content.page, "web")

        async def index(_: web.Request) -> web.StreamResponse:
            return web.Response(text=page, content_type="text/html")

        async def file(request: web.Request) -> web.StreamResponse:
            name = request.match_info["name"]
            if name not in (*_ASSETS, *_CHARTS):
                raise web.HTTPNotFound
            text = asset(name, "report" if name in _CHARTS else "web")
            return web.Response(text=text, content_type=_TYPES[name.rpartition(".")[2]])

        async def role(_: web.Request) -> web.StreamResponse:
            return web.json_response({"role": present_role()})

        application.add_routes(
            [web.get("/", index), web.get("/assets/{name}", file), web.get("/role", role)]
        )
        self._content.add_to(application)
        return application


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
        text = in_words(error)
        print(f"gcs-sysid: web page: {text}; please report it", file=sys.stderr, flush=True)
        return refuse(500, text)


def _silent() -> logging.Logger:
    """A log that leads nowhere: garbage on the port is answered, and no news."""
    logger = logging.getLogger("gcs_sysid.web")
    logger.addHandler(logging.NullHandler())
    logger.propagate = False
    return logger
