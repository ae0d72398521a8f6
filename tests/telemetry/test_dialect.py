"""Messages that pymavlink lacks are packed and unpacked as if it had them."""

import random

import fastcrc
import pytest

from gcs_sysid.telemetry.dialect import declare, mavlink
from gcs_sysid.telemetry.frames import CRC_EXTRA
from gcs_sysid.telemetry.message_table import MESSAGES
from gcs_sysid.telemetry.messages import MESSAGE_IDS
from tests.pymavlink_xml import SIZES, definitions


@pytest.mark.parametrize(
    ("name", "message_id", "crc_extra", "length"),
    [("ESC_INFO", 290, 251, 46), ("ESC_STATUS", 291, 10, 57), ("PROTOCOL_VERSION", 300, 217, 22)],
)
def test_messages_that_pymavlink_lacks_have_the_wire_form_of_mavlink(
    name, message_id, crc_extra, length
):
    """By the headers of MAVLink's library in C."""
    message = mavlink.mavlink_map[message_id]
    assert (message.msgname, message.crc_extra, message.unpacker.size) == (name, crc_extra, length)
    assert getattr(mavlink, f"MAVLINK_MSG_ID_{name}") == message_id
    assert getattr(mavlink, f"MAVLink_{name.lower()}_message") is message


DEFINED = definitions("minimal", "common", "ardupilotmega")
DECLARED = [
    (number, name, fields)
    for number, (name, fields, extension) in DEFINED.items()
    if not extension and all(kind != "char" for kind, _, _ in fields)
]


@pytest.mark.parametrize(("number", "name", "fields"), DECLARED, ids=[n for _, n, _ in DECLARED])
def test_a_declared_message_is_what_pymavlinks_generator_makes(
    number, name, fields, make_sender, make_message
):
    """Of every message that pymavlink has and that can be declared."""
    theirs = mavlink.mavlink_map[number]
    written = (f"{k}[{n}] {field}" if n else f"{k} {field}" for k, n, field in fields)
    ours = declare(number, name, ", ".join(written))
    for what in (
        "id", "msgname", "fieldnames", "ordered_fieldnames", "orders", "lengths", "array_lengths",
        "crc_extra", "native_format", "__name__",
    ):  # fmt: skip
        assert getattr(ours, what) == getattr(theirs, what), what
    assert ours.unpacker.size == theirs.unpacker.size
    message = make_message(theirs, random.Random(number))
    values = [getattr(message, field) for field in ours.fieldnames]
    packed = make_sender().raw(theirs(*values))
    assert make_sender().raw(ours(*values)) == packed
    assert make_sender().raw(ours(**dict(zip(ours.fieldnames, values, strict=True)))) == packed


def test_every_message_read_has_the_checksum_of_its_definition():
    """Independent of pymavlink's generator: from the XML, by the guide to serialization."""
    wanted = {MESSAGE_IDS[message.name] for message in MESSAGES} | {0, 22, 76, 244, 245, 253}
    checked = wanted & DEFINED.keys()
    assert len(checked) > 25
    for number in checked:
        name, fields, _ = DEFINED[number]
        crc = fastcrc.crc16.mcrf4xx(f"{name} ".encode())
        for kind, length, field in sorted(fields, key=lambda f: -SIZES[f[0]]):
            text = f"{kind} {field} ".encode() + bytes([length] * bool(length))
            crc = fastcrc.crc16.mcrf4xx(text, crc)
        assert CRC_EXTRA[number] == bytes([crc & 0xFF ^ crc >> 8]), name
