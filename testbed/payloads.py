"""A message at a time, unpacked to names and values: not by the arrays that readers use."""

from gcs_sysid.telemetry.messages import LAYOUTS

Value = int | float | str | tuple[int, ...] | tuple[float, ...]


def unpack(message_id: int, payload: bytes) -> dict[str, Value]:
    """One message as field name -> value; arrays as tuples, char arrays as text."""
    layout = LAYOUTS[message_id]
    # Longer: a newer definition with more extension fields, which always come last.
    flat = layout.unpacker.unpack(payload[: layout.size].ljust(layout.size, b"\0"))
    fields: dict[str, Value] = {}
    for name, (at, count) in layout.places.items():
        value = flat[at] if count == 1 else flat[at : at + count]
        if isinstance(value, bytes):
            value = value.split(b"\0", 1)[0].decode("utf-8", "replace")
        fields[name] = value
    return fields
