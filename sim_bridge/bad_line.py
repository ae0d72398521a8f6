"""A link with faults: what an autopilot sends comes late, broken, twice or never.

A frame is what is lost, late or broken, as a small datagram or a radio's packet is. Nothing here
looks at a clock: time is that of the frames sent, so that the same seed spoils the same frames,
over a socket as into a file. Into a file, frames are stamped with the time of their arrival.
"""

import heapq
import math

import numpy as np

from sim_bridge.attacker import Attacker
from sim_bridge.autopilot import BOOT_US
from sim_bridge.choices import Span
from sim_bridge.line_faults import LineFaults
from sim_bridge.links import Link
from sim_bridge.wire import MAGIC

QUEUE = 0.5
"""s of a narrow link's bytes that wait for their turn."""

BEHIND = 0.02
"""s, at most, that a frame out of order or a second copy comes later."""


class BadLine:
    """A link that spoils what passes.

    Args:
        link: that carries what is left.
        faults: in force.
        seed: of all that is random.

    Attributes:
        lost: frames that never arrive, of the vehicle's.
    """

    def __init__(self, link: Link, faults: LineFaults, seed: np.random.SeedSequence) -> None:
        self._link = link
        self._faults = faults
        # A generator each: one fault does not move what another does.
        names = ("loss", "bursts", "corrupt", "jitter", "reorder", "duplicate", "up")
        *children, attacker = seed.spawn(len(names) + 1)
        self._random = dict(zip(names, map(np.random.default_rng, children), strict=True))
        self._attacker = Attacker(faults, attacker) if faults.intruders else None
        self._on_the_way: list[tuple[int, int, bytes]] = []
        self._number = 0
        self._in_burst = False
        self._free_at = self._latest = -math.inf
        self._now = 0.0
        self.lost = 0

    @property
    def connected(self) -> bool:
        """Whether the link itself is."""
        return self._link.connected

    def send(self, frames: list[bytes], time_us: int) -> None:
        """Take frames of this time of the vehicle's clock; pass on what has arrived by then."""
        self._now = now = 1e-6 * (time_us - BOOT_US)
        # What leaves at once meets the same delay.
        jitter = self._faults.jitter * self._random["jitter"].random()
        for frame in frames:
            if self._passes(frame, now):
                self._deliver(self._spoilt(frame), now, jitter)
            else:
                self.lost += 1
        self._pass_on(time_us)
        if self._attacker is not None:
            self._link.intrude(self._attacker.datagrams(now), time_us)

    def receive(self) -> bytes:
        """What has arrived from the ground; the way up loses as much as the way down."""
        data = self._link.receive()
        lost = self._random["up"].random() < self._faults.loss if data else False
        return b"" if lost or _is_on(self._faults.silence, self._now) else data

    def intrude(self, datagrams: list[bytes], time_us: int) -> None:
        """Send what is not the vehicle's; it meets no fault."""
        self._link.intrude(datagrams, time_us)

    def close(self) -> None:
        """Let what is on the way arrive, and let go of the link."""
        self._pass_on(None)
        self._link.close()

    def _passes(self, frame: bytes, now: float) -> bool:
        faults = self._faults
        # Drawn for every frame, whatever else befalls it.
        lost = self._meets_burst(), self._draws("loss", faults.loss)
        if any(lost) or _is_on(faults.silence, now):
            return False
        if faults.stall:
            number = _message_number(frame)
            if any(number == stalled and span.holds(now) for stalled, span in faults.stall):
                return False
        return True

    def _meets_burst(self) -> bool:
        """Gilbert's channel: good and bad by turns, and in the bad state all is lost."""
        lost, mean = self._faults.bursts
        if not lost:
            return False
        change = 1.0 / mean if self._in_burst else lost / (mean * (1.0 - lost))
        if self._random["bursts"].random() < change:
            self._in_burst = not self._in_burst
        return self._in_burst

    def _draws(self, name: str, share: float) -> bool:
        return bool(share) and float(self._random[name].random()) < share

    def _spoilt(self, frame: bytes) -> bytes:
        """The frame, perhaps with a few wrong bytes or without its end."""
        if not self._draws("corrupt", self._faults.corrupt):
            return frame
        random = self._random["corrupt"]
        if random.random() < 0.25:
            return frame[: int(random.integers(1, len(frame)))]
        broken = bytearray(frame)
        for at in random.integers(len(frame), size=int(random.integers(1, 4))).tolist():
            broken[at] ^= int(random.integers(1, 256))
        return bytes(broken)

    def _deliver(self, frame: bytes, now: float, jitter: float) -> None:
        """Put a frame on its way, if there is room for it."""
        faults = self._faults
        at = now
        if faults.bandwidth:
            at = max(self._free_at, now)
            if at - now > QUEUE:
                self.lost += 1
                return
            at += len(frame) / faults.bandwidth
            self._free_at = at
        at = self._latest = max(self._latest, at + faults.delay + jitter)
        at += faults.scatter * self._random["jitter"].random() if faults.scatter else 0.0
        if self._draws("reorder", faults.reorder):
            at += BEHIND * self._random["reorder"].random()
        self._push(at, frame)
        if self._draws("duplicate", faults.duplicate):
            self._push(at + BEHIND * self._random["duplicate"].random(), frame)

    def _push(self, at: float, frame: bytes) -> None:
        self._number += 1
        heapq.heappush(self._on_the_way, (BOOT_US + round(1e6 * at), self._number, frame))

    def _pass_on(self, until_us: int | None) -> None:
        """Hand over what arrives by then, or all; frames of one arrival time go together."""
        waiting = self._on_the_way
        while waiting and (until_us is None or waiting[0][0] <= until_us):
            due = waiting[0][0]
            together = []
            while waiting and waiting[0][0] == due:
                together.append(heapq.heappop(waiting)[2])
            self._link.send(together, due)


def _is_on(span: Span | None, now: float) -> bool:
    return span is not None and span.holds(now)


def _message_number(frame: bytes) -> int:
    return int.from_bytes(frame[7:10], "little") if frame[0] == MAGIC else frame[5]
