"""MAVLink 2 frames on the way out.

pymavlink's own `pack` builds several objects a message; at thousands of messages a second it
would be the slowest part of the emulator. A test holds these frames equal to pymavlink's.
"""

import struct
from typing import Any

from fastcrc.crc16 import mcrf4xx

MAGIC = 0xFD
_HEADER = struct.Struct("<BBBBBBBHB")
_CRC = struct.Struct("<H")


class FrameWriter:
    """Makes frames of one sender, numbered one after the other.

    Attributes:
        sysid: of the sender.
        compid: of the sender.
        sequence: number of the next frame.
    """

    def __init__(self, sysid: int = 1, compid: int = 1) -> None:
        self.sysid = sysid
        self.compid = compid
        self.sequence = 0

    def frame(self, message: Any, *values: Any) -> bytes:
        """A frame of the given message class.

        Args:
            message: class of the dialect.
            values: the fields in wire order (`ordered_fieldnames`), arrays spread out.
        """
        return self.frame_of_payload(message.id, message.crc_extra, message.unpacker.pack(*values))

    def frame_of_payload(self, msgid: int, crc_extra: int, payload: bytes) -> bytes:
        """A frame around a packed payload, trailing zero bytes cut as MAVLink 2 does."""
        payload = payload.rstrip(b"\0") or payload[:1]
        head = _HEADER.pack(
            MAGIC,
            len(payload),
            0,
            0,
            self.sequence,
            self.sysid,
            self.compid,
            msgid & 0xFFFF,
            msgid >> 16,
        )
        self.sequence = (self.sequence + 1) & 0xFF
        body = head + payload
        crc = mcrf4xx(bytes((crc_extra,)), mcrf4xx(body[1:]))
        return body + _CRC.pack(crc)
