"""Unpacking gives pymavlink's values for every message."""

import random

import pytest

from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frames import read_frame
from gcs_sysid.telemetry.messages import LAYOUTS, message_name, picker
from testbed.payloads import unpack

MESSAGES = list(mavlink.mavlink_map.values())


def as_compared(value):
    return tuple(value) if isinstance(value, list) else value


@pytest.mark.parametrize("cls", MESSAGES, ids=lambda cls: cls.msgname)
def test_random_values_come_out_as_from_pymavlink(cls, sender, make_message):
    rng = random.Random(cls.id)
    for _ in range(30):
        raw = sender.raw(make_message(cls, rng))
        theirs = mavlink.MAVLink(None).decode(bytearray(raw))
        frame = read_frame(raw)
        ours = unpack(frame.message_id, frame.payload)
        assert ours == {name: as_compared(getattr(theirs, name)) for name in cls.fieldnames}


def test_a_payload_longer_than_the_definition_is_read_up_to_it(sender):
    frame = sender.imu(3.0)
    assert unpack(105, frame.payload.ljust(70, b"\7"))["time_usec"] == 3_000_000


def test_picked_fields_are_the_fields_named(sender):
    esc = sender.frame(
        mavlink.MAVLink_esc_status_message(0, 1_000_000, [1, -2, 3, 0], [0.0] * 4, [0.0] * 4)
    )
    assert len(esc.payload) < LAYOUTS[291].size
    assert picker("ESC_STATUS", "index", "rpm")(esc.payload) == (0, 1, -2, 3, 0)


def test_names_of_own_other_and_unknown_messages():
    assert message_name(291) == "ESC_STATUS"
    assert message_name(62) == "NAV_CONTROLLER_OUTPUT"
    assert message_name(60_999) == "UNKNOWN_60999"


def test_text_ends_at_its_first_zero():
    message_id = next(i for i, layout in LAYOUTS.items() if layout.name == "STATUSTEXT")
    payload = b"\6" + b"one\0two\0three".ljust(50, b"x")
    assert unpack(message_id, payload)["text"] == "one"
    assert unpack(message_id, b"\6\xff")["text"] == "\ufffd"
