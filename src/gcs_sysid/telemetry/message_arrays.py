"""Messages of one type as one structured array, with the fields that the dialect gives them."""

from collections.abc import Collection
from functools import cache

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.telemetry.checksums import rows_of
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frame_block import OK, FrameBlock, counts_of
from gcs_sysid.telemetry.messages import LAYOUTS, MESSAGE_IDS

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
    good = frames.validity == OK
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
    messages["_time_us"] = frames.time_us[rows]
    messages["_frame"] = frames.number + rows
    messages["_sequence"] = frames.sequence[rows]
    messages["_system"] = frames.system[rows]
    messages["_component"] = frames.component[rows]
    payloads = rows_of(frames.data, frames.payload_at[rows], size)
    came = frames.payload_size[rows]
    # Zeros at the end are not sent; what lies there is the checksum and the next record.
    for missing in np.flatnonzero(np.bincount(came)[:size]).tolist():
        payloads[came == missing, missing:] = 0
    messages.view(np.uint8).reshape(len(rows), kind.itemsize)[:, -size:] = payloads
    return messages
