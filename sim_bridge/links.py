"""Links to a ground station: UDP, TCP and serial, addressed as MAVProxy users write them."""

import contextlib
import os
import select
import socket
import time
from abc import ABC, abstractmethod
from pathlib import Path
from typing import IO, Any, Protocol

import serial

from gcs_sysid.errors import InputError, LinkError
from gcs_sysid.telemetry.frames import FrameScanner
from sim_bridge.autopilot import EPOCH_US

DATAGRAM = 1400
"""Bytes at most in a datagram: frames of one instant travel together, as PX4 sends them."""

CONNECT_PATIENCE = 5.0
"""s to go on trying a TCP connection: the other side may be starting, too."""


class Link(Protocol):
    """Where frames go and questions come from."""

    @property
    def connected(self) -> bool:
        """Whether it is known whom to send to."""
        ...

    def send(self, frames: list[bytes], time_us: int) -> None:
        """Send frames made at this time of the vehicle's clock."""
        ...

    def intrude(self, datagrams: list[bytes], time_us: int) -> None:
        """Send what another sender sends to the same port."""
        ...

    def receive(self) -> bytes:
        """What has arrived; empty when nothing has."""
        ...

    def close(self) -> None:
        """Let go of the link."""
        ...


class _OneSender(ABC):
    """A link on which other senders have no address of their own."""

    @abstractmethod
    def send(self, frames: list[bytes], time_us: int) -> None:
        """Send frames made at this time of the vehicle's clock."""

    def intrude(self, datagrams: list[bytes], time_us: int) -> None:
        """Send what another sender sends to the same port: here along with ours."""
        if datagrams:
            self.send(datagrams, time_us)


class UdpLink:
    """UDP, either way round.

    Attributes:
        peer: where frames go; None until something was received on a listening link.
    """

    def __init__(self, host: str, port: int, listen: bool) -> None:
        self._listen = listen
        self._attacker: socket.socket | None = None
        family, address = _resolve(host, port, socket.SOCK_DGRAM)
        self.peer: Any = None if listen else address
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        if listen:
            try:
                self._socket.bind(address)
            except OSError as error:
                self._socket.close()
                raise LinkError(f"cannot listen on UDP {host}:{port}: {error.strerror}") from error

    @property
    def connected(self) -> bool:
        """Whether the other side's address is known."""
        return self.peer is not None

    def send(self, frames: list[bytes], time_us: int) -> None:
        """Send frames in as few datagrams as they fit into."""
        del time_us
        if self.peer is None:
            return
        bundle = b""
        for frame in frames:
            if bundle and len(bundle) + len(frame) > DATAGRAM:
                self._send(bundle)
                bundle = b""
            bundle += frame
        if bundle:
            self._send(bundle)

    def _send(self, data: bytes) -> None:
        try:
            self._socket.sendto(data, self.peer)
        except BlockingIOError:
            select.select([], [self._socket], [], 0.1)
            with contextlib.suppress(OSError):
                self._socket.sendto(data, self.peer)
        except OSError:
            # There is no listener yet, or no network: a radio would not notice either.
            return

    def intrude(self, datagrams: list[bytes], time_us: int) -> None:
        """Send datagrams as they are, from an address of their own."""
        del time_us
        if self.peer is None or not datagrams:
            return
        if self._attacker is None:
            self._attacker = socket.socket(self._socket.family, socket.SOCK_DGRAM)
            self._attacker.setblocking(False)
        for data in datagrams:
            with contextlib.suppress(OSError):  # who floods does not wait
                self._attacker.sendto(data, self.peer)

    def receive(self) -> bytes:
        """What has arrived; on a listening link the last sender becomes the peer."""
        data = b""
        while True:
            try:
                more, sender = self._socket.recvfrom(65535)
            except OSError:
                return data
            data += more
            if self._listen:
                self.peer = sender

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
        if self._attacker is not None:
            self._attacker.close()


class TcpLink(_OneSender):
    """TCP: connecting, or listening for one ground station after the other."""

    connected = True  # made so

    def __init__(self, host: str, port: int, listen: bool) -> None:
        family, address = _resolve(host, port, socket.SOCK_STREAM)
        self._server: socket.socket | None = None
        if listen:
            self._server = socket.socket(family, socket.SOCK_STREAM)
            if os.name == "posix":  # elsewhere it would share a port that is in use
                self._server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                self._server.bind(address)
            except OSError as error:
                self._server.close()
                raise LinkError(f"cannot listen on TCP {host}:{port}: {error.strerror}") from error
            self._server.listen(1)
            self._peer: socket.socket | None = self._accept(None)
        else:
            self._peer = _connect(family, address, f"{host}:{port}")

    def _accept(self, timeout: float | None) -> socket.socket | None:
        """The next ground station, or None when none comes in time."""
        if self._server is None or not select.select([self._server], [], [], timeout)[0]:
            return None
        peer, _ = self._server.accept()
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return peer

    def _lost(self) -> None:
        if self._peer is not None:
            self._peer.close()
            self._peer = None
        if self._server is None:
            raise LinkError("the ground station closed the TCP connection")

    def send(self, frames: list[bytes], time_us: int) -> None:
        """Send frames; waits while the other side is behind."""
        del time_us
        if self._peer is None:
            self._peer = self._accept(0.0)
        if self._peer is None:
            return
        try:
            self._peer.sendall(b"".join(frames))
        except OSError:
            self._lost()

    def receive(self) -> bytes:
        """What has arrived."""
        if self._peer is None or not select.select([self._peer], [], [], 0.0)[0]:
            return b""
        try:
            data = self._peer.recv(65536)
        except OSError:
            data = b""
        if not data:
            self._lost()
        return data

    def close(self) -> None:
        """Close the connection."""
        for s in (self._peer, self._server):
            if s is not None:
                s.close()


_BUSY = 2.0
"""s that a serial port may take nothing, before what is sent is lost."""


class SerialLink(_OneSender):
    """A serial port."""

    connected = True

    def __init__(self, device: str, baud: int) -> None:
        try:
            self._port = serial.Serial(device, baud, timeout=0, write_timeout=_BUSY)
        except (serial.SerialException, ValueError) as error:
            raise LinkError(f"cannot open serial port {device} at {baud} baud: {error}") from error

    def send(self, frames: list[bytes], time_us: int) -> None:
        """Send frames; waits while the port is busy, but not for ever: there may be no reader."""
        del time_us
        try:
            self._port.write(b"".join(frames))
        except serial.SerialTimeoutException:
            pass  # lost, as on a line that is too slow
        except (serial.SerialException, OSError) as error:
            raise LinkError(f"serial port {self._port.port} is gone: {error}") from error

    def receive(self) -> bytes:
        """What has arrived."""
        try:
            return bytes(self._port.read(4096))
        except (serial.SerialException, OSError) as error:
            raise LinkError(f"serial port {self._port.port} is gone: {error}") from error

    def close(self) -> None:
        """Close the port."""
        self._port.close()


class TlogLink:
    """A .tlog file: big-endian microseconds since 1970, then the frame."""

    connected = True

    def __init__(self, path: Path, replace: bool = False, *, recorded: bool = False) -> None:
        """Open a new file, or empty one that there is if `replace` allows it.

        With `recorded`, what is written is what a receiver makes out in the datagrams sent.
        """
        # One a sender, as receivers have: what is broken of one cannot cut the other's frames.
        self._scanners = (FrameScanner(), FrameScanner()) if recorded else None
        try:
            self._file: IO[bytes] = path.open("wb" if replace else "xb", buffering=1 << 20)
        except FileExistsError as error:
            raise InputError(f"{path} exists; --force replaces it") from error
        except OSError as error:
            raise InputError(f"cannot write {path}: {error.strerror}") from error

    def send(self, frames: list[bytes], time_us: int) -> None:
        """Write frames with the vehicle's clock on a fixed epoch, so that bytes repeat."""
        self._write(frames, time_us, 0)

    def intrude(self, datagrams: list[bytes], time_us: int) -> None:
        """Write what a receiver finds in another sender's datagrams."""
        self._write(datagrams, time_us, 1)

    def _write(self, frames: list[bytes], time_us: int, sender: int) -> None:
        stamp = (EPOCH_US + time_us).to_bytes(8, "big")
        if self._scanners is not None:
            scan = self._scanners[sender].scan
            frames = [made_out.raw for data in frames for made_out in scan(data)]
        self._file.write(b"".join([stamp + frame for frame in frames]))

    def receive(self) -> bytes:
        """Nothing ever comes from a file."""
        return b""

    def close(self) -> None:
        """Write what is left."""
        self._file.close()


def open_link(url: str, baud: int) -> Link:
    """Open `udpout:HOST:PORT`, `udpin:`, `tcp:`, `tcpin:` or a serial device.

    Raises:
        InputError: the address cannot be understood.
        LinkError: the link cannot be opened.
    """
    scheme, colon, rest = url.partition(":")
    if colon and scheme in ("udpout", "udpin", "udp", "tcp", "tcpin"):
        host, port = _host_port(url, rest)
        if scheme.startswith("udp"):
            return UdpLink(host, port, listen=scheme == "udpin")
        return TcpLink(host, port, listen=scheme == "tcpin")
    if url.startswith("/dev/") or Path(url).exists() or url.upper().startswith("COM"):
        return SerialLink(url, baud)
    raise InputError(
        f"cannot understand --connect {url!r}: write udpout:HOST:PORT, udpin:HOST:PORT, "
        "tcp:HOST:PORT, tcpin:HOST:PORT or a serial device such as /dev/ttyUSB0"
    )


def _host_port(url: str, rest: str) -> tuple[str, int]:
    host, _, port = rest.rpartition(":")
    if not host or not port.isdigit() or not 0 < int(port) < 65536:
        raise InputError(f"cannot understand --connect {url!r}: HOST:PORT is missing or wrong")
    return host, int(port)


def _resolve(host: str, port: int, kind: socket.SocketKind) -> tuple[int, Any]:
    """Address family and socket address."""
    try:
        found = socket.getaddrinfo(host.strip("[]"), port, type=kind)
    except OSError as error:
        raise LinkError(f"cannot find host {host!r}: {error.strerror}") from error
    return found[0][0], found[0][4]


def _connect(family: int, address: Any, name: str) -> socket.socket:
    give_up = time.monotonic() + CONNECT_PATIENCE
    while True:
        peer = socket.socket(family, socket.SOCK_STREAM)
        try:
            peer.connect(address)
        except OSError as error:
            peer.close()
            if time.monotonic() > give_up:
                raise LinkError(f"cannot connect to TCP {name}: {error.strerror}") from error
            time.sleep(0.1)
        else:
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return peer
