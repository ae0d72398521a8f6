"""A log in the chain, with states kept to go back to."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gcs_sysid.health.assessment import HoverRecords, beside_analysis
from gcs_sysid.health.health_file import document_of
from gcs_sysid.health.vehicle_health import Given
from gcs_sysid.live.log_segments import LogSegments
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.results.result import Result
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.session.chain import Chain, ChainOptions
from gcs_sysid.session.pipeline import Pipeline
from gcs_sysid.signals.sampling import SampleBlock

_CHECKPOINTS = 6
"""States kept at most. Each is a chain with its whole record: 55 MB after some minutes."""
_APART = 10.0
"""s of the flight between them, at least."""


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
    result = analyze_log(path, airframe, wanted, progress=progress, observer=seen, keeper=hover)
    found = hover.health(str(path), Given(airframe))
    health = document_of(beside_analysis(found, result.verdict, result.reasons))
    return Recorded(path, airframe, wanted, result, seen.duration, seen.options, health)


@dataclass(frozen=True)
class _Checkpoint:
    position: float
    """s"""
    windows: int
    """Of the log, taken before it."""
    pipeline: Pipeline


class LogPlayback:
    """Gives a log to a chain, part by part.

    Args:
        recorded: the log.
        course_interval: s of the flight between estimates of the history.

    Raises:
        InputError: the file can no longer be read.

    Attributes:
        pipeline: that takes it; another one after `go_back`.
        log: where the parts come from; another one after `go_back`.
    """

    def __init__(self, recorded: Recorded, history_interval: float) -> None:
        self._recorded = recorded
        self._options = replace(recorded.options, history_interval=history_interval)
        self._checkpoints: list[_Checkpoint] = []
        self.go_back(0.0)

    def take(self) -> None:
        """Take the next part, which must be there."""
        self.pipeline.take_window(self.log_segments.take())
        apart = max(_APART, self._recorded.duration / (_CHECKPOINTS + 1))
        position = self.log_segments.position
        last = self._checkpoints[-1].position if self._checkpoints else 0.0
        if self.log_segments.whole and position - last >= apart:
            state = _Checkpoint(position, self.log_segments.windows_taken, self.pipeline.copy())
            self._checkpoints.append(state)

    def go_back(self, position: float) -> None:
        """Stand at the latest state known from before `position`, in s, or at the beginning.

        Raises:
            InputError: the file can no longer be read.
        """
        recorded = self._recorded
        known = [state for state in self._checkpoints if state.position <= position]
        if known:
            self.pipeline = known[-1].pipeline.copy()
        else:
            self.pipeline = Pipeline(
                recorded.airframe, str(recorded.path), recorded.wanted, self._options
            )
        self.log_segments = LogSegments(recorded.path, recorded.wanted, self.pipeline)
        if known:
            self.log_segments.skip(known[-1].windows)
