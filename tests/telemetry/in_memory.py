"""A link and a recording that are nowhere but in memory."""

import struct

from gcs_sysid.telemetry.frames import read_frame
from gcs_sysid.telemetry.link import Link
from gcs_sysid.telemetry.requests import StreamRequests
from gcs_sysid.telemetry.urls import parse_url


def as_bytes(records):
    return b"".join(struct.pack(">Q", t) + frame.raw for t, frame in records)


class Ether(Link):
    """A UDP link in memory."""

    datagrams = True

    def __init__(self, url="udpin:0.0.0.0:14550"):
        super().__init__(parse_url(url) if isinstance(url, str) else url)
        self.arriving = []
        self.sent = []
        self.to = None
        self.closed = False

    def receive(self, _timeout):
        chunks, self.arriving = self.arriving, []
        return chunks

    def send(self, data):
        assert not self.closed
        self.sent.append((self.to, read_frame(data)))

    def answer_to(self, source):
        self.to = source

    def close(self):
        self.closed = True


class DefaultRates:
    """Knows the vehicle's own rates at once: its defaults."""

    def __init__(self):
        self.events = []

    def tick(self, *_):
        return True

    looked = tick

    def own(self, _):
        return 0

    def left_over(self, *_):
        return []

    taken_over = left_over

    def follow(self, *_):
        pass

    again = remember = requested = restored = close = follow


class Asking(StreamRequests):
    """Requests that begin at once."""

    def __init__(self, gate, rate, **options):
        self._told = DefaultRates()
        super().__init__(gate, rate, self._told, **options)

    def take_events(self):
        events, self._told.events = self._told.events, []
        return events
