"""A log as parts that follow each other, each with its time on the vehicle's clock."""

from collections import Counter, deque
from collections.abc import Iterator
from pathlib import Path

from gcs_sysid.session.pipeline import Pipeline
from gcs_sysid.signals.columns import RecordBlock
from gcs_sysid.telemetry.logs import Telemetry, open_log

_STEP_BACK = -1.0
"""s; times further back than this are of a clock that was set back (a reboot)."""
_RATES_OVER = 5.0
"""s that rates are taken over."""
_WINDOW = 2048
"""IMU samples. Only between windows can a state be kept, and at full speed the screen looks."""


class LogSegments:
    """The windows of a log, cut finer where playback stops in them.

    Args:
        path: of the log.
        wanted: system and perhaps component; None: the first autopilot in it.
        pipeline: that will take the parts; it is given the log.

    Raises:
        InputError: the file cannot be read as a log.

    Attributes:
        position: s of the vehicle's clock from the first record to the newest one taken. Goes on
            over a reboot.
        windows_taken: how many of the log's windows were taken up to now, or have been begun.
        telemetry: of the log, beside its records.
    """

    def __init__(self, path: Path, wanted: tuple[int, int | None] | None, pipeline: Pipeline):
        log = open_log(path, wanted)
        self.telemetry: Telemetry = log
        self.position = 0.0
        self.windows_taken = 0
        self._windows: Iterator[RecordBlock] = pipeline.windows(log, _WINDOW)
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

    def take(self) -> RecordBlock:
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
            self.take()

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
        newest = (
            first if self._newest is None or first - self._newest < _STEP_BACK else self._newest
        )
        start, end = self.position + first - newest, self.position + last - newest
        return max(start, self.position), max(end, self.position)

    def _count(self, part: RecordBlock, start: float, end: float) -> None:
        counts: Counter[str] = Counter()
        for track in part.tracks:
            counts[track.source or track.stream.value] += len(track.t)
        self._recent.append((start, end, counts))
        while len(self._recent) > 1 and self._recent[1][0] < end - _RATES_OVER:
            self._recent.popleft()


def _samples_in(part: RecordBlock, seconds: float) -> int:
    """How many IMU samples of a part come in so many seconds; at least one."""
    imu = next((track.t for track in part.tracks if track.stream == "imu"), None)
    if imu is None or len(imu) < 2 or imu[-1] <= imu[0]:
        return part.imu_samples
    return max(int(seconds * (len(imu) - 1) / (imu[-1] - imu[0])), 1)
