"""What the receiver's process and a session's hand each other: objects, each behind its length.

To the receiver go the arguments of `open_reception`, then orders, each a name and its arguments.
From it come the URL that was opened or the error, then `Report`, `Flushed` and the items of
`reception`. Frames travel as they came over the link, and are not checked again; all else is
pickled.
"""

import pickle
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from gcs_sysid.live.reception import RecordingReport
from gcs_sysid.telemetry.frames import join_frames, split_frames
from gcs_sysid.telemetry.receiver import ReceivedFrames
from gcs_sysid.telemetry.transceiver import LinkReport

REQUESTS = (
    "heartbeat", "set_message_interval", "get_message_interval", "request_message_interval",
    "request_group", "read_parameter",
)  # fmt: skip
"""What a session may have the receiver's gate ask: the methods of `Requests`."""
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
