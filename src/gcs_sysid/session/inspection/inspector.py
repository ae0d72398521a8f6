"""From the records of a log or link to the facts about it."""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from gcs_sysid.errors import InputError
from gcs_sysid.records import Record, Stream
from gcs_sysid.session.inspection.facts import (
    AXES,
    ClockFacts,
    Inspection,
    RotorFacts,
    RotorSource,
    StreamFacts,
)
from gcs_sysid.session.inspection.parameters import that_matter
from gcs_sysid.session.inspection.readiness import findings_of
from gcs_sysid.session.inspection.rotor_input import choose_rotor_input, rotor_count
from gcs_sysid.session.inspection.watch import MotionWatch, RotorWatch, StreamWatch
from gcs_sysid.telemetry.clock import JUMP_BACK, ClockDrift
from gcs_sysid.telemetry.ground_station import GroundStation
from gcs_sysid.telemetry.intake import Intake
from gcs_sysid.telemetry.link import Link
from gcs_sysid.telemetry.logs import Telemetry, open_log

SETTLING = 2.0
"""s after which a vehicle sends what it was asked for: streams are watched from then on."""
SHORTEST_FLIGHT = 1.0
"""s; less is a jump of the autopilot's judgement."""
MOST_FLIGHTS = 1000
_WRAP = 2**32 * 1e-6
"""s between two wraps of 32-bit stamps in microseconds."""
_POLL, _ASK_EVERY = 0.05, 0.2
_RECORDS_AT_ONCE = 4096
_STATES = (Stream.IN_AIR, Stream.ARMED)
_ROTORS = (Stream.ROTOR_SPEED, Stream.ROTOR_COMMAND)
_MESSAGES: dict[Stream, tuple[str, ...]] = {
    Stream.IMU: ("HIGHRES_IMU", "SCALED_IMU", "RAW_IMU", "sensor_combined", "IMU"),
    Stream.ATTITUDE: (
        *("ATTITUDE", "ATTITUDE_QUATERNION", "vehicle_attitude"),
        *("ATT", "XKQ", "XKQ1", "NKQ", "NKQ1"),
    ),
    Stream.VELOCITY: (
        *("LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "vehicle_local_position"),
        *("XKF1", "NKF1", "EKF1"),
    ),
}
"""Stream -> messages that it may come from; records do not say which."""

Key = tuple[Stream, str, int]


class FlightWatch:
    """When the vehicle flies: what the autopilot says, else armed with its rotors turning."""

    def __init__(self) -> None:
        self.spans: list[tuple[float, float]] = []
        self._in_air: bool | None = None
        self._armed: bool | None = None
        self._turning: dict[tuple[str, int], bool] = {}
        self._since: float | None = None

    @property
    def told_by(self) -> str:
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

    def take(self, record: Record) -> bool:
        """Note a record; whether it flies now."""
        if record.stream is Stream.IN_AIR:
            self._in_air = record.values[0] > 0.5
        elif record.stream is Stream.ARMED:
            self._armed = record.values[0] > 0.5
        elif record.stream is Stream.ROTOR_SPEED and self._in_air is None:
            # One dead ESC does not mean that all stand still.
            turning = sum(1 for speed in record.values if speed > 0.0)
            self._turning[record.source, record.offset] = 2 * turning >= len(record.values)
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
            if t - self._since >= SHORTEST_FLIGHT and len(self.spans) < MOST_FLIGHTS:
                self.spans.append((self._since, t))
            self._since = None

    def reboot(self, t: float) -> None:
        """The autopilot began anew, not knowing of any flight; session time of the moment."""
        self.turn(t, flying=False)
        self._in_air = self._armed = None
        self._turning.clear()


class Inspector:
    """Takes the records of one vehicle, in the order in which they came."""

    def __init__(self) -> None:
        self.duration = 0.0
        self._flight = FlightWatch()
        self._streams: dict[Key, StreamWatch] = {}
        self._rotors: dict[Key, RotorWatch] = {}
        self._motion = MotionWatch()
        self._reboots = 0
        self._wraps = 0
        self._boot_began = 0.0
        self._began: float | None = None
        self._newest = 0.0

    def take(self, record: Record, *, count: bool = True) -> None:
        """Take a record; without `count` for what it says of flight alone."""
        stream, t, values, offset, source = record
        if stream is Stream.PARAMETER:
            return
        if self._began is None:
            self._began = self._boot_began = self._newest = t
        if t < self._newest - JUMP_BACK:
            self._reboot(t)
        elif t > self._newest:
            self._newest = t
            self.duration = t - self._began
        if stream in _STATES or stream is Stream.ROTOR_SPEED:
            flying = self._flight.take(record)
            if flying is not self._flight.flying:
                self._look_at_all()
                self._flight.turn(max(t - self._began, 0.0), flying=flying)
        if stream in _STATES or not count:
            return
        key = stream, source, offset
        watch = self._streams.get(key)
        if watch is None:
            watch = self._streams[key] = StreamWatch()
        if watch.add(t, values):
            self._look_at(key, watch)

    def _reboot(self, t: float) -> None:
        assert self._began is not None
        self._look_at_all()
        self._flight.reboot(self.duration)
        self._reboots += 1
        self._count_wraps()
        for watch in self._streams.values():
            watch.restart()
        self._began = t - self.duration
        self._boot_began = self._newest = t

    def _count_wraps(self) -> None:
        if any(source == "SERVO_OUTPUT_RAW" for _, source, _ in self._streams):
            self._wraps += int(self._newest // _WRAP) - int(self._boot_began // _WRAP)

    def _look_at_all(self) -> None:
        for key, watch in self._streams.items():
            self._look_at(key, watch)

    def _look_at(self, key: Key, watch: StreamWatch) -> None:
        flying = self._flight.flying
        chunk = watch.take(flying=flying)
        if chunk is None or not flying:
            return
        if key[0] in _ROTORS:
            self._rotors.setdefault(key, RotorWatch()).take(chunk.values)
        elif key[0] is Stream.IMU and len(chunk.t) > 1:
            self._motion.take(chunk.t, chunk.values[:, :3], watch.usual_step)

    def finish(
        self,
        source: str,
        kind: str,
        telemetry: Telemetry,
        drift_ppm: float | None,
        problems: tuple[str, ...] = (),
    ) -> Inspection:
        """All that was found, judged.

        Args:
            source: name of the log or link.
            kind: as `Inspection.kind`.
            telemetry: what the log or link tells beside its records.
            drift_ppm: of the vehicle's clock.
            problems: that a link has.
        """
        self._look_at_all()
        told_by = self._flight.told_by
        self._flight.turn(self.duration, flying=False)
        self._count_wraps()
        counts = telemetry.as_dict()
        vehicle = telemetry.vehicle
        messages = {name: entry["count"] for name, entry in counts.get("messages", {}).items()}
        sources = self._sources(rotor_count(vehicle))
        inspection = Inspection(
            source=source,
            kind=kind,  # type: ignore[arg-type]
            duration=self.duration,
            vehicle=vehicle,
            systems=tuple(telemetry.systems),
            flights=tuple(self._flight.spans),
            flight_told_by=told_by,  # type: ignore[arg-type]
            streams=tuple(
                _stream_facts(key, watch, messages)
                for key, watch in sorted(self._streams.items(), key=_in_table_order)
            ),
            rotor_sources=sources,
            motion=dict(zip(AXES, self._motion.motion(), strict=False)),
            clock=ClockFacts(drift_ppm, self._reboots, self._wraps),
            parameters=that_matter(telemetry.parameters),
            parameter_count=len(telemetry.parameters),
            telemetry=counts,
            rotor_input=choose_rotor_input(sources, flown=bool(self._flight.spans)),
            problems=problems,
        )
        return replace(inspection, findings=findings_of(inspection))

    def _sources(self, rotors: int | None) -> tuple[RotorSource, ...]:
        """The rotor streams, those of one message joined; of `rotors` where that is known."""
        joined: dict[tuple[Stream, str], dict[int, StreamWatch]] = {}
        for (stream, source, offset), watch in self._streams.items():
            if stream in _ROTORS:
                family = "ESC_TELEMETRY" if source.startswith("ESC_TELEMETRY") else source
                joined.setdefault((stream, family), {})[offset] = watch
        found = []
        for (stream, family), watches in joined.items():
            facts: dict[int, RotorFacts] = {}
            for (kind, source, offset), ranges in self._rotors.items():
                if kind is stream and source.startswith(family):
                    facts |= {offset + i: rotor for i, rotor in enumerate(ranges.rotors())}
            rates = [watch.tally.rate for watch in watches.values() if watch.tally.rate]
            found.append(
                RotorSource(
                    message=family,
                    kind="speed" if stream is Stream.ROTOR_SPEED else "command",
                    rate=min(rates, default=None),
                    repeats_percent=max(w.tally.repeats_percent for w in watches.values()),
                    rotors=tuple(
                        facts[i]
                        for i in sorted(facts)
                        if (i < rotors if rotors else _used(facts[i]))
                    ),
                )
            )
        return tuple(found)


def _used(rotor: RotorFacts) -> bool:
    """Whether an output drives something, where the vehicle's type does not tell how many."""
    return rotor.low != rotor.high


def _in_table_order(entry: tuple[Key, StreamWatch]) -> tuple[int, int, int]:
    (stream, _, offset), watch = entry
    return list(Stream).index(stream), -watch.tally.samples, offset


def _stream_facts(key: Key, watch: StreamWatch, messages: Mapping[str, int]) -> StreamFacts:
    stream, source, offset = key
    tally = watch.tally
    samples = watch.flight.samples + watch.ground.samples
    candidates = [name for name in _MESSAGES.get(stream, ()) if name in messages]
    # The best that comes is taken, and a message makes at most one sample.
    enough = [name for name in candidates if messages[name] >= samples]
    return StreamFacts(
        stream=stream,
        message=source or next(iter(enough or candidates), str(stream)),
        offset=offset,
        samples=tally.samples,
        rate=tally.rate,
        gaps=tally.gaps,
        longest_gap=tally.longest_gap,
        missing_percent=tally.missing_percent,
        repeats_percent=tally.repeats_percent,
    )


def inspect_log(
    path: Path,
    wanted: tuple[int, int | None] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Inspection:
    """See what is in a recording.

    Args:
        path: a .tlog, .ulg or .bin file.
        wanted: system and perhaps component; None: the first autopilot in it.
        progress: called with the share of the log done, 0 to 1, now and then.

    Raises:
        InputError: the file cannot be read as a log.
    """
    log = open_log(path, wanted)
    inspector = Inspector()
    for number, record in enumerate(log.records()):
        inspector.take(record)
        if number % _RECORDS_AT_ONCE == 0:
            log.take_events()
            if progress:
                progress(log.share_read)
    if progress:
        progress(1.0)
    return inspector.finish(str(path), log.kind, log, log.drift_ppm)


def inspect_link(
    link: Link,
    duration: float,
    *,
    rate: float,
    rotors: int = 4,
    listen_only: bool = False,
    wanted: tuple[int, int | None] | None = None,
    signing_key: Path | None = None,
    stop: Callable[[], bool] = lambda: False,
    progress: Callable[[float], None] | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> Inspection:
    """See what comes over a link, asking for the streams as a live session does.

    Args:
        link: open; it is closed at the end.
        duration: s to listen once the vehicle has spoken, and to wait for it to speak.
        rate: Hz to ask for, for IMU and rotors.
        rotors: how many to ask for.
        listen_only: send nothing at all.
        wanted: as of `inspect_log`.
        signing_key: file with the key of MAVLink 2 signing.
        stop: whether to end now.
        progress: as of `inspect_log`.
        clock: steady, s.

    Raises:
        InputError: the signing key cannot be read.
    """
    intake, inspector, drift = Intake(wanted), Inspector(), ClockDrift()
    try:
        station = GroundStation(
            link, rotors, rate, listen_only=listen_only, signing_key=signing_key
        )
    except InputError:
        link.close()
        raise
    settling = 0.0 if listen_only else min(SETTLING, 0.5 * duration)
    began = asked = clock()
    heard: float | None = None
    try:
        station.tick(began, intake)
        while not (stop() or link.ended):
            frames = station.poll(_POLL)
            now = clock()
            intake.garbage_bytes = station.garbage_bytes
            if heard is None and intake.vehicle is not None:
                heard = now
            count = heard is not None and now - heard >= settling
            for record in intake.frames(frames):
                inspector.take(record, count=count)
            if intake.clock is not None:
                drift.take(intake.clock, now)
            station.follow(now, intake)
            passed = now - (began if heard is None else heard)
            if now - asked >= _ASK_EVERY:
                asked = now
                station.tick(now, intake)
                if progress:
                    progress(0.0 if heard is None else min(passed / duration, 0.99))
            if passed >= duration:
                break
    finally:
        station.close()
    if progress:
        progress(1.0)
    return inspector.finish(str(link.url), "link", intake, drift.ppm, station.problems)
