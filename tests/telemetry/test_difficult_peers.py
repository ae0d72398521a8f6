"""Peers that stall in the middle of a frame or do not read, IPv6, and a host clock that jumps."""

import socket
import struct

import numpy as np
import pytest

from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.frames import FrameScanner
from gcs_sysid.telemetry.link import open_link
from gcs_sysid.telemetry.logs import open_log
from gcs_sysid.telemetry.outgoing import Gate
from gcs_sysid.telemetry.transceiver import Receiver
from gcs_sysid.telemetry.urls import parse_url
from tests.telemetry.test_link import WAIT, receive


@pytest.fixture
def peer():
    """A TCP server with small buffers, and our link to it."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        with open_link(parse_url(f"tcp:127.0.0.1:{server.getsockname()[1]}")) as link:
            link._peer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
            with server.accept()[0] as vehicle:
                vehicle.settimeout(WAIT)
                yield vehicle, link


def test_a_peer_that_stalls_in_a_frame_is_waited_for_and_holds_up_nothing(peer, sender):
    vehicle, link = peer
    receiver = Receiver(link)
    first, second = sender.heartbeat(), sender.heartbeat()
    vehicle.sendall(first.raw + second.raw[:7])
    assert receive(receiver, 1) == [first]
    for _ in range(20):
        assert receiver.poll(0.0) == []
    assert not link.ended
    vehicle.sendall(second.raw[7:])
    assert receive(receiver, 1) == [second]


def test_a_peer_that_does_not_read_gets_whole_frames_or_none(peer, sender):
    vehicle, link = peer
    sent = [sender.heartbeat() for _ in range(3000)]
    for frame in sent:
        link.send(frame.raw)
    scanner, found, last = FrameScanner(), [], sender.heartbeat(custom_mode=7)
    for _ in range(1000):
        if last in found:
            break
        found += scanner.feed(vehicle.recv(65536))
        link.send(last.raw)
    kept = [frame.raw for frame in found if frame.raw != last.raw]
    in_order = iter(frame.raw for frame in sent)
    assert 0 < len(kept) < len(sent)
    assert all(raw in in_order for raw in kept)
    assert (scanner.garbage_bytes, scanner.bad_crc) == (0, 0)


@pytest.fixture
def host():
    """The loopback of IPv6, where there is one."""
    try:
        with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as probe:
            probe.bind(("::1", 0))
    except OSError:
        pytest.skip("no IPv6 here")
    return "::1"


def test_datagrams_over_ipv6_go_both_ways(host, sender):
    with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as vehicle:
        vehicle.bind((host, 0))
        vehicle.settimeout(WAIT)
        with open_link(parse_url(f"udpout:[{host}]:{vehicle.getsockname()[1]}")) as link:
            Gate(link.send).heartbeat()
            data, address = vehicle.recvfrom(100)
            assert data[0] == 0xFD
            beat = sender.heartbeat()
            vehicle.sendto(beat.raw, address)
            assert receive(Receiver(link), 1) == [beat]
        port = address[1]
        with open_link(parse_url(f"udpin:[{host}]:{port}")) as link:
            vehicle.sendto(beat.raw, (host, port))
            (chunk,) = link.receive(WAIT)
            assert (chunk.data, chunk.source[0]) == (beat.raw, host)
            link.answer_to(chunk.source)
            Gate(link.send).heartbeat()
            assert vehicle.recv(100)[0] == 0xFD


@pytest.mark.parametrize("jumps", [(3600.0,), (-3600.0,), (-1e9, 2e9), (0.3, -0.3) * 8])
def test_a_computer_whose_clock_jumps_changes_no_sample(paper_flight, tmp_path, jumps):
    """Stamps of a .tlog are the host's; times of the samples are the vehicle's."""
    data = bytearray(paper_flight.tlog.read_bytes())
    path = tmp_path / "jumps.tlog"
    records, at = [], 0
    while at + 10 < len(data):
        records.append(at)
        at += 8 + 12 + data[at + 9]
    for number, by in enumerate(jumps, 1):
        for at in records[len(records) * number // (len(jumps) + 1) :]:
            (stamp,) = struct.unpack_from(">Q", data, at)
            struct.pack_into(">Q", data, at, max(stamp + round(by * 1e6), 0))
    path.write_bytes(data)
    before, after = (imu(log) for log in (paper_flight.tlog, path))
    assert len(before) > 400
    np.testing.assert_array_equal(after, before)


def imu(log):
    """Times and values of the IMU's samples."""
    tracks = [track for block in open_log(log).blocks() for track in block.tracks]
    parts = [np.column_stack([t.t, t.values]) for t in tracks if t.stream is Stream.IMU]
    return np.concatenate(parts)
