"""Snapshots for other processes of this machine, and what they ask to be done.

Only who knows the key is listened to, and only then is anything unpickled. What a viewer may call
are the actions of the scene, by name.
"""

import pickle
import secrets
import socket
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from multiprocessing import AuthenticationError
from multiprocessing.connection import (
    Client,
    Connection,
    Listener,
    answer_challenge,
    deliver_challenge,
)
from typing import Any, TypeAlias

from gcs_sysid.errors import GcsSysidError, InputError
from gcs_sysid.results.snapshot import Snapshot
from gcs_sysid.screen.scene import Scene
from gcs_sysid.screen.source import Actions, SnapshotSource
from gcs_sysid.screen.view import Baseline
from gcs_sysid.screen.widgets.transport import Transport

VARIABLE = "GCS_SYSID_SHARE"
"""Of the environment, in which a viewer finds where to connect."""
_LOOK_EVERY = 0.1
"""s between a viewer's looks for a new snapshot, and at most until it finds that it is over."""
_CALLED = "called over there"
"""Stands for a function of the scene."""

Link: TypeAlias = "Connection[Any, Any]"


@dataclass(frozen=True)
class Door:
    """Where snapshots are to be had.

    Attributes:
        port: of 127.0.0.1.
        key: that opens.
    """

    port: int
    key: bytes

    def __str__(self) -> str:
        return f"{self.port}:{self.key.hex()}"

    @classmethod
    def parse(cls, text: str) -> "Door":
        """The inverse of `str`.

        Raises:
            ValueError: it is none.
        """
        port, _, key = text.partition(":")
        return cls(int(port), bytes.fromhex(key))

    def enter(self) -> Link:
        """A new connection.

        Raises:
            OSError: nobody is there.
            AuthenticationError: it is somebody else.
        """
        return Client(("127.0.0.1", self.port), "AF_INET", authkey=self.key)


@dataclass(frozen=True)
class _Portable:
    """A scene whose functions are called at home."""

    truth: Mapping[str, float]
    baseline: Baseline | None
    actions: dict[str, Any]
    transport: dict[str, Any] | None


class Share:
    """Serves one source to many viewers.

    Args:
        source: of the snapshots; not stopped when a viewer leaves.
        scene: what viewers may do, too.

    Attributes:
        door: for viewers.
    """

    def __init__(self, source: SnapshotSource, scene: Scene) -> None:
        self._source, self._scene = source, scene
        self._listener = Listener(("127.0.0.1", 0), "AF_INET", backlog=16)
        _, port = self._listener.address  # type: ignore[misc]
        self.door = Door(int(port), secrets.token_bytes(32))
        self._closing = False
        self._lock = threading.Lock()
        self._newest: Snapshot | None = None
        self._serial = 0
        self._packed = b""
        self._thread = threading.Thread(target=self._accept, name="share", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def close(self) -> None:
        """Send all viewers away; they find out within moments."""
        self._closing = True
        # A blocked accept wakes by nothing else, everywhere.
        socket.create_connection(("127.0.0.1", self.door.port)).close()
        self._thread.join()
        self._listener.close()

    def _accept(self) -> None:
        while True:
            try:
                link = self._listener.accept()
            except OSError:  # it went before it was let in
                continue
            if self._closing:
                link.close()
                return
            threading.Thread(target=self._attend, args=(link,), daemon=True).start()

    def _attend(self, link: Link) -> None:
        """Answer one viewer until it leaves."""
        try:
            deliver_challenge(link, self.door.key)
            answer_challenge(link, self.door.key)
            while not self._closing:
                if link.poll(_LOOK_EVERY):
                    link.send_bytes(self._answer(link.recv()))
        except (EOFError, OSError, AuthenticationError):
            pass
        finally:
            link.close()

    def _answer(self, request: tuple[Any, ...]) -> bytes:
        match request:
            case ("scene",):
                return pickle.dumps(self._portable())
            case ("snapshot", int(known)):
                return self._snapshot_after(known)
            case ("call", str(group), str(name), tuple(arguments)):
                return pickle.dumps(self._call(group, name, arguments))
        return pickle.dumps(None)

    def _portable(self) -> _Portable:
        scene = self._scene
        transport = None if scene.transport is None else _without_functions(scene.transport)
        return _Portable(
            dict(scene.truth), scene.baseline, _without_functions(scene.actions), transport
        )

    def _snapshot_after(self, known: int) -> bytes:
        """(serial, snapshot) if there is a newer one, else (known, None); packed once for all."""
        with self._lock:
            newest = self._source.latest()
            if newest is not self._newest:
                self._newest = newest
                self._serial += 1
                self._packed = pickle.dumps((self._serial, newest), pickle.HIGHEST_PROTOCOL)
            return self._packed if self._serial != known else pickle.dumps((known, None))

    def _call(self, group: str, name: str, arguments: tuple[Any, ...]) -> tuple[bool, Any]:
        """(whether it was done, what it returned or one line that says why not)."""
        offered = {"actions": self._scene.actions, "transport": self._scene.transport}.get(group)
        names = () if offered is None else tuple(field.name for field in fields(offered))
        function = getattr(offered, name) if name in names else None
        if not callable(function):
            return False, f"{name} is not available here"
        try:
            return True, function(*arguments)
        except (GcsSysidError, OSError) as error:
            return False, str(error)


class RemoteSource:
    """Snapshots of another process.

    Args:
        door: of its `Share`.
        on_gone: called in a thread of its own when that has closed.

    Raises:
        InputError: nobody is there.
    """

    def __init__(self, door: Door, on_gone: Callable[[], None]) -> None:
        self._door, self._on_gone = door, on_gone
        try:
            self._link = door.enter()
            self._link.send(("scene",))
            self._portable: _Portable = self._link.recv()
        except (OSError, EOFError, AuthenticationError) as error:
            raise InputError(f"the session has ended ({error})") from error
        self._latest: Snapshot | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._follow, name="viewer", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    @property
    def scene(self) -> Scene:
        """As over there; what is done here is done there."""
        found = self._portable
        transport = found.transport
        return Scene(
            truth=found.truth,
            actions=Actions(**self._with_functions("actions", found.actions)),
            transport=None
            if transport is None
            else Transport(**self._with_functions("transport", transport)),
            baseline=found.baseline,
        )

    def latest(self) -> Snapshot | None:
        """The newest snapshot."""
        return self._latest

    def stop(self) -> None:
        """Look no more; the session goes on."""
        self._stop.set()

    def _follow(self) -> None:
        known = 0
        try:
            while not self._stop.is_set():
                self._link.send(("snapshot", known))
                known, snapshot = self._link.recv()
                if snapshot is not None:
                    self._latest = snapshot
                self._stop.wait(_LOOK_EVERY)
        except (EOFError, OSError):
            self._on_gone()
        finally:
            self._link.close()

    def _with_functions(self, group: str, portable: Mapping[str, Any]) -> dict[str, Any]:
        def function(name: str) -> Callable[..., Any]:
            return lambda *arguments: self._call(group, name, arguments)

        return {
            name: function(name) if value == _CALLED else value for name, value in portable.items()
        }

    def _call(self, group: str, name: str, arguments: tuple[Any, ...]) -> Any:
        """Have something done over there. A connection of its own, since it may take its time."""
        try:
            with self._door.enter() as link:
                link.send(("call", group, name, arguments))
                done, said = link.recv()
        except (OSError, EOFError, AuthenticationError) as error:
            raise InputError("the session has ended") from error
        if not done:
            raise InputError(said)
        return said


def _without_functions(offered: Actions | Transport) -> dict[str, Any]:
    values = {field.name: getattr(offered, field.name) for field in fields(offered)}
    return {name: _CALLED if callable(value) else value for name, value in values.items()}
