"""Detects senders that use the vehicle's address. Without signatures there is no proof, only
evidence.

`Whereabouts` knows addresses, and acts before anything is recorded, so that live sessions and the
analysis of their recordings see the same frames. `Contradictions` uses message content only, on any
link and in any recording.
"""

from collections import deque
from typing import NamedTuple

from gcs_sysid.telemetry.frames import Frame, Validity
from gcs_sysid.telemetry.link import Address
from gcs_sysid.telemetry.message_table import INERTIAL
from gcs_sysid.telemetry.messages import MESSAGE_IDS

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

        Args:
            found: of any sender and validity.
            source: address that it came from.
            now: any steady clock, s.

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


class Contradictions:
    """Detects heartbeats of one vehicle that contradict each other by turns.

    No vehicle arms and disarms, or is one autopilot and then another, every few heartbeats:
    another sender is behind some of them.

    Attributes:
        found: whether they did, once.
    """

    LATEST = 20
    """Heartbeats that are looked at."""
    CHANGES = 6
    """Among them, from which on they contradict each other."""

    def __init__(self) -> None:
        self.found = False
        self._said: tuple[int, int, bool] | None = None
        self._changed: deque[bool] = deque(maxlen=self.LATEST)

    def note_heartbeat(self, vehicle_type: int, autopilot: int, *, armed: bool) -> bool:
        """Take what a heartbeat says; whether that made it sure."""
        said = (vehicle_type, autopilot, armed)
        self._changed.append(self._said is not None and said != self._said)
        self._said = said
        if self.found or sum(self._changed) < self.CHANGES:
            return False
        self.found = True
        return True
