"""From the bytes of a link to frames that are believed."""

from gcs_sysid.telemetry.frames import Frame, FrameScanner, Validity
from gcs_sysid.telemetry.link import Address, Link
from gcs_sysid.telemetry.signing import Refusal, SignatureCheck


class Receiver:
    """Reads frames from a link, and points its answers at the vehicle.

    Each sender of datagrams has a scanner of its own, so that a stranger's garbage cannot
    cut the vehicle's frames.

    Args:
        link: open.
        check: believes only what is signed; None: there is no key, and all is believed.

    Attributes:
        received_bytes: all bytes that arrived.
        check: see above.
    """

    MOST_SENDERS = 64
    MOVED_AFTER = 3
    """Datagrams in a row with frames in the vehicle's name from one other address, none from its
    own, after which it has moved there. Who forges a few among the vehicle's gets no answers."""

    def __init__(self, link: Link, check: SignatureCheck | None = None) -> None:
        self.received_bytes = 0
        self.check = check
        self._link = link
        self._breaks = link.breaks
        self._vehicle: tuple[int, int] | None = None
        self._scanners: dict[Address | None, FrameScanner] = {}
        self._garbage_of_dropped = 0
        self._answered: Address | None = None
        self._elsewhere = 0

    def follow(self, vehicle: tuple[int, int]) -> None:
        """Answer from now on to the address that the vehicle (sysid, compid) speaks from."""
        self._vehicle = vehicle

    def poll(self, timeout: float) -> list[Frame]:
        """Wait up to `timeout` s for bytes; the frames that they complete and that are believed."""
        frames: list[Frame] = []
        for data, source in self._link.receive(timeout):
            self.received_bytes += len(data)
            scanner = self._scanner(source)
            found = scanner.scan(data) if self._link.datagrams else scanner.feed(data)
            frames += self._believed(found, source)
        if self._link.breaks != self._breaks:
            # What was cut off is not continued by whatever the next connection brings.
            self._breaks = self._link.breaks
            for source, scanner in self._scanners.items():
                frames += self._believed(scanner.flush(), source)
        return frames

    def _believed(self, found: list[Frame], source: Address | None) -> list[Frame]:
        """The frames that are believed; answers go where the vehicle's come from."""
        if self.check is None:
            if any(self._is_the_vehicles(frame) for frame in found):
                self._hear_vehicle(source)
            return found
        believed = []
        for frame in found:
            refusal = self.check.take(frame)
            if refusal is None:
                believed.append(frame)
            # A vehicle without a clock of its own begins with an old time. It learns the time
            # from our heartbeats, so that they must reach it before it is believed.
            ours = refusal is None or (refusal is Refusal.TOO_OLD and self._vehicle is None)
            if ours and frame.signed and self._is_the_vehicles(frame):
                self._answer(source)
        return believed

    def _hear_vehicle(self, source: Address | None) -> None:
        """Answer the vehicle where it speaks from; nothing proves that it is the vehicle."""
        self._elsewhere = 0 if source == self._answered else self._elsewhere + 1
        unsettled = self._vehicle is None or self._answered is None
        if unsettled or self._elsewhere >= self.MOVED_AFTER:
            self._answer(source)

    def _answer(self, source: Address | None) -> None:
        self._answered, self._elsewhere = source, 0
        self._link.answer_to(source)

    def _is_the_vehicles(self, frame: Frame) -> bool:
        if self._vehicle is None:
            return True
        return (frame.system, frame.component) == self._vehicle and frame.valid is Validity.OK

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
