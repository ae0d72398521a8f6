"""The one place that decides what may be sent to a vehicle.

A tool that only listens can do no harm, and this one must not do more than ask: its heartbeat,
requests for the rates of messages and groups of them, and reading of parameters and logs. Nothing
that moves, arms, configures or restarts a vehicle, writes or erases can pass, and each field of
what passes is limited to useful values: a caller's slip is refused as well.
"""

import math
import re
import struct
from collections.abc import Callable
from enum import IntEnum
from typing import Any

from gcs_sysid.errors import GcsSysidError
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.signing import SigningClock

OWN_SYSTEM = 245
"""Not 255: autopilots tie their failsafe to the ground station of that number, so that
quitting this tool could trip it."""
OWN_COMPONENT: int = mavlink.MAV_COMP_ID_MISSIONPLANNER

# Groups with what identification needs; never "all", which would reset those of others.
_GROUPS = frozenset(
    {
        mavlink.MAV_DATA_STREAM_RAW_SENSORS,
        mavlink.MAV_DATA_STREAM_RC_CHANNELS,
        mavlink.MAV_DATA_STREAM_POSITION,
        mavlink.MAV_DATA_STREAM_EXTRA1,
        mavlink.MAV_DATA_STREAM_EXTRA3,
    }
)
MOST_OF_GROUP = 50
"""Hz. ArduPilot before 4.0 sends no group faster, and no other autopilot is sent group requests."""
SHORTEST_INTERVAL = 500
"""us. No autopilot sends faster, and one that tried would have no time left to fly."""
LONGEST_INTERVAL = 60_000_000
"""us. No use for a stream slower than one a minute."""
_ASKED_FOR = frozenset(
    getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
    for name in (
        "HIGHRES_IMU",
        "RAW_IMU",
        "ATTITUDE",
        "LOCAL_POSITION_NED",
        "EXTENDED_SYS_STATE",
        "ESC_STATUS",
        "ESC_TELEMETRY_1_TO_4",
        "ESC_TELEMETRY_5_TO_8",
        "ESC_TELEMETRY_9_TO_12",
        "ESC_TELEMETRY_13_TO_16",
        "ACTUATOR_OUTPUT_STATUS",
        "SERVO_OUTPUT_RAW",
    )
)
"""Messages whose rates this tool asks for, and that it may therefore have to stop again."""
_PARAMETER_NAME = re.compile(r"[A-Z0-9_]{1,16}")
LOG_FOLDER = "@MAV_LOG"
"""Where MAVLink FTP has the logs, whatever the vehicle's folders."""
_LOG_PATH = re.compile(rf"{LOG_FOLDER}(/[A-Za-z0-9_-][A-Za-z0-9_.-]*)*")
FILE_HEADER = struct.Struct("<HBBBBBxI")
"""Before the data of MAVLink FTP: sequence, session, opcode, size, opcode asked for, whether a
burst is complete, offset."""


class FileRequest(IntEnum):
    """What is asked of MAVLink FTP: its opcodes that read, and the end of that."""

    TERMINATE_SESSION = 1
    LIST_DIRECTORY = 3
    OPEN_FILE_RO = 4
    READ_FILE = 5


class NotAllowedError(GcsSysidError):
    """Something was about to be sent that must never be."""


def _is_harmless_heartbeat(message: Any) -> bool:
    return bool(
        message.type == mavlink.MAV_TYPE_GCS
        and message.autopilot == mavlink.MAV_AUTOPILOT_INVALID
        and message.base_mode == 0
        and message.custom_mode == 0
    )


def _is_harmless_command(message: Any) -> bool:
    parameters = [getattr(message, f"param{i}") for i in range(1, 8)]
    if not all(math.isfinite(value) for value in parameters) or not _is_of_one_vehicle(message):
        return False
    wanted, value, *rest = parameters
    if any(rest) or message.confirmation != 0:
        return False
    if message.command == mavlink.MAV_CMD_REQUEST_MESSAGE:
        # Only the message with an interval.
        return bool(wanted == mavlink.MAVLINK_MSG_ID_MESSAGE_INTERVAL and value in _ASKED_FOR)
    if wanted not in _ASKED_FOR:
        return False
    if message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
        # 0 asks for the vehicle's default, -1 stops what was not sent before either.
        return value in (0, -1) or bool(SHORTEST_INTERVAL <= value <= LONGEST_INTERVAL)
    return bool(message.command == mavlink.MAV_CMD_GET_MESSAGE_INTERVAL and value == 0)


def _is_of_one_vehicle(message: Any) -> bool:
    """No broadcast, and only to valid ids."""
    return bool(0 < message.target_system <= 255 and 0 <= message.target_component <= 255)


def _is_harmless_group(message: Any) -> bool:
    """Of one vehicle, and stopped only where nothing came before."""
    if not _is_of_one_vehicle(message) or message.req_stream_id not in _GROUPS:
        return False
    rate = message.req_message_rate
    if message.start_stop == 0:
        return bool(rate == 0)
    return bool(message.start_stop == 1 and 0 < rate <= MOST_OF_GROUP)


def _is_harmless_reading(message: Any) -> bool:
    """By a name that a parameter can have, not by a number: those differ between versions."""
    name = message.param_id
    text = name.decode("ascii", "replace") if isinstance(name, bytes) else str(name)
    by_name = message.param_index == -1 and _PARAMETER_NAME.fullmatch(text.rstrip("\0"))
    return bool(by_name and _is_of_one_vehicle(message))


def is_log_path(text: str) -> bool:
    """Whether it is the folder of logs for MAVLink FTP, or a path from there down."""
    return _LOG_PATH.fullmatch(text) is not None


def _is_harmless_file_request(message: Any) -> bool:
    """Of logs alone, and read alone."""
    payload = bytes(message.payload)
    _, _, opcode, size, asked, burst, _ = FILE_HEADER.unpack_from(payload)
    data = payload[FILE_HEADER.size :]
    if asked or burst or message.target_network != 0 or not _is_of_one_vehicle(message):
        return False
    if opcode in (FileRequest.READ_FILE, FileRequest.TERMINATE_SESSION):
        return size <= len(data) and not any(data)
    path = data[:size].decode("ascii", "replace")
    named = is_log_path(path) and not any(data[size:])
    return named and opcode in (FileRequest.LIST_DIRECTORY, FileRequest.OPEN_FILE_RO)


ADMITTED: dict[int, Callable[[Any], bool]] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: _is_harmless_heartbeat,
    mavlink.MAVLINK_MSG_ID_COMMAND_LONG: _is_harmless_command,
    mavlink.MAVLINK_MSG_ID_REQUEST_DATA_STREAM: _is_harmless_group,
    mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ: _is_harmless_reading,
    mavlink.MAVLINK_MSG_ID_LOG_REQUEST_LIST: _is_of_one_vehicle,
    mavlink.MAVLINK_MSG_ID_LOG_REQUEST_DATA: _is_of_one_vehicle,
    mavlink.MAVLINK_MSG_ID_LOG_REQUEST_END: _is_of_one_vehicle,
    mavlink.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL: _is_harmless_file_request,
}
"""What may be sent, by message id, and which values of its fields. docs/security.md lists it."""


def is_allowed(message: Any) -> bool:
    """Whether a message of the dialect may be sent at all."""
    # Not `message.id`: some messages have a field of that name, which hides the type.
    message_id = message.get_msgId()
    check = ADMITTED.get(message_id)
    of_that_type = type(message) is mavlink.mavlink_map.get(message_id)
    return check is not None and of_that_type and check(message)


class Gate:
    """The only way out: everything that is sent passes through `send`.

    Attributes:
        listen_only: when set, nothing at all is sent.
        sent: messages sent so far.
        version: of MAVLink, 1 or 2: as the vehicle's.

    `send_bytes` takes each frame; with a key and its clock those of version 2 are signed (version 1
    has no signatures).
    """

    def __init__(
        self,
        send_bytes: Callable[[bytes], None],
        *,
        listen_only: bool = False,
        key: bytes | None = None,
        clock: SigningClock | None = None,
    ) -> None:
        self.listen_only = listen_only
        self.sent = 0
        self.version = 2
        self._send_bytes = send_bytes
        self._clock = clock
        self._packer = mavlink.MAVLink(None, srcSystem=OWN_SYSTEM, srcComponent=OWN_COMPONENT)
        self._packer.signing.secret_key, self._packer.signing.sign_outgoing = key, self.signing

    @property
    def signing(self) -> bool:
        """Whether frames are signed."""
        return self._clock is not None

    def send(self, message: Any) -> bool:
        """Send one message of the dialect; False when only listening.

        Raises:
            NotAllowedError: for anything that is not on the short list above.
        """
        if not is_allowed(message):
            raise NotAllowedError(f"{message.msgname} must never be sent to a vehicle")
        if self.listen_only:
            return False
        if self._clock is not None and self.version == 2:
            self._packer.signing.timestamp = self._clock.next_time()
        raw = bytes(message.pack(self._packer, force_mavlink1=self.version == 1))
        self._packer.seq = (self._packer.seq + 1) % 256
        self._send_bytes(raw)
        self.sent += 1
        return True

    def heartbeat(self) -> bool:
        """Say that a ground station is here (once a second)."""
        return self.send(
            mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_GCS,
                mavlink.MAV_AUTOPILOT_INVALID,
                base_mode=0,
                custom_mode=0,
                system_status=mavlink.MAV_STATE_ACTIVE,
                mavlink_version=3,
            )
        )

    def _command(self, target: tuple[int, int], command: int, p1: float, p2: float = 0.0) -> bool:
        return self.send(
            mavlink.MAVLink_command_long_message(
                *target, command, 0, float(p1), float(p2), 0.0, 0.0, 0.0, 0.0, 0.0
            )
        )

    def set_message_interval(
        self, target: tuple[int, int], message_id: int, interval_us: int, own_us: int = 0
    ) -> bool:
        """Ask for a message every `interval_us`; 0 restores the vehicle's default, -1 stops it.

        `own_us` was its interval before: not sent, but known to the process that outlives the
        session.
        """
        del own_us
        return self._command(target, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, interval_us)

    def get_message_interval(self, target: tuple[int, int], message_id: int) -> bool:
        """Ask at which interval a message is sent."""
        return self._command(target, mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, message_id)

    def request_message_interval(self, target: tuple[int, int], message_id: int) -> bool:
        """Ask the same by REQUEST_MESSAGE, which supersedes the command for it."""
        interval_message = mavlink.MAVLINK_MSG_ID_MESSAGE_INTERVAL
        return self._command(target, mavlink.MAV_CMD_REQUEST_MESSAGE, interval_message, message_id)

    def request_group(self, target: tuple[int, int], group: int, hertz: int) -> bool:
        """Ask for a group of messages (REQUEST_DATA_STREAM) at a rate; 0 Hz stops it."""
        return self.send(
            mavlink.MAVLink_request_data_stream_message(*target, group, hertz, int(hertz > 0))
        )

    def read_parameter(self, target: tuple[int, int], name: str) -> bool:
        """Ask for one parameter by name (at most 16 characters)."""
        return self.send(
            mavlink.MAVLink_param_request_read_message(*target, name.encode("ascii")[:16], -1)
        )

    def request_log_list(self, target: tuple[int, int]) -> bool:
        """Ask for the list of all logs."""
        return self.send(mavlink.MAVLink_log_request_list_message(*target, 0, 0xFFFF))

    def request_log_data(
        self, target: tuple[int, int], number: int, offset: int, size: int
    ) -> bool:
        """Ask for bytes of a log."""
        return self.send(mavlink.MAVLink_log_request_data_message(*target, number, offset, size))

    def end_log_requests(self, target: tuple[int, int]) -> bool:
        """End the reading of logs: the vehicle records again where it had paused that."""
        return self.send(mavlink.MAVLink_log_request_end_message(*target))

    def request_file(
        self,
        target: tuple[int, int],
        sequence: int,
        session: int,
        request: FileRequest,
        offset: int,
        size: int,
        path: bytes = b"",
    ) -> bool:
        """Ask MAVLink FTP to list a folder of logs, to open, read or close one."""
        head = FILE_HEADER.pack(sequence, session, request, size, 0, 0, offset)
        payload = (head + path).ljust(251, b"\0")
        return self.send(mavlink.MAVLink_file_transfer_protocol_message(0, *target, payload))
