"""From the records of a log or link to the facts about it."""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from gcs_sysid.errors import InputError
from gcs_sysid.health.assessment import health_of_log
from gcs_sysid.health.vehicle_health import Given
from gcs_sysid.inspection.derived_facts import (
    USUAL,
    FlightWatch,
    RotorJudge,
    assumed_airframe,
    rotor_count,
)
from gcs_sysid.inspection.facts import (
    AXES,
    ClockFacts,
    Inspection,
    RotorFacts,
    RotorInput,
    RotorSource,
    StreamFacts,
    that_matter,
)
from gcs_sysid.inspection.readiness import findings_of, obtainable
from gcs_sysid.inspection.stream_watch import MotionWatch, RotorWatch, StreamWatch
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.session.clock_check import clock_doubt
from gcs_sysid.signals.records import Record, Stream
from gcs_sysid.signals.rotor_source_selector import family
from gcs_sysid.telemetry.clock import JUMP_BACK, WRAP_US
from gcs_sysid.telemetry.ground_station import GroundStation
from gcs_sysid.telemetry.intake import Intake
from gcs_sysid.telemetry.link import Link
from gcs_sysid.telemetry.logs import Telemetry, open_log
from gcs_sysid.telemetry.transceiver import Transceiver

SETTLING = 2.0
"""s after which a vehicle sends what it was asked for: streams are watched from then on."""
_POLL, _ASK_EVERY = 0.05, 0.2
_RECORDS_AT_ONCE = 4096
_STATES = (Stream.IN_AIR, Stream.ARMED)
_UNWATCHED = (*_STATES, Stream.RATE_SETPOINT)
"""Of which no rate is shown: nothing needs them."""
_ROTORS = (Stream.ROTOR_SPEED, Stream.ROTOR_COMMAND)
_MESSAGES: dict[Stream, tuple[str, ...]] = {
    Stream.IMU: ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "sensor_combined", "IMU"),
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


class Inspector:
    """Takes the records of one vehicle, in the order in which they came.

    Args:
        telemetry: of the log or link, beside its records.
        airframe: of the vehicle; None: its type gives the number of rotors.
    """

    def __init__(self, telemetry: Telemetry, airframe: Airframe | None = None) -> None:
        self.duration = 0.0
        self._telemetry = telemetry
        self._airframe = airframe
        self._judge: RotorJudge | None = None
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
        if self._judge is None:
            self._judge = self._new_judge()
        self._judge.take(record)
        if stream in (Stream.PARAMETER, Stream.VOLTAGE):
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
        if stream in _UNWATCHED or not count:
            return
        key = stream, source, offset
        watch = self._streams.get(key)
        if watch is None:
            watch = self._streams[key] = StreamWatch()
        if watch.add(t, values):
            self._look_at(key, watch)

    @property
    def _known_rotors(self) -> int | None:
        if self._airframe is not None:
            return len(self._airframe.rotors)
        return rotor_count(self._telemetry.vehicle)

    def _new_judge(self) -> RotorJudge:
        vehicle = self._telemetry.vehicle
        airframe = self._airframe or assumed_airframe(self._known_rotors or USUAL)
        return RotorJudge(airframe, vehicle.key if vehicle else "")

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
            self._wraps += int(self._newest // WRAP_US) - int(self._boot_began // WRAP_US)

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
        problems: tuple[str, ...] = (),
    ) -> Inspection:
        """All that was found, judged.

        Args:
            source: name of the log or link.
            kind: as `Inspection.kind`.
            problems: that a link has.
        """
        self._look_at_all()
        recognized_by = self._flight.recognized_by
        self._flight.turn(self.duration, flying=False)
        self._count_wraps()
        telemetry = self._telemetry
        doubt = clock_doubt(telemetry.drift, telemetry.parameters)
        doubts = () if doubt is None else (doubt.reason,)
        counts = telemetry.as_dict()
        rotors = self._known_rotors
        messages = {name: entry["count"] for name, entry in counts.get("messages", {}).items()}
        sources = self._sources(rotors)
        inspection = Inspection(
            source=source,
            kind=kind,  # type: ignore[arg-type]
            duration=self.duration,
            vehicle=telemetry.vehicle,
            systems=tuple(telemetry.systems),
            flights=tuple(self._flight.spans),
            flight_told_by=recognized_by,  # type: ignore[arg-type]
            streams=tuple(
                _stream_facts(key, watch, messages)
                for key, watch in sorted(self._streams.items(), key=_in_table_order)
            ),
            rotor_sources=sources,
            motion=dict(zip(AXES, self._motion.motion(), strict=False)),
            clock=ClockFacts(telemetry.drift.ppm, self._reboots, self._wraps),
            parameters=that_matter(telemetry.parameters),
            parameter_count=len(telemetry.parameters),
            rotors=rotors or USUAL,
            rotors_assumed=rotors is None,
            telemetry=counts,
            rotor_input=RotorInput(None) if self._judge is None else self._judge.finish(sources),
            problems=(*problems, *telemetry.problems, *doubts),
        )
        return judged(inspection)

    def _sources(self, rotors: int | None) -> tuple[RotorSource, ...]:
        """The rotor streams, those of one message joined; of `rotors` where that is known."""
        joined: dict[tuple[Stream, str], dict[int, StreamWatch]] = {}
        for (stream, source, offset), watch in self._streams.items():
            if stream in _ROTORS:
                joined.setdefault((stream, family(source)), {})[offset] = watch
        found = []
        for (stream, name), watches in joined.items():
            facts: dict[int, RotorFacts] = {}
            for (kind, source, offset), ranges in self._rotors.items():
                if kind is stream and family(source) == name:
                    facts |= {offset + i: rotor for i, rotor in enumerate(ranges.rotors())}
            rates = [watch.tally.rate for watch in watches.values() if watch.tally.rate]
            found.append(
                RotorSource(
                    message=name,
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
    """Whether an output drives something, where the vehicle's type does not give the number."""
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
    airframe: Airframe | None = None,
) -> Inspection:
    """See what is in a recording.

    Args:
        path: a .tlog, .ulg, .bin or .bbl file.
        wanted: system and perhaps component; None: the first autopilot in it.
        progress: called with the share of the log done, 0 to 1, now and then.
        airframe: of the vehicle; its rotors and its anchor, if any, count. None: the vehicle's type
            gives the number of rotors.

    Raises:
        InputError: the file cannot be read as a log.
    """
    log = open_log(path, wanted)
    inspector = Inspector(log, airframe)
    for number, record in enumerate(log.records()):
        inspector.take(record)
        if number % _RECORDS_AT_ONCE == 0:
            log.take_events()
            if progress:
                progress(log.share_read)
    found = inspector.finish(str(path), log.kind)
    try:
        health = health_of_log(path, Given(airframe), wanted)
    except InputError:  # the rotors' positions are unknown
        pass
    else:
        found = replace(
            found,
            hover=health.seconds,
            explained=health.explained,
            explained_coupled=health.explained_coupled,
        )
    if progress:
        progress(1.0)
    return judged(found)


def judged(inspection: Inspection) -> Inspection:
    """With the findings that its facts lead to, and with how much is obtainable."""
    whole = replace(inspection, findings=findings_of(inspection))
    return replace(whole, obtainable=obtainable(whole))


def inspect_link(
    link: Link,
    duration: float,
    *,
    rate: float,
    airframe: Airframe | None = None,
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
        duration: s to listen after the vehicle's first frame, and to wait for that.
        rate: Hz to ask for, for IMU and rotors.
        airframe: as of `inspect_log`; None: as for four rotors.
        listen_only: send nothing at all.
        wanted: as of `inspect_log`.
        signing_key: file with the key of MAVLink 2 signing.
        stop: whether to end now.
        progress: as of `inspect_log`.
        clock: steady, s.

    Raises:
        InputError: the signing key cannot be read.
    """
    intake = Intake(wanted)
    inspector = Inspector(intake, airframe)
    rotors = USUAL if airframe is None else len(airframe.rotors)
    try:
        transceiver = Transceiver(link, listen_only=listen_only, signing_key=signing_key)
    except InputError:
        link.close()
        raise
    station = GroundStation(transceiver, rotors, rate)
    settling = 0.0 if listen_only else min(SETTLING, 0.5 * duration)
    began = asked = clock()
    heard: float | None = None
    try:
        station.tick(began, intake)
        while not (stop() or link.ended):
            batches = transceiver.receive(_POLL)
            now = clock()
            frames = [frame for batch in batches for frame in batch.frames]
            intake.garbage_bytes = transceiver.link_report.garbage_bytes
            if heard is None and intake.vehicle is not None:
                heard = now
            count = heard is not None and now - heard >= settling
            for record in intake.frames(frames, now):
                inspector.take(record, count=count)
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
    return inspector.finish(str(link.url), "link", station.problems)
