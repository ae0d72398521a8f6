"""A whole analysis of a log, read once: what is identified, and what hover shows beside it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gcs_sysid.health.assessment import HoverRecords, beside_analysis
from gcs_sysid.health.health_file import document_of
from gcs_sysid.health.vehicle_health import Health, HealthOptions
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.results.health_view import FirstAnswer, first_answer
from gcs_sysid.results.result import Result
from gcs_sysid.session.analysis import Observer, analyze_log
from gcs_sysid.session.chain import ChainOptions
from gcs_sysid.telemetry.logs import Log


@dataclass(frozen=True)
class WholeAnalysis:
    """What one log shows.

    Attributes:
        result: of the identification.
        health: of the same flight, withheld where the motion contradicts the airframe.
    """

    result: Result
    health: Health

    def named(self, log: str) -> "WholeAnalysis":
        """The same of a log that has another name for people."""
        return replace(self, result=replace(self.result, source=log))

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
    observers: Sequence[Observer] = (),
    *,
    name: str | None = None,
    opened: Log | None = None,
) -> WholeAnalysis:
    """Identify from a recording, and assess the hover in it.

    Args:
        log: its file.
        airframe: with a scale anchor.
        vehicle: system and perhaps component; None: the first autopilot in the log.
        options: of the chain; by default the estimate's history is not computed.
        progress: called with the share of the log done, 0 to 1, now and then.
        observers: look on.
        name: of the log for people; None: its path.
        opened: the log, opened by the caller.

    Raises:
        InputError: the file cannot be read as a log.
    """
    options = options or ChainOptions()
    keeper = HoverRecords()
    result = analyze_log(
        log, airframe, vehicle, options, progress, observers=observers, keeper=keeper,
        opened=opened,
    )  # fmt: skip
    found = keeper.health(name or str(log), HealthOptions(airframe), (options.start, options.end))
    return WholeAnalysis(result, beside_analysis(found, result))
