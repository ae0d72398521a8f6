"""The emulator as a program of its own, over real sockets and a real serial port."""

import json
import select
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frames import FrameScanner

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


def udp_socket() -> socket.socket:
    s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    s.bind(("127.0.0.1", 0))
    return s


def free_port(kind: int) -> int:
    with socket.socket(socket.AF_INET, kind) as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def hears(s: socket.socket, message_id: int) -> None:
    """Datagrams come until one holds such a message."""
    s.settimeout(PATIENCE)
    scanner = FrameScanner()
    while message_id not in [frame.message_id for frame in scanner.scan(s.recv(65535))]:
        pass


@pytest.mark.slow
def test_listening_on_udp_it_answers_the_first_who_speaks(start: Start) -> None:
    port = free_port(socket.SOCK_DGRAM)
    start("--connect", f"udpin:127.0.0.1:{port}")
    with udp_socket() as s:
        beat = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
        raw = beat.pack(mavlink.MAVLink(None, 245, 190))
        give_up = time.monotonic() + PATIENCE
        while not select.select([s], [], [], 0.1)[0]:
            assert time.monotonic() < give_up
            s.sendto(raw, ("127.0.0.1", port))
        hears(s, mavlink.MAVLINK_MSG_ID_HIGHRES_IMU)


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
        hears(s, mavlink.MAVLINK_MSG_ID_HEARTBEAT)
        assert json.loads(truth.read_text())["mass"] == 1.5
