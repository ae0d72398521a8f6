"""What a recording says of the user's actions."""

import pytest

from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.tlog_writer import RESET_TEXT, is_reset_mark, reset_mark


@pytest.fixture
def text(make_sender):
    """A STATUSTEXT of some system."""

    def text(words, system=245, component=190, version=2):
        message = mavlink.MAVLink_statustext_message(5, words.encode())
        return make_sender(system, component).frame(message, version)

    return text


def test_a_mark_is_known_by_its_address_and_text(text, sender):
    assert is_reset_mark(reset_mark())
    assert reset_mark().version == 1
    assert is_reset_mark(text(RESET_TEXT))  # as another tool may write it again
    assert not is_reset_mark(text(RESET_TEXT, system=1, component=1))
    assert not is_reset_mark(text(RESET_TEXT, component=1))
    assert not is_reset_mark(text(RESET_TEXT + "s"))
    assert not is_reset_mark(sender.heartbeat())
