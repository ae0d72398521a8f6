"""Bytes in, MAVLink frames out, whatever the bytes are.

One rule decides everything: a frame counts as good only when its checksum, taken with the
CRC_EXTRA of its message type, is right. Failures are distinguished:

- the checksum of a known type fails but the chain goes on where its length says: the sender
  has another definition of that message. The frame is reported as `BAD_CRC` and skipped;
- an unknown type is skipped by its length in the same way (`UNKNOWN`); - otherwise the sync is
lost, and the scanner hunts for the next frame whose checksum is right. What lies between is counted
as garbage.

The answer depends on the bytes alone, never on how they were cut into pieces.
"""

import re
from collections.abc import Iterable
from enum import IntEnum
from typing import NamedTuple

from fastcrc import crc16

from gcs_sysid.telemetry.dialect import mavlink

MAGIC_1: int = mavlink.PROTOCOL_MARKER_V1
MAGIC_2: int = mavlink.PROTOCOL_MARKER_V2
HEADER_1: int = mavlink.HEADER_LEN_V1
HEADER_2: int = mavlink.HEADER_LEN_V2
CHECKSUM = 2
SIGNATURE: int = mavlink.MAVLINK_SIGNATURE_BLOCK_LEN
FLAG_SIGNED: int = mavlink.MAVLINK_IFLAG_SIGNED
LONGEST_FRAME = HEADER_2 + 255 + CHECKSUM + SIGNATURE

_mcrf4xx = crc16.mcrf4xx
_MAGIC = re.compile(b"[\xfd\xfe]")

CRC_EXTRA: dict[int, bytes] = {
    message_id: bytes([message.crc_extra]) for message_id, message in mavlink.mavlink_map.items()
}
"""Message id -> CRC_EXTRA as one byte, ready to be appended to what the checksum covers."""
LONGEST_1 = tuple(
    mavlink.mavlink_map[message_id].unpacker.size if message_id in CRC_EXTRA else -1
    for message_id in range(256)
)
"""Message id of version 1 -> bytes of its whole payload, -1 where it is unknown. A byte that claims
more begins no good frame; that is seen before a checksum is taken of what may be garbage."""


class Validity(IntEnum):
    """Validity of a frame."""

    OK = 0
    """The checksum is right."""
    UNKNOWN = 1
    """No CRC_EXTRA is known for the type: the content is unchecked."""
    BAD_CRC = 2
    """Checksum wrong although the chain is intact: a changed definition, or corrupted."""
    REPEATED = 3
    """The same frame, byte for byte, came before, as over a second radio."""


class Frame(NamedTuple):
    """One MAVLink frame as it came."""

    system: int
    component: int
    sequence: int
    message_id: int
    payload: bytes
    """As sent: in version 2 without trailing zeros."""
    raw: bytes
    """The whole frame, magic to checksum or signature."""
    version: int
    """1 or 2."""
    signed: bool
    valid: Validity


class _Need(Exception):  # noqa: N818 - a signal inside this module, not an error
    """More bytes are needed before anything can be decided."""


def _header(data: bytes, at: int, end: int) -> tuple[int, int, int, int] | None:
    """Read a header: (total length, end of payload, message id, version).

    None when these bytes cannot begin a frame; `_Need` when they end too early.
    """
    magic = data[at]
    if magic == MAGIC_2:
        if end - at < HEADER_2:
            # Flags already seen must be ones we can frame (the protocol says: discard).
            if end - at > 2 and data[at + 2] > FLAG_SIGNED:
                return None
            raise _Need
        flags = data[at + 2]
        if flags > FLAG_SIGNED:
            return None
        payload_end = at + HEADER_2 + data[at + 1]
        total = payload_end - at + CHECKSUM + (SIGNATURE if flags else 0)
        message_id = data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16
        return total, payload_end, message_id, 2
    if magic == MAGIC_1:
        if end - at < HEADER_1:
            raise _Need
        payload_end = at + HEADER_1 + data[at + 1]
        return payload_end - at + CHECKSUM, payload_end, data[at + 5], 1
    return None


def _frame_at(data: bytes, at: int, end: int) -> Frame | None:
    """Cut the frame that begins at `at`; None when nothing can begin there."""
    header = _header(data, at, end)
    if header is None:
        return None
    total, payload_end, message_id, _ = header
    if at + total > end:
        raise _Need
    extra = CRC_EXTRA.get(message_id)
    if extra is None:
        valid = Validity.UNKNOWN
    elif _mcrf4xx(data[at + 1 : payload_end] + extra) == (
        data[payload_end] | data[payload_end + 1] << 8
    ):
        valid = Validity.OK
    else:
        valid = Validity.BAD_CRC
    return _cut(data, at, header, valid)


def _cut(data: bytes, at: int, header: tuple[int, int, int, int], valid: Validity) -> Frame:
    """The frame with a header that begins at `at`."""
    total, payload_end, message_id, version = header
    stop = at + total
    if version == 2:
        return Frame(
            data[at + 5], data[at + 6], data[at + 4], message_id,
            data[at + HEADER_2 : payload_end], data[at:stop], 2, data[at + 2] != 0, valid,
        )  # fmt: skip
    return Frame(
        data[at + 3], data[at + 4], data[at + 2], message_id,
        data[at + HEADER_1 : payload_end], data[at:stop], 1, False, valid,
    )  # fmt: skip


def read_frame(data: bytes, at: int = 0) -> Frame | None:
    """Cut the frame that begins at `at`, of any validity; None when there is no whole one."""
    try:
        return _frame_at(data, at, len(data)) if at < len(data) else None
    except _Need:
        return None


def join_frames(frames: Iterable[Frame]) -> bytes:
    """Frames as bytes, each behind what its checksum was found to be; `split_frames` undoes it."""
    return b"".join([bytes([frame.valid]) + frame.raw for frame in frames])


def split_frames(data: bytes) -> list[Frame]:
    """The frames that `join_frames` joined; no checksum is taken again."""
    frames, at = [], 0
    while at < len(data):
        header = _header(data, at + 1, len(data))
        assert header is not None, "what was a frame there is one here"
        frames.append(_cut(data, at + 1, header, Validity(data[at])))
        at += 1 + header[0]
    return frames


def find_frame(data: bytes, at: int, stop: int, *, final: bool) -> tuple[int, Frame | None]:
    """Hunt for the first frame with a right checksum that begins in [at, stop).

    Returns its position and the frame, or (stop, None) when there is none. Unless `final`,
    a candidate that the data cut short raises the need for more.
    """
    end = len(data)
    while at < stop:
        found = _MAGIC.search(data, at, stop)
        if found is None:
            break
        at = found.start()
        if data[at] == MAGIC_1 and at + HEADER_1 <= end and data[at + 1] > LONGEST_1[data[at + 5]]:
            at += 1
            continue
        try:
            frame = _frame_at(data, at, end)
        except _Need:
            if not final:
                # Everything before this candidate is settled; go on from here next time.
                raise _NeedFrom(at) from None
        else:
            if frame is not None and frame.valid is Validity.OK:
                return at, frame
        at += 1
    return stop, None


class _NeedFrom(_Need):
    """More bytes are needed for a candidate at a position."""

    def __init__(self, at: int) -> None:
        super().__init__()
        self.at = at


class FrameScanner:
    """Turns pieces of a byte stream, or datagrams, into frames. Never raises on any bytes.

    Use `feed` for streams (TCP, serial) or `scan` for datagrams, not both on one scanner.

    Attributes:
        garbage_bytes: bytes that were part of no frame so far.
        bad_crc: frames reported as `BAD_CRC` so far.
    """

    def __init__(self) -> None:
        self.garbage_bytes = 0
        self.bad_crc = 0
        self._rest = b""
        self._in_chain = False

    def feed(self, chunk: bytes) -> list[Frame]:
        """Take the next piece of a stream and return the frames that it completes."""
        return self._run(self._rest + chunk if self._rest else bytes(chunk), final=False)

    def flush(self) -> list[Frame]:
        """Settle what is still held when the stream has ended."""
        frames = self._run(self._rest, final=True)
        self.garbage_bytes += len(self._rest)
        self._rest = b""
        self._in_chain = False
        return frames

    def scan(self, datagram: bytes) -> list[Frame]:
        """Return the frames of one datagram, which begins on a frame boundary.

        Some serial-to-UDP bridges cut frames in two: a frame begun at the end of the last
        datagram is completed by this one when the checksum then is right, and only then.
        """
        data = bytes(datagram)
        frames: list[Frame] = []
        if self._rest:
            joined = read_frame(self._rest + data)
            if joined is not None and joined.valid is Validity.OK:
                frames.append(joined)
                data = data[len(joined.raw) - len(self._rest) :]
            else:
                self.garbage_bytes += len(self._rest)
            self._rest = b""
        self._in_chain = True
        return frames + self._run(data, final=True)

    def _run(self, data: bytes, *, final: bool) -> list[Frame]:
        """Cut all frames that can be decided; what cannot stays in `_rest`."""
        frames: list[Frame] = []
        at = 0
        end = len(data)
        in_chain = self._in_chain
        try:
            while at < end:
                if not in_chain:
                    found, frame = find_frame(data, at, end, final=final)
                    self.garbage_bytes += found - at
                    at = found
                    if frame is None:
                        break
                else:
                    try:
                        frame = _frame_at(data, at, end)
                    except _Need:
                        if not final:
                            raise
                        # Cut short for good, unless whole frames hide behind a wrong length.
                        found, frame = find_frame(data, at + 1, end, final=True)
                        if frame is None:
                            break
                        self.garbage_bytes += found - at
                        at = found
                    if frame is None:
                        in_chain = False
                        continue
                    if frame.valid is not Validity.OK and not self._goes_on(
                        data, at, frame, final=final
                    ):
                        self.garbage_bytes += 1
                        at += 1
                        in_chain = False
                        continue
                in_chain = True
                if frame.valid is Validity.BAD_CRC:
                    self.bad_crc += 1
                frames.append(frame)
                at += len(frame.raw)
        except _NeedFrom as need:
            if not in_chain:  # the bytes before the candidate were hunted through already
                self.garbage_bytes += need.at - at
                at = need.at
        except _Need:
            pass
        self._rest = data[at:]
        self._in_chain = in_chain
        return frames

    def _goes_on(self, data: bytes, at: int, frame: Frame, *, final: bool) -> bool:
        """Whether the chain goes on after a frame that has no right checksum."""
        stop = at + len(frame.raw)
        if stop < len(data):
            intact = data[stop] == MAGIC_2 or data[stop] == MAGIC_1
        elif final:
            intact = True
        else:
            raise _Need
        if not intact or frame.valid is Validity.UNKNOWN:
            return intact
        # A corrupted length byte can land on a magic byte by chance. Then good frames lie
        # inside of what would be skipped.
        _, inside = find_frame(data, at + 1, stop, final=final)
        return inside is None
