"""A session on a page: snapshots go out, what a pilot asks for goes in.

What may be asked for is what the terminal's screen offers, by name; it goes into the session's
command queue as from there. Nothing here knows a link or a message.
"""

import asyncio
import contextlib
from collections.abc import Callable, Mapping
from typing import Any

from aiohttp import web

from gcs_sysid.errors import InputError, one_line
from gcs_sysid.files import real_number
from gcs_sysid.live.live_view import Session
from gcs_sysid.model.airframe import ANCHORS
from gcs_sysid.report.page import health_picture
from gcs_sysid.results.health_view import absent_health
from gcs_sysid.results.snapshot import Snapshot
from gcs_sysid.screen.view import Scene
from gcs_sysid.strict_json import json_text
from gcs_sysid.web.log_request import PICTURE, short_text
from gcs_sysid.web.page_json import health_view, history_view, session_view
from gcs_sysid.web.site import json_of, present_role, refuse
from gcs_sysid.web.workbench import PICTURE_HEADERS

Command = Callable[[Mapping[str, Any]], Any]

MOST_VIEWERS = 16
"""Each is an open response; what it shows is made once for all."""
_LOOK_EVERY = 0.2
"""s between looks for a new snapshot."""
_MOST_TEXT = 200


class SessionPage:
    """Serves one session.

    The source of the snapshots is not stopped when a viewer leaves.
    """

    page = "live.html"

    def __init__(self, source: Session, scene: Scene) -> None:
        self._source, self._scene = source, scene
        self._viewers = 0
        self._serial = 0
        self._known: Snapshot | None = None
        self._packed = b""
        self._plots: dict[str, bytes] = {}
        self._health = health_view(None, 0)
        self._looks = 0
        self._closing = asyncio.Event()

    def add_to(self, application: web.Application) -> None:
        """As `SiteContent` says."""
        application.add_routes(
            [
                web.get("/live", self._live),
                web.get("/live/scene", self._offered),
                web.get("/live/history", self._history),
                web.get(f"/live/{PICTURE}", self._picture),
                web.post("/live/action", self._act),
            ]
        )
        application.on_shutdown.append(self._leave)

    async def _leave(self, _: web.Application) -> None:
        self._closing.set()

    # -- out

    def _newest(self) -> tuple[int, bytes]:
        """The newest snapshot as an event, and its number; made once for all viewers."""
        snapshot = self._source.latest()
        if snapshot is not None and snapshot is not self._known:
            view = session_view(snapshot, self._scene.truth, self._scene.baseline)
            if self._known is None or snapshot.health is not self._known.health:
                self._looks += 1
                self._health = health_view(snapshot.health, self._looks)
            self._known = snapshot
            self._serial += 1
            self._packed = _event({"session": view})
            self._plots.clear()
        return self._serial, self._packed

    async def _live(self, request: web.Request) -> web.StreamResponse:
        """Server-sent events: what is new, until the viewer leaves or the session's page ends."""
        if self._viewers >= MOST_VIEWERS:
            return refuse(503, f"{MOST_VIEWERS} viewers already")
        self._viewers += 1
        try:
            response = web.StreamResponse(headers={"Content-Type": "text/event-stream"})
            await response.prepare(request)
            await self._follow(response)
        finally:
            self._viewers -= 1
        return response

    async def _follow(self, response: web.StreamResponse) -> None:
        seen, health, silent = 0, None, 0.0
        while not self._closing.is_set():
            serial, packed = self._newest()
            if serial != seen:
                await response.write(packed)
                seen, silent = serial, 0.0
            if health is not self._health:
                health, silent = self._health, 0.0
                await response.write(_event({"health": health}))
            # A word now and then, so that a viewer that has gone is noticed.
            if silent >= 10.0:
                await response.write(b":\n\n")
                silent = 0.0
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._closing.wait(), _LOOK_EVERY)
            silent += _LOOK_EVERY
        await response.write(_event({"ended": True}))

    async def _history(self, request: web.Request) -> web.StreamResponse:
        name = request.query.get("name", "")
        self._newest()
        if self._known is None:
            raise InputError("no estimate yet")
        if name not in self._plots:
            made = history_view(self._known, name, self._scene.truth)
            if len(self._plots) >= 32:
                self._plots.clear()
            self._plots[name] = json_text(made).encode()
        return web.Response(body=self._plots[name], content_type="application/json")

    async def _picture(self, _: web.Request) -> web.StreamResponse:
        self._newest()
        document = None if self._known is None else self._known.health
        if document is None or document["verdict"] == "refused":
            raise InputError(absent_health(document))
        text = await asyncio.to_thread(health_picture, document)
        return web.Response(text=text, content_type="image/svg+xml", headers=PICTURE_HEADERS)

    async def _offered(self, _: web.Request) -> web.StreamResponse:
        """What the one who asks may do here."""
        names = sorted(self._commands()) if present_role() == "pilot" else []
        return web.json_response(
            {
                "role": present_role(),
                "actions": names,
                "exports": list(self._scene.export_targets),
                "absent": self._scene.absent,
            }
        )

    # -- in

    def _commands(self) -> Mapping[str, Command]:
        """What is offered: name -> function of the arguments."""
        live, replay = self._scene.live, self._scene.replay
        out: dict[str, Command] = {}
        if live is not None:
            out["mark"] = lambda a: live.mark(_text(a, "text"))
            out["reset"] = lambda _: live.reset()
            out["record"] = lambda _: live.toggle_recording()
            out["scale"] = lambda a: live.set_anchor(_scale(a), _real(a, "value"))
            out["vehicle"] = lambda a: live.choose_vehicle(_address(a))
        if (report := self._scene.report) is not None:
            out["report"] = lambda _: report()
        if self._scene.export is not None:
            out["export"] = self._export
        if replay is not None:
            out["pause"] = lambda _: replay.toggle_pause()
            out["speed"] = lambda a: replay.change_speed(1 if _real(a, "step") > 0 else -1)
            out["seek"] = lambda a: replay.seek(_real(a, "position"))
            out["skip"] = lambda a: replay.skip(_real(a, "seconds"))
        return out

    async def _act(self, request: web.Request) -> web.StreamResponse:
        """Do one thing; says what happened, or in one line why not."""
        document = await json_of(request)
        if not isinstance(document, dict) or not isinstance(document.get("action"), str):
            raise InputError("must be a JSON object with an action")
        function = self._commands().get(document["action"])
        if function is None:
            raise InputError(f"{one_line(document['action'])[:40]!r} is not available here")
        try:
            said = await asyncio.to_thread(function, document)
        except OSError as error:
            raise InputError(str(error)) from error
        return web.json_response({"said": said if isinstance(said, str) else ""})

    def _export(self, arguments: Mapping[str, Any]) -> str:
        target, scene = _text(arguments, "target"), self._scene
        snapshot = self._source.latest()
        if target not in scene.export_targets:
            raise InputError("no such export format")
        if snapshot is None or scene.export is None:
            raise InputError("no estimate yet")
        return scene.export(target, snapshot.result)


def _event(document: Mapping[str, Any]) -> bytes:
    return b"data: " + json_text(document).encode() + b"\n\n"


def _text(arguments: Mapping[str, Any], key: str) -> str:
    return one_line(short_text(arguments.get(key, ""), key, _MOST_TEXT))


def _real(arguments: Mapping[str, Any], key: str) -> float:
    return real_number(arguments.get(key), f"{key}:")


def _scale(arguments: Mapping[str, Any]) -> str:
    name = _text(arguments, "name")
    if name not in ANCHORS:
        raise InputError(f"scale: name must be one of {', '.join(ANCHORS)}")
    return name


def _address(arguments: Mapping[str, Any]) -> tuple[int, int]:
    value = arguments.get("address")
    if (
        not isinstance(value, list)
        or len(value) != 2
        or not all(type(v) is int and 0 <= v <= 255 for v in value)
    ):
        raise InputError("address: must be system and component, 0 to 255")
    return value[0], value[1]
