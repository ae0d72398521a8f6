"""MAVLink's messages and enumerations, as pymavlink packs and unpacks them.

`mavlink` is the dialect of pymavlink that includes all others, in which the messages that it lacks
are registered.
"""

import struct
from inspect import Parameter, Signature
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

__all__ = ["declare", "mavlink"]

_LACKING = (
    # Slow ESC data of up to four rotors.
    (290, "ESC_INFO", "uint8_t index, uint64_t time_usec, uint16_t counter, uint8_t count,"
     "uint8_t connection_type, uint8_t info, uint16_t[4] failure_flags, uint32_t[4] error_count,"
     "int16_t[4] temperature"),
    # Rotor speeds of up to four rotors, in rpm: the sign is the sense of rotation. `index` is the
    # first ESC's, `time_usec` the time of sending, not of measuring.
    (291, "ESC_STATUS", "uint8_t index, uint64_t time_usec, int32_t[4] rpm, float[4] voltage,"
     "float[4] current"),
    (300, "PROTOCOL_VERSION", "uint16_t version, uint16_t min_version, uint16_t max_version,"
     "uint8_t[8] spec_version_hash, uint8_t[8] library_version_hash"),
)  # fmt: skip
"""(number, name, fields in the order of MAVLink's XML) of what no dialect of pymavlink 2.4.50 has.
A message with extension fields or text has no place here yet."""

_CODES = {
    "uint64_t": "Q", "int64_t": "q", "double": "d", "uint32_t": "I", "int32_t": "i", "float": "f",
    "uint16_t": "H", "int16_t": "h", "uint8_t": "B", "int8_t": "b",
}  # fmt: skip


def declare(number: int, name: str, definition: str) -> type[Any]:
    """Make the class of a message as pymavlink's generator does.

    Fields go onto the wire by size, the largest first, and CRC_EXTRA is a checksum of their names
    and types (https://mavlink.io/en/guide/serialization.html). The definition is types and names of
    the fields, separated by commas; `int32_t[4] rpm` is an array.
    """
    base = mavlink.MAVLink_message
    fields = []  # (type, length of the array or 0, name)
    for words in definition.split(","):
        declared, field = words.split()
        kind, _, length = declared.rstrip("]").partition("[")
        fields.append((kind, int(length or 0), field))
    wire = sorted(fields, key=lambda field: -struct.calcsize(_CODES[field[0]]))
    checksum = mavlink.x25crc(f"{name} ".encode())
    for kind, count, field in wire:
        checksum.accumulate(f"{kind} {field} ".encode() + bytes([count] if count else []))
    names = [field for _, _, field in fields]
    signature = Signature([Parameter(n, Parameter.POSITIONAL_OR_KEYWORD) for n in names])

    def init(message: Any, *values: Any, **named: Any) -> None:
        base.__init__(message, number, name)
        message._fieldnames = names
        vars(message).update(signature.bind(*values, **named).arguments)

    def pack(message: Any, mav: Any, force_mavlink1: bool = False) -> bytes:
        values: list[float] = []
        for _, count, field in wire:
            value = getattr(message, field)
            values += value[:count] if count else [value]
        payload = message.unpacker.pack(*values)
        packed: bytes = message._pack(mav, message.crc_extra, payload, force_mavlink1)
        return packed

    content = {
        "id": number,
        "msgname": name,
        "fieldnames": names,
        "ordered_fieldnames": [field for _, _, field in wire],
        "fieldtypes": [kind for kind, _, _ in fields],
        "native_format": bytearray("<" + "".join(_CODES[kind] for kind, _, _ in wire), "ascii"),
        "orders": [wire.index(field) for field in fields],
        "lengths": [max(count, 1) for _, count, _ in wire],
        "array_lengths": [count for _, count, _ in wire],
        "crc_extra": (checksum.crc & 0xFF) ^ checksum.crc >> 8,
        "unpacker": struct.Struct(
            "<" + "".join(f"{count or ''}{_CODES[kind]}" for kind, count, _ in wire)
        ),
        "__init__": init,
        "pack": pack,
    }
    return type(f"MAVLink_{name.lower()}_message", (base,), content)


for _number, _name, _definition in _LACKING:
    if _number not in mavlink.mavlink_map:
        _message = declare(_number, _name, _definition)
        mavlink.mavlink_map[_number] = _message
        setattr(mavlink, f"MAVLINK_MSG_ID_{_name}", _number)
        setattr(mavlink, _message.__name__, _message)
