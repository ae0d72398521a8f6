"""What the receiver's process and a session's say to each other, as bytes.

To the receiver go lines of JSON: the settings, then orders, each a list of a name and arguments.
From it come messages, each a kind, a length and a body. Frames travel as they came over the link,
and are not checked again.
"""

import json
import struct
from dataclasses import asdict, dataclass, field
from typing import Any, BinaryIO

from gcs_sysid.live.reception import (
    Ended,
    Failure,
    Item,
    RecordingCut,
    RecordingReport,
    ResetMark,
    Toggled,
)
from gcs_sysid.telemetry.frames import join_frames, split_frames
from gcs_sysid.telemetry.receiver import ReceivedFrames
from gcs_sysid.telemetry.senders import Rival
from gcs_sysid.telemetry.signing import Refusal
from gcs_sysid.telemetry.transceiver import LinkReport

OPENED, REFUSED, REPORT, FLUSHED = b"O", b"N", b"R", b"L"
"""The link is open, with its URL; it could not be, with the error; figures; the latest file."""
FRAMES, RESET, CUT, TOGGLED, FAILURE, ENDED = b"F", b"M", b"C", b"T", b"X", b"E"
"""The items of `reception`, in their order."""
_HEAD = struct.Struct("<cI")
TIME = struct.Struct("<Q")


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


def message(kind: bytes, body: bytes = b"") -> bytes:
    """A message to the session."""
    return _HEAD.pack(kind, len(body)) + body


def read_message(source: BinaryIO) -> tuple[bytes, bytes] | None:
    """The next message, kind and body; None when there is no more."""
    head = source.read(_HEAD.size)
    if len(head) < _HEAD.size:
        return None
    kind, size = _HEAD.unpack(head)
    body = source.read(size)
    return (kind, body) if len(body) == size else None


def json_message(kind: bytes, content: Any) -> bytes:
    """The same with something of JSON as its body."""
    return message(kind, json.dumps(content).encode())


def item_message(item: Item) -> bytes:
    """An item of `reception`."""
    match item:
        case ReceivedFrames(time_us, frames):
            return message(FRAMES, TIME.pack(time_us) + join_frames(frames))
        case ResetMark(time_us):
            return message(RESET, TIME.pack(time_us))
        case RecordingCut():
            return message(CUT)
        case Toggled(text):
            return message(TOGGLED, text.encode())
        case Failure(text):
            return message(FAILURE, text.encode())
        case Ended():
            return message(ENDED)


def read_item(kind: bytes, body: bytes) -> Item:
    """The item that a message holds."""
    match kind:
        case b"F":
            return ReceivedFrames(TIME.unpack_from(body)[0], split_frames(body, TIME.size))
        case b"M":
            return ResetMark(TIME.unpack(body)[0])
        case b"C":
            return RecordingCut()
        case b"T":
            return Toggled(body.decode())
        case b"X":
            return Failure(body.decode())
    return Ended()


def report_message(report: Report) -> bytes:
    """Figures of the moment."""
    return json_message(REPORT, asdict(report))


def read_report(body: bytes) -> Report:
    """The figures in a message."""
    table = json.loads(body)
    link, recording = table["link"], table["recording"]
    if link["rival"] is not None:
        link["rival"] = Rival(*map(tuple, link["rival"]))
    if link["refused"] is not None:
        link["refused"] = {Refusal(reason): n for reason, n in link["refused"].items()}
    recording["lines"] = tuple(recording["lines"])
    return Report(
        LinkReport(**link), RecordingReport(**recording), table["withheld"], tuple(table["events"])
    )
