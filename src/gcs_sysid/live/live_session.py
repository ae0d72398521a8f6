"""The live session: from what is received to immutable snapshots, in a thread.

    receiver -> queue -> this thread: learn, answer the vehicle, publish

What is received is recorded before it comes here (`reception`), in a process of its own where
`gcs-sysid live` runs: this thread may fail, be slow or be killed, and the recording is whole.
"""

import queue
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path

from gcs_sysid.errors import GcsSysidError, InputError, in_words
from gcs_sysid.live.live_estimate import Duty, LiveEstimate, LiveOptions
from gcs_sysid.live.live_view import RESULT_EVERY, Backlog, Session, link_status, with_link
from gcs_sysid.live.receiver_process import Source
from gcs_sysid.live.reception import (
    POLL,
    Ended,
    Failure,
    Item,
    Reception,
    RecordingCut,
    ResetMark,
    Toggled,
)
from gcs_sysid.model.airframe import ANCHORS, Airframe, AnchorName, ScaleReference
from gcs_sysid.results.result import Result
from gcs_sysid.results.snapshot import FoundVehicle, LinkState, Snapshot
from gcs_sysid.telemetry.ground_station import GroundStation
from gcs_sysid.telemetry.link import Link
from gcs_sysid.telemetry.tlog_writer import unused_path
from gcs_sysid.telemetry.transceiver import ReceivedFrames

_LOADED_AHEAD = ("scipy.optimize",)
"""What else a flight loads where it first needs it, in the air: data would wait 0.1 s and more."""
_PUBLISH_EVERY, _PUBLISH_LATE = 0.2, 1.0
"""s between snapshots; the longer one while the computer is too slow."""


class CommandQueue:
    """Commands of users, which wait until the session's thread carries them out."""

    def __init__(self) -> None:
        # Who asks faster is refused.
        self._waiting: queue.Queue[Callable[[], None]] = queue.Queue(64)

    def ask(self, command: Callable[[], None]) -> None:
        """Have something done in the session's thread.

        Raises:
            InputError: too much waits to be done.
        """
        try:
            self._waiting.put_nowait(command)
        except queue.Full:
            raise InputError("the session is busy: try again") from None

    def grant(self, note: Callable[[str], None]) -> Exception | None:
        """Carry out the requests. One that fails is reported, and the session continues.

        `note` is called with what could not be done.

        Returns:
            The first defect, if one was met.
        """
        first: Exception | None = None
        while not self._waiting.empty():
            try:
                self._waiting.get()()
            except (GcsSysidError, OSError) as error:
                note(f"not done: {error}")
            except Exception as defect:  # noqa: BLE001 - the flight goes on all the same
                first = first or defect
                note(f"not done: {in_words(defect)}")
        return first


class LiveSession(Session):
    """Identifies and publishes, in a thread of its own.

    A defect in what identifies costs the estimate, which stays what it was; a defect in what
    watches the link, that as well. The link goes on being recorded.

    Wall-clock time decides only when to publish and when to call the link silent; the numbers
    come from the vehicle's clock and the order of the frames alone.

    Args:
        source: of the data, or an open link, which is then read and recorded in the session's
            thread. The session closes it. When the link ends, so does the session; a
            `PersistentLink` comes back instead.
        airframe: with a scale anchor.
        options: settings.
        record_to: recording; None for none. An existing file is never overwritten. A source that is
            no link has its own already, and continues beside this one.
        sender_gone: whether the sender has ended (an emulator that exited); given only where it
            connects once.
        on_result: called in the session's thread about once a second of vehicle time.
    """

    def __init__(
        self,
        source: Source | Link,
        airframe: Airframe,
        options: LiveOptions,
        record_to: Path | None = None,
        sender_gone: Callable[[], bool] | None = None,
        on_result: Callable[[Result], None] | None = None,
    ) -> None:
        super().__init__("session")
        if isinstance(source, Link):
            source = Reception(
                source,
                record_to,
                listen_only=options.listen_only,
                signing_key=options.signing_key,
            )
        self._source: Source = source
        self._options = options
        self._station = GroundStation(
            source,
            len(airframe.rotors),
            options.rate,
            connects_once=sender_gone is not None,
            state_folder=options.state_folder,
        )
        self._airframe = airframe
        self._stem = record_to or Path("logs") / "session.tlog"
        self._estimate = self._new_estimate(options.wanted)
        self._backlog = Backlog(source)
        self._sender_gone = sender_gone
        self._on_result = on_result
        self._commands = CommandQueue()
        self._toggling = self._postponed = False
        self._choice: FoundVehicle | None = None
        self._all_taken = self._loaded = False
        self._result_reported_at = 0.0
        self._asked = self._published = -float("inf")

    def _new_estimate(self, wanted: tuple[int, int | None] | None) -> LiveEstimate:
        url, options = str(self._source.url), self._options
        return LiveEstimate(self._airframe, url, options, wanted, self._meet)

    def _meet(self, defect: Exception | None) -> None:
        """Keep the first defect for the main thread, which reports it."""
        self.problem = self.problem or defect

    # -- what the user does, in threads of their own

    def start(self) -> None:
        """Publish a first snapshot, and begin."""
        self._publish(LinkState.WAITING)
        self._thread.start()

    def mark(self, text: str) -> None:
        """Write a mark into the event log."""
        self._commands.ask(lambda: self._estimate.note(text[:200]))

    def reset(self) -> None:
        """Reset the estimate and restart, as the analysis of the recording then does too."""
        self._commands.ask(self._mark_reset)

    def toggle_recording(self) -> str:
        """Start or stop recording; says which.

        Raises:
            InputError: it is being started or stopped, or see `CommandQueue.ask`.
        """
        if self._toggling:
            raise InputError("recording is being started or stopped: try again")
        source, report = self._source, self._source.recording_report
        path = unused_path(self._stem)
        self._toggling = True
        try:
            if report.active:
                self._commands.ask(source.stop_recording)
                return f"recording {report.path} stopped"
            self._commands.ask(lambda: source.start_recording(path))
            return f"recording to {path}"
        except InputError:
            self._toggling = False
            raise

    def set_anchor(self, kind: str, value: float) -> str:
        """Let another fact set the scale.

        `kind` is "mass", "k_T" or "T_max"; `value` is SI.

        Raises:
            InputError: there is no such kind, or it cannot have this value.
        """
        if kind not in ANCHORS:
            raise InputError(f"the scale is set by one of {', '.join(ANCHORS)}, not by {kind!r}")
        name: AnchorName = kind  # type: ignore[assignment]
        airframe = self._airframe.with_anchor(name, value)
        self._estimate.chain.check_anchor(name)
        given = airframe.uncertainty.scale_share(name, value)
        anchor = ScaleReference(name, value, given=given)
        self._commands.ask(lambda: self._set_anchor(airframe, anchor))
        return f"scale from {kind} = {value:.6g} {ANCHORS[name]}"

    def choose_vehicle(self, address: tuple[int, int]) -> str:
        """Restart on another vehicle, into another recording.

        Raises:
            InputError: none of that system and component was received.
        """
        received = {v.address: v for v in (self._latest.link.vehicles if self._latest else ())}
        if address not in received:
            raise InputError("no vehicle {}:{} was found".format(*address))
        vehicle, path = received[address], unused_path(self._stem)
        self._commands.ask(lambda: self._choose(vehicle, path))
        return f"restarting on {vehicle.name}"

    @property
    def airframe(self) -> Airframe:
        """With the anchor in force."""
        return self._airframe

    def flushed_recording(self) -> Path | None:
        """The latest recording, all that was written so far in the file; None without one."""
        return self._source.flushed_recording()

    def recordings(self) -> list[str]:
        """A line for each recording of an ended session: where it is, or why it is not."""
        return list(self._source.recording_report.lines)

    # -- the session's thread

    def _run(self) -> None:
        began = time.monotonic()
        self._guarded(lambda: self._loop(began))
        self._guarded(self._station.leave)
        self._guarded(self._take_the_rest)
        self._guarded(self._source.close)
        self._estimate.note_all(self._source.take_events())
        assert self._latest is not None
        last = self._latest.result
        self.final = self._estimate.final(self._complete, last, self.problem)
        self._publish(LinkState.ENDED)
        self._estimate.drop()

    def _guarded(self, step: Callable[[], object]) -> None:
        """Do a step; errors are handed to the main thread, which reports them."""
        try:
            step()
        except Exception as problem:  # noqa: BLE001 - the next step is done all the same
            self._meet(problem)

    def _loop(self, began: float) -> None:
        while not self._stop.is_set():
            items = self._source.next_items(POLL)
            if items and not self._loaded:
                self._load_ahead()
            now = time.monotonic()
            self._turn(items, now)
            if not items and self._ended(now, began):
                return
            duration = self._options.duration
            if duration is not None and now - began >= duration:
                return

    def _load_ahead(self) -> None:
        """Load at the first data: a screen that waits for them is there sooner."""
        self._loaded = True
        for name in _LOADED_AHEAD:
            self._guarded(partial(import_module, name))

    def _turn(self, items: Sequence[Item], now: float) -> None:
        """Learn from what came, answer the vehicle, do what users ask, show how things stand.

        Showing and advising wait for the next turn where samples were processed in this one: what
        arrives on a fast link meanwhile would wait for both.
        """
        before = self._estimate.chain.t
        # Also while nothing else comes.
        self._estimate.intake.garbage_bytes = self._source.link_report.garbage_bytes
        for item in items:
            self._accept(item)
        learned = self._estimate.chain.t != before
        self._attend(now)
        self._see_backlog(now)
        self._meet(self._commands.grant(self._estimate.note))
        self._estimate.note_all(self._source.take_events())
        self._postponed = learned and not self._postponed
        if self._postponed:
            return
        if self._backlog.is_idle:
            self._estimate.think()
        every = _PUBLISH_LATE if self._backlog.too_slow else _PUBLISH_EVERY
        if now - self._published >= every:
            self._published = now
            self._publish(self._state())

    def _accept(self, item: Item) -> None:
        match item:
            case ReceivedFrames():
                self._estimate.learn(item)
                self._report_result()
            case ResetMark(time_us):
                self._estimate.reset(time_us)
            case RecordingCut():
                self._restart()
            case Toggled(text):
                self._toggling = False
                self._estimate.note(text)
            case Failure(text):
                self._meet(RuntimeError(text))
                self._estimate.note(f"internal error ({text})")
            case Ended():
                self._all_taken = True

    def _attend(self, now: float) -> None:
        """Answer the vehicle."""
        if self._estimate.duty is Duty.RECORD or self._choice is not None:
            return
        station, intake = self._station, self._estimate.intake
        try:
            station.follow(now, intake)
            if now - self._asked >= 0.2:
                self._asked = now
                station.tick(now, intake)
        except Exception as defect:  # noqa: BLE001 - what arrives is recorded all the same
            self._estimate.retreat(defect)
        self._estimate.note_all(station.take_events())

    def _see_backlog(self, now: float) -> None:
        before = self._backlog.too_slow
        self._estimate.note_all(self._backlog.look(now))
        if self._backlog.too_slow is not before:
            self._estimate.relieve(on=not before)

    def _take_the_rest(self) -> None:
        """Process all that is recorded, with few estimates on the way."""
        self._estimate.relieve(on=True)
        self._source.finish()
        self._estimate.note_all(self._backlog.last_words())
        while not self._all_taken:
            for item in self._source.next_items(POLL):
                self._accept(item)
            now = time.monotonic()
            self._backlog.look(now)
            if now - self._published >= _PUBLISH_LATE:
                self._published = now
                self._publish(self._state())

    def _ended(self, now: float, began: float) -> bool:
        """Whether nothing more will come."""
        if self._source.link_report.ended:
            return True
        if self._sender_gone is not None and self._sender_gone():
            # What its line still holds comes within that time.
            return now - (self._station.received_at or began) >= 0.7
        return False

    def _state(self) -> LinkState:
        if self._station.received_at is None:
            return LinkState.WAITING
        return LinkState.LOST if self._station.lost else LinkState.CONNECTED

    def _complete(self, result: Result) -> Result:
        return with_link(result, self._source, self._station, self._backlog, time.monotonic())

    def _report_result(self) -> None:
        estimate, t = self._estimate, self._estimate.chain.t
        if estimate.relieved or estimate.duty is not Duty.IDENTIFY:
            return
        if self._on_result is None or t - self._result_reported_at < RESULT_EVERY:
            return
        self._result_reported_at = t
        try:
            result = estimate.advised(self._complete(estimate.result()))
        except Exception as defect:  # noqa: BLE001 - what arrives is recorded all the same
            estimate.retreat(defect)
            return
        try:
            self._on_result(result)
        except Exception as problem:  # noqa: BLE001 - the session goes on without a listener
            self._meet(problem)
            self._on_result = None
            self._estimate.note(f"{in_words(problem)}: results are no longer written")

    def _mark_reset(self) -> None:
        self._estimate.need()
        self._source.mark_reset()

    def _set_anchor(self, airframe: Airframe, anchor: ScaleReference) -> None:
        self._estimate.need()
        try:
            self._estimate.chain.set_anchor(anchor)
        except InputError as error:
            self._estimate.note(f"the scale stays: {error}")
        else:
            self._airframe = airframe

    def _choose(self, vehicle: FoundVehicle, path: Path) -> None:
        self._estimate.need()
        self._station.leave()
        self._choice = vehicle
        self._source.cut_recording(path)

    def _restart(self) -> None:
        """Restart in every respect, so that the new recording's analysis ends the same."""
        vehicle, before = self._choice, self._estimate
        assert vehicle is not None
        self._choice = None
        self._estimate = self._new_estimate(vehicle.address)
        self._estimate.relieve(on=before.relieved)
        before.drop()
        self._estimate.know(before.intake.selector.autopilots)
        self._result_reported_at = 0.0
        self._estimate.note(f"chosen: {vehicle.name}; the session restarts")
        path = self._source.recording_report.path
        if path:
            self._estimate.note(f"recording to {path}")

    def _publish(self, state: LinkState) -> None:
        while True:
            try:
                self._latest = self._picture(state)
                return
            except Exception as defect:
                if self._latest is None or self._estimate.duty is Duty.RECORD:
                    raise
                self._estimate.retreat(defect)

    def _picture(self, state: LinkState) -> Snapshot:
        """How things stand; after a defect, as far as that is known."""
        before, estimate = self._latest, self._estimate
        if before is not None and self._estimate.duty is Duty.RECORD:
            recording = self._source.recording_report.path
            link = replace(before.link, state=state, recording=recording)
        else:
            intake, too_slow = estimate.intake, self._backlog.too_slow
            link = link_status(state, self._source, self._station, intake, too_slow=too_slow)
        if before is not None and self._estimate.duty is not Duty.IDENTIFY:
            result, events = self.final or before.result, estimate.chain.events
            return replace(before, result=result, link=link, events=events, advice=None)
        result = self.final or self._complete(estimate.result())
        return estimate.snapshot(result, link)
