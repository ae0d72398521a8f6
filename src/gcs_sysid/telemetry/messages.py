"""Payloads to numbers, by precompiled layouts taken from the dialect: one message, or all of a type
as one structured array.
"""

import struct
from collections.abc import Callable, Collection
from functools import cache
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frame_block import FrameBlock, counts_of, rows_of
from gcs_sysid.telemetry.frames import Validity

HEADER = [
    ("_time_us", "<u8"),
    ("_frame", "<i8"),
    ("_sequence", "u1"),
    ("_system", "u1"),
    ("_component", "u1"),
]
"""What every array has before the message's own fields, with names that no field has: the
record's time in us since 1970, the number of the frame in the file, and the frame's header."""

_TYPES = {
    "uint8_t_mavlink_version": "u1", "uint8_t": "u1", "int8_t": "i1", "uint16_t": "<u2",
    "int16_t": "<i2", "uint32_t": "<u4", "int32_t": "<i4", "uint64_t": "<u8", "int64_t": "<i8",
    "float": "<f4", "double": "<f8",
}  # fmt: skip


class PayloadLayout(NamedTuple):
    """How the payload of one message type is laid out on the wire."""

    name: str
    unpacker: struct.Struct
    size: int
    """Bytes of the whole payload, extensions included."""
    places: dict[str, tuple[int, int]]
    """Field name -> (index of its first value, number of values) after unpacking."""


def _layout(message: Any) -> PayloadLayout:
    places: dict[str, tuple[int, int]] = {}
    at = 0
    lengths = dict(
        # pymavlink keeps array lengths in wire order, but types in the order of the XML.
        zip(message.ordered_fieldnames, message.array_lengths, strict=True)
    )
    for name in message.ordered_fieldnames:
        kind = message.fieldtypes[message.fieldnames.index(name)]
        # A char array unpacks to one bytes value.
        count = 1 if kind == "char" else max(1, lengths[name])
        places[name] = (at, count)
        at += count
    unpacker = message.unpacker
    return PayloadLayout(message.msgname, unpacker, unpacker.size, places)


LAYOUTS: dict[int, PayloadLayout] = {
    message_id: _layout(message) for message_id, message in mavlink.mavlink_map.items()
}
MESSAGE_IDS: dict[str, int] = {layout.name: message_id for message_id, layout in LAYOUTS.items()}
NAMED_IDS = np.array(sorted(LAYOUTS))
"""Ids of all message types that have a name, rising."""
OTHER_TYPES = 2**24
"""Id for types without a name that are counted together; no message has it."""


def message_name(message_id: int) -> str:
    """Name of a message type; `UNKNOWN_<id>` when unknown."""
    if message_id == OTHER_TYPES:
        return "UNKNOWN"
    layout = LAYOUTS.get(message_id)
    return f"UNKNOWN_{message_id}" if layout is None else layout.name


def picker(message_name: str, *fields: str) -> Callable[[bytes], tuple[Any, ...]]:
    """Make a fast function from a payload to the flat values of the fields named."""
    message_id = MESSAGE_IDS[message_name]
    layout = LAYOUTS[message_id]
    places = [layout.places[field] for field in fields]
    indices = [at + i for at, count in places for i in range(count)]
    size = layout.size
    unpack_payload = layout.unpacker.unpack
    if len(indices) == 1:
        only = indices[0]
        return lambda payload: (unpack_payload(payload[:size].ljust(size, b"\0"))[only],)
    pick: Callable[[tuple[Any, ...]], tuple[Any, ...]] = itemgetter(*indices)
    return lambda payload: pick(unpack_payload(payload[:size].ljust(size, b"\0")))


def field_bytes(message_name: str, field: str) -> slice:
    """Where a field lies in the payload of a message."""
    fields = message_dtype(message_name).fields
    assert fields is not None
    kind, offset, *_ = fields[field]
    start = offset - np.dtype(HEADER).itemsize
    return slice(start, start + kind.itemsize)


@cache
def message_dtype(name: str) -> np.dtype[np.void]:
    """Type of the array that holds messages of a name: `HEADER`, then the fields.

    The fields lie as on the wire, arrays as subarrays and char arrays as bytes.

    Raises:
        KeyError: the dialect has no message of that name.
    """
    message = mavlink.mavlink_map[MESSAGE_IDS[name]]
    fields: list[tuple[str, str] | tuple[str, str, int]] = [*HEADER]
    for field, count in zip(message.ordered_fieldnames, message.array_lengths, strict=True):
        kind = message.fieldtypes[message.fieldnames.index(field)]
        if kind == "char":
            fields.append((field, f"S{max(count, 1)}"))
        elif count:
            fields.append((field, _TYPES[kind], count))
        else:
            fields.append((field, _TYPES[kind]))
    return np.dtype(fields)


def message_arrays(
    frames: FrameBlock, names: Collection[str] | None = None, among: Array | None = None
) -> dict[str, Array]:
    """The messages in frames whose checksums are right.

    Args:
        frames: some frames of a log.
        names: of the types wanted; None: all that the dialect knows.
        among: (n,) bool, of which frames; None: of all.

    Returns:
        Name -> (m,) array of type `message_dtype(name)`, in the order of the file, for the
        types that occur.

    Raises:
        KeyError: the dialect has no message of a name.
    """
    wanted = set(LAYOUTS) if names is None else {MESSAGE_IDS[name] for name in names}
    good = frames.validity == Validity.OK
    if among is not None:
        good &= among
    arrays: dict[str, Array] = {}
    good_ids = np.where(good, frames.message_id, -1)
    for message_id in sorted(wanted.intersection(counts_of(frames.message_id[good]))):
        rows = np.flatnonzero(good_ids == message_id)
        name = LAYOUTS[message_id].name
        arrays[name] = _gather(frames, rows, message_dtype(name), LAYOUTS[message_id].size)
    return arrays


def _gather(frames: FrameBlock, rows: Array, kind: np.dtype[np.void], size: int) -> Array:
    messages = np.empty(len(rows), kind)
    messages["_time_us"] = frames.time_us.take(rows)
    messages["_frame"] = frames.number + rows
    messages["_sequence"] = frames.sequence.take(rows)
    messages["_system"] = frames.system.take(rows)
    messages["_component"] = frames.component.take(rows)
    payloads = rows_of(frames.data, frames.payload_at.take(rows), size)
    came = frames.payload_size.take(rows)
    # Zeros at the end are not sent; what lies there is the checksum and the next record.
    for missing in np.flatnonzero(np.bincount(came)[:size]).tolist():
        payloads[came == missing, missing:] = 0
    messages.view(np.uint8).reshape(len(rows), kind.itemsize)[:, -size:] = payloads
    return messages
