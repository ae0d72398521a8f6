"""The live session: a thread from the link to immutable snapshots."""

import contextlib
import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from gcs_sysid.errors import GcsSysidError, InputError
from gcs_sysid.estimation.anchors import Anchor
from gcs_sysid.model.airframe import ANCHORS, Airframe, AnchorName
from gcs_sysid.session.chain import ChainOptions
from gcs_sysid.session.coaching import Coach, CoachOptions
from gcs_sysid.session.pipeline import Pipeline
from gcs_sysid.session.prediction import LivePrediction
from gcs_sysid.session.result import Result
from gcs_sysid.session.snapshot import Advice, HeardVehicle, LinkState, LinkStatus, Snapshot
from gcs_sysid.telemetry.ground_station import GroundStation
from gcs_sysid.telemetry.link import Link
from gcs_sysid.telemetry.marks import reset_mark
from gcs_sysid.telemetry.tlog import TlogWriter, unused_path

_POLL = 0.05
"""s; the longest that an action of the user waits."""
_ASK_EVERY = 0.2
"""s between looks at the rates that arrive."""
_FEW, _GATHER = 16, 0.002
"""Frames in one go that are not worth waking for, and s to wait for more."""
_PUBLISH_EVERY, _PUBLISH_LATE = 0.2, 0.4
"""s between snapshots; the longer one while more frames wait than are taken in one go."""
_DRAINED_AFTER = 0.7
"""s of silence after the sender's end, before the session ends too."""


@dataclass(frozen=True)
class LiveOptions:
    """What a user may set for a live session.

    Attributes:
        rate: Hz to ask for, for IMU and rotors.
        listen_only: send nothing at all.
        wanted: system and perhaps component; None: the first autopilot heard.
        duration: s of wall clock after which the session ends; None: never.
        refit_interval: s of vehicle time between estimates.
        signing_key: file with the key of MAVLink 2 signing; None: nothing is signed or checked.
        coach: what the flight coach aims at; None: no advice.
        predict: whether snapshots show the acceleration that was predicted.
    """

    rate: float = 250.0
    listen_only: bool = False
    wanted: tuple[int, int | None] | None = None
    duration: float | None = None
    refit_interval: float = 0.2
    signing_key: Path | None = None
    coach: CoachOptions | None = None
    predict: bool = True


class LiveSession:
    """Receives, records, identifies and publishes, in a thread of its own.

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
        """What ended the session against its will."""
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
        self._writer = TlogWriter(record_to) if record_to else None
        self._recording_stem = record_to or Path("logs") / "session.tlog"
        self._sender_gone = sender_gone
        self._on_result = on_result
        self._actions: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._stop = threading.Event()
        self._latest: Snapshot | None = None
        self._told_result_at = 0.0
        self._recordings: list[str] = []
        self._recorded: Path | None = None
        self._told_problem = ""
        self._thread = threading.Thread(target=self._run, name="session", daemon=True)

    def _begin(self, wanted: tuple[int, int | None] | None) -> None:
        """Begin with a pipeline that knows nothing yet."""
        options = ChainOptions(course_interval=self._options.refit_interval)
        self._pipeline = Pipeline(self._airframe, str(self._link.url), wanted, options)
        chain, coach = self._pipeline.chain, self._options.coach
        self._prediction = LivePrediction(chain)
        if self._options.predict:
            chain.observers.append(self._prediction.take)
        self._coach = None if coach is None else Coach(chain, coach)

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
        self._actions.put(lambda: self._pipeline.chain.note(text))

    def reset(self) -> None:
        """Forget the estimate and start anew, as the analysis of the recording then does too."""
        self._actions.put(self._reset)

    def toggle_recording(self) -> str:
        """Start or stop recording; says which."""
        writer = self._writer
        if writer is not None and writer.recording:
            self._actions.put(self._stop_recording)
            return f"recording {writer.path} stopped"
        path = unused_path(self._recording_stem)
        self._actions.put(lambda: self._start_recording(path))
        return f"recording to {path}"

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
        self._actions.put(lambda: self._set_anchor(airframe, Anchor(name, value)))
        return f"scale from {kind} = {value:.6g} {ANCHORS[name]}"

    def choose_vehicle(self, address: tuple[int, int]) -> str:
        """Start anew on another vehicle, into another recording.

        Raises:
            InputError: none of that system and component was heard.
        """
        heard = {v.address: v for v in (self._latest.link.vehicles if self._latest else ())}
        if address not in heard:
            raise InputError("no vehicle {}:{} was heard".format(*address))
        vehicle = heard[address]
        self._actions.put(lambda: self._choose(vehicle))
        return f"starting anew on {vehicle.name}"

    @property
    def airframe(self) -> Airframe:
        """With the anchor in force."""
        return self._airframe

    def flushed_recording(self) -> Path | None:
        """The latest recording, all that was written so far on the disk; None without one."""
        writer = self._writer
        if writer is None:
            return self._recorded
        if writer.problem:
            return None
        writer.flush()
        return writer.path

    def recordings(self) -> list[str]:
        """A line for each recording of an ended session: where it is, or why it is not."""
        return list(self._recordings)

    def _run(self) -> None:
        try:
            self._loop()
        except Exception as problem:  # noqa: BLE001 - handed to the main thread, which tells it
            self.problem = problem
        finally:
            self._station.close()
            if self._writer:
                self._end_recording(self._writer)
            try:
                self.final = self._complete(self._pipeline.finish())
            except Exception as problem:  # noqa: BLE001 - as above
                self.problem = self.problem or problem
                self.final = self._complete(self._pipeline.result())
            self._publish(LinkState.ENDED)

    def _loop(self) -> None:
        began = time.monotonic()
        published = began
        asked = began - _ASK_EVERY
        while not self._stop.is_set():
            frames = self._station.poll(_POLL)
            now = time.monotonic()
            if frames:
                if self._writer:
                    self._writer.write(time.time_ns() // 1000, frames)
                self._pipeline.intake.garbage_bytes = self._station.garbage_bytes
                self._pipeline.take(frames)
            self._station.follow(now, self._pipeline.intake)
            if frames and self._pipeline.intake.clock is not None:
                self._pipeline.intake.drift.take(self._pipeline.intake.clock, now)
            while not self._actions.empty():
                self._do(self._actions.get())
            if now - asked >= _ASK_EVERY:
                asked = now
                self._station.tick(now, self._pipeline.intake)
            for text in self._station.take_events():
                self._pipeline.chain.note(text)
            self._tell_recording_problem()
            # What is shown waits while frames do, but not for ever.
            if now - published >= (_PUBLISH_EVERY if len(frames) < _FEW else _PUBLISH_LATE):
                self._publish(self._state())
                self._tell_result()
                published = now
            if self._ended(now, began):
                return
            if 0 < len(frames) < _FEW:
                # Let datagrams gather in the system's buffer: waking for each costs most.
                self._stop.wait(_GATHER)

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
        return replace(result, reasons=reasons, telemetry=telemetry)

    def _tell_result(self) -> None:
        t = self._pipeline.chain.t
        if self._on_result is not None and t - self._told_result_at >= 1.0:
            self._told_result_at = t
            self._on_result(self._complete(self._pipeline.result()))

    def _tell_recording_problem(self) -> None:
        if self._writer and self._writer.problem != self._told_problem:
            self._told_problem = self._writer.problem
            self._pipeline.chain.note(self._told_problem)

    def _start_recording(self, path: Path) -> None:
        if self._writer is not None and self._writer.recording:
            return  # asked for twice before the first was done
        self._writer = TlogWriter(path)
        self._pipeline.chain.note(self._writer.problem or f"recording to {path}")

    def _do(self, action: Callable[[], None]) -> None:
        """What a user asks for may fail; it is told, and the flight goes on."""
        try:
            action()
        except (GcsSysidError, OSError) as error:
            self._pipeline.chain.note(f"not done: {error}")

    def _stop_recording(self) -> None:
        if self._writer:
            self._end_recording(self._writer)
            self._pipeline.chain.note(f"recording {self._writer.path} stopped")
            self._writer = None

    def _end_recording(self, writer: TlogWriter) -> None:
        """Close it, and leave no file behind in which there is nothing."""
        writer.close()
        self._recorded = None if writer.problem else writer.path
        line = writer.problem or f"recorded to {writer.path}"
        with contextlib.suppress(OSError):  # it never came to be, or is gone
            if writer.path.stat().st_size == 0:
                writer.path.unlink()
                self._recorded = None
                line = writer.problem or f"nothing was heard: {writer.path} is not kept"
        self._recordings.append(line)

    def _reset(self) -> None:
        mark = [reset_mark()]
        if self._writer:
            self._writer.write(time.time_ns() // 1000, mark)
        self._pipeline.take(mark)

    def _set_anchor(self, airframe: Airframe, anchor: Anchor) -> None:
        try:
            self._pipeline.chain.set_anchor(anchor)
        except InputError as error:
            self._pipeline.chain.note(f"the scale stays: {error}")
        else:
            self._airframe = airframe

    def _choose(self, vehicle: HeardVehicle) -> None:
        """Begin anew in every respect, so that the new recording's analysis ends the same."""
        self._station.leave()
        intake = self._pipeline.intake
        self._begin(vehicle.address)
        selector = self._pipeline.intake.selector
        for known in intake.selector.autopilots:  # the others stay to be chosen
            selector.systems[known.address], selector.frames[known.address] = known, 0
        self._told_result_at = 0.0
        self._pipeline.chain.note(f"chosen: {vehicle.name}; the session starts anew")
        if self._writer is not None and self._writer.recording:
            self._end_recording(self._writer)
            self._start_recording(unused_path(self._recording_stem))

    def _vehicles(self) -> tuple[HeardVehicle, ...]:
        selector = self._pipeline.intake.selector
        chosen = None if selector.chosen is None else selector.chosen.address
        return tuple(
            HeardVehicle(v.address, str(v), v.address == chosen) for v in selector.autopilots
        )

    def _advice(self) -> Advice | None:
        """The coach's; a defect of the coach is told once and costs no flight."""
        if self._coach is None:
            return None
        try:
            return self._coach.advise()
        except Exception as defect:  # noqa: BLE001 - words alone are lost
            self._coach = None
            kind = type(defect).__name__
            self._pipeline.chain.note(f"the coach fell silent ({kind}: {defect}): please report it")
            return None

    def _publish(self, state: LinkState) -> None:
        chain, intake = self._pipeline.chain, self._pipeline.intake
        health = intake.health()
        monitor = intake.monitor
        writer = self._writer
        recording = writer is not None and (
            writer.recording or (state is LinkState.ENDED and not writer.problem)
        )
        self._latest = Snapshot(
            t=chain.t,
            used_seconds=chain.used_seconds,
            flying=chain.sampler.flying,
            result=self.final or self._complete(self._pipeline.result()),
            course=chain.course,
            link=LinkStatus(
                state=state,
                url=str(self._link.url),
                vehicle=str(intake.vehicle or ""),
                rates=health.rates,
                asked=dict(self._station.asked),
                received=health.received,
                rejected=health.rejected,
                unknown=health.unknown,
                lost_percent=health.lost_percent,
                lost=monitor.lost,
                gaps=monitor.gap_count,
                last_gap=monitor.gaps[-1][1] if monitor.gaps else None,
                clock_ppm=intake.drift.ppm,
                vehicles=self._vehicles(),
                recording=str(writer.path) if writer and recording else "",
                bytes_per_second=health.bytes_per_second,
            ),
            attitude=chain.sampler.attitude,
            rates=chain.sampler.rates,
            rotor_speeds=chain.sampler.rotor_speeds,
            acceleration=self._prediction.acceleration(),
            target=(self._options.coach or CoachOptions()).target,
            events=chain.events,
            advice=self._advice(),
        )
