"""The emulator as a program of its own, over real sockets and a real serial port."""

import itertools
import json
import select
import signal
import socket
import subprocess
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from gcs_sysid.telemetry.dialect import mavlink

ROOT = Path(__file__).parents[2]
PATIENCE = 20.0
"""s until a test gives up; nothing here takes that long."""

Start = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def start() -> Iterator[Start]:
    """Starts emulators and ends them with the test."""
    running: list[subprocess.Popen[str]] = []

    def run(*options: str) -> "subprocess.Popen[str]":
        process = subprocess.Popen(
            [sys.executable, "-m", "sim_bridge", *options],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        running.append(process)
        return process

    yield run
    for process in running:
        process.kill()
        process.communicate()


class Station:
    """A ground station on any pair of read and write functions."""

    def __init__(self, source: Any, read: Callable[[], bytes], write: Callable[[bytes], object]):
        self._source = source
        self._read = read
        self._write = write
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._sender = mavlink.MAVLink(None, 245, 190)
        self._waiting: deque[Any] = deque()

    def sign(self, key: bytes) -> None:
        """Sign what is sent, and take only what is signed, and not long ago."""
        # Signatures count 10 us from 2015 on.
        now = round((time.time() - 1_420_070_400) * 1e5)
        for end in (self._sender, self._parser):
            end.signing.secret_key = key
            end.signing.timestamp = now
        self._sender.signing.sign_outgoing = True

    def send(self, message: Any) -> None:
        self._write(message.pack(self._sender))

    def until(self, wanted: Callable[[Any], bool]) -> list[Any]:
        """Everything received up to the message that is wanted."""
        got: list[Any] = []
        give_up = time.monotonic() + PATIENCE
        while time.monotonic() < give_up:
            while self._waiting:
                got.append(self._waiting.popleft())
                if wanted(got[-1]):
                    return got
            if not select.select([self._source], [], [], 0.2)[0]:
                continue
            data = self._read()
            if not data:
                break
            self._waiting.extend(self._parser.parse_buffer(data) or ())
        raise AssertionError(f"never came; got {sorted({m.get_type() for m in got})}")

    def command(self, number: int, *params: float) -> Any:
        """Send a command and return its acknowledgement."""
        filled = [*params, *[0.0] * (7 - len(params))]
        self.send(mavlink.MAVLink_command_long_message(1, 1, number, 0, *filled))
        return self.until(lambda m: is_a(m, "COMMAND_ACK") and m.command == number)[-1]


def is_a(message: Any, name: str) -> bool:
    return bool(message.get_type() == name)


def udp_socket() -> socket.socket:
    s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    s.bind(("127.0.0.1", 0))
    return s


def free_port(kind: int) -> int:
    with socket.socket(socket.AF_INET, kind) as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def peer_station(s: socket.socket) -> Station:
    """On a bound UDP socket: answers to whoever spoke last."""
    peer: list[Any] = []

    def read() -> bytes:
        data, sender = s.recvfrom(65535)
        peer[:] = [sender]
        return data

    return Station(s, read, lambda data: s.sendto(data, peer[0]))


@pytest.mark.slow
def test_requests_and_answers_over_udp(start: Start) -> None:
    with udp_socket() as s:
        port = s.getsockname()[1]
        process = start("--connect", f"udpout:127.0.0.1:{port}", "--rate", "50")
        station = peer_station(s)
        station.until(lambda m: is_a(m, "HEARTBEAT"))
        set_interval = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
        ack = station.command(set_interval, mavlink.MAVLINK_MSG_ID_HIGHRES_IMU, 5000)
        assert ack.result == mavlink.MAV_RESULT_ACCEPTED
        first = station.until(lambda m: is_a(m, "HIGHRES_IMU"))[-1].time_usec
        got = station.until(lambda m: is_a(m, "HIGHRES_IMU") and m.time_usec >= first + 200_000)
        stamps = [first, *(m.time_usec for m in got if is_a(m, "HIGHRES_IMU"))]
        gaps = Counter(b - a for a, b in itertools.pairwise(stamps))
        assert gaps.most_common(1)[0][0] == 5000
        ack = station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0)
        assert ack.result == mavlink.MAV_RESULT_UNSUPPORTED
        station.send(mavlink.MAVLink_timesync_message(0, 42))
        assert station.until(lambda m: is_a(m, "TIMESYNC"))[-1].ts1 == 42
        station.send(mavlink.MAVLink_param_request_list_message(1, 1))
        station.until(lambda m: is_a(m, "PARAM_VALUE") and m.param_index == m.param_count - 1)
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE) == 0
        assert process.communicate() == ("", "")


@pytest.mark.slow
def test_listening_on_udp_it_answers_the_first_who_speaks(start: Start) -> None:
    port = free_port(socket.SOCK_DGRAM)
    start("--connect", f"udpin:127.0.0.1:{port}")
    with udp_socket() as s:
        s.settimeout(0.1)
        station = Station(
            s, lambda: s.recv(65535), lambda data: s.sendto(data, ("127.0.0.1", port))
        )
        heartbeat = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
        give_up = time.monotonic() + PATIENCE
        while not select.select([s], [], [], 0.1)[0]:
            assert time.monotonic() < give_up
            station.send(heartbeat)
        station.until(lambda m: is_a(m, "HIGHRES_IMU"))


@pytest.mark.slow
@pytest.mark.parametrize("way", ["tcp", "tcpin"])
def test_a_whole_flight_over_tcp_loses_nothing(start: Start, way: str, tmp_path: Path) -> None:
    port = free_port(socket.SOCK_STREAM)
    options = ("--speed", "max", "--duration", "3", "--mission", "hover", "--seed", "4")
    file = tmp_path / "same.tlog"
    if way == "tcp":
        with socket.create_server(("127.0.0.1", port)) as server:
            process = start("--connect", f"tcp:127.0.0.1:{port}", "--tlog", str(file), *options)
            server.settimeout(PATIENCE)
            peer, _ = server.accept()
    else:
        process = start("--connect", f"tcpin:127.0.0.1:{port}", "--tlog", str(file), *options)
        give_up = time.monotonic() + PATIENCE
        while True:
            try:
                peer = socket.create_connection(("127.0.0.1", port), timeout=1.0)
                break
            except OSError:
                assert time.monotonic() < give_up
                time.sleep(0.05)
    with peer:
        peer.settimeout(PATIENCE)
        received = b""
        while data := peer.recv(65536):
            received += data
    assert process.wait(PATIENCE) == 0
    # The same frames as in the file written beside, which has eight bytes a record on top.
    recorded = file.read_bytes()
    frames, at = [], 0
    while at < len(recorded):
        size = 12 + recorded[at + 9]
        frames.append(recorded[at + 8 : at + 8 + size])
        at += 8 + size
    assert received == b"".join(frames)


@pytest.mark.slow
def test_a_lost_tcp_connection_is_one_clear_line(start: Start) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        process = start("--connect", f"tcp:127.0.0.1:{port}")
        server.settimeout(PATIENCE)
        peer, _ = server.accept()
        peer.close()
    assert process.wait(PATIENCE) == 2
    out, err = process.communicate()
    assert out == ""
    assert err == "sim-bridge: error: the ground station closed the TCP connection\n"


def test_the_truth_is_there_while_it_flies(start: Start, tmp_path: Path) -> None:
    with udp_socket() as s:
        truth = tmp_path / "truth.json"
        start("--connect", f"udpout:127.0.0.1:{s.getsockname()[1]}", "--truth", str(truth))
        peer_station(s).until(lambda m: is_a(m, "HEARTBEAT"))
        assert json.loads(truth.read_text())["mass"] == 1.5
