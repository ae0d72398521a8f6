"""The replay: a recorded flight once more, paced by the vehicle's clock, as snapshots.

A log is analyzed first: that gives its length, the autopilot's parameters in force, and its final
numbers. Then the same windows of it are taken at the pace wanted. How they are cut moves the
numbers by rounding alone; where the log ends, those of the analysis are shown.
"""

import math
import queue
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from gcs_sysid.live.acceleration_prediction import KEPT, LivePrediction
from gcs_sysid.live.live_view import RESULT_EVERY, Session, picture
from gcs_sysid.live.log_playback import LogPlayback, LogSegments, Recorded
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.results.result import Result
from gcs_sysid.results.snapshot import (
    FoundVehicle,
    LinkState,
    LinkStatus,
    Playback,
    speed_text,
)
from gcs_sysid.session.chain import Chain
from gcs_sysid.signals.sampling import SampleBlock

SPEEDS = (1.0, 10.0, math.inf)
"""Seconds of the flight in one second."""
_PIECE = 0.1
"""s between looks at the clock; so much of the flight, times the speed, is taken at once."""
_SEEN = KEPT + 5.0
"""s of the flight before where it stops that are seen there, filters' settling included."""
_IDLE = 1.0
"""s to wait where nothing is due; an action wakes."""


class ReplaySession(Session):
    """Plays a log, in a thread of its own.

    Args:
        recorded: the log, as `survey` knows it.
        speed: one of `SPEEDS`.
        course_interval: s of the flight between estimates of the history.
        target: half the 95 % interval, as a share of its value, that every parameter is to reach.
        stay: whether to wait at the end of the log for a seek; else the session ends there.
        clock: s that only grow; tests put their own here.
        on_result: called in the session's thread, once a second of the flight.

    Raises:
        InputError: the file can no longer be read.
    """

    def __init__(
        self,
        recorded: Recorded,
        speed: float = 1.0,
        history_interval: float = 0.2,
        target: float = 0.02,
        *,
        stay: bool = True,
        clock: Callable[[], float] = time.monotonic,
        on_result: Callable[[Result], None] | None = None,
    ) -> None:
        super().__init__("replay")
        self._recorded = recorded
        self._target = target
        self._stay = stay
        self._clock = clock
        self._on_result = on_result
        self._result_reported_at = 0.0
        self._speed = speed
        self._paused = self._ended = False
        self._asked_speed, self._asked_paused = speed, False
        self._goal: float | None = None
        self._asked_goal: float | None = None
        self._playback = LogPlayback(recorded, history_interval)
        self._actions: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._published = -math.inf
        self._changed = False
        self._begin()

    # -- the session, as the screen and the command line see it

    def start(self) -> None:
        """Publish a first snapshot, and begin."""
        self._set_pace(self._speed, self._paused)
        self._publish()
        self._thread.start()

    @property
    def airframe(self) -> Airframe:
        """That the log was analyzed with."""
        return self._recorded.airframe

    def recordings(self) -> list[str]:
        """None: what is played is recorded already."""
        return []

    def flushed_recording(self) -> Path:
        """The log."""
        return self._recorded.path

    # -- what a user may do; each returns what happens, in words

    def toggle_pause(self) -> str:
        """Pause, or continue; from the end, restart."""
        if self._ended and self._goal is None:
            self._asked_paused = False
            self._do(lambda: self._seek(0.0, paused=False))
            return "Replay restarted."
        self._asked_paused = paused = not self._asked_paused
        self._do(lambda: self._set_pace(self._speed, paused))
        return "Replay paused." if paused else "Replay resumed."

    def change_speed(self, step: int) -> str:
        """Faster by so many of the `SPEEDS`, or slower."""
        index = min(max(SPEEDS.index(self._asked_speed) + step, 0), len(SPEEDS) - 1)
        self._asked_speed = speed = SPEEDS[index]
        self._do(lambda: self._set_pace(speed, self._paused))
        return f"Speed: {speed_text(speed)}"

    def seek(self, position: float) -> str:
        """Go to `position` s of the flight."""
        self._asked_goal = goal = min(max(position, 0.0), self._duration)
        self._do(lambda: self._seek(goal, self._paused))
        return f"To {goal:.0f} s of {self._duration:.0f} s."

    def skip(self, seconds: float) -> str:
        """Go `seconds` on from here, or from where it is on its way to."""
        goal = self._asked_goal
        return self.seek((self._position if goal is None else goal) + seconds)

    def _do(self, action: Callable[[], None]) -> None:
        self._actions.put(action)
        self._wake.set()

    # -- the work, in the session's thread

    def _run(self) -> None:
        try:
            while not self._stop.is_set() and (self._stay or not self._ended):
                wait = self.step()
                if wait > 0.0:
                    self._wake.wait(wait)
                    self._wake.clear()
        except Exception as problem:  # noqa: BLE001 - handed to the main thread, which reports it
            self.problem = problem
        finally:
            try:
                self.final = self._recorded.result if self._ended else self._chain.finish()
            except Exception as problem:  # noqa: BLE001 - as above
                self.problem = self.problem or problem
            self._ended = True
            self._publish()

    def step(self) -> float:
        """Do what is due, at most one part of the log; s until something is due again."""
        while not self._actions.empty():
            self._actions.get()()
            self._changed = True
        wait = self._advance()
        if self._changed and (wait >= _IDLE or self._is_publishing_due()):
            self._publish()
        return wait

    def _advance(self) -> float:
        playback, goal = self._playback, self._goal
        if self._ended or (self._paused and goal is None):
            return _IDLE
        until, piece = self._due(), _PIECE * self._speed
        if goal is not None:
            until, piece = goal, _PIECE
        stop = until
        if self._on_result is not None:
            stop = min(until, self._result_reported_at + RESULT_EVERY)
            piece = min(piece, 0.25 * RESULT_EVERY)
        end = playback.log_segments.next_end(stop, piece)
        if end is None:
            self._end()
            return 0.0
        if end > until:
            return self._wait(playback.log_segments, end, until)
        playback.play_part()
        self._changed = True
        self._report_result()
        return 0.0

    def _wait(self, log_segments: LogSegments, end: float, until: float) -> float:
        """Seconds until the part that ends at `end` is due, when the flight has come to `until`."""
        if self._goal is not None:
            self._arrive()
            return 0.0
        silence = end - log_segments.position
        # Of longer silences the rest is skipped.
        if silence > 3.0 + _PIECE * self._speed:
            self._chain.note(f"no data for {silence:.0f} s: skipped")
            self._anchor = (self._clock(), end)
            return 0.0
        # Rounding would ask for less than any clock resolves.
        return max((end - until) / self._speed, 1e-3)

    def _due(self) -> float:
        """Seconds of the flight that the clock has reached."""
        if math.isinf(self._speed):
            return math.inf
        began, position = self._anchor
        return position + (self._clock() - began) * self._speed

    def _set_pace(self, speed: float, paused: bool) -> None:
        self._speed, self._paused = speed, paused
        self._anchor = (self._clock(), self._position)

    def _seek(self, goal: float, paused: bool) -> None:
        to_end = goal >= self._duration
        if goal < self._position or (self._ended and not to_end):
            self._playback.go_back(goal)
            self._begin()
        self._paused = paused
        self._goal = None if self._ended else math.inf if to_end else goal

    def _arrive(self) -> None:
        self._goal = None
        if self._actions.empty():
            self._asked_goal = None
        self._anchor = (self._clock(), self._position)
        self._changed = True

    def _begin(self) -> None:
        """Go on from where the playback stands now."""
        self._ended = False
        self._prediction = LivePrediction(self._chain)
        self._chain.observers[:] = [self._look]
        self._result_reported_at = self._position
        self._anchor = (self._clock(), self._position)

    def _look(self, block: SampleBlock) -> None:
        """Predict what will be shown; while seeking nothing is shown, and it costs as much."""
        until = self._goal if self._goal is not None else self._due()
        if min(until, self._duration) - block.t[-1] < _SEEN:
            self._prediction.add_samples(block)

    def _end(self) -> None:
        self._chain.finish()
        self._ended = True
        self._arrive()

    @property
    def _position(self) -> float:
        return self._playback.log_segments.position

    @property
    def _duration(self) -> float:
        return self._recorded.duration

    @property
    def _chain(self) -> Chain:
        return self._playback.chain

    # -- what others see

    def _report_result(self) -> None:
        due = self._result_reported_at + RESULT_EVERY
        if self._on_result is not None and self._position >= due:
            late = self._position - due
            self._result_reported_at = due + late // RESULT_EVERY * RESULT_EVERY
            self._on_result(self._chain.result())

    def _is_publishing_due(self) -> bool:
        return self._clock() - self._published >= 0.2

    def _publish(self) -> None:
        result = self._recorded.result if self._ended else self._chain.result()
        seen = self._prediction.acceleration()
        self._latest = replace(
            picture(self._chain, self.final or result, self._link(), seen, self._target, None),
            playback=Playback(
                position=self._position,
                duration=self._duration,
                speed=self._speed,
                paused=self._paused,
                seeking=self._goal if self._goal is None else min(self._goal, self._duration),
                ended=self._ended,
            ),
            health=self._recorded.health,
        )
        self._published = self._clock()
        self._changed = False

    def _link(self) -> LinkStatus:
        """Of the log: rates where the replay stands, losses of the whole."""
        whole = self._recorded.result.telemetry
        gaps = whole.get("imu_gaps", {})
        log_segments = self._playback.log_segments
        vehicle = log_segments.telemetry.vehicle
        received = () if vehicle is None else (FoundVehicle(vehicle.address, str(vehicle), True),)
        return LinkStatus(
            state=LinkState.ENDED if self._ended else LinkState.REPLAY,
            url=str(self._recorded.path),
            vehicle=str(vehicle or ""),
            rates=log_segments.rates(),
            received=whole.get("received", 0),
            rejected=whole.get("bad_crc", 0),
            unknown=whole.get("unknown", 0),
            lost_percent=whole.get("lost_percent", 0.0),
            lost=whole.get("lost", 0),
            gaps=gaps.get("count", 0),
            last_gap=gaps["last"][-1]["length"] if gaps.get("last") else None,
            clock_ppm=whole.get("clock_drift_ppm"),
            vehicles=received,
        )
