"""A link, the frames it accepts and what may be sent on it: all that touches a vehicle.

Senders that use the vehicle's address are found here, before anything is recorded, so that live
sessions and the analysis of their recordings see the same frames. Without signatures there is no
proof, only evidence.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from gcs_sysid.telemetry.frames import Frame, FrameScanner, Validity
from gcs_sysid.telemetry.link import Address, Link
from gcs_sysid.telemetry.message_table import INERTIAL
from gcs_sysid.telemetry.messages import MESSAGE_IDS
from gcs_sysid.telemetry.outgoing import OWN_SYSTEM, Gate
from gcs_sysid.telemetry.signing import Refusal, SignatureCheck, SigningClock, read_key
from gcs_sysid.telemetry.tlog_writer import is_reset_mark
from gcs_sysid.telemetry.urls import LinkUrl

_STATES = frozenset(MESSAGE_IDS[name] for name in ("HEARTBEAT", "EXTENDED_SYS_STATE"))
"""Messages with the vehicle's type, and whether it is armed and flies."""
_IMU = frozenset(MESSAGE_IDS[name] for name in INERTIAL)


class Rival(NamedTuple):
    """Another address that sends in the vehicle's name, by turns with its own."""

    vehicle: tuple[int, int]
    address: Address
    """The vehicle's address, as taken."""
    other: Address


class Whereabouts:
    """Follows the address that the vehicle sends from.

    Once an address sends IMU data, the vehicle's state is accepted from there alone, as far as it
    is reported there: forged heartbeats must not disarm the vehicle. Everything else is accepted
    from anywhere, because a vehicle may have several links.

    Attributes:
        vehicle: (sysid, compid); None while any sender may be it.
        address: that is answered; None on links with one sender, and before the first frame.
        rival: another sender with its address, the first found; None while there is none.
        passed_over: frames of others with its state.
    """

    MOVED_AFTER = 3
    """Datagrams in a row with frames in the vehicle's name from other addresses, none from its
    own, after which it has moved there. Who forges a few among the vehicle's gets no answers."""
    SILENT_FOR = 2.0
    """s that an address with IMU data must have been silent before the vehicle has moved."""
    TURNS = 5
    """Changes between two addresses before it is reported: a moved sender makes two at most."""

    def __init__(self) -> None:
        self.vehicle: tuple[int, int] | None = None
        self.address: Address | None = None
        self.rival: Rival | None = None
        self.passed_over = 0
        self._received_at = 0.0
        self._other: Address | None = None
        self._elsewhere = 0
        self._turns = 0
        self._states: set[int] = set()
        self._has_imu = False

    def follow(self, vehicle: tuple[int, int]) -> None:
        """Follow this vehicle (sysid, compid) from now on, at the address of the last one."""
        if vehicle != self.vehicle:
            self.vehicle = vehicle
            self.rival = None
            self._forget()

    def accept(self, found: list[Frame], source: Address | None, now: float) -> list[Frame]:
        """Take the frames of one datagram.

        `now` is of any steady clock, s.

        Returns:
            Those accepted.
        """
        mine = [frame for frame in found if self.is_vehicles(frame)]
        if not mine:
            return found
        if source == self.address:
            self._notice(mine, now)
        elif self._is_new_home(now):
            self.move(source)
            self._notice(mine, now)
        else:
            self._other = source
            if self._has_imu:
                return self._without_state(found)
        return found

    def move(self, address: Address | None) -> None:
        """Answer to this address from now on."""
        if address != self.address:
            self.address = address
            self._forget()
        self._elsewhere = 0

    def is_vehicles(self, frame: Frame) -> bool:
        """Whether a frame has the vehicle's address."""
        if self.vehicle is None:
            return True
        return (frame.system, frame.component) == self.vehicle and frame.valid is Validity.OK

    def _forget(self) -> None:
        self._elsewhere = self._turns = 0
        self._states.clear()
        self._has_imu = False

    def _notice(self, mine: list[Frame], now: float) -> None:
        self._received_at = now
        if self._elsewhere:
            self._elsewhere = 0
            self._take_turn()
        if self.vehicle is not None:
            ids = {frame.message_id for frame in mine}
            self._states |= ids & _STATES
            self._has_imu = self._has_imu or not _IMU.isdisjoint(ids)

    def _take_turn(self) -> None:
        self._turns += 1
        if self.rival is not None or self._turns < self.TURNS:
            return
        if self.vehicle is not None and self.address is not None and self._other is not None:
            self.rival = Rival(self.vehicle, self.address, self._other)

    def _is_new_home(self, now: float) -> bool:
        """Count a datagram from elsewhere; whether the vehicle is there now."""
        self._elsewhere += 1
        if self.vehicle is None or self.address is None:
            return True
        silent = not self._has_imu or now - self._received_at > self.SILENT_FOR
        return silent and self._elsewhere >= self.MOVED_AFTER

    def _without_state(self, found: list[Frame]) -> list[Frame]:
        """Those of another address without content that the vehicle's own sends."""
        left = [f for f in found if f.message_id not in self._states or not self.is_vehicles(f)]
        self.passed_over += len(found) - len(left)
        return left


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


STATE_SUFFIX = ".time"
"""Added to the key file's name for the time of signatures."""


@dataclass(frozen=True)
class LinkReport:
    """The state of a link, beside its frames.

    Attributes:
        ended: as of `Link`, as are `breaks`, `floods` and `dropped`.
        garbage_bytes: that were part of no frame.
        marks: as of `Receiver`.
        rival: another sender with the vehicle's address.
        passed_over: frames of others with the vehicle's state.
        accepted: frames that are signed with the key; None: there is no key.
        refused: reason -> frames that are not.
        signing_problem: one line about the file of the signatures' time, else "".
    """

    ended: bool = False
    breaks: int = 0
    floods: int = 0
    dropped: int = 0
    garbage_bytes: int = 0
    marks: int = 0
    rival: Rival | None = None
    passed_over: int = 0
    accepted: int | None = None
    refused: dict[Refusal, int] | None = None
    signing_problem: str = ""


class Port(Protocol):
    """The port of a ground station, here or in another process."""

    @property
    def url(self) -> LinkUrl:
        """Of the link."""

    @property
    def gate(self) -> Gate:
        """What is to be sent goes here."""

    @property
    def link_report(self) -> LinkReport:
        """As things stand."""

    def follow(self, vehicle: tuple[int, int]) -> None:
        """Answer to this vehicle (sysid, compid) from now on."""

    def close(self) -> None:
        """Give the port back."""


class Transceiver(Receiver):
    """A receiver that also sends what the gate lets pass.

    `close` closes the link. Without the file with the signing key nothing is signed or checked.

    Raises:
        InputError: there is no key in that file.
    """

    def __init__(
        self, link: Link, *, listen_only: bool = False, signing_key: Path | None = None
    ) -> None:
        self._signing: SigningClock | None = None
        check = key = None
        if signing_key is not None:
            key = read_key(signing_key)
            state = signing_key.with_name(signing_key.name + STATE_SUFFIX)
            self._signing = SigningClock(state)
            check = SignatureCheck(key, self._signing)
        super().__init__(link, check)
        self.gate = Gate(link.send, listen_only=listen_only, key=key, clock=self._signing)

    @property
    def url(self) -> LinkUrl:
        """Of the link."""
        return self._link.url

    @property
    def link_report(self) -> LinkReport:
        """As things stand."""
        link, check, whereabouts = self._link, self.check, self.whereabouts
        signing: dict[str, Any] = {}
        if check is not None:
            signing = {"accepted": check.accepted, "refused": dict(check.refused)}
        return LinkReport(
            ended=link.ended,
            breaks=link.breaks,
            floods=link.floods,
            dropped=link.dropped,
            garbage_bytes=self.garbage_bytes,
            marks=self.marks,
            rival=whereabouts.rival,
            passed_over=whereabouts.passed_over,
            signing_problem=self._signing.problem if self._signing else "",
            **signing,
        )

    def close(self) -> None:
        """Give the link's port back."""
        self._link.close()
        if self._signing is not None:
            self._signing.close()
