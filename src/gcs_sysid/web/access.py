"""Who may ask, and for what.

Three checks, each of which alone stops another page of the same browser: the host name must be
one that this server has (against DNS rebinding), the origin must be the page's own (against
forged requests), and a secret must come with the request: in the address at the first visit, as
a cookie afterwards. There are two secrets: who has the viewer's can change nothing.
"""

import hmac
import ipaddress
import json
import secrets
import socket
from collections.abc import Awaitable, Callable
from contextvars import ContextVar
from typing import Any, Literal

from aiohttp import web

from gcs_sysid.errors import InputError, one_line

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

    Args:
        host: address or name that it listens on.

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


def authority(host: str, port: int) -> str:
    """Host and port as in an address."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


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
