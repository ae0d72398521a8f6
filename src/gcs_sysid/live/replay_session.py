"""The replay: a recorded flight once more, paced by the vehicle's clock, as snapshots.

A log is analyzed first: that gives its length, the autopilot's parameters in force, and its final
numbers. Then the same windows of it are taken at the pace wanted. How they are cut moves the
numbers by rounding alone; where the log ends, those of the analysis are shown. States of the chain
are kept to go back to.
"""

import math
import queue
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gcs_sysid.health.health_file import document_of
from gcs_sysid.health.whole_analysis import analyze_whole
from gcs_sysid.live.acceleration_prediction import KEPT, LivePrediction
from gcs_sysid.live.live_view import RESULT_EVERY, Session, picture
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.results.result import Result
from gcs_sysid.results.snapshot import FoundVehicle, LinkState, LinkStatus, Playback, speed_text
from gcs_sysid.session.chain import Chain, ChainOptions
from gcs_sysid.session.origin import Origin
from gcs_sysid.signals.columns import RecordBlock
from gcs_sysid.signals.sampling import SampleBlock
from gcs_sysid.telemetry.logs import Telemetry, open_log

_WINDOW = 2048
"""IMU samples. Only between windows can a state be kept, and at full speed the screen looks."""
_CHECKPOINTS = 6
"""States kept at most. Each is a chain with its whole record: 55 MB after some minutes."""
_APART = 10.0
"""s of the flight between them, at least."""


class LogSegments:
    """The windows of a log, cut finer where playback stops in them.

    `wanted` is system and perhaps component; None: the first autopilot in it.

    Raises:
        InputError: the file cannot be read as a log.

    Attributes:
        position: s of the vehicle's clock from the first record to the newest one taken. Goes on
            over a reboot.
        windows_taken: how many of the log's windows were taken up to now, or have been begun.
        telemetry: of the log, beside its records.
    """

    def __init__(self, path: Path, wanted: tuple[int, int | None] | None) -> None:
        log = open_log(path, wanted)
        self.telemetry: Telemetry = log
        self.position = 0.0
        self.windows_taken = 0
        self._windows: Iterator[RecordBlock] = (
            window for block in log.blocks() for window in block.windows(_WINDOW)
        )
        self._parts: deque[RecordBlock] = deque()
        self._newest: float | None = None
        self._recent: deque[tuple[float, float, Counter[str]]] = deque()

    @property
    def whole(self) -> bool:
        """Whether it stands between two windows, with none begun."""
        return not self._parts

    def next_end(self, until: float, piece: float) -> float | None:
        """The position after the next part; None at the end of the log.

        Args:
            until: position; a part that reaches beyond it is cut.
            piece: s, the length into which.
        """
        if self._next() is None:
            return None
        # Samples come evenly but where there is a pause: then each is a part of its own.
        for shortest in (False, True):
            part = self._parts[0]
            _, end = self._span(part)
            if end <= until or (shortest and end - self.position <= 2.0 * piece):
                break
            samples = 1 if shortest else _samples_in(part, piece)
            if samples < part.imu_samples:
                self._parts.popleft()
                self._parts.extendleft(reversed(list(part.windows(samples))))
        return self._span(self._parts[0])[1]

    def next_part(self) -> RecordBlock:
        """The next part, which must be there."""
        part = self._next()
        assert part is not None
        self._parts.popleft()
        start, end = self._span(part)
        if part.tracks:
            self._newest = max(float(track.t.max()) for track in part.tracks)
            self._count(part, start, end)
        self.position = end
        return part

    def skip(self, windows: int) -> None:
        """Pass so many windows over."""
        for _ in range(windows):
            self.next_part()

    def rates(self) -> dict[str, float]:
        """Samples a second of the flight by the name of their stream, over the last seconds."""
        if not self._recent:
            return {}
        counts = sum((count for _, _, count in self._recent), Counter[str]())
        seconds = self.position - self._recent[0][0]
        return {name: n / seconds for name, n in sorted(counts.items())} if seconds > 0.0 else {}

    def _next(self) -> RecordBlock | None:
        if not self._parts:
            window = next(self._windows, None)
            if window is None:
                return None
            self.windows_taken += 1
            self._parts.append(window)
        return self._parts[0]

    def _span(self, part: RecordBlock) -> tuple[float, float]:
        """Positions of the first and the last sample of the next part."""
        if not part.tracks:
            return self.position, self.position
        first = min(float(track.t.min()) for track in part.tracks)
        last = max(float(track.t.max()) for track in part.tracks)
        # Times more than a second back are of a clock that was set back (a reboot).
        newest = first if self._newest is None or first - self._newest < -1.0 else self._newest
        start, end = self.position + first - newest, self.position + last - newest
        return max(start, self.position), max(end, self.position)

    def _count(self, part: RecordBlock, start: float, end: float) -> None:
        counts: Counter[str] = Counter()
        for track in part.tracks:
            counts[track.source or track.stream.value] += len(track.t)
        self._recent.append((start, end, counts))
        # Rates are those of the last 5 s.
        while len(self._recent) > 1 and self._recent[1][0] < end - 5.0:
            self._recent.popleft()


def _samples_in(part: RecordBlock, seconds: float) -> int:
    """How many IMU samples of a part come in so many seconds; at least one."""
    imu = next((track.t for track in part.tracks if track.stream == "imu"), None)
    if imu is None or len(imu) < 2 or imu[-1] <= imu[0]:
        return part.imu_samples
    return max(int(seconds * (len(imu) - 1) / (imu[-1] - imu[0])), 1)


@dataclass(frozen=True)
class Recorded:
    """A log, and what its analysis says.

    Attributes:
        path: of the file.
        airframe: that it was analyzed with.
        wanted: system and perhaps component; None: the first autopilot in it.
        result: of all of it.
        duration: s from the first record to the last.
        options: that the analysis ended with: parameters that came late are known in them.
        health: a health file's content, by the hover of all of it.
    """

    path: Path
    airframe: Airframe
    wanted: tuple[int, int | None] | None
    result: Result
    duration: float
    options: ChainOptions
    health: dict[str, Any] | None = None


class _Survey:
    """An observer that records what a result does not hold."""

    def __init__(self) -> None:
        self.duration = 0.0
        self.options = ChainOptions()

    def begin(self) -> None:
        """As `Observer` says."""

    def take(self, block: SampleBlock) -> None:
        """As `Observer` says."""

    def end(self, chain: Chain) -> None:
        """As `Observer` says."""
        self.duration = chain.sampler.recorded or 0.0
        self.options = chain.options


def survey(
    path: Path,
    airframe: Airframe,
    wanted: tuple[int, int | None] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Recorded:
    """Analyze a log that will be played.

    Raises:
        InputError: the file cannot be read as a log.
    """
    seen = _Survey()
    found = analyze_whole(path, airframe, wanted, progress=progress, observers=[seen])
    health = document_of(found.health)
    return Recorded(path, airframe, wanted, found.result, seen.duration, seen.options, health)


@dataclass(frozen=True)
class _Checkpoint:
    position: float
    """s"""
    windows: int
    """Of the log, taken before it."""
    chain: Chain


class LogPlayback:
    """Gives a log to a chain, part by part.

    `history_interval` is s of the flight between estimates of the history.

    Raises:
        InputError: the file can no longer be read.

    Attributes:
        chain: that takes it; another one after `go_back`.
        log_segments: where the parts come from; another one after `go_back`.
    """

    def __init__(self, recorded: Recorded, history_interval: float) -> None:
        self._recorded = recorded
        self._options = replace(recorded.options, history_interval=history_interval)
        self._checkpoints: list[_Checkpoint] = []
        self.go_back(0.0)

    def play_part(self) -> None:
        """Take the next part, which must be there."""
        self.chain.take(self.log_segments.next_part())
        apart = max(_APART, self._recorded.duration / (_CHECKPOINTS + 1))
        position = self.log_segments.position
        last = self._checkpoints[-1].position if self._checkpoints else 0.0
        if self.log_segments.whole and position - last >= apart:
            state = _Checkpoint(position, self.log_segments.windows_taken, self.chain.copy())
            self._checkpoints.append(state)

    def go_back(self, position: float) -> None:
        """Stand at the latest state known from before `position`, in s, or at the beginning.

        Raises:
            InputError: the file can no longer be read.
        """
        recorded = self._recorded
        known = [state for state in self._checkpoints if state.position <= position]
        self.log_segments = LogSegments(recorded.path, recorded.wanted)
        origin = Origin(self.log_segments.telemetry, str(recorded.path), recorded.wanted)
        if known:
            self.chain = known[-1].chain.copy()
            self.chain.origin = origin
            self.log_segments.skip(known[-1].windows)
        else:
            self.chain = Chain(recorded.airframe, self._options, origin=origin)


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
        history_interval: s of the flight between estimates of the history.
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
        if self._changed and (wait >= _IDLE or self._clock() - self._published >= 0.2):
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
