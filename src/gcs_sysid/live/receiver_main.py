"""The receiver's process: reads, stamps and records what comes over a link, however busy the
session.

    python -m gcs_sysid.live.receiver_main

is started by `receiver_process.ReceiverProcess`, which talks to it through its standard input and
output. It ends on request, or when its input closes, because the session's process has ended in
whatever way. Then it gives the vehicle its own rates back, takes what the system still holds, and
closes a whole recording. Signals that end the session are not for it: a terminal sends Ctrl-C to
all processes that it knows.
"""

import os
import queue
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, BinaryIO

from gcs_sysid.errors import GcsSysidError
from gcs_sysid.live.receiver_process import (
    MOST_WAITING,
    REQUESTS,
    Flushed,
    Report,
    packed,
    read_message,
)
from gcs_sysid.live.reception import POLL, Failure, Item, Reception
from gcs_sysid.telemetry.link import PersistentLink, open_link
from gcs_sysid.telemetry.outgoing import Gate
from gcs_sysid.telemetry.transceiver import ReceivedFrames
from gcs_sysid.telemetry.urls import LinkUrl

GATHER, FEW = 0.004, 64
"""s in which datagrams gather in the system's buffer, after fewer frames than that: waking for each
costs most."""
_OF_RECEPTION = ("follow", "mark_reset", "start_recording", "stop_recording", "cut_recording")
"""Orders that are its methods; it has others, as a transceiver, which are none."""


class Outbox:
    """Hands messages to the session, whenever it takes them; only `close` waits for that.

    Attributes:
        withheld: frames for which there was no room.
    """

    def __init__(self, pipe: BinaryIO) -> None:
        self.withheld = 0
        self._pipe = pipe
        self._wake = threading.Condition()
        self._waiting: deque[bytes] = deque()
        self._size = 0
        self._closing = self._broken = False
        self._thread = threading.Thread(target=self._run, name="outbox", daemon=True)
        self._thread.start()

    def put(self, data: bytes) -> None:
        """Hand over a message."""
        with self._wake:
            if not self._broken:
                self._waiting.append(data)
                self._size += len(data)
                self._wake.notify()

    def put_items(self, items: Sequence[Item]) -> None:
        """Hand over items; frames only if there is room."""
        for item in items:
            data = packed(item)
            if isinstance(item, ReceivedFrames) and self._size + len(data) > MOST_WAITING:
                self.withheld += len(item.frames)
            else:
                self.put(data)

    def close(self) -> None:
        """Wait until all is handed over, or the reader has gone."""
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._waiting or self._closing)
                if not self._waiting:
                    return
                data = b"".join(self._waiting)
                self._waiting.clear()
            try:
                self._pipe.write(data)
                self._pipe.flush()
            except (OSError, ValueError):  # the reader has gone
                with self._wake:
                    self._broken = True
                    self._waiting.clear()
            with self._wake:
                self._size -= len(data)


class RequestsDone:
    """Executes the requests of `RelayedRequests`, through the gate alone, and can undo them."""

    def __init__(self, gate: Gate) -> None:
        self._gate = gate
        # (vehicle, message) -> version of MAVLink, and the interval to put back.
        self._changed: dict[tuple[tuple[int, int], int], tuple[int, int]] = {}
        self._may: dict[str, Callable[..., bool]] = {
            **{name: getattr(gate, name) for name in REQUESTS},
            "set_message_interval": self._set_message_interval,
        }

    def ask(self, name: str, version: int, *arguments: object) -> None:
        """Have the gate ask.

        Raises:
            NotAllowedError: that must never be sent.
            KeyError: no request has that name.
        """
        self._gate.version = 1 if version == 1 else 2
        self._may[name](*arguments)

    def _set_message_interval(
        self, target: tuple[int, int], message_id: int, interval_us: int, own_us: int = 0
    ) -> bool:
        if interval_us == own_us:
            self._changed.pop((target, message_id), None)
        else:
            self._changed[target, message_id] = self._gate.version, own_us
        return self._gate.set_message_interval(target, message_id, interval_us)

    def restore(self) -> None:
        """Restore the vehicle's own rates: the session is no longer there to do it."""
        changed, self._changed = self._changed, {}
        for _ in range(2):  # there is no later retry here either
            for (target, message_id), (version, own_us) in changed.items():
                self._gate.version = version
                self._gate.set_message_interval(target, message_id, own_us)


class ReceiverMain:
    """Drives a reception by the orders that come.

    The orders are names and arguments; None at their end.
    """

    def __init__(
        self,
        reception: Reception,
        requests: RequestsDone,
        outbox: Outbox,
        orders: "queue.SimpleQueue[Sequence[Any] | None]",
    ) -> None:
        self._reception = reception
        self._requests = requests
        self._outbox = outbox
        self._orders = orders
        self._report = Report()
        self._reported = -float("inf")
        self._finished = False

    def run(self) -> None:
        """Receive until the end."""
        while not self._finished:
            self._obey()
            items = self._taken(0.0 if self._finished else POLL)
            self._send_report()
            self._outbox.put_items(items)
            if 0 < sum(len(i.frames) for i in items if isinstance(i, ReceivedFrames)) < FEW:
                time.sleep(GATHER)

    def _taken(self, timeout: float) -> list[Item]:
        try:
            return self._reception.next_items(timeout)
        except Exception as defect:  # noqa: BLE001 - reported, and the next bytes may differ
            time.sleep(POLL)
            return [Failure(f"{type(defect).__name__}: {defect}")]

    def _obey(self) -> None:
        """Do what was ordered."""
        while not self._finished and not self._orders.empty():
            order = self._orders.get()
            try:
                if order is None:
                    self._requests.restore()
                    self._finish()
                else:
                    self._do(*order)
            except Exception as defect:  # noqa: BLE001 - what arrives is recorded all the same
                self._outbox.put_items([Failure(f"{type(defect).__name__}: {defect}")])

    def _do(self, name: str, *arguments: Any) -> None:
        match name:
            case "ask":
                self._requests.ask(*arguments)
            case "flush":
                # A disk that does not respond blocks only the caller.
                threading.Thread(target=self._flush, args=arguments, daemon=True).start()
            case "finish":
                self._finish()
            case _ if name in _OF_RECEPTION:
                getattr(self._reception, name)(*arguments)
        self._reported = -float("inf")

    def _flush(self, number: int) -> None:
        answer = Flushed(number, self._reception.flushed_recording())
        self._outbox.put(packed(answer))

    def _finish(self) -> None:
        """Take what has come so far, and end."""
        self._finished = True
        # What the system holds at the end is taken, for a second at most.
        until = time.monotonic() + 1.0
        while time.monotonic() < until and (items := self._taken(0.0)):
            self._outbox.put_items(items)
        self._reception.finish()

    def _send_report(self) -> None:
        """Report what has changed."""
        now = time.monotonic()
        if now - self._reported < 0.1 and not self._finished:
            return
        self._reported = now
        reception = self._reception
        events = tuple(reception.take_events())
        report = Report(
            reception.link_report, reception.recording_report, self._outbox.withheld, events
        )
        if report != self._report:
            self._report = report
            self._outbox.put(packed(report))


def _read_orders(source: BinaryIO, orders: "queue.SimpleQueue[Sequence[Any] | None]") -> None:
    while (order := read_message(source)) is not None:
        orders.put(order.content)
    orders.put(None)


def _watch_parent(orders: "queue.SimpleQueue[Sequence[Any] | None]") -> None:
    """End when the session's process has: another child of it may hold the pipe open."""
    parent = os.getppid()
    while os.getppid() == parent:
        time.sleep(1.0)
    orders.put(None)


def open_reception(
    url: LinkUrl, listen_only: bool, signing_key: Path | None, record_to: Path | None
) -> tuple[Reception, RequestsDone]:
    """What drives it; arguments as of `ReceiverProcess`.

    Raises:
        GcsSysidError: it cannot be.
    """
    link = PersistentLink(open_link(url))
    try:
        reception = Reception(link, record_to, listen_only=listen_only, signing_key=signing_key)
    except GcsSysidError:
        link.close()
        raise
    return reception, RequestsDone(reception.gate)


def main() -> int:
    """Receive until the session ends."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    outbox = Outbox(sys.stdout.buffer)
    try:
        settings = read_message(sys.stdin.buffer)
        if settings is None:
            return 2
        reception, requests = open_reception(*settings.content)
    except GcsSysidError as error:
        outbox.put(packed(error))
        outbox.close()
        return 2
    outbox.put(packed(reception.url))
    orders: queue.SimpleQueue[Sequence[Any] | None] = queue.SimpleQueue()
    threading.Thread(target=_read_orders, args=(sys.stdin.buffer, orders), daemon=True).start()
    threading.Thread(target=_watch_parent, args=(orders,), daemon=True).start()
    ReceiverMain(reception, requests, outbox, orders).run()
    outbox.close()
    os._exit(0)  # a disk that never answers again is left behind


if __name__ == "__main__":
    sys.exit(main())
