"""The session's end of a receiver in a process of its own, and what travels between the two.

Objects travel, each behind its length. To the receiver go the arguments of `open_reception`, then
orders, each a name and its arguments. From it come the URL that was opened or the error, then
`Report`, `Flushed` and the items of `reception`. Frames travel as they came over the link, and are
not checked again; all else is pickled.
"""

import contextlib
import pickle
import struct
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial, wraps
from pathlib import Path
from typing import Any, BinaryIO, Concatenate, NamedTuple, ParamSpec, cast

from gcs_sysid.errors import LinkError
from gcs_sysid.live.reception import Item, Reception, RecordingReport
from gcs_sysid.processes import apart
from gcs_sysid.telemetry.frames import join_frames, split_frames
from gcs_sysid.telemetry.outgoing import Gate
from gcs_sysid.telemetry.transceiver import LinkReport, ReceivedFrames
from gcs_sysid.telemetry.urls import LinkUrl

REQUESTS = (
    "heartbeat", "set_message_interval", "get_message_interval", "request_message_interval",
    "request_group", "read_parameter",
)  # fmt: skip
"""What a session may have the receiver's gate ask: methods of `Gate`."""
_HEAD = struct.Struct("<QI")
"""When frames arrived, us since 1970, 0 for anything else; bytes that follow."""


@dataclass(frozen=True)
class Report:
    """Figures of the moment.

    Attributes:
        link: of the link.
        recording: of the recording.
        withheld: frames that were recorded and not handed over.
        events: what happened to the recording since the last report.
    """

    link: LinkReport = field(default_factory=LinkReport)
    recording: RecordingReport = field(default_factory=RecordingReport)
    withheld: int = 0
    events: tuple[str, ...] = ()


class Flushed(NamedTuple):
    """The answer to a numbered wish: the latest recording, whole up to now; None without one."""

    number: int
    path: Path | None


class WireMessage(NamedTuple):
    """An object on its way; frames are not unpacked before they are wanted."""

    time_us: int
    body: bytes

    @property
    def content(self) -> Any:
        """The object."""
        if self.time_us:
            return ReceivedFrames(self.time_us, split_frames(self.body))
        return pickle.loads(self.body)


def packed(content: object) -> bytes:
    """An object as it is written into the pipe."""
    if isinstance(content, ReceivedFrames):
        body = join_frames(content.frames)
        return _HEAD.pack(content.time_us, len(body)) + body
    body = pickle.dumps(content)
    return _HEAD.pack(0, len(body)) + body


def read_message(source: BinaryIO) -> WireMessage | None:
    """The next object out of the pipe; None when there is no more."""
    head = source.read(_HEAD.size)
    if len(head) < _HEAD.size:
        return None
    time_us, size = _HEAD.unpack(head)
    body = source.read(size)
    return WireMessage(time_us, body) if len(body) == size else None


COMMAND = [sys.executable, "-P", "-m", "gcs_sysid.live.receiver_main"]
AT_ONCE = 32
"""Items taken at a time: 0.1 to 0.3 s of data."""
MOST_WAITING = 64 * 2**20
"""Bytes that wait here, ten minutes at 1 kHz; as many more wait in the receiver, and what comes
beyond is recorded, and not handed over."""
_MOST_EVENTS = 100


class RelayedRequests:
    """Proxy for the gate where that is in another process: forwards requests to it.

    `send` is called with a method of `Gate`, the protocol version and the arguments.
    """

    def __init__(
        self, send: Callable[..., None], *, listen_only: bool = False, signing: bool = False
    ) -> None:
        self.version = 2
        self._send = send
        self.listen_only = listen_only
        self.signing = signing

    def __getattr__(self, name: str) -> Callable[..., bool]:
        if name not in REQUESTS:
            raise AttributeError(name)
        return partial(self._ask, name)

    def _ask(self, name: str, *arguments: object) -> bool:
        if not self.listen_only:
            self._send(name, self.version, *arguments)
        return not self.listen_only


_Arguments = ParamSpec("_Arguments")


def _ordered(
    method: Callable[Concatenate[Any, _Arguments], None],
) -> Callable[Concatenate["ReceiverProcess", _Arguments], None]:
    """A method of `Reception`, done there."""

    @wraps(method)
    def order(
        self: "ReceiverProcess", /, *arguments: _Arguments.args, **_: _Arguments.kwargs
    ) -> None:
        self._order(method.__name__, *arguments)

    return order


class ReceiverProcess:
    """A receiver that goes on while this process is busy, and closes its recording if it dies.

    Without the file with the signing key nothing is signed or checked; without `record_to` nothing
    is recorded until it is started.

    Raises:
        InputError: the recording exists, or there is no key.
        LinkError: the link cannot be opened.
    """

    def __init__(
        self,
        url: LinkUrl,
        *,
        listen_only: bool = False,
        signing_key: Path | None = None,
        record_to: Path | None = None,
    ) -> None:
        self._wake = threading.Condition()
        self._messages: deque[WireMessage] = deque()
        self._size = 0
        self._newest = self._taken = 0  # us since 1970
        self._over = False
        self._returned: list[Item] = []
        self._report = Report()
        self._events: deque[str] = deque(maxlen=_MOST_EVENTS)
        self._flushes = 0
        self._flushed = Flushed(0, None)
        self._ordering = threading.Lock()
        self._reader: threading.Thread | None = None
        self._process: subprocess.Popen[bytes] = subprocess.Popen(
            COMMAND,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            **apart(),
        )
        self._orders = cast(BinaryIO, self._process.stdin)
        self._answers = cast(BinaryIO, self._process.stdout)
        self._send((url, listen_only, signing_key, record_to))
        self.url = self._opened(url)
        settings = {"listen_only": listen_only, "signing": signing_key is not None}
        relayed = RelayedRequests(lambda *what: self._order("ask", *what), **settings)
        self._gate = cast(Gate, relayed)
        self._reader = threading.Thread(target=self._read, name="receiver", daemon=True)
        self._reader.start()

    def _opened(self, url: LinkUrl) -> LinkUrl:
        """The URL that was opened; the error if none was."""
        first = read_message(self._answers)
        opened = LinkError(f"{url}: the receiver process did not start")
        if first is not None:
            opened = first.content
        if isinstance(opened, LinkUrl):
            return opened
        self.close()
        raise opened

    @property
    def gate(self) -> Gate:
        """Passes requests to the receiver; its gate decides."""
        return self._gate

    @property
    def link_report(self) -> LinkReport:
        """By its latest report."""
        report = self._report.link
        # What came before the end is still to be taken.
        return replace(report, ended=report.ended and not self._messages)

    @property
    def recording_report(self) -> RecordingReport:
        """By its latest report."""
        return self._report.recording

    @property
    def withheld(self) -> int:
        """Frames that are recorded and were not handed over, because too many waited."""
        return self._report.withheld

    @property
    def waiting(self) -> float:
        """Arrived data that were not taken yet, s."""
        return max(0.0, 1e-6 * (self._newest - self._taken)) if self._messages else 0.0

    def next_items(self, timeout: float) -> Sequence[Item]:
        """Wait up to `timeout` s; what comes next, in order.

        Raises:
            LinkError: the receiver has died.
        """
        if self._returned:
            returned, self._returned = self._returned, []
            return returned
        with self._wake:
            self._wake.wait_for(lambda: self._messages or self._over, timeout)
            count = min(len(self._messages), AT_ONCE)
            some = [self._messages.popleft() for _ in range(count)]
            self._size -= sum(len(message.body) for message in some)
            self._wake.notify_all()
        if not some and self._over:
            raise LinkError(f"{self.url}: the receiver died; its recording is complete")
        self._taken = max(self._taken, *(message.time_us for message in some), 0)
        return [message.content for message in some]

    def put_back(self, items: Sequence[Item]) -> None:
        """Have the next `next_items` give these, which were taken before."""
        self._returned = [*items, *self._returned]

    def take_events(self) -> list[str]:
        """What happened to the recording since this was last asked, one line each."""
        events = []
        while self._events:
            events.append(self._events.popleft())
        return events

    follow = _ordered(Reception.follow)
    mark_reset = _ordered(Reception.mark_reset)
    start_recording = _ordered(Reception.start_recording)
    stop_recording = _ordered(Reception.stop_recording)
    cut_recording = _ordered(Reception.cut_recording)
    finish = _ordered(Reception.finish)

    def flushed_recording(self) -> Path | None:
        """The latest recording, all that was written so far in the file; None without one."""
        with self._wake:
            self._flushes += 1
            number = self._flushes
        self._order("flush", number)
        with self._wake:
            self._wake.wait_for(lambda: self._flushed.number >= number or self._over, 15.0)
            return self._flushed.path

    def close(self) -> None:
        """End it, if it has not ended; what was not taken is recorded all the same."""
        with contextlib.suppress(OSError):
            self._orders.close()
        with self._wake:
            self._messages.clear()
            self._size = 0
            self._wake.notify_all()
        try:
            # It may take its time to write everything; then it is killed.
            self._process.wait(20.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._reader is None:
            self._answers.close()
        else:
            self._reader.join()

    def _order(self, name: str, *arguments: object) -> None:
        self._send((name, *arguments))

    def _send(self, content: Any) -> None:
        with (
            self._ordering,
            contextlib.suppress(OSError, ValueError),
        ):  # it has died: `take` reports that
            self._orders.write(packed(content))
            self._orders.flush()

    def _read(self) -> None:
        """Take down all that the receiver says; in a thread of its own."""
        with contextlib.suppress(OSError, ValueError):
            while (message := read_message(self._answers)) is not None:
                self._note(message)
        with self._wake:
            self._over = True
            self._wake.notify_all()
        self._answers.close()

    def _note(self, message: WireMessage) -> None:
        content = None if message.time_us else message.content
        if isinstance(content, Report):
            self._report = content
            self._events.extend(content.events)
            return
        with self._wake:
            if isinstance(content, Flushed):
                self._flushed = content
            else:
                self._wake.wait_for(lambda: self._size < MOST_WAITING)
                if message.time_us:
                    self._newest = max(self._newest, message.time_us)
                    self._taken = self._taken or self._newest
                self._messages.append(message)
                self._size += len(message.body)
            self._wake.notify_all()


Source = Reception | ReceiverProcess
"""Where a session's data come from: a reception, here or in another process."""
