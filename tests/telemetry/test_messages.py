"""Unpacking gives pymavlink's values for every message."""

from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.messages import LAYOUTS, message_name, picker


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
