"""Signs frames that are there already, as a sender with the key would."""

import hashlib

from fastcrc import crc16

from gcs_sysid.telemetry.frames import CHECKSUM, FLAG_SIGNED
from gcs_sysid.telemetry.signing import SigningClock


class Signer:
    """Signs frames of version 2."""

    def __init__(self, key: bytes, clock: SigningClock) -> None:
        self._key = key
        self._clock = clock

    def sign(self, raw: bytes, crc_extra: int) -> bytes:
        """The frame with its flag set, a new checksum (which covers the flag) and a signature."""
        body = bytearray(raw[:-CHECKSUM])
        body[2] |= FLAG_SIGNED
        checksum = crc16.mcrf4xx(bytes(body[1:]) + bytes([crc_extra]))
        body += checksum.to_bytes(2, "little")
        body.append(0)  # there is one link
        body += self._clock.next_time().to_bytes(6, "little")
        return bytes(body) + hashlib.sha256(self._key + bytes(body)).digest()[:6]
