"""The estimate of a live session, and what looks on while it is made."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np

from gcs_sysid.errors import InputError, in_words
from gcs_sysid.health.assessment import HoverRecords, beside_analysis
from gcs_sysid.health.health_file import condition_text, document_of
from gcs_sysid.health.vehicle_health import HealthOptions
from gcs_sysid.judgement.judge import object_to
from gcs_sysid.live.acceleration_prediction import LivePrediction
from gcs_sysid.live.flight_coach import Coach, CoachOptions
from gcs_sysid.live.live_view import SELDOM, picture
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.estimate import Objection
from gcs_sysid.results.result import Result
from gcs_sysid.results.snapshot import Advice, LinkState, LinkStatus, Snapshot
from gcs_sysid.session.chain import Chain, ChainOptions
from gcs_sysid.session.origin import Origin
from gcs_sysid.signals.columns import RecordBlock, Track, by_key
from gcs_sysid.signals.records import Stream
from gcs_sysid.signals.sampling import Sampler
from gcs_sysid.telemetry.intake import FrameGathering, Intake
from gcs_sysid.telemetry.logs import Telemetry
from gcs_sysid.telemetry.tlog_writer import reset_mark
from gcs_sysid.telemetry.transceiver import ReceivedFrames
from gcs_sysid.telemetry.vehicles import MavlinkSystem


@dataclass(frozen=True)
class LiveOptions:
    """What a user may set for a live session.

    Attributes:
        rate: Hz to ask for, for IMU and rotors.
        listen_only: send nothing at all.
        wanted: system and perhaps component; None: the first autopilot received.
        duration: s of wall clock after which the session ends; None: never.
        refit_interval: s of vehicle time between estimates.
        signing_key: file with the key of MAVLink 2 signing; None: nothing is signed or checked.
        coach: what the flight coach aims at; None: no advice.
        state_folder: where the rates to restore are kept while the session lasts; None: nowhere.
        predict: whether snapshots show the acceleration that was predicted.
    """

    rate: float = 250.0
    listen_only: bool = False
    wanted: tuple[int, int | None] | None = None
    duration: float | None = None
    refit_interval: float = 0.2
    signing_key: Path | None = None
    coach: CoachOptions | None = None
    state_folder: Path | None = None
    predict: bool = True


class Duty(IntEnum):
    """What is done with the data; what has failed once is not tried again."""

    RECORD = 0
    """Nothing here: it is recorded."""
    WATCH = 1
    """The link is watched, and the vehicle is asked for its streams."""
    IDENTIFY = 2


class LiveEstimate:
    """Frames in, estimates out: a fresh chain, its prediction and its coach.

    A defect in what identifies costs the estimate, which stays what it was; a defect in what
    watches the link, that as well. `wanted` is system and perhaps component; None: the first
    autopilot received. `on_defect` is called with each defect.
    """

    def __init__(
        self,
        airframe: Airframe,
        source: str,
        options: LiveOptions,
        wanted: tuple[int, int | None] | None,
        on_defect: Callable[[Exception], None],
    ) -> None:
        self.duty = Duty.IDENTIFY
        self._options = options
        self._on_defect = on_defect
        own = ChainOptions(history_interval=options.refit_interval, reserve=True)
        self.intake = Intake(wanted)
        """From frames to records."""
        self._origin = Origin(self.intake, source, wanted)
        self.chain = chain = Chain(airframe, own, origin=self._origin)
        """From records to estimates."""
        self._gathering = FrameGathering(self.intake, lambda: chain.until_tick)
        self._contradicted: tuple[str, ...] = ()
        self._prediction = LivePrediction(self.chain)
        if options.predict:
            self.chain.observers.append(self._prediction.add_samples)
        self._coach = None if options.coach is None else Coach(self.chain, options.coach)
        self._advised: Advice | None = None
        self._hover: HoverWatch | None = HoverWatch(self.intake, source)
        self._health: dict[str, Any] | None = None
        self.relieved = False
        """Whether the estimate is renewed seldom on the way."""

    @property
    def airframe_problems(self) -> tuple[str, ...]:
        """What the airframe says otherwise than the vehicle; empty where they agree."""
        return self._origin.airframe_problems(self.chain.airframe)

    def learn(self, batch: ReceivedFrames) -> None:
        """Learn from frames as they are recorded, or count them at least."""
        wall = 1e-6 * batch.time_us
        try:
            if self.duty is Duty.IDENTIFY:
                self._learn_from(self._gathering.gather(batch.frames, wall))
            elif self.duty is Duty.WATCH:
                self.intake.frames(batch.frames, wall)
        except Exception as defect:  # noqa: BLE001 - what arrives is recorded all the same
            self.retreat(defect)

    def _learn_from(self, records: RecordBlock) -> None:
        if not len(records) and not records.events:
            return
        if self._hover is not None:
            self._hover.add_records(records)
        self.chain.take(records)

    def result(self) -> Result:
        """The latest estimate, from all that was taken."""
        self._learn_from(self._gathering.rest())
        return self.chain.result()

    def retreat(self, defect: Exception) -> None:
        """Do less from now on: what has failed once would fail again."""
        self._on_defect(defect)
        self.duty = Duty(max(self.duty - 1, Duty.RECORD))
        watched = self.duty is Duty.WATCH
        lost = "the estimate ends here" if watched else "the link is no longer watched"
        self.note(f"{in_words(defect)}: {lost}; what arrives is still recorded")

    def need(self) -> None:
        """Check that there is an estimate to act on.

        Raises:
            InputError: it has ended.
        """
        if self.duty is not Duty.IDENTIFY:
            raise InputError("the estimate ended with an internal error")

    def reset(self, time_us: int) -> None:
        """Do what the recording says at this place."""
        try:
            self.need()
            self._learn_from(self._gathering.gather([reset_mark()], 1e-6 * time_us))
        except InputError as error:
            self.note(f"not done: {error}")
        except Exception as defect:  # noqa: BLE001 - the flight goes on all the same
            self._on_defect(defect)
            self.note(f"not done: {in_words(defect)}")

    def note(self, text: str) -> None:
        """Add a line to the event log; none of an empty one."""
        if text:
            self.chain.note(text)

    def note_all(self, texts: Sequence[str]) -> None:
        """Add lines to the event log."""
        for text in texts:
            self.note(text)

    def relieve(self, *, on: bool) -> None:
        """Whether to renew the estimate seldom: there is no time, or no use."""
        self.relieved = on
        self.chain.renew_every(SELDOM if on else self._options.refit_interval)

    def think(self) -> None:
        """Let the coach think, and look at the hover; a defect is reported once, costs no
        flight.
        """
        self._look_at_hover()
        if self._coach is None:
            return
        try:
            # What is wrong on the ground is not mended by flying.
            wrong = bool(self.airframe_problems)
            if not wrong:
                self._coach.think()
            self._advised = None if wrong else self._coach.look()
        except Exception as defect:  # noqa: BLE001 - words alone are lost
            self._coach = self._advised = None
            self.note(f"{in_words(defect)}: coaching stops")

    def _look_at_hover(self) -> None:
        if self._hover is None:
            return
        try:
            news = self._hover.look(self.chain.airframe, self.result, self.chain.sampler)
        except Exception as defect:  # noqa: BLE001 - the flight goes on without it
            self._hover = None
            self.note(f"{in_words(defect)}: health is no longer updated")
            return
        if news is not None:
            self._health, text = news
            self.note(text)

    def final(
        self, complete: Callable[[Result], Result], last: Result, problem: Exception | None
    ) -> Result:
        """The final result; after a defect, the last good one.

        `complete` adds what only the link knows; `problem` is why it may be the last.
        """
        if self.duty is Duty.IDENTIFY:
            try:
                self._look_at_hover()
                self._learn_from(self._gathering.rest())
                return replace(complete(self.chain.finish()), health=self._health)
            except Exception as defect:  # noqa: BLE001 - handed to the main thread, which reports it
                self.retreat(defect)
                problem = problem or defect
        why = "" if problem is None else f"{in_words(problem)}: "
        early = f"{why}the estimate is that of {self.chain.t:.1f} s, its last good one"
        return object_to(last, [Objection(early, verdict="identified", by="session")])

    def snapshot(self, result: Result, link: LinkStatus) -> Snapshot:
        """How things stand."""
        self._check_airframe()
        acceleration = self._prediction.acceleration()
        target = (self._options.coach or CoachOptions()).target
        # No advice to fly what is not received.
        advised = self._advised if link.state is LinkState.CONNECTED else None
        seen = picture(self.chain, result, link, acceleration, target, advised)
        return replace(seen, health=self._health)

    def _check_airframe(self) -> None:
        """Enter what the airframe says otherwise in the event log, when that becomes known."""
        found = self.airframe_problems
        if found != self._contradicted:
            self._contradicted = found
            self.note_all(found)

    def advised(self, result: Result) -> Result:
        """A result with what the coach says now, and the vehicle's health."""
        advice = None if self._advised is None else self._advised.as_json()
        return replace(result, advice=advice, health=self._health)

    def know(self, others: Sequence[MavlinkSystem]) -> None:
        """Keep other vehicles in mind, to be chosen."""
        selector = self.intake.selector
        for known in others:
            selector.systems[known.address], selector.frames[known.address] = known, 0

    def drop(self) -> None:
        """Let go of whom it knows: each would outlive the session by the other."""
        self.chain.observers.clear()
        self._hover = None
        self._on_defect = lambda _: None


_KEPT = 90.0
"""s of the vehicle's clock that are averaged: a baseline of 30 s and what is compared with it."""
_EVERY = 10.0
"""s of the vehicle's clock between looks: at 250 Hz each takes 0.2 s of a processor."""
_MOST_WAITING = 2000
"""Tracks that may wait to be joined, while not viewed."""
_NEW_FLIGHT = ("reboot", "reset", "vehicle")
"""Events after which what was flown before is another flight's."""


class HoverWatch:
    """Keeps the last minutes of records, and assesses the vehicle's health by their hover."""

    def __init__(self, telemetry: Telemetry, source: str) -> None:
        self._telemetry = telemetry
        self._source = source
        self._kept: list[Track] = []
        self._fresh: list[Track] = []
        self._looked = -np.inf
        self._now = -np.inf
        self._named: int | None = None
        self._number = 0
        """Of the next record: each block of a link counts from 0."""

    def add_records(self, block: RecordBlock) -> None:
        """The next records."""
        if any(event.kind in _NEW_FLIGHT for _, event in block.events):
            self._kept, self._fresh = [], []
            self._looked = self._now = -np.inf
            self._named = None
        number = self._number
        for track in block.tracks:
            if track.stream is not Stream.PARAMETER and len(track.t):
                order = track.order + number
                self._fresh.append(replace(track, order=order))
                self._number = max(self._number, int(order[-1]) + 1)
                self._now = max(self._now, float(track.t[-1]))
        if len(self._fresh) > _MOST_WAITING:
            self._join()

    def look(
        self,
        airframe: Airframe,
        result: Callable[[], Result] | None = None,
        sampler: Sampler | None = None,
    ) -> tuple[dict[str, Any], str] | None:
        """Findings of the hover now; None where it is not time for another look.

        They are a health file's content, whose verdict is "refused" where nothing hovers, and the
        words on a rotor that is weak and was not before, if one is.

        `result` is called where it is time to look. `sampler` took the records; None: none did.
        """
        if self._now - self._looked < _EVERY:
            return None
        self._looked = self._now
        self._join()
        records = HoverRecords()
        records.begin(self._telemetry)
        records.add_records(RecordBlock(tuple(self._kept)))
        if sampler is not None:
            records.end(sampler)
        health = records.health(self._source, HealthOptions(airframe))
        if result is not None:
            latest = result()
            health = beside_analysis(health, latest)
        text = ""
        weakened = health.weakened
        if weakened is not None and weakened.condition.rotor != self._named:
            self._named = weakened.condition.rotor
            text = condition_text(weakened.condition)
        return document_of(health), text

    def _join(self) -> None:
        joined = by_key([*self._kept, *by_key(self._fresh).values()])
        oldest = self._now - _KEPT
        parts = (track.part(track.t >= oldest) for track in joined.values())
        self._kept = [part for part in parts if len(part.t)]
        self._fresh = []
