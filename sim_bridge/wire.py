"""MAVLink frames on the way out: version 2, signed if wanted, or version 1.

pymavlink's own `pack` builds several objects a message; at thousands of messages a second it
would be the slowest part of the emulator. A test holds these frames equal to pymavlink's.
"""

import hashlib
import struct
from collections.abc import Callable
from typing import Any

from fastcrc.crc16 import mcrf4xx

MAGIC = 0xFD
MAGIC_1 = 0xFE
SIGNED = 0x01
_HEADER = struct.Struct("<BBBBBBHB")
_HEADER_1 = struct.Struct("<BBBBB")
_START, _START_1 = bytes((MAGIC,)), bytes((MAGIC_1,))
_EXTRAS = tuple(bytes((i,)) for i in range(256))

SIGNING_EPOCH_US = 1_420_070_400_000_000
"""us from 1970 to 2015, where the time stamps of signatures begin."""

BASE_LENGTHS = {
    1: 31,  # SYS_STATUS
    24: 30,  # GPS_RAW_INT
    27: 26,  # RAW_IMU
    29: 14,  # SCALED_PRESSURE
    31: 32,  # ATTITUDE_QUATERNION
    36: 21,  # SERVO_OUTPUT_RAW
    42: 2,  # MISSION_CURRENT
    44: 4,  # MISSION_COUNT
    77: 3,  # COMMAND_ACK
    105: 62,  # HIGHRES_IMU
    116: 22,  # SCALED_IMU2
    147: 36,  # BATTERY_STATUS
    148: 60,  # AUTOPILOT_VERSION
    242: 52,  # HOME_POSITION
    253: 51,  # STATUSTEXT
}
"""Payload bytes without extension fields, which version 1 does not carry, where there are any."""


class Signer:
    """Signs frames of one link.

    Attributes:
        key: 32 bytes.
    """

    def __init__(self, key: bytes, clock: Callable[[], int], link: int = 0) -> None:
        """Sign with a key; `clock` gives us since 1970."""
        self.key = key
        self._clock = clock
        self._link = link
        self._last = 0

    def signature(self, frame: bytes) -> bytes:
        """The 13 bytes that follow a frame with its checksum."""
        # Units of 10 us, and never the same twice.
        self._last = max(self._last + 1, (self._clock() - SIGNING_EPOCH_US) // 10)
        head = bytes((self._link,)) + self._last.to_bytes(6, "little")
        return head + hashlib.sha256(self.key + frame + head).digest()[:6]


class FrameWriter:
    """Makes frames of one sender, numbered one after the other.

    Attributes:
        sysid: of the sender.
        compid: of the sender.
        sequence: number of the next frame.
        version: of MAVLink, 1 or 2.
        signer: signs every frame; None for none.
    """

    def __init__(
        self, sysid: int = 1, compid: int = 1, version: int = 2, signer: Signer | None = None
    ) -> None:
        self.sysid = sysid
        self.compid = compid
        self.version = version
        self.signer = signer
        self.sequence = 0
        self._known: dict[Any, tuple[Callable[..., bytes], int, int]] = {}

    def frame(self, message: Any, *values: Any) -> bytes:
        """A frame of the given message class; empty where version 1 has no such message.

        Args:
            message: class of the dialect.
            values: the fields in wire order (`ordered_fieldnames`), arrays spread out.
        """
        known = self._known.get(message)
        if known is None:
            msgid, crc_extra = message.id, message.crc_extra
            known = message.unpacker.pack, msgid, crc_extra
            self._known[message] = known
        pack, msgid, crc_extra = known
        return self.frame_of_payload(msgid, crc_extra, pack(*values))

    def frame_of_payload(self, msgid: int, crc_extra: int, payload: bytes) -> bytes:
        """A frame around a packed payload; empty where version 1 has no such message."""
        if self.version == 1:
            return self._frame_1(msgid, crc_extra, payload)
        # Version 2 cuts trailing zero bytes.
        payload = payload.rstrip(b"\0") or payload[:1]
        signer = self.signer
        sequence = self.sequence
        self.sequence = (sequence + 1) & 0xFF
        low, high = msgid & 0xFFFF, msgid >> 16
        flags = 0 if signer is None else SIGNED
        head = _HEADER.pack(len(payload), flags, 0, sequence, self.sysid, self.compid, low, high)
        frame = _closed(_START, head + payload, crc_extra)
        return frame if signer is None else frame + signer.signature(frame)

    def _frame_1(self, msgid: int, crc_extra: int, payload: bytes) -> bytes:
        if msgid > 255:
            return b""
        payload = payload[: BASE_LENGTHS.get(msgid)]
        head = _HEADER_1.pack(len(payload), self.sequence, self.sysid, self.compid, msgid)
        self.sequence = (self.sequence + 1) & 0xFF
        return _closed(_START_1, head + payload, crc_extra)


def _closed(start: bytes, body: bytes, crc_extra: int) -> bytes:
    crc: int = mcrf4xx(body + _EXTRAS[crc_extra])
    return start + body + crc.to_bytes(2, "little")
