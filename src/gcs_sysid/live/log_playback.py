"""A log in the chain, part by part on the vehicle's clock, with states kept to go back to."""

from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gcs_sysid.health.assessment import HoverRecords, beside_analysis
from gcs_sysid.health.health_file import document_of
from gcs_sysid.health.vehicle_health import HealthOptions
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.results.result import Result
from gcs_sysid.session.analysis import analyze_log
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

    Args:
        path: of the log.
        wanted: system and perhaps component; None: the first autopilot in it.

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

    Args:
        path: of the file.
        airframe: with a scale anchor.
        wanted: as of `analyze_log`.
        progress: as of `analyze_log`.

    Raises:
        InputError: the file cannot be read as a log.
    """
    seen, hover = _Survey(), HoverRecords()
    result = analyze_log(path, airframe, wanted, progress=progress, observers=[seen], keeper=hover)
    found = hover.health(str(path), HealthOptions(airframe))
    health = document_of(beside_analysis(found, result))
    return Recorded(path, airframe, wanted, result, seen.duration, seen.options, health)


@dataclass(frozen=True)
class _Checkpoint:
    position: float
    """s"""
    windows: int
    """Of the log, taken before it."""
    chain: Chain


class LogPlayback:
    """Gives a log to a chain, part by part.

    Args:
        recorded: the log.
        course_interval: s of the flight between estimates of the history.

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
