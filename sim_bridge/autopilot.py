"""What any emulated autopilot does: streams that come due, answers to what arrives."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

STEP_US = 1000
"""One physics step in us: streams fall on this grid."""

BOOT_US = 20_000_000
"""The vehicle's clock at the start of the flight: it was switched on 20 s before."""

EPOCH_US = 1_735_689_600_000_000
"""us since 1970 at which the vehicle was switched on (2025-01-01).

Fixed, so that the same seed gives the same bytes.
"""


class Autopilot(Protocol):
    """An autopilot as its ground station sees it."""

    def poll(self, tick: int) -> list[bytes]:
        """Frames due at this physics step, in the order they are sent."""
        ...

    def receive(self, data: bytes, tick: int) -> list[bytes]:
        """Frames that answer what a ground station sent."""
        ...


@dataclass
class Stream:
    """One message sent again and again.

    Attributes:
        msgid: message number.
        make: makes its frames (several for messages in groups).
        default: us between messages at the start; 0 for never.
        interval: us between messages; 0 for never.
        due: us since the start when the next is due.
    """

    msgid: int
    make: Callable[[], list[bytes]]
    default: float
    interval: float
    due: float


class Schedule:
    """Decides which streams are due.

    The next due time is counted up, never measured, so that a rate that does not fit the 1 kHz
    grid keeps its mean and does not drift.
    """

    def __init__(self) -> None:
        self.streams: dict[int, Stream] = {}
        self._wake = 0.0

    def add(self, msgid: int, rate: float, make: Callable[[], list[bytes]]) -> None:
        """Add a stream of this many messages a second; 0 for one that is only on request.

        The order of adding is the order of sending.
        """
        interval = 1e6 / rate if rate else 0.0
        self.streams[msgid] = Stream(msgid, make, interval, interval, 0.0)

    def set_interval(self, msgid: int, interval: float, tick: int) -> bool:
        """Change a stream: us, 0 for its default, negative for never. False: no such stream."""
        stream = self.streams.get(msgid)
        if stream is None:
            return False
        if interval < 0:
            stream.interval = 0.0
        else:
            # Faster than the physics is not to be had.
            stream.interval = max(interval, STEP_US) if interval else stream.default
        stream.due = tick * STEP_US + stream.interval
        self._wake = 0.0
        return True

    def take(self, tick: int) -> list[Stream]:
        """The streams due at this step."""
        now = tick * STEP_US
        if now < self._wake:
            return []
        taken = []
        wake = float("inf")
        for stream in self.streams.values():
            if not stream.interval:
                continue
            # Half a microsecond of slack: due times are sums of floats.
            if stream.due <= now + 0.5:
                taken.append(stream)
                stream.due += stream.interval
            wake = min(wake, stream.due)
        self._wake = wake - 0.5
        return taken
