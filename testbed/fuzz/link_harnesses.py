"""Harnesses of what comes over a link: frames, recordings of them, records, our answers."""

import hashlib
import io
import struct
from collections import Counter
from typing import Any

import numpy as np

from gcs_sysid.signals.records import Record
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frames import (
    CRC_EXTRA,
    HEADER_1,
    HEADER_2,
    Frame,
    FrameScanner,
    Validity,
    read_frame,
)
from gcs_sysid.telemetry.ground_station import GroundStation
from gcs_sysid.telemetry.intake import Intake
from gcs_sysid.telemetry.link import Address, Link, ReceivedBytes
from gcs_sysid.telemetry.logs import open_log
from gcs_sysid.telemetry.messages import MESSAGE_IDS
from gcs_sysid.telemetry.outgoing import OWN_COMPONENT, OWN_SYSTEM
from gcs_sysid.telemetry.remote_logs import Exchange, RemoteLogs
from gcs_sysid.telemetry.signing import SignatureCheck, SigningClock
from gcs_sysid.telemetry.tlog import STAMP, ScanCounts, Scanner
from gcs_sysid.telemetry.transceiver import Transceiver
from gcs_sysid.telemetry.urls import LinkUrl
from sim_bridge.log_server import LogServer
from sim_bridge.wire import FrameWriter
from testbed.fuzz.harness import Bytes, Scratch, one_line_errors
from testbed.fuzz.references import checksum, frames_of_log, frames_of_stream
from testbed.payloads import unpack
from testbed.recordings import in_sequence
from testbed.signer import Signer

_TYPES = (
    "HEARTBEAT", "HIGHRES_IMU", "ATTITUDE", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED",
    "ESC_STATUS", "ACTUATOR_OUTPUT_STATUS", "SERVO_OUTPUT_RAW", "RAW_IMU", "SCALED_IMU", "RPM",
    "ESC_TELEMETRY_1_TO_4", "ESC_TELEMETRY_5_TO_8", "GLOBAL_POSITION_INT", "EXTENDED_SYS_STATE",
    "PARAM_VALUE", "SYSTEM_TIME", "STATUSTEXT", "COMMAND_ACK", "TIMESYNC", "COMMAND_LONG",
    "PARAM_REQUEST_LIST", "RADIO_STATUS", "AUTOPILOT_VERSION",
)  # fmt: skip
"""What is read, and what might provoke an answer."""
_US64 = {"HIGHRES_IMU", "ESC_STATUS", "ACTUATOR_OUTPUT_STATUS", "RAW_IMU"}
_NO_STAMP = {"HEARTBEAT", "PARAM_VALUE", "STATUSTEXT", "COMMAND_LONG", "RPM", "COMMAND_ACK"}
MOST_A_SECOND = 60
"""Messages that we may send, whatever comes."""


def packed(message_id: int, payload: bytes, sequence: int, system: int, version: int) -> bytes:
    """A frame with a right checksum around any payload."""
    payload = payload[:255]
    if version == 1:
        body = struct.pack("<5B", len(payload), sequence, system, 1, message_id & 255) + payload
        magic, extra = b"\xfe", CRC_EXTRA.get(message_id & 255, b"\0")
    else:
        body = struct.pack("<6B", len(payload), 0, 0, sequence, system, 1)
        body += message_id.to_bytes(3, "little") + payload
        magic, extra = b"\xfd", CRC_EXTRA.get(message_id, b"\0")
    from fastcrc import crc16

    return magic + body + crc16.mcrf4xx(body + extra).to_bytes(2, "little")


def _heartbeat(autopilot: int) -> bytes:
    return struct.pack("<I5B", 0, mavlink.MAV_TYPE_QUADROTOR, autopilot, 128, 4, 3)


def frames_of(program: Bytes) -> list[bytes]:
    """Frames with right checksums, as bytes that a fuzzer chose tell.

    Most stamps run on, so that records are made; the others are what they are.
    """
    raws: list[bytes] = []
    t_us = 5_000_000 + (program.byte() << 24)
    autopilot = (12, 3, 0, 8)[program.byte() & 3]
    raws.append(packed(0, _heartbeat(autopilot), 0, 1, 2))
    while program and len(raws) < 40:
        kind, style = program.byte(), program.byte()
        name = _TYPES[kind % len(_TYPES)]
        payload = bytearray(program.take(style & 31 if style & 32 else 40))
        t_us += 4000 + (style << 2)
        if style & 64 and name not in _NO_STAMP and len(payload) >= 8:
            stamp = struct.pack("<Q", t_us)
            payload[: 8 if name in _US64 else 4] = (
                stamp if name in _US64 else struct.pack("<I", t_us // 1000 % 2**32)
            )
        if name == "HEARTBEAT" and style & 64:
            payload = bytearray(_heartbeat(autopilot))
        system = 1 if kind < 240 else kind & 3
        version = 1 if style & 128 and MESSAGE_IDS[name] < 256 else 2
        raws.append(packed(MESSAGE_IDS[name], bytes(payload), len(raws) & 255, system, version))
    return raws


def as_log(raws: list[bytes]) -> bytes:
    """The same as a .tlog."""
    start = 1_750_000_000_000_000
    return b"".join(struct.pack(">Q", start + 4000 * i) + raw for i, raw in enumerate(raws))


def _plain(frames: list[Frame]) -> list[tuple[bytes, str]]:
    return [(frame.raw, frame.valid.name.lower()) for frame in frames]


def check_frames(data: bytes) -> None:
    """A stream gives exactly the reference's frames, however it is cut."""
    cut, stream = (data[0] if data else 0), data[1:]
    scanner = FrameScanner()
    early = scanner.feed(stream)
    whole = early + scanner.flush()
    expected = [(stream[f.at : f.at + f.size], f.validity) for f in frames_of_stream(stream)]
    assert _plain(whole) == expected, "not the frames of the reference"
    assert scanner.garbage_bytes == len(stream) - sum(len(raw) for raw, _ in expected)
    for frame in whole:
        _check_content(frame)
    pieces = FrameScanner()
    step = 1 + cut
    fed = [f for at in range(0, len(stream), step) for f in pieces.feed(stream[at : at + step])]
    assert fed == early, "cut into pieces, other frames"
    assert pieces.flush() == whole[len(early) :]
    assert pieces.garbage_bytes == scanner.garbage_bytes
    at = cut * len(stream) // 256
    assert FrameScanner().feed(stream[:at]) == whole[: len(FrameScanner().feed(stream[:at]))]


def _check_content(frame: Frame) -> None:
    header = HEADER_2 if frame.version == 2 else HEADER_1
    assert frame.raw[header : header + len(frame.payload)] == frame.payload
    if frame.valid is Validity.OK:
        end = header + len(frame.payload)
        told = int.from_bytes(frame.raw[end : end + 2], "little")
        assert checksum(frame.raw[1:end] + CRC_EXTRA[frame.message_id]) == told


def check_datagrams(data: bytes) -> None:
    """Datagrams never raise, and what is believed has a right checksum."""
    program = Bytes(data)
    scanner = FrameScanner()
    total = found = 0
    while program:
        datagram = program.take(program.byte())
        total += len(datagram)
        for frame in scanner.scan(datagram):
            _check_content(frame)
            found += len(frame.raw)
    held = len(scanner._rest)
    assert found + scanner.garbage_bytes + held == total, "bytes are lost"


def _scanned(log: bytes, window: int) -> tuple[list[tuple[int, int, int]], ScanCounts]:
    scanner = Scanner()
    out: list[tuple[int, int, int]] = []
    rest, at, base, final = b"", 0, 0, False
    while not final:
        rest += log[at : at + window]
        at += window
        final = at >= len(log)
        block, done = scanner.scan(rest, final=final)
        places = (base + block.at).tolist()
        out += zip(places, block.size.tolist(), block.validity.tolist(), strict=True)
        rest, base = rest[done:], base + done
    return out, scanner.counts


def check_tlog_scan(data: bytes) -> None:
    """A recording gives exactly the reference's frames, in windows of any size."""
    cut, log = (data[0] if data else 0), data[1:]
    whole, counts = _scanned(log, len(log) + 1)
    numbers = {"ok": 0, "unknown": 1, "bad_crc": 2}
    expected = [(f.at, f.size, numbers[f.validity]) for f in frames_of_log(log)]
    assert whole == expected, "not the frames of the reference"
    ends = [0, *(at + size for at, size, _ in whole[:-1])]
    told = sum(size + min(STAMP, at - end) for (at, size, _), end in zip(whole, ends, strict=False))
    assert counts.garbage_bytes == len(log) - told
    for window in (16 + cut, 300):
        assert _scanned(log, window) == (whole, counts), f"windows of {window}: other frames"


_tlog = Scratch(".tlog")


def check_tlog(data: bytes) -> None:
    """A .tlog is read or refused with one line, and its records are sound."""
    path = _tlog.put(data)
    with one_line_errors():
        log = open_log(path)
        for block in log.blocks():
            for track in block.tracks:
                assert np.isfinite(track.t).all()
                assert track.values.shape[0] == len(track.t) == len(track.order)
        log.as_dict()
        assert 0.0 <= log.share_read <= 1.0


def _comparable(records: list[Record]) -> list[Any]:
    return [
        (r.stream, struct.pack("<d", r.t), np.nan_to_num(r.values).tolist(), r.offset, r.source)
        for r in records
    ]


def check_records(data: bytes) -> None:
    """Frames of any content, as a block or one by one, make the same records."""
    log = as_log(frames_of(Bytes(data)))
    block, _ = Scanner().scan(log, final=True)
    single, many = Intake(), Intake()
    records = [record for _, frame in block for record in in_sequence(single.frames([frame]))]
    made = many.block(block)
    assert _comparable(in_sequence(made)) == _comparable(records)
    assert many.clock == single.clock
    assert many.parameters == single.parameters
    assert many.fates == single.fates
    assert all(np.isfinite(record.t) for record in records)
    health = single.health()
    assert health == many.health()


class _FakeLink(Link):
    """Hands in what it is given, and keeps what is sent."""

    datagrams = True

    def __init__(self) -> None:
        super().__init__(LinkUrl("udpin", "udpin:127.0.0.1:14550", "127.0.0.1", 14550))
        self.waiting: list[ReceivedBytes] = []
        self.sent: list[bytes] = []

    def receive(self, timeout: float) -> list[ReceivedBytes]:
        """As `Link` says; never waits."""
        came, self.waiting = self.waiting, []
        return came

    def send(self, data: bytes) -> None:
        """As `Link` says."""
        self.sent.append(data)

    def answer_to(self, source: Address | None) -> None:
        """As `Link` says."""

    def close(self) -> None:
        """As `Link` says."""


STOPPED = (27, 30, 32, 36, 105, 245, 291, 375, 11030, 11031, 11032, 11033)
"""Messages that may be switched off: those that it asks for."""


def check_sent(raw: bytes) -> None:
    """What is sent is harmless: judged by bytes, with nothing of the gate's own rules."""
    frame = read_frame(raw)
    assert frame is not None
    assert frame.valid is Validity.OK
    assert len(frame.raw) == len(raw)
    assert (frame.system, frame.component) == (OWN_SYSTEM, OWN_COMPONENT)
    fields = unpack(frame.message_id, frame.payload)
    assert fields is not None
    match frame.message_id:
        case 0:  # HEARTBEAT
            assert (fields["type"], fields["autopilot"], fields["base_mode"]) == (6, 8, 0)
        case 76:  # COMMAND_LONG
            assert fields["target_system"] != 0
            command, p1, p2 = fields["command"], fields["param1"], fields["param2"]
            assert command in (510, 511, 512), fields
            assert command != 510 or p2 == 0, fields
            # Stopped is only what this tool asks for; requested is only MESSAGE_INTERVAL.
            assert command != 511 or 0 <= p2 <= 6e7 or (p2 == -1 and p1 in STOPPED), fields
            assert command != 512 or p1 == 244, fields
            assert not any(fields[f"param{i}"] for i in range(3, 8))
        case 66:  # REQUEST_DATA_STREAM
            assert fields["target_system"] != 0
            assert fields["req_stream_id"] in (1, 3, 6, 10, 12)
            assert fields["req_message_rate"] <= 50
        case 20 | 117 | 119 | 122:  # PARAM_REQUEST_READ, LOG_REQUEST_LIST, _DATA, _END
            assert fields["target_system"] != 0
        case 110:  # FILE_TRANSFER_PROTOCOL: to end a session, to list, to open for reading, to read
            assert fields["target_system"] != 0
            payload = fields["payload"]
            assert isinstance(payload, tuple)
            path = bytes(b for b in payload[12:] if isinstance(b, int)).rstrip(b"\0")
            assert payload[3] in (1, 3, 4, 5), fields
            assert path.startswith(b"@MAV_LOG") == (payload[3] in (3, 4)), fields
            assert b".." not in path, fields
        case other:
            raise AssertionError(f"message {other} was sent")


def check_answers(data: bytes) -> None:
    """Whatever frames come, only harmless messages go out, and few of them."""
    program = Bytes(data)
    raws = frames_of(program)
    link = _FakeLink()
    intake = Intake()
    transceiver = Transceiver(link)
    station = GroundStation(transceiver, 4, 250.0)
    often: Counter[int] = Counter()
    now = 0.0
    for i, raw in enumerate(raws):
        link.waiting.append(ReceivedBytes(raw, ("10.0.0.1", 14550 + raw[-1] % 3)))
        if raw[-1] & 7 == 0:
            link.breaks += 1
        for batch in transceiver.receive(0.0):
            intake.frames(batch.frames)
        station.follow(now, intake)
        if i % 2:
            sent = len(link.sent)
            station.tick(now, intake)
            often[int(now)] += len(link.sent) - sent
            now += 0.25
        station.take_events()
    station.close()
    for sent_raw in link.sent:
        check_sent(sent_raw)
    assert max(often.values(), default=0) <= MOST_A_SECOND, often


class _LogVehicle(_FakeLink):
    """A vehicle with one log, whose answers a fuzzer changes; in time of its own."""

    def __init__(self, program: Bytes, content: bytes) -> None:
        super().__init__()
        self.now, self.lied = 0.0, False
        self._program, self._beat_at = program, 0.0
        self._server = LogServer([_log_on_board.put(content)], FrameWriter())
        self._serves = (("LOG_", "FILE_"), ("LOG_",), ("FILE_",))[program.byte() % 3]
        self._parser = mavlink.MAVLink(None)

    def receive(self, timeout: float) -> list[ReceivedBytes]:
        """As `Link` says; never waits."""
        self.waiting += [self._came(raw) for raw in self._changed(self._server.poll())]
        if self.now >= self._beat_at:
            self._beat_at = self.now + 1.0
            self.waiting.append(self._came(packed(0, _heartbeat(12), 0, 1, 2)))
        self.now += 0.001 if self.waiting else timeout
        return super().receive(timeout)

    def send(self, data: bytes) -> None:
        """As `Link` says."""
        super().send(data)
        for message in self._parser.parse_buffer(data) or ():
            name = message.get_type()
            if name.startswith(self._serves):
                answers = self._changed(self._server.handlers[name](message))
                self.waiting += map(self._came, answers)

    @staticmethod
    def _came(raw: bytes) -> ReceivedBytes:
        return ReceivedBytes(raw, ("10.0.0.1", 14550))

    def _changed(self, raws: list[bytes]) -> list[bytes]:
        changed: list[bytes] = []
        for raw in raws:
            action = self._program.byte()
            frame = read_frame(raw)
            assert frame is not None
            payload = bytearray(frame.payload)
            if action == 1:
                continue
            if action == 2:
                changed.append(raw)
            elif action & 3 == 3:
                at = self._program.byte() % 24 if action & 64 else self._program.byte()
                piece = self._program.take(1 + (action >> 3 & 7))
                payload[at : at + len(piece)] = piece
            elif action == 4:
                payload = bytearray(self._program.take(self._program.byte()))
            self.lied |= action & 3 == 3 or action == 4
            changed.append(packed(frame.message_id, bytes(payload), 0, 1, 2))
        return changed


_log_on_board = Scratch(".ulg")


def check_remote_logs(data: bytes) -> None:
    """Whatever answers come to requests for logs, they are read alone, and right where all are."""
    program = Bytes(data)
    content = (program.take(37) * 40)[: program.byte() * 5]
    vehicle = _LogVehicle(program, content)
    with one_line_errors():
        logs = RemoteLogs(Exchange(Transceiver(vehicle), clock=lambda: vehicle.now))
        for log in logs.listed():
            file = io.BytesIO()
            file.write(content[: program.byte()] if program.byte() & 1 else b"other")
            logs.read(log, file)
            assert len(file.getvalue()) == log.size
            assert vehicle.lied or file.getvalue() == content
    for raw in vehicle.sent:
        check_sent(raw)


_KEY = hashlib.sha256(b"fuzz").digest()


def check_signatures(data: bytes) -> None:
    """With a key, a frame is believed once, as it was signed, and never otherwise."""
    program = Bytes(data)
    now = [10**12]
    check = SignatureCheck(_KEY, SigningClock(now=lambda: now[0]))
    signer = Signer(_KEY, SigningClock(now=lambda: now[0]))
    raws = frames_of(Bytes(program.take(48)))
    signed = []
    for raw in raws:
        frame = read_frame(raw)
        if frame is not None and frame.version == 2 and frame.valid is Validity.OK:
            signed.append(signer.sign(raw, CRC_EXTRA[frame.message_id][0]))
    believed: set[bytes] = set()
    sendable = set(signed)
    while program:
        raw = bytearray(signed[program.byte() % len(signed)])
        action = program.byte()
        if action & 1:
            raw[program.byte() % len(raw)] ^= action
        elif action & 2:
            raw = bytearray(program.take(program.byte()))
        frame = read_frame(bytes(raw))
        if frame is None or frame.valid is Validity.BAD_CRC:
            continue
        if check.refusal_of(frame) is None and frame.message_id != MESSAGE_IDS["RADIO_STATUS"]:
            assert frame.raw in sendable, "a frame that nobody signed was believed"
            assert frame.raw not in believed, "a repeated frame was believed"
            believed.add(frame.raw)


def _few_frames() -> list[bytes]:
    """Programs of `frames_of` that make every type of message once or twice."""
    programs = [bytes(range(k, k + 60)) for k in (0, 60, 130)]
    return programs + [
        bytes([0, 0, k, 64] + [1] * 40 + [k + 1, 96 + 8] + [2] * 8) for k in range(len(_TYPES))
    ]


def stream_seeds() -> list[bytes]:
    """Streams of good frames, of both versions, signed, unknown and damaged."""
    streams = [b"\x07" + b"".join(frames_of(Bytes(p)))[:300] for p in _few_frames()]
    signer = Signer(_KEY, SigningClock(now=lambda: 10**12))
    streams.append(b"\x03" + signer.sign(packed(0, _heartbeat(12), 1, 1, 2), CRC_EXTRA[0][0]) * 3)
    unknown = bytes([0xFD, 1, 0, 0, 9, 1, 1, 0xFF, 0xFF, 0xFF, 7, 1, 2])
    streams.append(streams[0][:60] + unknown + streams[1][:90] + b"\xfd\xfe\xfd" + streams[2][:80])
    return streams


def log_seeds() -> list[bytes]:
    """Recordings, with a byte in front that says how to cut them."""
    return [b"\xfa" + as_log(frames_of(Bytes(p)))[:250] for p in _few_frames()]


def program_seeds() -> list[bytes]:
    """Bytes that `frames_of` makes something of."""
    imu = bytes([1, 64]) + bytes(40)
    usual = [bytes([k, 64]) + bytes(8) + bytes([60, 63] * 16) for k in range(1, 17)]
    return [
        bytes([0, 0]) + b"".join(usual[:6]),
        bytes([0, 1]) + b"".join(usual[5:11]),
        bytes([200, 1]) + b"".join(usual[10:]),
        bytes([0, 1]) + (bytes([15, 0]) + b"\0\0\0\x3f\0\0\0\0SIH_MASS" + bytes(24)) * 3,
        bytes([1, 0]) + b"".join(bytes([1, 96 + 16]) + bytes(16) for _ in range(12)),
        bytes([2, 2]) + bytes(range(100)),
        bytes([0, 0]) + (imu + bytes([1, 0]) + bytes(40)) * 3,
        bytes([0, 0]) + (imu + bytes([8, 0]) + bytes([1] * 40)) * 3,
    ]


def remote_log_seeds() -> list[bytes]:
    """Sound answers and changed ones, of each way to ask."""
    return [
        bytes(range(37)) + bytes([size, way]) + changes
        for way in range(3)
        for size in (1, 90, 255)
        for changes in (b"", bytes([0, 1, 2]), bytes([3, 2, 9, 0, 67, 3, 1, 4, 3]))
    ]


def datagram_seeds() -> list[bytes]:
    """Length and datagram, one after the other."""
    return [
        b"".join(bytes([len(raw)]) + raw for raw in frames_of(Bytes(seed)) if len(raw) < 256)
        for seed in program_seeds()
    ]


def tlog_seeds() -> list[bytes]:
    """Whole recordings."""
    return [seed[1:] for seed in log_seeds()]
