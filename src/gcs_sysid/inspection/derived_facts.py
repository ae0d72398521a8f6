"""When the vehicle flew, its rotor source, and assumptions without a given airframe."""

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.inspection.facts import ChosenSource, RotorMessage
from gcs_sysid.model.airframe import Airframe, Rotor
from gcs_sysid.model.scale_reference import ScaleReference
from gcs_sysid.session.chain import WINDOW
from gcs_sysid.signals.columns import RecordBlock, Track
from gcs_sysid.signals.records import Record, Stream
from gcs_sysid.signals.rotor_source_selector import RotorSourceSelector
from gcs_sysid.signals.rotor_units import RotorSource
from gcs_sysid.signals.sampling import SampleBlock, Sampler
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.vehicles import MavlinkSystem

STATES = (Stream.IN_AIR, Stream.ARMED)
"""What an autopilot says of itself."""


class FlightWatch:
    """When the vehicle flies: what the autopilot says, else armed with its rotors turning."""

    def __init__(self) -> None:
        self.spans: list[tuple[float, float]] = []
        self._in_air: bool | None = None
        self._armed: bool | None = None
        self._turning: dict[tuple[str, int], bool] = {}
        self._since: float | None = None

    @property
    def recognized_by(self) -> str:
        """As `Inspection.flight_told_by` says."""
        if self._in_air is not None:
            return "autopilot"
        if self._turning:
            return "rotors"
        return "arming" if self._armed is not None else ""

    @property
    def flying(self) -> bool:
        """Whether it flies, by the records so far."""
        return self._since is not None

    def add_record(self, record: Record) -> bool:
        """Note a record; whether it flies now."""
        if record.stream is Stream.IN_AIR:
            self._in_air = record.values[0] > 0.5
        elif record.stream is Stream.ARMED:
            self._armed = record.values[0] > 0.5
        elif record.stream is Stream.ROTOR_SPEED and self._in_air is None:
            turning = bool(_most_turn(np.array([record.values]))[0])
            self._turning[record.source, record.offset] = turning
        if self._in_air is not None:
            return self._in_air
        if self._turning:
            return self._armed is not False and any(self._turning.values())
        return bool(self._armed)

    def turn(self, t: float, *, flying: bool) -> None:
        """Take-off or landing at a time."""
        if flying:
            self._since = t
        elif self._since is not None:
            # Less than a second is a jump of the autopilot's judgement.
            if t - self._since >= 1.0 and len(self.spans) < 1000:
                self.spans.append((self._since, t))
            self._since = None

    def reboot(self, t: float) -> None:
        """The autopilot rebooted, not knowing of any flight; session time of the moment."""
        self.turn(t, flying=False)
        self._in_air = self._armed = None
        self._turning.clear()


def _most_turn(speeds: Array) -> Mask:
    """(n,) whether half of the rotors turn: one dead ESC does not mean that all stand still."""
    turning: Mask = 2 * np.count_nonzero(speeds > 0.0, axis=1) >= speeds.shape[1]
    return turning


def decisive(tracks: Iterable[Track], reboots: Array) -> Iterator[tuple[int, Record]]:
    """(order, record) of those that may change whether the vehicle flies.

    Args:
        tracks: of a block.
        reboots: (k,) rising orders, after which states have to be learned again.
    """
    for track in tracks:
        some = track
        if track.stream is Stream.ROTOR_SPEED:
            turning = _most_turn(track.values)
            changes = np.append(True, turning[1:] != turning[:-1])
            first = np.searchsorted(track.order, reboots)
            changes[first[first < len(track.t)]] = True
            some = track.part(changes)
        elif track.stream not in STATES:
            continue
        yield from zip(some.order.tolist(), some.records(), strict=True)


class RotorJudge:
    """Asks the chain's own selector, on the chain's own samples, which rotor stream to use.

    Args:
        airframe: whose rotors; its anchor is used where it has one.
        autopilot: "px4", "ardupilot".
    """

    def __init__(self, airframe: Airframe, autopilot: str) -> None:
        own = airframe.anchor()
        self._rotor_selector = RotorSourceSelector(airframe, ScaleReference(*own) if own else None)
        self._rotor_selector.autopilot = autopilot
        self._sampler = Sampler(self._rotor_selector, len(airframe.rotors))
        self._believed: RotorSource | None = None

    def add_records(self, block: RecordBlock) -> None:
        """Take records, of whatever streams."""
        for part in block.windows(WINDOW):
            for _, record_of in part.parameters:
                self._rotor_selector.learn(record_of.source, record_of.values[0])
            self._note(self._sampler.feed_tracks(part.tracks))

    def finish(self, sources: Sequence[RotorMessage]) -> ChosenSource:
        """The source that identification uses at the end."""
        self._note(self._sampler.finish())
        believed, rotor_selector = self._believed, self._rotor_selector
        refused = rotor_selector.refused if believed is None else believed.refused or {}
        reasons = [f"{name} {why}" for name, why in refused.items()]
        if believed is None:
            return ChosenSource(None, tuple(reasons), rotor_selector.judged)
        if believed.kind.motors or believed.scale != 1.0:
            reasons.append(f"rotors from {believed.name}, {believed.why}")
        span = believed.range
        return ChosenSource(
            next((source for source in sources if source.message == believed.name), None),
            tuple(reasons),
            rotor_selector.judged,
            None if span is None else (span.low, span.high),
            "" if span is None else span.origin,
        )

    def _note(self, blocks: Iterable[SampleBlock]) -> None:
        for block in blocks:
            self._believed = block.rotors or self._believed


USUAL = 4
"""Rotors of a vehicle whose type does not give their number."""

_ROTORS = {
    mavlink.MAV_TYPE_TRICOPTER: 3,
    mavlink.MAV_TYPE_QUADROTOR: 4,
    mavlink.MAV_TYPE_HEXAROTOR: 6,
    mavlink.MAV_TYPE_OCTOROTOR: 8,
    mavlink.MAV_TYPE_DECAROTOR: 10,
    mavlink.MAV_TYPE_DODECAROTOR: 12,
}


def rotor_count(vehicle: MavlinkSystem | None) -> int | None:
    """How many rotors a vehicle has by its type; None when unknown."""
    return None if vehicle is None else _ROTORS.get(vehicle.vehicle_type or -1)


def assumed_airframe(rotors: int) -> Airframe:
    """So many rotors on a circle: enough to judge their telemetry, where no scale is known."""
    angles = [2.0 * math.pi * i / rotors for i in range(rotors)]
    return Airframe(
        "assumed",
        tuple(Rotor(math.cos(a), math.sin(a), 1 - 2 * (i % 2)) for i, a in enumerate(angles)),
    )
