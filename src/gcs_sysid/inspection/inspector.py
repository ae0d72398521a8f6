"""From the records of a log or link to the facts about it."""

import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError, NoAnswerError
from gcs_sysid.health.airframe_guess import guess_airframe
from gcs_sysid.health.assessment import HoverRecords
from gcs_sysid.health.vehicle_health import Health, HealthOptions
from gcs_sysid.inspection.facts import (
    ClockFacts,
    Inspection,
    RotorFacts,
    RotorMessage,
    StreamFacts,
    that_matter,
)
from gcs_sysid.inspection.readiness import objections_to, obtainable
from gcs_sysid.inspection.stream_watch import (
    UNWATCHED,
    USUAL,
    ChainWatch,
    MotionWatch,
    RotorWatch,
    StreamWatch,
    assumed_airframe,
    set_back,
)
from gcs_sysid.judgement.received import clock_doubt
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.parameters import AXES
from gcs_sysid.signals.columns import Key, RecordBlock, Track, by_key
from gcs_sysid.signals.motor_order import MotorOrder
from gcs_sysid.signals.records import ROTOR_STREAMS, Stream
from gcs_sysid.signals.rotor_source_selector import family
from gcs_sysid.telemetry.clock import WRAP_US
from gcs_sysid.telemetry.dataflash import ENTRIES
from gcs_sysid.telemetry.frame_block import FrameBlock
from gcs_sysid.telemetry.ground_station import GroundStation
from gcs_sysid.telemetry.intake import Intake
from gcs_sysid.telemetry.link import Link
from gcs_sysid.telemetry.logs import Log, Telemetry, open_log
from gcs_sysid.telemetry.message_table import MESSAGES, Message, OnboardMessage
from gcs_sysid.telemetry.transceiver import Transceiver
from gcs_sysid.telemetry.ulog import TOPICS

_ROTORS = (Stream.ROTOR_SPEED, Stream.ROTOR_COMMAND)
_ROWS: tuple[Message | OnboardMessage, ...] = (*MESSAGES, *TOPICS, *ENTRIES)
_MESSAGES: dict[Stream, tuple[str, ...]] = {
    stream: tuple(row.name for row in _ROWS if row.stream is stream)
    for stream in (Stream.IMU, Stream.ATTITUDE, Stream.VELOCITY)
}
"""Stream -> messages that it may come from; records do not say which."""


@dataclass(frozen=True)
class _Waiting:
    """Samples of one stream: (n,) s by its stamps, (n, width), (n,) s of the session, and after how
    many reboots.
    """

    t: Array
    values: Array
    session: Array
    boot: int

    def part(self, rows: slice) -> "_Waiting":
        return _Waiting(self.t[rows], self.values[rows], self.session[rows], self.boot)


class Inspector:
    """Takes the records of one vehicle, block by block.

    Without an airframe the vehicle's type gives the number of rotors.
    """

    def __init__(self, telemetry: Telemetry, airframe: Airframe | None = None) -> None:
        self.duration = 0.0
        self._telemetry = telemetry
        self._airframe = airframe
        self._chain: ChainWatch | None = None
        self._streams: dict[Key, StreamWatch] = {}
        self._waiting: dict[Key, deque[_Waiting]] = {}
        """Samples of which it is not known yet whether it flew."""
        self._rotors: dict[Key, RotorWatch] = {}
        self._motion = MotionWatch()
        self._reboots = 0
        self._wraps = 0
        self._boot_began = 0.0
        self._began: float | None = None
        self._newest = 0.0

    def add_records(self, block: RecordBlock, *, count: bool = True) -> None:
        """Take records that follow each other; without `count` for what they say of flight alone.

        How they are cut into blocks changes no number.
        """
        if not len(block):
            return
        if self._chain is None:
            self._chain = self._new_chain()
        self._chain.add_records(block)
        tracks = [track for track in block.tracks if track.stream is not Stream.VOLTAGE]
        if not tracks:
            return
        order = np.concatenate([track.order for track in tracks])
        rows = np.argsort(order, kind="stable")
        order, t = order[rows], np.concatenate([track.t for track in tracks])[rows]
        if self._began is None:
            self._began = self._boot_began = self._newest = float(t[0])
        watched = by_key(track for track in tracks if count and track.stream not in UNWATCHED)
        done = 0
        for row in set_back(t, self._newest):
            self._wait(watched.values(), int(order[done]), int(order[row]))
            self._pass(t[done:row])
            self._reboot(float(t[row]))
            done = row
        self._wait(watched.values(), int(order[done]), int(order[-1]) + 1)
        self._pass(t[done:])
        self._look_at_all(self._chain.flight.known if self._chain.has_samples else math.inf)

    def _pass(self, t: Array) -> None:
        """Time goes on by records at (n,) s."""
        assert self._began is not None
        newest = float(t.max(initial=self._newest))
        if newest > self._newest:
            self._newest = newest
            self.duration = newest - self._began

    def _wait(self, tracks: Iterable[Track], first: int, stop: int) -> None:
        """Put off the samples of these orders."""
        assert self._began is not None
        for track in tracks:
            part = track.between(first, stop)
            if len(part.t):
                waiting = self._waiting.setdefault(track.key, deque())
                waiting.append(_Waiting(part.t, part.values, part.t - self._began, self._reboots))

    def _look_at_all(self, known: float) -> None:
        """Look at what came up to a time of the session, s."""
        for key, waiting in self._waiting.items():
            while waiting:
                later = waiting[0].session > known
                ready = int(np.argmax(later)) if later.any() else len(later)
                self._fill(key, waiting[0].part(slice(ready)))
                if ready < len(waiting[0].t):
                    waiting[0] = waiting[0].part(slice(ready, None))
                    break
                waiting.popleft()

    def _fill(self, key: Key, samples: "_Waiting") -> None:
        """Give a watch its next samples, flight and ground apart."""
        assert self._chain is not None
        watch = self._streams.setdefault(key, StreamWatch())
        flying = self._chain.flight.flying(samples.session)
        changes = np.flatnonzero(np.diff(flying)) + 1
        for first, stop in pairwise([0, *changes.tolist(), len(flying)]):
            if first == stop:
                continue
            if (bool(flying[first]), samples.boot) != (watch.flying, watch.boot):
                self._look_at(key, watch)
                watch.begin(flying=bool(flying[first]), boot=samples.boot)
            while first < stop:
                first += watch.add(samples.t[first:stop], samples.values[first:stop])
                if watch.full:
                    self._look_at(key, watch)

    @property
    def _known_rotors(self) -> int | None:
        if self._airframe is not None:
            return len(self._airframe.rotors)
        vehicle = self._telemetry.vehicle
        return None if vehicle is None else vehicle.rotors

    def _new_chain(self) -> ChainWatch:
        vehicle, airframe = self._telemetry.vehicle, self._airframe
        if airframe is None and vehicle is not None:
            with suppress(NoAnswerError):
                airframe = guess_airframe(vehicle, self._telemetry.parameters, None, None).airframe
        airframe = airframe or assumed_airframe(self._known_rotors or USUAL)
        return ChainWatch(airframe, vehicle.key if vehicle else "")

    def _reboot(self, t: float) -> None:
        self._reboots += 1
        self._count_wraps()
        self._began = t - self.duration
        self._boot_began = self._newest = t

    def _count_wraps(self) -> None:
        if any(source == "SERVO_OUTPUT_RAW" for _, source, _ in self._waiting):
            self._wraps += int(self._newest // WRAP_US) - int(self._boot_began // WRAP_US)

    def _look_at(self, key: Key, watch: StreamWatch) -> None:
        t, values = watch.cut_chunk()
        if not len(t) or not watch.flying:
            return
        if key[0] in _ROTORS:
            self._rotors.setdefault(key, RotorWatch()).add_values(values)
        elif key[0] is Stream.IMU and len(t) > 1:
            self._motion.add_rates(t, values[:, :3])

    def finish(
        self,
        source: str,
        kind: str,
        problems: tuple[str, ...] = (),
    ) -> Inspection:
        """All that was found, judged."""
        if self._chain is None:
            self._chain = self._new_chain()
        chain = self._chain
        chain.finish()
        self._look_at_all(math.inf)
        for key, watch in self._streams.items():
            self._look_at(key, watch)
        self._count_wraps()
        telemetry = self._telemetry
        drift = telemetry.drift
        doubt = clock_doubt(drift.bounds, telemetry.parameters, by_gps=drift.by_gps)
        doubts = () if doubt is None else (f"{doubt.reason}; {doubt.how}",)
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
            flights=tuple(chain.flight.spans),
            flight_told_by=chain.recognized_by,
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
            rotor_input=chain.chosen(sources),
            gyro=chain.gyro,
            saturated=chain.saturated,
            problems=(*problems, *telemetry.problems, *doubts),
        )
        return judged(inspection)

    def _sources(self, rotors: int | None) -> tuple[RotorMessage, ...]:
        """The rotor streams, those of one message joined; of `rotors` where that is known."""
        joined: dict[tuple[Stream, str], dict[int, StreamWatch]] = {}
        for (stream, source, offset), watch in self._streams.items():
            if stream in _ROTORS:
                joined.setdefault((stream, family(source)), {})[offset] = watch
        vehicle, found = self._telemetry.vehicle, []
        key = "" if vehicle is None else vehicle.key
        order = MotorOrder.of(key, self._telemetry.parameters, rotors)
        for (stream, name), watches in joined.items():
            facts: dict[int, RotorFacts] = {}
            for (kind, source, offset), ranges in self._rotors.items():
                if kind is stream and family(source) == name:
                    facts |= {offset + i: rotor for i, rotor in enumerate(ranges.rotors())}
            rates = [watch.tally.rate for watch in watches.values() if watch.tally.rate]
            for reading, outputs in order.readings(name):
                columns = outputs or range(min(facts, default=0), max(facts, default=-1) + 1)
                found.append(
                    RotorMessage(
                        message=reading,
                        kind=ROTOR_STREAMS[stream],
                        rate=min(rates, default=None),
                        repeats_percent=max(w.tally.repeats_percent for w in watches.values()),
                        rotors=tuple(
                            facts.get(column, _SILENT)
                            for i, column in enumerate(columns)
                            if (
                                i < rotors
                                if rotors
                                else outputs or _used(facts.get(column, _SILENT))
                            )
                        ),
                    )
                )
        return tuple(found)


_SILENT = RotorFacts(math.nan, math.nan, math.nan, 100.0)
"""Of which nothing comes, though others do."""


def _used(rotor: RotorFacts) -> bool:
    """Whether an output drives something, where the vehicle's type does not give the number."""
    return rotor.low < rotor.high


def _in_table_order(entry: tuple[Key, StreamWatch]) -> tuple[int, int, int]:
    (stream, _, offset), watch = entry
    return list(Stream).index(stream), -watch.tally.counts.received, offset


def _stream_facts(key: Key, watch: StreamWatch, messages: Mapping[str, int]) -> StreamFacts:
    stream, source, offset = key
    tally, counts = watch.tally, watch.tally.counts
    samples = watch.flight.counts.received + watch.ground.counts.received
    candidates = [name for name in _MESSAGES.get(stream, ()) if name in messages]
    # The best that comes is taken, and a message makes at most one sample.
    enough = [name for name in candidates if messages[name] >= samples]
    return StreamFacts(
        stream=stream,
        message=source or next(iter(enough or candidates), str(stream)),
        offset=offset,
        samples=counts.received,
        rate=tally.rate,
        gaps=counts.gaps,
        longest_gap=counts.longest_gap,
        missing_percent=100.0 * counts.share if stream is Stream.IMU else None,
        repeats_percent=tally.repeats_percent,
    )


def inspect_log(
    path: Path,
    wanted: tuple[int, int | None] | None = None,
    progress: Callable[[float], None] | None = None,
    airframe: Airframe | None = None,
    opened: Log | None = None,
    health: Health | None = None,
) -> Inspection:
    """See what is in a recording.

    Args:
        path: of a log.
        wanted: system and perhaps component; None: the first autopilot in it.
        progress: called with the share of the log done, 0 to 1, now and then.
        airframe: of the vehicle; its rotors and its anchor, if any, count. None: the vehicle's type
            gives the number of rotors.
        opened: the log, opened by the caller.
        health: of it, where that is known already.

    Raises:
        InputError: the file cannot be read as a log.
    """
    log = opened or open_log(path, wanted)
    inspector = Inspector(log, airframe)
    keeper = HoverRecords()
    keeper.begin(log)
    for block in log.blocks():
        inspector.add_records(block)
        if health is None:
            keeper.add_records(block)
        if progress:
            progress(log.share_read)
    found = inspector.finish(str(path), log.kind)
    health = health or keeper.health(str(path), HealthOptions(airframe))
    if health.airframe is not None:
        found = replace(
            found,
            hover=health.seconds,
            layout=health.layout,
            explained=health.explained,
            explained_coupled=health.explained_coupled,
        )
    if progress:
        progress(1.0)
    return judged(found)


def judged(inspection: Inspection) -> Inspection:
    """With the objections that its facts lead to, and with how much is obtainable."""
    whole = replace(inspection, objections=objections_to(inspection))
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
    # Streams are watched once the vehicle sends what it was asked for.
    settling = 0.0 if listen_only else min(2.0, 0.5 * duration)
    began = asked = clock()
    received: float | None = None
    try:
        station.tick(began, intake)
        while not (stop() or link.ended):
            batches = transceiver.receive(0.05)
            now = clock()
            frames = [frame for batch in batches for frame in batch.frames]
            intake.garbage_bytes = transceiver.link_report.garbage_bytes
            if received is None and intake.vehicle is not None:
                received = now
            count = received is not None and now - received >= settling
            inspector.add_records(intake.block(FrameBlock.of(frames, now)), count=count)
            station.follow(now, intake)
            passed = now - (began if received is None else received)
            if now - asked >= 0.2:
                asked = now
                station.tick(now, intake)
                if progress:
                    progress(0.0 if received is None else min(passed / duration, 0.99))
            if passed >= duration:
                break
    finally:
        station.close()
    if progress:
        progress(1.0)
    return inspector.finish(str(link.url), "link", station.problems)
