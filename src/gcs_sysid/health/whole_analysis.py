"""A whole analysis of a log, read once: what is identified, and what hover shows beside it."""

import contextlib
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gcs_sysid.health.assessment import HoverRecords, beside_analysis, health_of_log
from gcs_sysid.health.health_file import document_of
from gcs_sysid.health.vehicle_health import Health, HealthOptions
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.results.health_view import FirstAnswer, first_answer
from gcs_sysid.results.result import Result
from gcs_sysid.session.analysis import Observer, analyze_log
from gcs_sysid.session.chain_options import ChainOptions

_LONG_LOG = 40_000_000
"""Bytes: 9 minutes at 250 Hz, whose hover takes longer to assess than a process to start."""


@dataclass(frozen=True)
class WholeAnalysis:
    """What one log shows.

    Attributes:
        result: of the identification.
        health: of the same flight, withheld where the motion contradicts the airframe.
    """

    result: Result
    health: Health

    @property
    def answer(self) -> FirstAnswer:
        """The first line on the flight."""
        return first_answer(document_of(self.health), self.result)

    @property
    def health_document(self) -> dict[str, Any] | None:
        """A health file's content; None where nothing hovers."""
        return document_of(self.health) if self.health.reported else None

    def as_json(self) -> dict[str, Any]:
        """The result as its file has it, with the health."""
        health = self.health_document
        document = {**self.result.as_json(), "summary": self.answer.as_json()}
        return document if health is None else {**document, "health": health}


def analyze_whole(
    log: Path,
    airframe: Airframe,
    vehicle: tuple[int, int | None] | None = None,
    options: ChainOptions | None = None,
    progress: Callable[[float], None] | None = None,
    observer: Observer | None = None,
    *,
    name: str | None = None,
    in_two_processes: bool = False,
) -> WholeAnalysis:
    """Identify from a recording, and assess the hover in it.

    Args:
        log: its file.
        airframe: with a scale anchor.
        vehicle: system and perhaps component; None: the first autopilot in the log.
        options: of the chain; by default the estimate's history is not computed.
        progress: called with the share of the log done, 0 to 1, now and then.
        observer: looks on.
        name: of the log for people; None: its path.
        in_two_processes: whether another process may read a long log and assess its hover, where
            a processor is free. The numbers are the same.

    Raises:
        InputError: the file cannot be read as a log.
    """
    options = options or ChainOptions(history_interval=None)
    given, span = HealthOptions(airframe), (options.start, options.end)
    with contextlib.ExitStack() as stack:
        reader = None
        if in_two_processes and _is_long(log) and _processors() > 1:
            from gcs_sysid.health.reader_process import ReaderProcess  # only long logs wait for it

            with contextlib.suppress(OSError):  # no process can be started
                reader = ReaderProcess(log, vehicle, given, span)
                stack.callback(reader.close)
        keeper = HoverRecords() if reader is None else None
        opened = None if reader is None else reader.log
        result = analyze_log(
            log, airframe, vehicle, options, progress, observer=observer, keeper=keeper,
            opened=opened,
        )  # fmt: skip
        if keeper is not None:
            found = keeper.health(str(log), given, span)
        else:
            assert reader is not None
            # Where the other process was ended, the log is read again here.
            found = reader.health() or health_of_log(log, given, vehicle, span)
    found = replace(found, source=name or str(log))
    return WholeAnalysis(result, beside_analysis(found, result))


def _is_long(log: Path) -> bool:
    try:
        return log.stat().st_size >= _LONG_LOG
    except OSError:  # a table and its mapping, or what the analysis will complain of
        return False


def _processors() -> int:
    """Of this machine, that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
