"""From the bytes of a link to accepted frames."""

import time
from collections.abc import Callable
from typing import NamedTuple

from gcs_sysid.telemetry.frames import Frame, FrameScanner, Validity
from gcs_sysid.telemetry.link import Address, Link
from gcs_sysid.telemetry.marks import is_reset_mark
from gcs_sysid.telemetry.outgoing import OWN_SYSTEM
from gcs_sysid.telemetry.senders import Whereabouts
from gcs_sysid.telemetry.signing import Refusal, SignatureCheck


class ReceivedFrames(NamedTuple):
    """Frames that arrived together, in their order."""

    time_us: int
    """When the last of them arrived, us since 1970."""
    frames: list[Frame]


class Receiver:
    """Reads frames from a link, and points its answers at the vehicle.

    Each sender of datagrams has a scanner of its own, so that a stranger's garbage cannot
    cut the vehicle's frames.

    Args:
        link: open.
        check: accepts only signed frames; None: there is no key, and nearly all are accepted.
        clock: steady, s.

    Attributes:
        received_bytes: all bytes that arrived.
        check: see above.
        whereabouts: of the vehicle.
        marks: frames that pose as the user's reset, rejected: only recordings have such frames,
            none over a link is valid.
    """

    TOGETHER = 8000
    """us; datagrams that arrived within so long are taken, and recorded, at one time."""

    MOST_SENDERS = 64

    def __init__(
        self,
        link: Link,
        check: SignatureCheck | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.check = check
        self.whereabouts = Whereabouts()
        self.marks = 0
        self._link = link
        self._clock = clock
        self._breaks = link.breaks
        self._scanners: dict[Address | None, FrameScanner] = {}
        self._garbage_of_dropped = 0

    def follow(self, vehicle: tuple[int, int]) -> None:
        """Answer from now on to the address that the vehicle (sysid, compid) sends from."""
        self.whereabouts.follow(vehicle)

    def poll(self, timeout: float) -> list[Frame]:
        """The frames of `receive`, however they came together."""
        return [frame for batch in self.receive(timeout) for frame in batch.frames]

    def receive(self, timeout: float) -> list[ReceivedFrames]:
        """Wait up to `timeout` s for bytes; the accepted frames that they complete."""
        chunks = self._link.receive(timeout)
        now = time.time_ns() // 1000
        batches: list[ReceivedFrames] = []
        began = last = 0  # of the batch that still grows, us
        frames: list[Frame] = []
        for data, source, time_us in chunks:
            arrived = now if time_us is None else time_us
            if frames and abs(arrived - began) > self.TOGETHER:
                batches.append(ReceivedFrames(last, frames))
                frames = []
            scanner = self._scanner(source)
            found = scanner.scan(data) if self._link.datagrams else scanner.feed(data)
            began = began if frames else arrived
            last = arrived
            frames += self._believed(found, source)
        if self._link.breaks != self._breaks:
            # What was cut off is not continued by whatever the next connection brings.
            self._breaks = self._link.breaks
            last = last or now
            for source, scanner in self._scanners.items():
                frames += self._believed(scanner.flush(), source)
        if frames:
            batches.append(ReceivedFrames(last, frames))
        return batches

    def _believed(self, found: list[Frame], source: Address | None) -> list[Frame]:
        """The accepted frames; replies go to the vehicle's address."""
        if self.check is None:
            before = self.whereabouts.address
            believed = self.whereabouts.accept(found, source, self._clock())
            if self.whereabouts.address != before:
                self._link.answer_to(self.whereabouts.address)
        else:
            believed = self._signed(self.check, found, source)
        if any(frame.system == OWN_SYSTEM for frame in believed):
            return self._without_marks(believed)
        return believed

    def _signed(
        self, check: SignatureCheck, found: list[Frame], source: Address | None
    ) -> list[Frame]:
        """Those with the key's signature."""
        believed, whereabouts = [], self.whereabouts
        for frame in found:
            refusal = check.refusal_of(frame)
            if refusal is None:
                believed.append(frame)
            # A vehicle without a clock of its own begins with an old time. It learns the time
            # from our heartbeats, so that they must reach it before it is believed.
            ours = refusal is None or (refusal is Refusal.TOO_OLD and whereabouts.vehicle is None)
            if ours and frame.signed and whereabouts.is_vehicles(frame):
                whereabouts.move(source)
                self._link.answer_to(source)
        return believed

    def _without_marks(self, frames: list[Frame]) -> list[Frame]:
        left = [f for f in frames if f.valid is not Validity.OK or not is_reset_mark(f)]
        self.marks += len(frames) - len(left)
        return left

    @property
    def garbage_bytes(self) -> int:
        """Bytes that were part of no frame."""
        return self._garbage_of_dropped + sum(s.garbage_bytes for s in self._scanners.values())

    def _scanner(self, source: Address | None) -> FrameScanner:
        scanner = self._scanners.get(source)
        if scanner is None:
            if len(self._scanners) >= self.MOST_SENDERS:
                oldest = self._scanners.pop(next(iter(self._scanners)))
                self._garbage_of_dropped += oldest.garbage_bytes
            scanner = self._scanners[source] = FrameScanner()
        return scanner
