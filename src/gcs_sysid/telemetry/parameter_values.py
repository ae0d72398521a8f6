"""The autopilot's parameters as PARAM_VALUE carries them.

The message has one float for values of every type. PX4 puts an integer's bytes there as they
are, ArduPilot converts the number: that depends on the autopilot, the message does not say.
"""

import struct

from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.messages import picker

_param_value = picker("PARAM_VALUE", "param_id", "param_type", "param_value")

_INTEGERS = {
    mavlink.MAV_PARAM_TYPE_UINT8: struct.Struct("<B"),
    mavlink.MAV_PARAM_TYPE_INT8: struct.Struct("<b"),
    mavlink.MAV_PARAM_TYPE_UINT16: struct.Struct("<H"),
    mavlink.MAV_PARAM_TYPE_INT16: struct.Struct("<h"),
    mavlink.MAV_PARAM_TYPE_UINT32: struct.Struct("<I"),
    mavlink.MAV_PARAM_TYPE_INT32: struct.Struct("<i"),
}


def read_parameter(payload: bytes, *, bytewise: bool) -> tuple[str, float]:
    """Name and value of a PARAM_VALUE.

    Args:
        payload: of the message, perhaps without its trailing zeros.
        bytewise: whether integers lie in the value's bytes (PX4) instead of in its number.

    Returns:
        The name ("" when it is not text) and the value; it may be NaN.
    """
    name, kind, value = _param_value(payload)
    text = name.split(b"\0", 1)[0].decode("ascii", "replace")
    if not text.isprintable() or "\N{REPLACEMENT CHARACTER}" in text:
        text = ""
    integer = _INTEGERS.get(kind) if bytewise else None
    if integer is not None:
        # From the payload itself, whose first field it is: a float would not keep all bits.
        (value,) = integer.unpack_from(payload.ljust(4, b"\0"))
    return text, float(value)
