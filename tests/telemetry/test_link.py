"""Links by name, over real sockets and a real serial path."""

import socket
import sys
import threading
import time

import pytest

from gcs_sysid.errors import InputError, LinkError
from gcs_sysid.telemetry.link import Link, ReceivedBytes, UdpLink, open_link
from gcs_sysid.telemetry.outgoing import Gate
from gcs_sysid.telemetry.transceiver import Receiver
from gcs_sysid.telemetry.urls import LinkUrl, parse_url

WAIT = 5.0
"""s: a bound for what comes at once on loopback; nothing waits for it to pass."""


def free_port(kind=socket.SOCK_DGRAM):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def receive(receiver, count):
    frames = []
    for _ in range(200):
        frames += receiver.poll(WAIT / 100)
        if len(frames) >= count:
            break
    return frames


@pytest.mark.parametrize(
    ("text", "kind", "host", "port"),
    [
        ("udpin:0.0.0.0:14550", "udpin", "0.0.0.0", 14550),
        ("udp:127.0.0.1:14550", "udpin", "127.0.0.1", 14550),
        ("127.0.0.1:14550", "udpin", "127.0.0.1", 14550),
        ("udpout:drone.local:14550", "udpout", "drone.local", 14550),
        ("tcp:127.0.0.1:5760", "tcp", "127.0.0.1", 5760),
        ("tcpin:0.0.0.0:5760", "tcpin", "0.0.0.0", 5760),
        ("udpin:[::1]:14550", "udpin", "::1", 14550),
        ("udpin://0.0.0.0:14550", "udpin", "0.0.0.0", 14550),
        (" UDPIN:0.0.0.0:14550 ", "udpin", "0.0.0.0", 14550),
        ("udp://:14540", "udpin", "0.0.0.0", 14540),
        ("udpin://0.0.0.0:14540", "udpin", "0.0.0.0", 14540),
        ("udpout://10.0.0.1:14550", "udpout", "10.0.0.1", 14550),
        ("udp://:14540@127.0.0.1:14557", "udpin", "0.0.0.0", 14540),
        ("udp://@10.0.0.1:14550", "udpout", "10.0.0.1", 14550),
        ("udp://127.0.0.1:14550/?ids=255,240", "udpin", "127.0.0.1", 14550),
        ("tcp://10.0.0.1:5760?ids=1,1", "tcp", "10.0.0.1", 5760),
        ("tcpout://10.0.0.1:5760", "tcp", "10.0.0.1", 5760),
        ("tcp-l://0.0.0.0:5760", "tcpin", "0.0.0.0", 5760),
    ],
)
def test_network_links_are_named_as_in_mavproxy_mavsdk_and_mavros(text, kind, host, port):
    url = parse_url(text)
    assert (url.kind, url.host, url.port) == (kind, host, port)
    assert str(url) == text.strip()


@pytest.mark.parametrize(
    ("text", "device", "baud"),
    [
        ("/dev/ttyUSB0", "/dev/ttyUSB0", 921600),
        ("/dev/ttyACM0,57600", "/dev/ttyACM0", 57600),
        ("COM3", "COM3", 921600),
        ("COM3:57600", "COM3", 57600),
        ("/dev/ttyACM0:57600", "/dev/ttyACM0", 57600),
        ("serial:///dev/ttyUSB0:57600", "/dev/ttyUSB0", 57600),
        ("serial_flowcontrol:///dev/ttyUSB0:57600", "/dev/ttyUSB0", 57600),
        ("serial-hwfc:///dev/ttyUSB0:57600", "/dev/ttyUSB0", 57600),
        ("uart:/dev/ttyUSB0:57600", "/dev/ttyUSB0", 57600),
        ("/dev/ttyUSB0 57600", "/dev/ttyUSB0", 57600),
        ("com3@57600", "com3", 57600),
        ("ttyACM0:57600", "/dev/ttyACM0", 57600),
        ("ttyUSB0", "/dev/ttyUSB0", 921600),
        ("serial:///dev/ttyUSB0:57600?ids=1,1", "/dev/ttyUSB0", 57600),
        ("/dev/ttyACM0:57600?ids=1,240", "/dev/ttyACM0", 57600),
        ("/dev/serial/by-path/pci-0-usb-0:3:1.0", "/dev/serial/by-path/pci-0-usb-0:3:1.0", 921600),
        ("/dev/serial/by-id/usb-3D_Robotics:0", "/dev/serial/by-id/usb-3D_Robotics:0", 921600),
    ],
)
def test_serial_links_are_devices_with_a_baud_rate(text, device, baud):
    url = parse_url(text, baud=921600)
    assert (url.kind, url.device, url.baud) == ("serial", device, baud)


@pytest.mark.parametrize(
    ("text", "baud", "limit"),
    [
        ("/dev/ttyUSB0", None, 115200),
        ("/dev/ttyUSB0", 57600, 57600),
        ("/dev/ttyUSB0,57600", 921600, 57600),
        ("COM3", 57600, 57600),
        ("/dev/ttyACM0", None, None),
        ("/dev/cu.usbmodem01", None, None),
        ("/dev/ttyACM0", 57600, 57600),
        ("/dev/pts/3", None, None),
        ("udpin:0.0.0.0:14550", 57600, None),
    ],
)
def test_the_baud_rate_limits_where_it_is_one(text, baud, limit):
    assert parse_url(text, baud).line_rate == limit


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no link given"),
        ("nonsense", "cannot understand the link 'nonsense'"),
        ("http://example.com", "cannot understand"),
        ("udpin:", "write the link as"),
        ("udp:14540", "such as udpin:0.0.0.0:14540, from this computer alone udpin:127."),
        ("14550", "such as udpin:0.0.0.0:14550"),
        ("udp://@:14540", "such as udpin:0.0.0.0:14540"),
        ("udpout:", "such as udpout:127.0.0.1:14550"),
        ("mcast:", "mavproxy.py --master=LINK --out=127.0.0.1:14550"),
        ("udpin:0.0.0.0:", "the port must be a number"),
        ("udpin:0.0.0.0:port", "the port must be a number"),
        ("udpout:host:0", "the port must be a number"),
        ("tcp:host:70000", "the port must be a number"),
        ("tcp:host:-1", "the port must be a number"),
        ("udpin:::1:14550", "in brackets"),
        ("/dev/ttyUSB0,fast", "baud rate must be a number"),
        ("/dev/ttyUSB0,0", "baud rate must be positive"),
        ("flight.tlog", "use gcs-sysid analyze"),
        ("udpin:0.0.0.0:14550?x", "what is behind ? is not understood: write udpin:0.0.0.0:14550"),
    ],
)
def test_a_bad_name_gives_its_line(text, says):
    with pytest.raises(InputError) as caught:
        parse_url(text)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_datagrams_come_as_they_were_sent_and_answers_go_to_the_vehicle(stream):
    _, expected = stream
    port = free_port()
    with (
        open_link(parse_url(f"udpin:127.0.0.1:{port}")) as link,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as attacker,
    ):
        vehicle.settimeout(WAIT)
        attacker.setblocking(False)
        attacker.bind(("127.0.0.1", 0))
        receiver = Receiver(link)
        receiver.follow((1, 1))
        gate = Gate(link.send)
        gate.heartbeat()  # nobody to send it to yet
        for frame in expected:
            attacker.sendto(b"\xfd\x20garbage", ("127.0.0.1", port))
            vehicle.sendto(frame.raw, ("127.0.0.1", port))
        assert receive(receiver, len(expected)) == expected
        attacker.sendto(b"more garbage", ("127.0.0.1", port))
        receiver.poll(WAIT)
        assert receiver.garbage_bytes > 100
        gate.heartbeat()
        assert vehicle.recv(100)[0] == 0xFD
        with pytest.raises(BlockingIOError):
            attacker.recv(100)


def test_udpout_to_where_nobody_listens_goes_on():
    with open_link(parse_url(f"udpout:127.0.0.1:{free_port()}")) as link:
        for _ in range(3):
            Gate(link.send).heartbeat()
            assert link.receive(0.01) == []
        assert not link.ended


def test_tcp_gives_all_frames_and_then_its_end(stream):
    data, expected = stream
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        open_link(parse_url(f"tcp:127.0.0.1:{server.getsockname()[1]}")) as link,
    ):
        vehicle, _ = server.accept()
        with vehicle:
            vehicle.settimeout(WAIT)
            for at in range(0, len(data), 100):
                vehicle.sendall(data[at : at + 100])
            receiver = Receiver(link)
            assert receive(receiver, len(expected)) == expected
            Gate(link.send).heartbeat()
            assert vehicle.recv(100)[0] == 0xFD
        for _ in range(100):
            receiver.poll(WAIT / 100)
            if link.ended:
                break
        assert link.ended
        assert receiver.poll(0.0) == []
        link.send(b"into the void")


def test_tcpin_takes_one_connection_after_another(sender):
    port = free_port(socket.SOCK_STREAM)
    with open_link(parse_url(f"tcpin:127.0.0.1:{port}")) as link:
        receiver = Receiver(link)
        for _ in range(2):
            with socket.create_connection(("127.0.0.1", port)) as vehicle:
                beat = sender.heartbeat()
                vehicle.sendall(beat.raw)
                assert receive(receiver, 1) == [beat]
        assert not link.ended


def test_a_port_in_use_gives_its_line():
    port = free_port()
    with open_link(parse_url(f"udpin:127.0.0.1:{port}")):
        with pytest.raises(LinkError, match="in use") as caught:
            open_link(parse_url(f"udpin:127.0.0.1:{port}"))
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("/dev/ttyDoesNotExist", "no such device"),
        ("udpin:192.0.2.1:14550", "not an address of this machine"),
        ("tcp:no-such-host.invalid:5760", "no address found"),
    ],
)
def test_a_link_that_cannot_be_opened_gives_its_line(text, says):
    with pytest.raises(LinkError, match=says) as caught:
        open_link(parse_url(text))
    assert "\n" not in str(caught.value)


linux = pytest.mark.skipif(sys.platform != "linux", reason="what Linux tells of a datagram")


@linux
def test_a_datagram_is_stamped_when_it_arrives_however_late_it_is_read():
    with (
        UdpLink(LinkUrl("udpin", "udpin:127.0.0.1", "127.0.0.1")) as link,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle,
    ):
        # The kernel is late to begin stamping, and stamps what came before as it is read.
        for _ in range(50):
            before = time.time_ns() // 1000
            vehicle.sendto(b"first", ("127.0.0.1", link.port))
            after = time.time_ns() // 1000
            threading.Event().wait(0.2)
            vehicle.sendto(b"second", ("127.0.0.1", link.port))
            chunks = link.receive(WAIT)
            if chunks[0].time_us <= after:
                break
        assert [chunk.data for chunk in chunks] == [b"first", b"second"]
        assert before <= chunks[0].time_us <= after
        assert chunks[1].time_us - chunks[0].time_us >= 200_000


@linux
def test_what_the_system_drops_is_counted(monkeypatch):
    monkeypatch.setattr(UdpLink, "RECEIVE_BUFFER", 1)  # the smallest that Linux gives
    with (
        UdpLink(LinkUrl("udpin", "udpin:127.0.0.1", "127.0.0.1")) as link,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle,
    ):
        read = 0
        for _ in range(2):
            for _ in range(100):
                vehicle.sendto(b"datagram", ("127.0.0.1", link.port))
            read += len(link.receive(WAIT))
        assert read < 200
        vehicle.sendto(b"the next one brings the count", ("127.0.0.1", link.port))
        read += len(link.receive(WAIT))
        assert link.dropped == 201 - read


def test_what_arrived_together_is_one_batch_and_what_did_not_is_not(sender):
    class Told(Link):
        datagrams = True

        def receive(self, timeout):
            times = (1_000_000, 1_000_500, 1_000_500 + Receiver.TOGETHER, 2_000_000, None)
            return [ReceivedBytes(sender.heartbeat().raw, ("10.0.0.1", 14550), t) for t in times]

        def send(self, data):
            raise AssertionError("nothing is to be sent")

        def close(self):
            pass

    batches = Receiver(Told(parse_url("udpin:127.0.0.1:14550"))).receive(0.0)
    assert [len(batch.frames) for batch in batches] == [2, 1, 1, 1]
    assert [batch.time_us for batch in batches[:3]] == [
        1_000_500,
        1_000_500 + Receiver.TOGETHER,
        2_000_000,
    ]
    assert abs(batches[3].time_us - time.time_ns() // 1000) < 60_000_000
