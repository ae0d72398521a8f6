"""Payloads to numbers, by precompiled layouts taken from the dialect."""

import struct
from collections.abc import Callable
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np

from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.dialect.known_messages import KNOWN_MESSAGES

Value = int | float | str | tuple[int, ...] | tuple[float, ...]


class Layout(NamedTuple):
    """How the payload of one message type is laid out on the wire."""

    name: str
    unpacker: struct.Struct
    size: int
    """Bytes of the whole payload, extensions included."""
    places: dict[str, tuple[int, int]]
    """Field name -> (index of its first value, number of values) after unpacking."""


def _layout(message: Any) -> Layout:
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
    return Layout(message.msgname, unpacker, unpacker.size, places)


LAYOUTS: dict[int, Layout] = {
    message_id: _layout(message) for message_id, message in mavlink.mavlink_map.items()
}
MESSAGE_IDS: dict[str, int] = {layout.name: message_id for message_id, layout in LAYOUTS.items()}
_NAMES: dict[int, str] = {i: known[0] for i, known in KNOWN_MESSAGES.items()} | {
    i: layout.name for i, layout in LAYOUTS.items()
}


NAMED_IDS = np.array(sorted(_NAMES))
"""Ids of all message types that have a name, rising."""
OTHER_TYPES = 2**24
"""Id for types without a name that are counted together; no message has it."""


def message_name(message_id: int) -> str:
    """Name of a message type; `UNKNOWN_<id>` when unknown."""
    if message_id == OTHER_TYPES:
        return "UNKNOWN"
    return _NAMES.get(message_id) or f"UNKNOWN_{message_id}"


def unpack_flat(message_id: int, payload: bytes) -> tuple[Any, ...]:
    """All values in wire order, arrays laid out flat. Cut zeros are put back first."""
    layout = LAYOUTS[message_id]
    size = layout.size
    if len(payload) != size:
        # Longer: a newer definition with more extension fields, which always come last.
        payload = payload[:size].ljust(size, b"\0")
    return layout.unpacker.unpack(payload)


def unpack(message_id: int, payload: bytes) -> dict[str, Value]:
    """One message as field name -> value; arrays as tuples, char arrays as text."""
    flat = unpack_flat(message_id, payload)
    fields: dict[str, Value] = {}
    for name, (at, count) in LAYOUTS[message_id].places.items():
        value = flat[at] if count == 1 else flat[at : at + count]
        if isinstance(value, bytes):
            value = value.split(b"\0", 1)[0].decode("utf-8", "replace")
        fields[name] = value
    return fields


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
