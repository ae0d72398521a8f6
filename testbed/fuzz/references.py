"""Slow and plain: which frames a stream or a recording holds, a byte at a time.

Written from the protocol and from what the scanners promise, with nothing of theirs but the
CRC_EXTRA of each message type.
"""

from typing import NamedTuple

from gcs_sysid.telemetry.frames import CRC_EXTRA

OK, UNKNOWN, BAD = "ok", "unknown", "bad_crc"
_MAGICS = (0xFD, 0xFE)
_STAMP = 8


class Found(NamedTuple):
    """A frame, and what is known of it."""

    at: int
    size: int
    validity: str


def _shifted(crc: int) -> int:
    for _ in range(8):
        crc = crc >> 1 ^ (0x8408 if crc & 1 else 0)
    return crc


_SHIFTED = [_shifted(byte) for byte in range(256)]


def checksum(data: bytes) -> int:
    """CRC-16/MCRF4XX, a byte at a time."""
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ _SHIFTED[(crc ^ byte) & 0xFF]
    return crc


def look(data: bytes, at: int) -> Found | None:
    """The frame that begins at a position, if there is a whole one."""
    if at >= len(data) or data[at] not in _MAGICS:
        return None
    second = data[at] == 0xFD
    header = 10 if second else 6
    if len(data) - at < header:
        return None
    if second and data[at + 2] > 1:
        return None
    message_id = int.from_bytes(data[at + 7 : at + 10], "little") if second else data[at + 5]
    end = at + header + data[at + 1]
    size = end + 2 + (13 if second and data[at + 2] else 0) - at
    if at + size > len(data):
        return None
    extra = CRC_EXTRA.get(message_id)
    if extra is None:
        return Found(at, size, UNKNOWN)
    right = checksum(data[at + 1 : end] + extra) == int.from_bytes(data[end : end + 2], "little")
    return Found(at, size, OK if right else BAD)


def is_good(found: Found | None) -> bool:
    """Whether its checksum is right."""
    return found is not None and found.validity == OK


def _hides_one(data: bytes, found: Found) -> bool:
    """Whether a good frame begins inside of one whose checksum is wrong."""
    inside = range(found.at + 1, found.at + found.size)
    return found.validity == BAD and any(is_good(look(data, at)) for at in inside)


def frames_of_stream(data: bytes) -> list[Found]:
    """What `FrameScanner` finds in a stream that has ended."""
    out: list[Found] = []
    at, chained = 0, False
    while at < len(data):
        found = look(data, at)
        keep = is_good(found)
        if found is not None and not keep and chained:
            stop = at + found.size
            goes_on = stop == len(data) or data[stop] in _MAGICS
            keep = goes_on and not _hides_one(data, found)
        if found is not None and keep:
            out.append(found)
            at, chained = at + found.size, True
        else:
            at, chained = at + 1, False
    return out


def frames_of_log(data: bytes) -> list[Found]:
    """What a .tlog's `Scanner` finds."""
    out: list[Found] = []
    record: int | None = 0
    hunting = False
    while record is not None:
        found = None if hunting else _of_record(data, record + _STAMP)
        if found is None:
            places = range(record, len(data))
            found = next((f for f in (look(data, at) for at in places) if is_good(f)), None)
        if found is not None:
            out.append(found)
        record = None if found is None else found.at + found.size
    return out


def _of_record(data: bytes, at: int) -> Found | None:
    """The frame where a record has it, if it keeps its place."""
    found = look(data, at)
    if found is None or found.validity == OK:
        return found
    stop = at + found.size
    magic = stop + _STAMP
    follows = stop == len(data) if magic >= len(data) else data[magic] in _MAGICS
    return found if follows and not _hides_one(data, found) else None
