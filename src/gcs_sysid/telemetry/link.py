"""Links to a vehicle: UDP, TCP and serial, named as MAVProxy users name them.

The transport is our own, thin, on `socket` and pyserial, not pymavlink's `mavutil`, which is
unsound for this tool: it sets SO_REUSEADDR on UDP, so that a port in use is shared in silence
and each program loses what the other gets; it answers to every address that ever sent, so that
a stranger on the port receives the requests too; it keeps the small default receive buffer and
reads a datagram a call; it prints to standard output; it sleeps while it connects; and to
import it loads every message of every dialect. pymavlink packs and unpacks, here it ends.

`send` is called by `outgoing.Gate` alone, which decides what may be sent (through
`PersistentLink`, which opens a link again after the other side hung up, where that stands before
it).
"""

import contextlib
import errno
import select
import socket
import struct
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import serial

from gcs_sysid.errors import LinkError
from gcs_sysid.telemetry.urls import LinkUrl

STREAM_PIECE = 65536
CONNECT_TIMEOUT = 5.0
"""s."""
_KEEPALIVE = (
    ("TCP_KEEPIDLE", 5),
    ("TCP_KEEPINTVL", 2),
    ("TCP_KEEPCNT", 3),
    ("TCP_USER_TIMEOUT", 10_000),
)
"""Options of TCP, in s, s, tries and ms: a dead peer is noticed after about 10 s."""

# Of Linux; Python names them from 3.12 and 3.14 on. Elsewhere a datagram came when it was read.
SO_TIMESTAMPNS = 35
SO_RXQ_OVFL = 40
_SO_RCVBUFFORCE = 33
_STAMP = struct.Struct("@ll")
_COUNT = struct.Struct("@I")
_ROOM = (
    socket.CMSG_SPACE(_STAMP.size) + socket.CMSG_SPACE(_COUNT.size)
    if sys.platform == "linux"
    else 0
)

Address = tuple[str, int]


class ReceivedBytes(NamedTuple):
    """Bytes that arrived: one datagram, or a piece of a stream."""

    data: bytes
    source: Address | None
    """Who sent the datagram; None on streams."""
    time_us: int | None = None
    """When it arrived, by the system's stamp, us since 1970; None: when it was read."""


class Link(ABC):
    """An open link.

    Attributes:
        url: what it was opened from.
        datagrams: whether chunks are datagrams, each beginning on a frame boundary.
        ended: the other side closed it, or the device is gone.
        breaks: how often a stream of bytes ended, to be followed by another one or not.
        floods: how often others were found to flood it.
        dropped: datagrams that the system dropped, not read in time.
    """

    datagrams = False

    def __init__(self, url: LinkUrl) -> None:
        self.url = url
        self.ended = False
        self.breaks = 0
        self.floods = 0
        self.dropped = 0

    @abstractmethod
    def receive(self, timeout: float) -> list[ReceivedBytes]:
        """Wait up to `timeout` s and return all that has arrived; empty when nothing has."""

    @abstractmethod
    def send(self, data: bytes) -> None:
        """Send one frame, or lose it; never raises. Only `outgoing.Gate` calls this."""

    @abstractmethod
    def close(self) -> None:
        """Give the port back."""

    def answer_to(self, source: Address | None) -> None:  # noqa: B027 - most have no choice
        """Send to this address from now on, where the link has a choice."""

    def __enter__(self) -> "Link":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class TcpLink(Link):
    """A TCP connection, ours (`tcp`) or one that comes in (`tcpin`)."""

    RECEIVE_BUFFER = 4 * 2**20
    """Bytes asked of the system."""

    def __init__(self, url: LinkUrl, patience: float = CONNECT_TIMEOUT) -> None:
        super().__init__(url)
        self._listener: socket.socket | None = None
        self._peer: socket.socket | None = None
        self._rest = b""
        try:
            if url.kind == "tcp":
                self._take(socket.create_connection((url.host, url.port), patience))
            else:
                family, address = resolve(url, socket.SOCK_STREAM)
                self._listener = socket.create_server(address, family=family, backlog=1)
                self._listener.setblocking(False)
        except OSError as error:
            raise cannot_open(url, error) from error
        self.url = with_port(url, self.port)

    @property
    def port(self) -> int:
        """Local port number."""
        open_socket = self._listener or self._peer
        return int(open_socket.getsockname()[1]) if open_socket else 0

    def _take(self, peer: socket.socket) -> None:
        peer.setblocking(False)
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with contextlib.suppress(OSError):
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, self.RECEIVE_BUFFER)
        # A peer whose network is gone says no goodbye.
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in _KEEPALIVE:
            if hasattr(socket, name):
                with contextlib.suppress(OSError):
                    peer.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
        self._peer, self._rest = peer, b""

    def receive(self, timeout: float) -> list[ReceivedBytes]:
        """Bytes that have arrived; takes a waiting connection first."""
        waiting = self._peer or self._listener
        if waiting is None:
            return []
        readable, _, _ = select.select([waiting], [], [], max(0.0, timeout))
        if not readable:
            return []
        if self._peer is None and self._listener is not None:
            with contextlib.suppress(OSError):  # it hung up again before it was taken
                self._take(self._listener.accept()[0])
            return []
        assert self._peer is not None
        try:
            data = self._peer.recv(STREAM_PIECE)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if data:
            return [ReceivedBytes(data, None)]
        self._peer.close()
        self._peer = None
        self.breaks += 1
        self.ended = self._listener is None  # else wait for the next connection
        return []

    def send(self, data: bytes) -> None:
        """Send to the peer, if there is one."""
        if self._peer is None:
            return
        # A few bytes a second: should they not fit at once, the peer has stopped reading. A frame
        # that was cut off is finished before the next one.
        with contextlib.suppress(OSError):
            while self._rest:
                self._rest = self._rest[self._peer.send(self._rest) :]
            self._rest = data[self._peer.send(data) :]

    def close(self) -> None:
        """Hang up."""
        for open_socket in (self._peer, self._listener):
            if open_socket is not None:
                open_socket.close()
        self._peer = self._listener = None


class UdpLink(Link):
    """Datagrams, listening (`udpin`) or sending first (`udpout`).

    A flood on the port fills the system's buffer, and further datagrams are lost unread. So, once
    others send more than the vehicle ever would, its datagrams get a socket and a buffer of their
    own: one bound to the same port and connected to the vehicle's address, which Linux prefers for
    what comes from there. The others are read a few at a time.
    """

    datagrams = True

    RECEIVE_BUFFER = 16 * 2**20
    """Bytes asked of the system, which gives what its limit allows (Linux: net.core.rmem_max, 4 MB
    on many; root may ask for more): 4 MB hold 4 s of a vehicle at 1 kHz, unread."""
    LARGEST_DATAGRAM = 65536
    DATAGRAMS_AT_ONCE = 512
    FLOOD = 5000
    """Datagrams of others in a second; a vehicle at 1 kHz sends 2000."""
    STRANGERS_AT_ONCE = 64
    """Datagrams of others that are read at a time while the vehicle's come apart."""
    BACKLOG = 20_000
    """Datagrams at most that wait in the system's buffer."""
    SILENT_FOR = 2.0
    """s without a datagram of the vehicle, after which its own socket is given up."""

    def __init__(self, url: LinkUrl, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(url)
        self._clock = clock
        self._family, address = resolve(url, socket.SOCK_DGRAM)
        self._socket = socket.socket(self._family, socket.SOCK_DGRAM)
        self._to: Address | None = None
        self._apart: socket.socket | None = None
        self._apart_sent = False
        self._apart_received = 0.0
        self._unreachable: Address | None = None
        self._strangers = 0
        self._strangers_since = 0.0
        self._overflow: dict[socket.socket, int] = {}
        try:
            self._prepare(self._socket)
            if url.kind == "udpin":
                self._socket.bind(address)
            else:
                # Bound at once: an unbound socket cannot be waited for.
                self._socket.bind(("", 0))
                self._to = address
        except OSError as error:
            self._socket.close()
            raise cannot_open(url, error) from error
        self.url = with_port(url, self.port)

    @property
    def port(self) -> int:
        """Local port number."""
        return int(self._socket.getsockname()[1])

    def receive(self, timeout: float) -> list[ReceivedBytes]:
        """Datagrams that have arrived, in order; of a flood of others, some."""
        first = self._apart or self._socket
        readable, _, _ = select.select([first], [], [], max(0.0, timeout))
        chunks = self._drain(first, self.DATAGRAMS_AT_ONCE) if readable else []
        if self._apart is None:
            if self._is_flooded(chunks):
                chunks += self._set_apart()
            return chunks
        if chunks:
            self._apart_sent, self._apart_received = True, self._clock()
        elif self._clock() - self._apart_received > self.SILENT_FOR:
            # It is gone, or sends from another address now: accept any sender again.
            self._unreachable = None if self._apart_sent else self._to
            self._mix_again()
        return chunks + self._drain(self._socket, self.STRANGERS_AT_ONCE)

    def _drain(self, from_socket: socket.socket, most: int) -> list[ReceivedBytes]:
        chunks: list[ReceivedBytes] = []
        while len(chunks) < most:
            try:
                chunks.append(self._read(from_socket))
            except BlockingIOError:
                break
            except ConnectionError:
                continue  # ICMP port unreachable, in reply to something sent
        return chunks

    def _read(self, from_socket: socket.socket) -> ReceivedBytes:
        if not _ROOM:
            data, source = from_socket.recvfrom(self.LARGEST_DATAGRAM)
            return ReceivedBytes(data, source[:2])
        data, ancillary, _, source = from_socket.recvmsg(self.LARGEST_DATAGRAM, _ROOM)
        time_us = None
        for level, kind, content in ancillary:
            if level != socket.SOL_SOCKET:
                continue
            if kind == SO_TIMESTAMPNS and len(content) == _STAMP.size:
                seconds, ns = _STAMP.unpack(content)
                time_us = seconds * 1_000_000 + ns // 1000
            elif kind == SO_RXQ_OVFL and len(content) == _COUNT.size:
                self._count_dropped(from_socket, *_COUNT.unpack(content))
        return ReceivedBytes(data, source[:2], time_us)

    def _count_dropped(self, from_socket: socket.socket, count: int) -> None:
        """Take the system's count of what a socket dropped since it was opened, modulo 2^32.

        What it drops of others, while the vehicle has a socket of its own, is no loss.
        """
        before, self._overflow[from_socket] = self._overflow.get(from_socket, 0), count
        if from_socket is (self._apart or self._socket):
            self.dropped += (count - before) % 2**32

    def _is_flooded(self, chunks: list[ReceivedBytes]) -> bool:
        """Whether others than the vehicle have sent too much in this second."""
        if self._to is None or self._to == self._unreachable or sys.platform != "linux":
            return False
        now = self._clock()
        if now - self._strangers_since > 1.0:
            self._strangers, self._strangers_since = 0, now
        self._strangers += sum(chunk.source != self._to for chunk in chunks)
        return self._strangers > self.FLOOD

    def _set_apart(self) -> list[ReceivedBytes]:
        """Give the vehicle a socket of its own; what had come to the other one before."""
        assert self._to is not None  # without it no sender is foreign
        apart = socket.socket(self._family, socket.SOCK_DGRAM)
        both = (self._socket, apart)
        try:
            self._prepare(apart)
            # Two sockets on a port, for this one moment: no other can slip in afterwards.
            for each in both:
                each.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            apart.bind(self._socket.getsockname())
            apart.connect(self._to)
        except OSError:
            apart.close()
            self._unreachable = self._to
            return []
        finally:
            for each in both:
                with contextlib.suppress(OSError):  # closed above
                    each.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
        self._apart, self._apart_sent, self._apart_received = apart, False, self._clock()
        self.floods += 1
        # What came before is older than all that comes apart: the vehicle's share of it is kept.
        before = self._drain(self._socket, self.BACKLOG)
        return [chunk for chunk in before if chunk.source == self._to]

    def _mix_again(self) -> None:
        if self._apart is not None:
            self._overflow.pop(self._apart, None)
            self._apart.close()
        self._apart = None
        self._strangers = 0

    def send(self, data: bytes) -> None:
        """Send to the vehicle's address; nowhere while it is not known."""
        if self._to is not None:
            with contextlib.suppress(OSError):  # network gone for the moment; more heartbeats come
                self._socket.sendto(data, self._to)

    def answer_to(self, source: Address | None) -> None:
        """Send to this address from now on (`udpin`); `udpout` keeps to what the user named."""
        if self.url.kind == "udpin" and source is not None and source != self._to:
            self._to = source
            self._mix_again()

    def close(self) -> None:
        """Give the port back."""
        self._mix_again()
        self._socket.close()

    def _prepare(self, datagrams: socket.socket) -> None:
        datagrams.setblocking(False)
        options = [(socket.SO_RCVBUF, self.RECEIVE_BUFFER)]
        if sys.platform == "linux":
            options += [
                (_SO_RCVBUFFORCE, self.RECEIVE_BUFFER),
                (SO_TIMESTAMPNS, 1),
                (SO_RXQ_OVFL, 1),
            ]
        for option, value in options:
            with contextlib.suppress(OSError):  # some systems refuse more than their limit
                datagrams.setsockopt(socket.SOL_SOCKET, option, value)


class SerialLink(Link):
    """A serial port. Waits by pyserial's own timeout: `select` on it works on POSIX alone."""

    def __init__(self, url: LinkUrl) -> None:
        super().__init__(url)
        try:
            # Exclusive: two programs on one port take each other's bytes.
            self._serial = serial.Serial(
                url.device, url.baud, timeout=0.0, write_timeout=0.5, exclusive=True
            )
        except (OSError, ValueError) as error:  # SerialException is an OSError
            raise cannot_open(url, error) from error

    def receive(self, timeout: float) -> list[ReceivedBytes]:
        """Bytes that have arrived."""
        if self.ended:
            return []
        data = b""
        try:
            self._serial.timeout = max(0.0, timeout)
            data = self._serial.read(1)
            if data:
                data += self._serial.read(min(self._serial.in_waiting, STREAM_PIECE))
        except (OSError, TypeError):  # unplugged; pyserial's TypeError: closed while reading
            self.ended = True
            self.breaks += 1
        return [ReceivedBytes(bytes(data), None)] if data else []

    def send(self, data: bytes) -> None:
        """Write to the port."""
        with contextlib.suppress(OSError):
            self._serial.write(data)

    def close(self) -> None:
        """Give the port back."""
        self._serial.close()


class SerialDevice(NamedTuple):
    """A serial port of this machine."""

    name: str
    description: str
    usb: bool = True
    """Whether it was plugged in, and is not a port of the board that may lead nowhere."""


def serial_devices() -> list[SerialDevice]:
    """The serial ports that are plugged in, by name; none is opened."""
    from serial.tools import list_ports

    found = []
    for port in list_ports.comports():
        description = "" if port.description in (None, "n/a") else port.description
        found.append(SerialDevice(port.device, description, port.vid is not None))
    return sorted(found)


def open_link(url: LinkUrl, patience: float = CONNECT_TIMEOUT) -> Link:
    """Open a link; a TCP connection may take `patience` s.

    Raises:
        LinkError: one line saying what is wrong and what to do.
    """
    if url.kind == "serial":
        return SerialLink(url)
    if url.kind in ("udpin", "udpout"):
        return UdpLink(url)
    return TcpLink(url, patience)


def with_port(url: LinkUrl, port: int) -> LinkUrl:
    """The URL with the port that the system has chosen, where it was left to choose."""
    return url if url.port else replace(url, port=port, text=f"{url.text}:{port}")


def resolve(url: LinkUrl, kind: socket.SocketKind) -> tuple[socket.AddressFamily, Address]:
    """Where a URL leads to.

    Raises:
        LinkError: there is no such place.
    """
    try:
        found = socket.getaddrinfo(url.host, url.port, type=kind)
    except OSError as error:
        raise cannot_open(url, error) from error
    # IPv4 first: "localhost" means 127.0.0.1 to nearly every autopilot and simulator.
    found.sort(key=lambda entry: entry[0] != socket.AF_INET)
    family, *_, address = found[0]
    return family, (str(address[0]), int(address[1]))


def cannot_open(url: LinkUrl, error: Exception) -> LinkError:
    """Say what is wrong, where, and what to do."""
    number = getattr(error, "errno", None)
    if isinstance(error, socket.gaierror):
        return LinkError(f"{url}: no address found for {url.host!r}; check the spelling")
    if url.kind == "serial":
        if number == errno.EACCES or "PermissionError" in str(error):
            hint = "no permission; on Linux add yourself to the group dialout and log in again"
        elif number == errno.ENOENT or "FileNotFoundError" in str(error):
            hint = "no such device; is it plugged in?"
        elif "exclusively lock" in str(error) or number == errno.EBUSY:
            hint = "in use by another program; close that first"
        else:
            hint = f"{getattr(error, 'strerror', None) or error}"
        return LinkError(f"cannot open {url.device}: {hint}")
    if number == errno.EADDRINUSE:
        hint = "the port is in use; close the other ground station or use another port"
    elif number == errno.ECONNREFUSED:
        hint = "connection refused; is the vehicle or simulator running and listening there?"
    elif number == errno.EACCES:
        hint = "no permission for that port; use 1024 or higher"
    elif number == errno.EADDRNOTAVAIL:
        hint = f"{url.host} is not an address of this machine; 0.0.0.0 listens on all"
    elif isinstance(error, TimeoutError):
        hint = "no answer; check host and port"
    else:
        hint = getattr(error, "strerror", None) or str(error)
    return LinkError(f"cannot open {url}: {hint}")


class PersistentLink(Link):
    """Wraps a link and reopens it when it has ended. It never ends itself.

    UDP needs nothing of this: its socket outlives any silence.

    Args:
        link: open.
        reopen: opens the link again, or raises `LinkError`.
        clock: any steady clock, s.
        sleep: waits for s.
    """

    FIRST_PAUSE = 0.5
    """s before the first attempt to open it again; doubled after each one that failed."""
    LONGEST_PAUSE = 5.0
    PATIENCE = 1.0
    """s that an attempt may take: nothing else happens meanwhile."""

    def __init__(
        self,
        link: Link,
        reopen: Callable[[LinkUrl], Link] = lambda url: open_link(url, PersistentLink.PATIENCE),
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        super().__init__(link.url)
        self.datagrams = link.datagrams
        self._link = link
        self._reopen = reopen
        self._clock = clock
        self._sleep = sleep
        self._breaks_before = 0
        self._pause = self.FIRST_PAUSE
        self._next_try = 0.0

    @property
    def open(self) -> bool:
        """Whether the link is there at present."""
        return not self._link.ended

    def receive(self, timeout: float) -> list[ReceivedBytes]:
        """What has arrived; while the link is gone, tries to open it when that is due."""
        if self._link.ended:
            self._try(timeout)
            return []
        chunks = self._link.receive(timeout)
        self.breaks = self._breaks_before + self._link.breaks
        self.floods, self.dropped = self._link.floods, self._link.dropped
        if chunks:
            self._pause = self.FIRST_PAUSE
        if self._link.ended:
            self._link.close()
            self._next_try = self._clock() + self._pause
        return chunks

    def _try(self, timeout: float) -> None:
        if self._clock() < self._next_try:
            self._sleep(max(0.0, min(timeout, self._next_try - self._clock())))
            return
        try:
            link = self._reopen(self.url)
        except LinkError:
            self._wait_longer()
            self._next_try = self._clock() + self._pause
            return
        self._wait_longer()  # unless data come: the other side may hang up at once, every time
        self._breaks_before += self._link.breaks
        self._link = link

    def _wait_longer(self) -> None:
        self._pause = min(2.0 * self._pause, self.LONGEST_PAUSE)

    def send(self, data: bytes) -> None:
        """Send where the link is there."""
        if not self._link.ended:
            self._link.send(data)

    def answer_to(self, source: Address | None) -> None:
        """As the link does."""
        self._link.answer_to(source)

    def close(self) -> None:
        """Give the port back."""
        self._link.close()
