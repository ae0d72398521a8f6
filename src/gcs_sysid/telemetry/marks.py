"""What the user did in a live session, written into the recording beside the vehicle's frames.

As a STATUSTEXT of this tool's own address, which was never sent: ground stations record their own
messages too, and every reader of .tlog files takes it for what it is, a line of text. In version 1,
which readers of either version understand.
"""

from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frames import Frame, read_frame
from gcs_sysid.telemetry.messages import picker
from gcs_sysid.telemetry.outgoing import OWN_COMPONENT, OWN_SYSTEM

RESET_TEXT = "gcs-sysid: estimate reset"

_text = picker("STATUSTEXT", "text")


def reset_mark() -> Frame:
    """The frame that marks where the user reset the estimate."""
    packer = mavlink.MAVLink(None, srcSystem=OWN_SYSTEM, srcComponent=OWN_COMPONENT)
    message = mavlink.MAVLink_statustext_message(
        mavlink.MAV_SEVERITY_NOTICE, RESET_TEXT.encode("ascii")
    )
    frame = read_frame(bytes(message.pack(packer, force_mavlink1=True)))
    assert frame is not None
    return frame


def is_reset_mark(frame: Frame) -> bool:
    """Whether a frame with a right checksum is that mark."""
    if frame.message_id != mavlink.MAVLINK_MSG_ID_STATUSTEXT:
        return False
    if (frame.system, frame.component) != (OWN_SYSTEM, OWN_COMPONENT):
        return False
    text: bytes = _text(frame.payload)[0]
    return text.split(b"\0", 1)[0] == RESET_TEXT.encode("ascii")
