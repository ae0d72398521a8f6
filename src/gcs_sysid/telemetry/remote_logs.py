"""Logs on a vehicle: listed and read by the messages LOG_*, or by MAVLink FTP under @MAV_LOG.

Blocks of a log come in any order, and some never: what lacks is asked for again. Blocks that follow
each other without a hole go to the end of the file, so that a transfer that ended anyhow goes on
where that file ends (https://mavlink.io/en/messages/common.html#LOG_REQUEST_LIST and
https://mavlink.io/en/services/ftp.html).
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import BinaryIO, NamedTuple

from gcs_sysid.errors import LinkError
from gcs_sysid.telemetry.frame_block import FrameBlock
from gcs_sysid.telemetry.frames import Frame, Validity
from gcs_sysid.telemetry.messages import MESSAGE_IDS, picker
from gcs_sysid.telemetry.outgoing import FILE_HEADER, LOG_FOLDER, FileRequest, is_log_path
from gcs_sysid.telemetry.transceiver import Transceiver
from gcs_sysid.telemetry.vehicles import MavlinkSystem, VehicleSelector

_ENTRY, _DATA, _FILE = (
    MESSAGE_IDS[name] for name in ("LOG_ENTRY", "LOG_DATA", "FILE_TRANSFER_PROTOCOL")
)
_entry = picker("LOG_ENTRY", "id", "num_logs", "time_utc", "size")
_data = picker("LOG_DATA", "id", "ofs", "count", "data")
_file = picker("FILE_TRANSFER_PROTOCOL", "payload")


@dataclass(frozen=True)
class RemoteLog:
    """A log on a vehicle.

    Attributes:
        number: by which it is asked for.
        size: bytes.
        time: s since 1970 when it was begun; 0: not known.
        path: by MAVLink FTP; empty: by the messages LOG_*.
    """

    number: int
    size: int
    time: int = 0
    path: str = ""


class Exchange:
    """Requests to one vehicle, and what it answers.

    Args:
        port: open.
        wanted: system and perhaps component; None: the first autopilot.
        clock: any steady clock, s.

    Attributes:
        gate: what is asked goes here.
        clock: as given.
    """

    PATIENCE = 30.0
    """s without an answer, after which it is given up."""
    _QUICKEST, _SLOWEST = 0.05, 2.0
    """s of silence, after which what has not come is lost; the more, the later answers begin."""

    def __init__(
        self,
        port: Transceiver,
        wanted: tuple[int, int | None] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.gate, self.clock = port.gate, clock
        self._port = port
        self._selector = VehicleSelector(wanted)
        self._beat_at = float("-inf")
        self._silence = self._SLOWEST

    @property
    def name(self) -> str:
        """Of the link, and of the vehicle once it is received."""
        chosen = self._selector.chosen
        return f"{self._port.url}" + (f", {chosen}" if chosen is not None else "")

    def vehicle(self) -> MavlinkSystem:
        """The vehicle, once it is received.

        Raises:
            LinkError: there is none.
        """
        end = self.clock() + self.PATIENCE
        while self._selector.chosen is None:
            if self.clock() > end:
                raise LinkError(f"{self.name}: no vehicle in {self.PATIENCE:.0f} s")
            self._frames()
        return self._selector.chosen

    def answers(self) -> Iterator[Frame]:
        """What comes after a request, until there has been silence for a while."""
        asked = latest = self.clock()
        came = False
        while self.clock() - latest < self._silence:
            for frame in self._frames():
                if frame.message_id in (_ENTRY, _DATA, _FILE):
                    latest = self.clock()
                    if not came:
                        self._silence = 4.0 * (latest - asked)
                    came = True
                    yield frame
            self._silence = min(max(self._silence, self._QUICKEST), self._SLOWEST)
        if not came:
            self._silence *= 2.0

    def _frames(self) -> list[Frame]:
        """The vehicle's frames that came; once a second it is shown a ground station."""
        chosen = self._selector.chosen
        if self.clock() - self._beat_at >= 1.0:
            self._beat_at = self.clock()
            # Version 1 may be all that it knows, or all that it has seen of us.
            for version in {2, 2 if chosen is None else chosen.version}:
                self.gate.version = version
                self.gate.heartbeat()
        frames = [frame for batch in self._port.receive(0.02) for frame in batch.frames]
        self._selector.listen(FrameBlock.of(frames))
        if self._selector.chosen is not None:
            self.gate.version = self._selector.chosen.version
            if chosen is None:
                self._port.follow(self._selector.chosen.address)
        return [f for f in frames if f.valid is Validity.OK and self._selector.is_chosen(f)]


class RemoteLogs:
    """The logs of one vehicle."""

    _NEAR = 16
    """Blocks between two that lack, up to which both are asked for at once: a request of their own
    costs as much time."""

    def __init__(self, exchange: Exchange) -> None:
        self._exchange = exchange

    def listed(self) -> list[RemoteLog]:
        """All that hold something, by their numbers.

        Raises:
            LinkError: the vehicle answers in neither way, or there is none.
        """
        vehicle = self._exchange.vehicle()
        logs = _Messages(self._exchange, vehicle.address).listed()
        if logs is None:
            logs = _Files(self._exchange, vehicle.address).listed()
        if logs is None:
            raise LinkError(f"{self._exchange.name}: sends no list of its logs")
        return sorted((log for log in logs if log.size), key=lambda log: log.number)

    def read(
        self, log: RemoteLog, file: BinaryIO, progress: Callable[[float], None] | None = None
    ) -> None:
        """Read what a file lacks of a log.

        The file has a beginning of the log or nothing; other content is replaced.

        Raises:
            LinkError: nothing came any more; what came is in the file.
        """
        address = self._exchange.vehicle().address
        way = (_Files if log.path else _Messages)(self._exchange, address, log)
        try:
            self._complete(way, log.size, file, progress)
        finally:
            way.close()

    def _complete(
        self,
        way: "_Messages | _Files",
        size: int,
        file: BinaryIO,
        progress: Callable[[float], None] | None,
    ) -> None:
        # Its last block shows whether the file is of this log.
        at = max(min(file.seek(0, 2), size) - way.block, 0) // way.block * way.block
        file.seek(at)
        known = file.read(way.block)
        while at < size:
            data = self._window(way, at, min(at + way.at_once * way.block, size), size)
            if not data.startswith(known):
                at = 0
            else:
                file.seek(at)
                file.write(data)
                file.flush()
                at += len(data)
            known = b""
            if progress is not None:
                progress(at / size)
        file.truncate(size)

    def _window(self, way: "_Messages | _Files", start: int, end: int, size: int) -> bytes:
        """Bytes from `start` to `end` of a log of `size` bytes, whole."""
        got: dict[int, bytes] = {}
        missing, clock = list(range(start, end, way.block)), self._exchange.clock
        came_at = clock()
        while missing:
            apart = [b - a > self._NEAR * way.block for a, b in pairwise(missing)]
            last = missing[apart.index(True) if True in apart else -1]
            way.ask(missing[0], min(last + way.block, end) - missing[0])
            for frame in self._exchange.answers():
                offset, data = way.block_in(frame) or (-1, b"")
                if len(data) == min(way.block, size - offset) and offset in missing:
                    got[offset], came_at = data, clock()
                    if offset == last:
                        break
            missing = [offset for offset in missing if offset not in got]
            if missing and clock() - came_at > self._exchange.PATIENCE:
                raise LinkError(
                    f"{self._exchange.name}: nothing came for {self._exchange.PATIENCE:.0f} s "
                    f"after {start} of {size} bytes; the same command continues there"
                )
        return b"".join(got[offset] for offset in sorted(got))


class _Messages:
    """LOG_REQUEST_LIST and LOG_REQUEST_DATA."""

    block, at_once = 90, 128
    """Bytes that come together, and how often that is asked for at a time."""

    def __init__(
        self, exchange: Exchange, address: tuple[int, int], log: RemoteLog | None = None
    ) -> None:
        self._exchange, self._address, self._log = exchange, address, log

    def listed(self) -> list[RemoteLog] | None:
        """All logs; None: there is no answer."""
        found: dict[int, RemoteLog] = {}
        count: int | None = None
        end = self._exchange.clock() + self._exchange.PATIENCE / 3.0
        while self._exchange.clock() < end and (count is None or len(found) < count):
            self._exchange.gate.request_log_list(self._address)
            for frame in self._exchange.answers():
                if frame.message_id == _ENTRY:
                    number, count, begun, size = _entry(frame.payload)
                    found[number] = RemoteLog(number, size, begun)
                    if len(found) >= count:
                        break
        self.close()
        return None if count is None else list(found.values())

    def ask(self, offset: int, size: int) -> None:
        assert self._log is not None
        self._exchange.gate.request_log_data(self._address, self._log.number, offset, size)

    def block_in(self, frame: Frame) -> tuple[int, bytes] | None:
        if frame.message_id != _DATA or self._log is None:
            return None
        number, offset, count, *data = _data(frame.payload)
        return (offset, bytes(data[:count])) if number == self._log.number else None

    def close(self) -> None:
        """End the reading: while it lasts, some record nothing, or serve one reader alone."""
        self._exchange.gate.end_log_requests(self._address)


class _Answer(NamedTuple):
    """Of MAVLink FTP."""

    sequence: int
    session: int
    opcode: int
    size: int
    asked: int
    burst: int
    offset: int
    data: bytes = b""


class _Files:
    """Files under @MAV_LOG, by MAVLink FTP."""

    block, at_once = 239, 4
    """ArduPilot keeps five requests at most."""
    _DEEPEST, _MOST = 4, 5000
    """Folders in each other, and entries of all: PX4 has a folder a day."""
    _ACK, _INVALID_SESSION = 128, b"\4"

    def __init__(
        self, exchange: Exchange, address: tuple[int, int], log: RemoteLog | None = None
    ) -> None:
        self._exchange, self._address, self._log = exchange, address, log
        self._sequence = 0
        self._session: int | None = None

    def listed(self) -> list[RemoteLog] | None:
        """All files; None: there is no answer."""
        found: list[tuple[str, int]] = []
        folders = [LOG_FOLDER]
        count = 0
        for folder in folders:
            offset = 0
            while count < self._MOST:
                answer = self._called(FileRequest.LIST_DIRECTORY, folder, offset)
                if answer is None:
                    return None
                entries = answer.data.rstrip(b"\0").split(b"\0")
                if answer.opcode != self._ACK or not any(entries):
                    break
                offset += len(entries)
                count += len(entries)
                for entry in entries:
                    name, _, size = entry[1:].decode("ascii", "replace").partition("\t")
                    path = f"{folder}/{name}"
                    if not is_log_path(path):
                        continue
                    if entry[:1] == b"D" and path.count("/") < self._DEEPEST:
                        folders.append(path)
                    elif entry[:1] == b"F" and size.isdecimal():
                        found.append((path, int(size)))
        return [RemoteLog(i, size, path=path) for i, (path, size) in enumerate(sorted(found), 1)]

    def ask(self, offset: int, size: int) -> None:
        if self._session is None:
            assert self._log is not None
            # None is free while one that was cut off has not run out.
            answer = self._called(FileRequest.OPEN_FILE_RO, self._log.path)
            if answer is None or answer.opcode != self._ACK:
                return
            self._session = answer.session
        for at in range(offset, offset + size, self.block):
            self._sequence += 1
            length = min(self.block, offset + size - at)
            self._send(FileRequest.READ_FILE, at, length, session=self._session)

    def block_in(self, frame: Frame) -> tuple[int, bytes] | None:
        answer = self._answer(frame)
        if answer is None or answer.asked != FileRequest.READ_FILE:
            return None
        if answer.opcode != self._ACK and answer.data[:1] == self._INVALID_SESSION:
            self._session = None  # the vehicle has restarted
        good = answer.opcode == self._ACK and answer.session == self._session
        return (answer.offset, answer.data) if good else None

    def close(self) -> None:
        if self._session is not None:
            self._sequence += 1
            self._send(FileRequest.TERMINATE_SESSION, 0, 0, session=self._session)

    def _called(self, request: FileRequest, path: str, offset: int = 0) -> _Answer | None:
        """The answer to a request that has a path; None: there is none."""
        end = self._exchange.clock() + self._exchange.PATIENCE / 3.0
        self._sequence += 1
        while self._exchange.clock() < end:
            self._send(request, offset, len(path), path.encode("ascii"))
            for frame in self._exchange.answers():
                answer = self._answer(frame)
                if answer is not None and answer.sequence == (self._sequence + 1) & 0xFFFF:
                    return answer
        return None

    def _send(
        self, request: FileRequest, offset: int, size: int, data: bytes = b"", session: int = 0
    ) -> None:
        self._exchange.gate.request_file(
            self._address, self._sequence & 0xFFFF, session, request, offset, size, data
        )

    @staticmethod
    def _answer(frame: Frame) -> _Answer | None:
        if frame.message_id != _FILE:
            return None
        payload = bytes(_file(frame.payload))
        head = _Answer(*FILE_HEADER.unpack_from(payload))
        return head._replace(data=payload[FILE_HEADER.size :][: head.size])
