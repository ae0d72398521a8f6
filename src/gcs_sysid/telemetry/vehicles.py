"""Which of the systems found is the vehicle, and whether others pose as it."""

from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frame_block import FrameBlock, counts_of
from gcs_sysid.telemetry.frames import Frame, Validity
from gcs_sysid.telemetry.message_table import INERTIAL
from gcs_sysid.telemetry.messages import MESSAGE_IDS, picker

_HEARTBEAT = MESSAGE_IDS["HEARTBEAT"]
_heartbeat = picker("HEARTBEAT", "type", "autopilot")


RADIO = (ord("3"), ord("D"))
"""(sysid, compid) of SiK telemetry radios: they add RADIO_STATUS to what they carry."""
INERTIAL_IDS = frozenset(MESSAGE_IDS[name] for name in INERTIAL)
"""Ids of the messages with IMU data."""
_BEATS, _SAMPLES = 3, 20
"""Heartbeats and inertial messages of an active system, after which one silent in all that time is
not the vehicle. Autopilots send a heartbeat a second, and answer a request in less."""
_EVERYBODY = 0
"""The system that every vehicle is meant by; none has that number."""

_AUTOPILOT_KEYS = {
    mavlink.MAV_AUTOPILOT_PX4: ("px4", "PX4"),
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: ("ardupilot", "ArduPilot"),
}
_TYPE_WORDS = {mavlink.MAV_TYPE_GCS: "ground station", mavlink.MAV_TYPE_GENERIC: "vehicle"}
# What carries an autopilot's heartbeat but is never the vehicle.
_NOT_VEHICLES = {
    mavlink.MAV_TYPE_GCS,
    mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
    mavlink.MAV_TYPE_GIMBAL,
    mavlink.MAV_TYPE_CAMERA,
    mavlink.MAV_TYPE_ANTENNA_TRACKER,
    mavlink.MAV_TYPE_ADSB,
}


_ROTORS: dict[int, int] = {
    mavlink.MAV_TYPE_TRICOPTER: 3,
    mavlink.MAV_TYPE_QUADROTOR: 4,
    mavlink.MAV_TYPE_HEXAROTOR: 6,
    mavlink.MAV_TYPE_OCTOROTOR: 8,
    mavlink.MAV_TYPE_DECAROTOR: 10,
    mavlink.MAV_TYPE_DODECAROTOR: 12,
}

_OTHERS = {
    mavlink.MAV_TYPE_FIXED_WING,
    mavlink.MAV_TYPE_COAXIAL,
    mavlink.MAV_TYPE_HELICOPTER,
    mavlink.MAV_TYPE_AIRSHIP,
    mavlink.MAV_TYPE_GROUND_ROVER,
    mavlink.MAV_TYPE_SURFACE_BOAT,
    mavlink.MAV_TYPE_SUBMARINE,
}
"""Vehicles that fixed rotors do not carry; a VTOL is one that they do."""
GIVE_MULTIROTOR = "give a multirotor's log; if this is one, name its --airframe"
"""What to do about another vehicle's."""


def multirotor_type(rotors: int) -> int:
    """MAV_TYPE of a vehicle with so many rotors, where a log holds no more of it."""
    generic: int = mavlink.MAV_TYPE_GENERIC
    return next((kind for kind, count in _ROTORS.items() if count == rotors), generic)


def autopilot_key(autopilot: int) -> str:
    """Short lower-case name, as in the result: "px4", "ardupilot", ..."""
    if autopilot in _AUTOPILOT_KEYS:
        return _AUTOPILOT_KEYS[autopilot][0]
    entry = mavlink.enums["MAV_AUTOPILOT"].get(autopilot)
    return entry.name.removeprefix("MAV_AUTOPILOT_").lower() if entry else str(autopilot)


def _autopilot_name(autopilot: int) -> str:
    if autopilot in _AUTOPILOT_KEYS:
        return _AUTOPILOT_KEYS[autopilot][1]
    if autopilot == mavlink.MAV_AUTOPILOT_INVALID:
        return ""
    return autopilot_key(autopilot).replace("_", " ")


def _type_name(vehicle_type: int) -> str:
    if vehicle_type in _TYPE_WORDS:
        return _TYPE_WORDS[vehicle_type]
    entry = mavlink.enums["MAV_TYPE"].get(vehicle_type)
    if entry is None:
        return f"type {vehicle_type}"
    return str(entry.name).removeprefix("MAV_TYPE_").lower().replace("_", " ")


@dataclass(frozen=True)
class MavlinkSystem:
    """A system that was found, with what its heartbeat says."""

    system: int
    component: int
    vehicle_type: int | None = None
    """MAV_TYPE; None while no heartbeat came."""
    autopilot: int | None = None
    """MAV_AUTOPILOT; None while no heartbeat came."""
    version: int = 2
    """Of MAVLink, as its last heartbeat came."""

    @property
    def address(self) -> tuple[int, int]:
        """(sysid, compid)."""
        return self.system, self.component

    @property
    def key(self) -> str:
        """Such as "px4" or "ardupilot"; empty while unknown."""
        return "" if self.autopilot is None else autopilot_key(self.autopilot)

    @property
    def is_autopilot(self) -> bool:
        """Whether it is something that flies, and not a ground station, camera or radio."""
        return (
            self.autopilot not in (None, mavlink.MAV_AUTOPILOT_INVALID)
            and self.vehicle_type not in _NOT_VEHICLES
            and self.address != RADIO
            and self.system != _EVERYBODY
        )

    @property
    def rotors(self) -> int | None:
        """How many it has by its type; None when unknown."""
        return _ROTORS.get(self.vehicle_type or -1)

    @property
    def no_multirotor(self) -> str:
        """Why nothing holds for it, by its type; empty for what may be a multirotor."""
        if self.vehicle_type is None or self.vehicle_type not in _OTHERS:
            return ""
        return f"the vehicle is of type {_type_name(self.vehicle_type)}, and no multirotor"

    def __str__(self) -> str:
        words = []
        if self.address == RADIO:
            words = ["telemetry radio"]
        elif self.autopilot is not None and self.vehicle_type is not None:
            words = [_autopilot_name(self.autopilot), _type_name(self.vehicle_type)]
        return " ".join([*filter(None, words), f"{self.system}:{self.component}"])

    def as_dict(self) -> dict[str, int | str]:
        """The result's `vehicle`."""
        return {"sysid": self.system, "compid": self.component, "autopilot": self.key}


class VehicleSelector:
    """Chooses the vehicle: the one wanted, else the first autopilot that sends a heartbeat.

    That may be a stray heartbeat's: see `go_over`.

    Attributes:
        chosen: the vehicle, None until it has sent a heartbeat.
        systems: (sysid, compid) -> all systems received, in that order.
        frames: (sysid, compid) -> valid frames of each.
        wanted: system and perhaps component that the user chose; None: the first autopilot.
    """

    MOST_SYSTEMS = 256
    """Systems kept in the table: a hostile sender can claim 65 536 of them."""

    def __init__(self, wanted: tuple[int, int | None] | None = None) -> None:
        self.chosen: MavlinkSystem | None = None
        self.systems: dict[tuple[int, int], MavlinkSystem] = {}
        self.frames: dict[tuple[int, int], int] = {}
        self.wanted = wanted
        self._shown: dict[tuple[int, int], tuple[int, int]] = {}

    def note_senders(self, systems: Array, components: Array) -> None:
        """Note the senders of many frames whose checksums are right, heartbeats aside.

        Args:
            systems: (n,) uint8.
            components: (n,) uint8.
        """
        who = systems.astype(np.uint16) << 8 | components
        counts = {divmod(sender, 256): count for sender, count in counts_of(who).items()}
        new = counts.keys() - self.systems.keys()
        first = {(i, j): int(np.argmax(who == (i << 8 | j))) for i, j in new}
        for address in sorted(new, key=first.__getitem__)[: self.MOST_SYSTEMS - len(self.systems)]:
            self.systems[address] = MavlinkSystem(*address)
            self.frames[address] = 0
        for address in counts.keys() & self.systems.keys():
            self.frames[address] += counts[address]

    def listen(self, frames: FrameBlock) -> None:
        """Note frames of anybody, heartbeats too."""
        good = frames.validity == Validity.OK
        self.note_senders(frames.system[good], frames.component[good])
        for row in np.flatnonzero(good & (frames.message_id == _HEARTBEAT)).tolist():
            self.notice(frames.frame(row))

    def is_chosen(self, frame: Frame) -> bool:
        """Whether a frame is the chosen vehicle's."""
        chosen = self.chosen
        return chosen is not None and (frame.system, frame.component) == chosen.address

    def notice(self, heartbeat: Frame) -> None:
        """Note a heartbeat's data on its sender."""
        vehicle_type, autopilot = _heartbeat(heartbeat.payload)
        who = (heartbeat.system, heartbeat.component)
        self._notice(MavlinkSystem(*who, vehicle_type, autopilot, heartbeat.version))

    def go_over(self, frame: Frame) -> bool:
        """Choose the sender of a frame instead of a vehicle without data.

        Call it, while the chosen one has sent only heartbeats, for heartbeats and inertial messages
        of others.

        Returns:
            Whether the frame was what the decision took.
        """
        who = (frame.system, frame.component)
        other = self.systems.get(who)
        if self.wanted is not None or other is None or not other.is_autopilot:
            return False
        beats, samples = self._shown.get(who, (0, 0))
        beats += frame.message_id == _HEARTBEAT
        samples += frame.message_id in INERTIAL_IDS
        self._shown[who] = beats, samples
        if beats < _BEATS or samples < _SAMPLES:
            return False
        self.chosen = other
        return True

    @property
    def autopilots(self) -> list[MavlinkSystem]:
        """All vehicles found that one could choose, in the order found."""
        return [vehicle for vehicle in self.systems.values() if vehicle.is_autopilot]

    def _notice(self, vehicle: MavlinkSystem) -> None:
        if vehicle.address in self.systems:
            self.systems[vehicle.address] = vehicle
        if self.chosen is None and self._fits(vehicle):
            self.chosen = vehicle
        elif self.chosen is not None and self.chosen.address == vehicle.address:
            self.chosen = replace(self.chosen, version=vehicle.version)

    def _fits(self, vehicle: MavlinkSystem) -> bool:
        if vehicle.system == _EVERYBODY:
            return False
        if self.wanted is None:
            return vehicle.is_autopilot
        system, component = self.wanted
        if vehicle.system != system:
            return False
        # A component named by the user is taken at its word.
        return vehicle.is_autopilot if component is None else vehicle.component == component


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
