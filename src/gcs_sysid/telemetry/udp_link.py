"""UDP: datagrams with the system's stamps, and its count of those that it had to drop."""

import contextlib
import select
import socket
import struct
import sys
import time
from collections.abc import Callable

from gcs_sysid.telemetry.link import Address, Chunk, Link, cannot_open, resolve, with_port
from gcs_sysid.telemetry.urls import LinkUrl

RECEIVE_BUFFER = 16 * 2**20
"""Bytes asked of the system, which gives what its limit allows (Linux: net.core.rmem_max, 4 MB on
many; root may ask for more): 4 MB hold 4 s of a vehicle at 1 kHz, unread."""
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


class UdpLink(Link):
    """Datagrams, listening (`udpin`) or sending first (`udpout`).

    A flood on the port fills the system's buffer, and further datagrams are lost unread. So, once
    others send more than the vehicle ever would, its datagrams get a socket and a buffer of their
    own: one bound to the same port and connected to the vehicle's address, which Linux prefers for
    what comes from there. The others are read a few at a time.

    Args:
        url: what to open.
        clock: steady, s.
    """

    datagrams = True

    def __init__(self, url: LinkUrl, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(url)
        self._clock = clock
        self._family, address = resolve(url, socket.SOCK_DGRAM)
        self._socket = socket.socket(self._family, socket.SOCK_DGRAM)
        self._to: Address | None = None
        self._apart: socket.socket | None = None
        self._apart_spoke = False
        self._apart_heard = 0.0
        self._unreachable: Address | None = None
        self._strangers = 0
        self._strangers_since = 0.0
        self._overflow: dict[socket.socket, int] = {}
        try:
            _prepare(self._socket)
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

    def receive(self, timeout: float) -> list[Chunk]:
        """Datagrams that have arrived, in order; of a flood of others, some."""
        first = self._apart or self._socket
        readable, _, _ = select.select([first], [], [], max(0.0, timeout))
        chunks = self._drain(first, DATAGRAMS_AT_ONCE) if readable else []
        if self._apart is None:
            if self._is_flooded(chunks):
                chunks += self._set_apart()
            return chunks
        if chunks:
            self._apart_spoke, self._apart_heard = True, self._clock()
        elif self._clock() - self._apart_heard > SILENT_FOR:
            # It is gone, or sends from another address now: accept any sender again.
            self._unreachable = None if self._apart_spoke else self._to
            self._mix_again()
        return chunks + self._drain(self._socket, STRANGERS_AT_ONCE)

    def _drain(self, from_socket: socket.socket, most: int) -> list[Chunk]:
        chunks: list[Chunk] = []
        while len(chunks) < most:
            try:
                chunks.append(self._read(from_socket))
            except BlockingIOError:
                break
            except ConnectionError:
                continue  # ICMP port unreachable, in reply to something sent
        return chunks

    def _read(self, from_socket: socket.socket) -> Chunk:
        if not _ROOM:
            data, source = from_socket.recvfrom(LARGEST_DATAGRAM)
            return Chunk(data, source[:2])
        data, ancillary, _, source = from_socket.recvmsg(LARGEST_DATAGRAM, _ROOM)
        time_us = None
        for level, kind, content in ancillary:
            if level != socket.SOL_SOCKET:
                continue
            if kind == SO_TIMESTAMPNS and len(content) == _STAMP.size:
                seconds, ns = _STAMP.unpack(content)
                time_us = seconds * 1_000_000 + ns // 1000
            elif kind == SO_RXQ_OVFL and len(content) == _COUNT.size:
                self._count_dropped(from_socket, *_COUNT.unpack(content))
        return Chunk(data, source[:2], time_us)

    def _count_dropped(self, from_socket: socket.socket, count: int) -> None:
        """Take the system's count of what a socket dropped since it was opened, modulo 2^32.

        What it drops of others, while the vehicle has a socket of its own, is no loss.
        """
        before, self._overflow[from_socket] = self._overflow.get(from_socket, 0), count
        if from_socket is (self._apart or self._socket):
            self.dropped += (count - before) % 2**32

    def _is_flooded(self, chunks: list[Chunk]) -> bool:
        """Whether others than the vehicle have sent too much in this second."""
        if self._to is None or self._to == self._unreachable or sys.platform != "linux":
            return False
        now = self._clock()
        if now - self._strangers_since > 1.0:
            self._strangers, self._strangers_since = 0, now
        self._strangers += sum(chunk.source != self._to for chunk in chunks)
        return self._strangers > FLOOD

    def _set_apart(self) -> list[Chunk]:
        """Give the vehicle a socket of its own; what had come to the other one before."""
        assert self._to is not None  # without it no sender is foreign
        apart = socket.socket(self._family, socket.SOCK_DGRAM)
        both = (self._socket, apart)
        try:
            _prepare(apart)
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
        self._apart, self._apart_spoke, self._apart_heard = apart, False, self._clock()
        self.floods += 1
        # What came before is older than all that comes apart: the vehicle's share of it is kept.
        before = self._drain(self._socket, BACKLOG)
        return [chunk for chunk in before if chunk.source == self._to]

    def _mix_again(self) -> None:
        if self._apart is not None:
            self._overflow.pop(self._apart, None)
            self._apart.close()
        self._apart = None
        self._strangers = 0

    def send(self, data: bytes) -> None:
        """Send to the vehicle's address; nowhere while it is not known."""
        if self._to is None:
            self.unsent += 1
            return
        try:
            self._socket.sendto(data, self._to)
        except OSError:  # network gone for the moment; the next heartbeat tries again
            self.unsent += 1

    def answer_to(self, source: Address | None) -> None:
        """Send to this address from now on (`udpin`); `udpout` keeps to what the user named."""
        if self.url.kind == "udpin" and source is not None and source != self._to:
            self._to = source
            self._mix_again()

    def close(self) -> None:
        """Give the port back."""
        self._mix_again()
        self._socket.close()


def _prepare(datagrams: socket.socket) -> None:
    datagrams.setblocking(False)
    options = [(socket.SO_RCVBUF, RECEIVE_BUFFER)]
    if sys.platform == "linux":
        options += [(_SO_RCVBUFFORCE, RECEIVE_BUFFER), (SO_TIMESTAMPNS, 1), (SO_RXQ_OVFL, 1)]
    for option, value in options:
        with contextlib.suppress(OSError):  # some systems refuse more than their limit
            datagrams.setsockopt(socket.SOL_SOCKET, option, value)
