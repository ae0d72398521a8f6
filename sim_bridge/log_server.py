"""Logs that the emulated autopilot has on board, served by LOG_* and by MAVLink FTP."""

import struct
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gcs_sysid.files import read_bytes
from gcs_sysid.telemetry.dialect import mavlink
from sim_bridge.autopilot import EPOCH_US
from sim_bridge.wire import FrameWriter

LARGEST = 1 << 30
"""Bytes of a log that is served."""
_FOLDER = "@MAV_LOG"
_HEAD = struct.Struct("<HBBBBBBI")
_ACK, _NAK = 128, 129
_FAIL, _INVALID_SESSION, _END, _UNKNOWN = 1, 4, 6, 7


class LogServer:
    """Answers requests for logs.

    Args:
        paths: of the files that are the vehicle's logs.
        writer: makes the frames.

    Raises:
        InputError: a file cannot be read.
    """

    A_STEP = 4
    """Frames of a log in a physics step: an answer of many is no single instant's."""

    def __init__(self, paths: list[Path], writer: FrameWriter) -> None:
        self._logs = {path.name: read_bytes(path, "a log to serve", LARGEST) for path in paths}
        self._writer = writer
        self._waiting: deque[tuple[int, int, bytes]] = deque()
        self._open = ""
        self.handlers: dict[str, Callable[[Any], list[bytes]]] = {
            "LOG_REQUEST_LIST": self._list,
            "LOG_REQUEST_DATA": self._data,
            "LOG_REQUEST_END": self._end,
            "FILE_TRANSFER_PROTOCOL": self._file,
        }

    def poll(self) -> list[bytes]:
        """Frames of a log that are due now."""
        count = min(self.A_STEP, len(self._waiting))
        return [self._log_data(*self._waiting.popleft()) for _ in range(count)]

    def _log_data(self, number: int, offset: int, data: bytes) -> bytes:
        padded = data.ljust(90, b"\0")
        message = mavlink.MAVLink_log_data_message
        return self._writer.frame(message, offset, number, len(data), *padded)

    def _list(self, message: Any) -> list[bytes]:
        logs, began = list(self._logs.values()), EPOCH_US // 1_000_000
        return [
            self._writer.frame(
                mavlink.MAVLink_log_entry_message, began + 60 * i, len(log), i, len(logs), len(logs)
            )
            for i, log in enumerate(logs, 1)
            if message.start <= i <= message.end
        ]

    def _data(self, message: Any) -> list[bytes]:
        """A new request takes the place of the one before, as on both autopilots."""
        self._waiting.clear()
        logs = list(self._logs.values())
        if 1 <= message.id <= len(logs):
            log = logs[message.id - 1]
            end = min(message.ofs + message.count, len(log))
            for offset in range(message.ofs, end, 90):
                self._waiting.append((message.id, offset, log[offset : min(offset + 90, end)]))
        return []

    def _end(self, message: Any) -> list[bytes]:
        del message
        self._waiting.clear()
        return []

    def _file(self, message: Any) -> list[bytes]:
        payload = bytes(message.payload)
        sequence, session, opcode, size, _, _, _, offset = _HEAD.unpack_from(payload)
        kind, data = self._file_answer(opcode, session, offset, size, payload[_HEAD.size :][:size])
        head = _HEAD.pack((sequence + 1) & 0xFFFF, 1, kind, len(data), opcode, 0, 0, offset)
        answer = (head + data).ljust(251, b"\0")
        who = message.get_srcSystem(), message.get_srcComponent()
        return [
            self._writer.frame(mavlink.MAVLink_file_transfer_protocol_message, 0, *who, *answer)
        ]

    def _file_answer(
        self, opcode: int, session: int, offset: int, size: int, data: bytes
    ) -> tuple[int, bytes]:
        """ACK or NAK, and its data."""
        path = data.decode("ascii", "replace")
        match opcode:
            case 1:  # TerminateSession
                self._open = ""
                return _ACK, b""
            case 3 if path == _FOLDER:  # ListDirectory
                entries = [f"F{name}\t{len(log)}\0" for name, log in self._logs.items()]
                some = "".join(entries[offset : offset + 2]).encode()
                return (_ACK, some) if some else (_NAK, bytes([_END]))
            case 4:  # OpenFileRO
                name = path.removeprefix(f"{_FOLDER}/")
                if name not in self._logs:
                    return _NAK, bytes([_FAIL])
                self._open = name
                return _ACK, struct.pack("<I", len(self._logs[name]))
            case 5:  # ReadFile
                if not self._open or session != 1:
                    return _NAK, bytes([_INVALID_SESSION])
                read = self._logs[self._open][offset : offset + size]
                return (_ACK, read) if read else (_NAK, bytes([_END]))
        return _NAK, bytes([_UNKNOWN])
