"""The live session: a thread from the link to immutable snapshots."""

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from gcs_sysid.errors import InputError
from gcs_sysid.live.acceleration_prediction import LivePrediction
from gcs_sysid.live.command_queue import CommandQueue, in_words
from gcs_sysid.live.flight_coach import Coach, CoachOptions
from gcs_sysid.live.live_options import LiveOptions
from gcs_sysid.live.live_view import link_status, picture
from gcs_sysid.live.recording import Recording
from gcs_sysid.model.airframe import ANCHORS, Airframe, AnchorName
from gcs_sysid.model.scale_reference import ScaleReference
from gcs_sysid.results.result import Result
from gcs_sysid.results.snapshot import Advice, HeardVehicle, LinkState, Snapshot
from gcs_sysid.session.chain import ChainOptions
from gcs_sysid.session.pipeline import Pipeline
from gcs_sysid.telemetry.frames import Frame
from gcs_sysid.telemetry.ground_station import GroundStation
from gcs_sysid.telemetry.link import Link
from gcs_sysid.telemetry.marks import reset_mark

_POLL = 0.05
"""s; the longest that an action of the user waits."""
_ASK_EVERY = 0.2
"""s between looks at the rates that arrive."""
_FEW = 16
"""Frames in one go that are not worth waking for."""
_GATHER, _GATHER_MOST = 2.0, (0.002, 0.008)
"""Samples of the IMU to wait for then, and least and most s."""
_PUBLISH_EVERY, _PUBLISH_LATE = 0.2, 0.4
"""s between snapshots; the longer one while more frames wait than are taken in one go."""
_RESULT_EVERY = 1.0
"""s of the vehicle's clock between results that are passed on."""
_DRAINED_AFTER = 0.7
"""s of silence after the sender's end, before the session ends too."""
_LONGEST_MARK = 200
"""Characters; the rest is cut."""


class LiveSession:
    """Receives, records, identifies and publishes, in a thread of its own.

    A defect in what identifies costs the estimate, which stays what it was; a defect in what
    watches the link, that as well. The link goes on being recorded.

    Wall-clock time decides only when to publish and when to call the link silent; the numbers
    come from the vehicle's clock and the order of the frames alone.

    Args:
        link: open; the session closes it. When it ends, the session ends; a `PersistentLink`
            comes back instead.
        airframe: with a scale anchor.
        options: settings.
        record_to: recording; None for none. An existing file is never overwritten.
        sender_gone: tells that whoever sends has ended (an emulator that exited); who can be
            told of so connects once.
        on_result: called in the session's thread about once a second of vehicle time.
    """

    def __init__(
        self,
        link: Link,
        airframe: Airframe,
        options: LiveOptions,
        record_to: Path | None = None,
        sender_gone: Callable[[], bool] | None = None,
        on_result: Callable[[Result], None] | None = None,
    ) -> None:
        self.final: Result | None = None
        """The last result, once the session has ended."""
        self.problem: Exception | None = None
        """The first defect, or what ended the session against its will."""
        self._link = link
        self._options = options
        self._station = GroundStation(
            link,
            len(airframe.rotors),
            options.rate,
            listen_only=options.listen_only,
            signing_key=options.signing_key,
            connects_once=sender_gone is not None,
        )
        self._airframe = airframe
        self._begin(options.wanted)
        self._recording = Recording(record_to)
        self._sender_gone = sender_gone
        self._on_result = on_result
        self._commands = CommandQueue()
        self._toggling = False
        self._stop = threading.Event()
        self._latest: Snapshot | None = None
        self._arrived = self._told_result_at = 0.0
        self._asked = self._published = -float("inf")
        self._rounds: list[Callable[[LiveSession, Sequence[Frame], float], None]] = [
            LiveSession._identify,
            LiveSession._watch_link,
        ]
        """What is done with frames beside recording them; a defect takes the first away."""
        self._thread = threading.Thread(target=self._run, name="session", daemon=True)

    def _begin(self, wanted: tuple[int, int | None] | None) -> None:
        """Begin with a pipeline that knows nothing yet."""
        options = ChainOptions(history_interval=self._options.refit_interval)
        self._pipeline = Pipeline(self._airframe, str(self._link.url), wanted, options)
        chain, coach = self._pipeline.chain, self._options.coach
        self._prediction = LivePrediction(chain)
        if self._options.predict:
            chain.observers.append(self._prediction.take)
        self._coach = None if coach is None else Coach(chain, coach)
        self._advised: Advice | None = None

    def start(self) -> None:
        """Begin."""
        self._publish(LinkState.WAITING)
        self._thread.start()

    def latest(self) -> Snapshot | None:
        """The newest snapshot."""
        return self._latest

    def request_stop(self) -> None:
        """End the session soon; returns at once."""
        self._stop.set()

    def stop(self) -> None:
        """End the session and wait until everything is written."""
        self._stop.set()
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join()

    def join(self, timeout: float | None = None) -> bool:
        """Wait for the end; whether it has come."""
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def mark(self, text: str) -> None:
        """Write a mark into the event log."""
        self._commands.ask(lambda: self._pipeline.chain.note(text[:_LONGEST_MARK]))

    def reset(self) -> None:
        """Forget the estimate and start anew, as the analysis of the recording then does too."""
        self._commands.ask(self._reset)

    def toggle_recording(self) -> str:
        """Start or stop recording; says which.

        Raises:
            InputError: it is being started or stopped, or see `CommandQueue.ask`.
        """
        if self._toggling:
            raise InputError("recording is being started or stopped: try again")
        recording = self._recording
        if recording.active:
            self._ask_toggle(recording.stop)
            return f"recording {recording.path} stopped"
        path = recording.next_path()
        self._ask_toggle(lambda: recording.start(path))
        return f"recording to {path}"

    def _ask_toggle(self, change: Callable[[], str]) -> None:
        self._toggling = True
        try:
            self._commands.ask(lambda: self._toggle(change))
        except InputError:
            self._toggling = False
            raise

    def _toggle(self, change: Callable[[], str]) -> None:
        try:
            self._note(change())
        finally:
            self._toggling = False

    def set_anchor(self, kind: str, value: float) -> str:
        """Let another fact set the scale.

        Args:
            kind: "mass", "k_T" or "T_max".
            value: SI.

        Raises:
            InputError: there is no such kind, or it cannot have this value.
        """
        if kind not in ANCHORS:
            raise InputError(f"the scale is set by one of {', '.join(ANCHORS)}, not by {kind!r}")
        name: AnchorName = kind  # type: ignore[assignment]
        airframe = self._airframe.with_anchor(name, value)
        self._pipeline.chain.check_anchor(name)
        self._commands.ask(lambda: self._set_anchor(airframe, ScaleReference(name, value)))
        return f"scale from {kind} = {value:.6g} {ANCHORS[name]}"

    def choose_vehicle(self, address: tuple[int, int]) -> str:
        """Start anew on another vehicle, into another recording.

        Raises:
            InputError: none of that system and component was heard.
        """
        heard = {v.address: v for v in (self._latest.link.vehicles if self._latest else ())}
        if address not in heard:
            raise InputError("no vehicle {}:{} was heard".format(*address))
        vehicle, path = heard[address], self._recording.next_path()
        self._commands.ask(lambda: self._choose(vehicle, path))
        return f"starting anew on {vehicle.name}"

    @property
    def airframe(self) -> Airframe:
        """With the anchor in force."""
        return self._airframe

    def flushed_recording(self) -> Path | None:
        """The latest recording, all that was written so far in the file; None without one."""
        return self._recording.flushed()

    def recordings(self) -> list[str]:
        """A line for each recording of an ended session: where it is, or why it is not."""
        return self._recording.lines()

    def _run(self) -> None:
        try:
            self._loop()
        except Exception as problem:  # noqa: BLE001 - handed to the main thread, which tells it
            self.problem = self.problem or problem
        try:
            self._station.close()
        except Exception as problem:  # noqa: BLE001 - as above
            self.problem = self.problem or problem
        self._recording.finish()
        self._tell_recording()
        self.final = self._final()
        self._publish(LinkState.ENDED)
        self._leave()

    def _leave(self) -> None:
        """Let go of the pipeline, which would outlive its session."""
        self._pipeline.drop()

    def _loop(self) -> None:
        began = time.monotonic()
        while True:
            frames = self._station.poll(_POLL)
            now = time.monotonic()
            if frames:
                self._arrived = 1e-6 * self._recording.write(frames)
            if self._rounds:
                try:
                    self._rounds[0](self, frames, now)
                except Exception as defect:  # noqa: BLE001 - what arrives is recorded all the same
                    self._retreat(defect)
            met = self._commands.grant(self._note)
            self.problem = self.problem or met
            self._tell_recording()
            # What is shown waits while frames do, but not for ever.
            few = len(frames) < _FEW
            if few:
                self._think()
            every = _PUBLISH_EVERY if few else _PUBLISH_LATE
            if now - self._published >= every:
                self._published = now
                self._publish(self._state())
            if self._stop.is_set() or self._ended(now, began):
                return
            if frames and few:
                # Let datagrams gather in the system's buffer: waking for each costs most.
                least, most = _GATHER_MOST
                dt = self._pipeline.chain.sampler.time_base.dt
                self._stop.wait(min(max(_GATHER * dt, least), most))

    def _identify(self, frames: Sequence[Frame], now: float) -> None:
        """All that is done with frames beside recording them."""
        pipeline = self._pipeline
        if frames:
            pipeline.intake.garbage_bytes = self._station.garbage_bytes
            pipeline.take(frames, self._arrived)
        self._attend(frames, now)
        self._tell_result()

    def _watch_link(self, frames: Sequence[Frame], now: float) -> None:
        """The same without an estimate: the streams go on being asked for."""
        self._pipeline.intake.frames(frames, self._arrived)
        self._attend(frames, now)

    def _attend(self, frames: Sequence[Frame], now: float) -> None:
        """Answer the vehicle."""
        intake = self._pipeline.intake
        self._station.follow(now, intake)
        if now - self._asked >= _ASK_EVERY:
            self._asked = now
            self._station.tick(now, self._pipeline.intake)
        for text in self._station.take_events():
            self._note(text)

    @property
    def _identifying(self) -> bool:
        return self._rounds[:1] == [LiveSession._identify]

    def _retreat(self, defect: Exception) -> None:
        """Do less from now on: what has failed once would fail again."""
        self.problem = self.problem or defect
        del self._rounds[:1]
        lost = "the estimate ends here" if self._rounds else "the link is no longer watched"
        self._note(f"{in_words(defect)}: {lost}; what arrives is still recorded")

    def _final(self) -> Result:
        """The final result; after a defect, the last good one."""
        if self._identifying:
            try:
                return self._complete(self._pipeline.finish())
            except Exception as defect:  # noqa: BLE001 - handed to the main thread, which tells it
                self._retreat(defect)
        assert self._latest is not None
        result, chain = self._latest.result, self._pipeline.chain
        why = "" if self.problem is None else f"{in_words(self.problem)}: "
        early = f"{why}the estimate is that of {chain.t:.1f} s, its last good one"
        return replace(result, reasons=(*result.reasons, early))

    def _ended(self, now: float, began: float) -> bool:
        if self._link.ended:
            return True
        if self._options.duration is not None and now - began >= self._options.duration:
            return True
        if self._sender_gone is not None and self._sender_gone():
            return now - (self._station.heard_at or began) >= _DRAINED_AFTER
        return False

    def _state(self) -> LinkState:
        if self._station.heard_at is None:
            return LinkState.WAITING
        return LinkState.LOST if self._station.lost else LinkState.CONNECTED

    def _complete(self, result: Result) -> Result:
        """Add what only the link knows; the numbers stay those of the frames alone."""
        reasons = result.reasons
        if result.verdict != "identified":
            reasons = (*reasons, *self._station.problems)
        telemetry = {**result.telemetry, **self._station.as_dict()}
        if self._recording.dropped:
            telemetry["recording"] = {"missing": self._recording.dropped}
        return replace(result, reasons=reasons, telemetry=telemetry)

    def _tell_result(self) -> None:
        t = self._pipeline.chain.t
        late = t - self._told_result_at - _RESULT_EVERY
        if self._on_result is not None and late >= 0.0:
            self._told_result_at = t
            result = self._complete(self._pipeline.result())
            try:
                self._on_result(result)
            except Exception as problem:  # noqa: BLE001 - the session goes on without a listener
                self.problem = self.problem or problem
                self._on_result = None
                self._note(f"{in_words(problem)}: results are passed on no more")

    def _tell_recording(self) -> None:
        for text in self._recording.take_events():
            self._note(text)

    def _note(self, text: str) -> None:
        if text:
            self._pipeline.chain.note(text)

    def _reset(self) -> None:
        self._need_estimate()
        mark = [reset_mark()]
        self._recording.write(mark)
        self._pipeline.take(mark)

    def _need_estimate(self) -> None:
        if not self._identifying:
            raise InputError("the estimate has ended by an internal error")

    def _set_anchor(self, airframe: Airframe, anchor: ScaleReference) -> None:
        self._need_estimate()
        try:
            self._pipeline.chain.set_anchor(anchor)
        except InputError as error:
            self._pipeline.chain.note(f"the scale stays: {error}")
        else:
            self._airframe = airframe

    def _choose(self, vehicle: HeardVehicle, path: Path) -> None:
        """Begin anew in every respect, so that the new recording's analysis ends the same."""
        self._need_estimate()
        self._station.leave()
        intake = self._pipeline.intake
        self._leave()
        self._begin(vehicle.address)
        selector = self._pipeline.intake.selector
        for known in intake.selector.autopilots:  # the others stay to be chosen
            selector.systems[known.address], selector.frames[known.address] = known, 0
        self._told_result_at = 0.0
        self._pipeline.chain.note(f"chosen: {vehicle.name}; the session starts anew")
        if self._recording.active:
            self._recording.stop()
            self._note(self._recording.start(path))

    def _think(self) -> None:
        """Let the coach think; a defect of it is told once and costs no flight."""
        if self._coach is None:
            return
        try:
            self._coach.think()
            self._advised = self._coach.look()
        except Exception as defect:  # noqa: BLE001 - words alone are lost
            self._coach = self._advised = None
            self._note(f"{in_words(defect)}: the coach falls silent")

    def _publish(self, state: LinkState) -> None:
        while True:
            try:
                self._latest = self._picture(state)
                return
            except Exception as defect:
                if self._latest is None or not self._rounds:
                    raise
                self._retreat(defect)

    def _picture(self, state: LinkState) -> Snapshot:
        """How things stand; after a defect, as far as that is known."""
        before, recording = self._latest, self._recording.path
        if before is not None and not self._rounds:
            link = replace(before.link, state=state, recording=recording)
        else:
            url, intake = str(self._link.url), self._pipeline.intake
            link = link_status(state, url, self._station, intake, recording)
        if before is not None and not self._identifying:
            result, events = self.final or before.result, self._pipeline.chain.events
            return replace(before, result=result, link=link, events=events, advice=None)
        result = self.final or self._complete(self._pipeline.result())
        acceleration, advice = self._prediction.acceleration(), self._advised
        target = (self._options.coach or CoachOptions()).target
        return picture(self._pipeline.chain, result, link, acceleration, target, advice)
