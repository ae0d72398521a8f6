"""Unpacking gives pymavlink's values for every message."""

import random

import numpy as np
import pytest

from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frames import read_frame
from gcs_sysid.telemetry.messages import LAYOUTS, NAMED_IDS, OTHER_TYPES, message_name, picker
from gcs_sysid.telemetry.tlog import read_tlog
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


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["px4-esc-cg.tlog", "ardupilot-sitl.tlog", "public/real-quad-mavlink1.tlog"]
)
def test_recorded_flights_read_as_by_pymavlink(shared_logs, name):
    parser = mavlink.MAVLink(None)
    compared = 0
    for _, (_, frame) in zip(range(50_000), read_tlog(shared_logs / name), strict=False):
        if frame.valid != "ok" or frame.message_id not in LAYOUTS or compared >= 12_000:
            continue
        theirs = parser.decode(bytearray(frame.raw))
        ours = unpack(frame.message_id, frame.payload)
        for field, value in ours.items():
            expected = as_compared(getattr(theirs, field))
            assert value == expected or repr(value) == repr(expected), (theirs.msgname, field)
        header = theirs.get_header()
        assert frame[:3] == (header.srcSystem, header.srcComponent, header.seq)
        compared += 1
    assert compared > 5000


def test_types_that_are_not_told_apart_have_one_name():
    # Message ids have 24 bits.
    assert OTHER_TYPES == 16_777_216
    assert message_name(OTHER_TYPES) == "UNKNOWN"
    assert message_name(OTHER_TYPES - 1) == "UNKNOWN_16777215"


def test_ids_with_a_name_rise():
    assert (np.diff(NAMED_IDS) > 0).all()
    assert {0, 30, 62, 105, 291} <= set(NAMED_IDS.tolist())


def test_one_field_is_a_tuple_of_one(sender):
    pick = picker("HIGHRES_IMU", "time_usec")
    assert pick(sender.imu(3.0).payload) == (3_000_000,)
    # Cut zeros are put back, and what a newer definition adds is not read.
    assert pick(sender.imu(3.0).payload.ljust(90, b"\7")) == (3_000_000,)
    assert pick(b"") == (0,)


def test_text_ends_at_its_first_zero():
    message_id = next(i for i, layout in LAYOUTS.items() if layout.name == "STATUSTEXT")
    payload = b"\6" + b"one\0two\0three".ljust(50, b"x")
    assert unpack(message_id, payload)["text"] == "one"
    assert unpack(message_id, b"\6\xff")["text"] == "\ufffd"
