"""The report of a log: what it needs is gathered while the log is analyzed, then it is written.

    python -m gcs_sysid.web.log_report < JOB

makes the report of a recording that may still be growing in a process of its own; JOB is a pickled
`ReportJob`. In the session's process an analysis at full speed would hold up the session; and what
that process has for a terminal belongs to the screen.
"""

import pickle
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from gcs_sysid.errors import GcsSysidError, InputError, NoAnswerError
from gcs_sysid.files import write_whole
from gcs_sysid.health.whole_analysis import WholeAnalysis, analyze_whole
from gcs_sysid.inspection.inspector import inspect_log
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.report.data import ReportData, predicted, provenance_of
from gcs_sysid.report.evidence_sections import twin_svg
from gcs_sysid.report.page import render
from gcs_sysid.results.result import Result
from gcs_sysid.session.analysis import Observer
from gcs_sysid.session.chain import HISTORY_INTERVAL, ChainOptions
from gcs_sysid.twin.held_out_flight import fly_own_flight
from gcs_sysid.twin.measured_flight import FlightRecorder
from gcs_sysid.twin.twin_flight import TwinFlight


@dataclass(frozen=True)
class ReportJob:
    """A report to be made.

    Attributes:
        log: that it is of; may still be growing.
        target: file to write.
        airframe: with its anchor.
        command: that makes it.
        vehicle: system and component; None: the first autopilot found.
        truth: of an emulated vehicle.
        start: s after the first record, from which the log is analyzed.
        force: whether a file that is there may be replaced.
    """

    log: Path
    target: Path
    airframe: Airframe
    command: tuple[str, ...]
    vehicle: tuple[int, int | None] | None = None
    truth: Mapping[str, float] = field(default_factory=dict)
    start: float = 0.0
    force: bool = False


class Reporter:
    """Looks on while a log is analyzed; as a context, the observers to hand over."""

    def __init__(self, job: ReportJob) -> None:
        self._job = job
        # Half an hour at 250 Hz takes 80 MB in the twin.
        self._recorder = FlightRecorder(longest=1800.0)

    def __enter__(self) -> Sequence[Observer]:
        return (self._recorder,)

    def __exit__(self, *_: object) -> None:
        self._recorder.close()

    def write(self, found: WholeAnalysis, progress: Callable[[float], None] | None = None) -> None:
        """Write the report of the log analyzed, under the name that its result has for it.

        Raises:
            InputError: the file cannot be written, or has come into being meanwhile.
        """
        job, result = self._job, found.result
        inspection = inspect_log(job.log, job.vehicle, progress).as_json()
        provenance = provenance_of(job.command, job.log)
        data = ReportData(
            result,
            inspection,
            job.airframe,
            provenance,
            self._recorder.history,
            predicted(result, self._recorder, job.airframe),
            job.truth,
            self._recorder.notes,
            found.health_document or {},
        )
        twin = self._twin(result)
        if twin is not None:
            name = Path(result.source).name
            shown = replace(twin, source="the fit to the first part", log=name)
            data = replace(data, twin=twin.as_json(), twin_picture=twin_svg(shown))
        write_whole(job.target, render(data), replace=job.force)

    def _twin(self, result: Result) -> TwinFlight | None:
        """The model beside the vehicle; None where it cannot fly, or nothing was held out."""
        if result.verdict == "refused":
            return None
        job = self._job
        try:
            return fly_own_flight(
                result, self._recorder, job.log, job.airframe, job.vehicle, job.start
            )
        except (NoAnswerError, InputError):
            return None


def have_written(job: ReportJob) -> None:
    """Have another process write a report, and wait for it.

    Raises:
        InputError: the recording has no result, or the file cannot be written.
    """
    done = subprocess.run(
        [sys.executable, "-P", "-m", "gcs_sysid.web.log_report"],
        input=pickle.dumps(job),
        capture_output=True,
        check=False,
    )
    if done.returncode:
        lines = done.stderr.decode("utf-8", "replace").strip().splitlines()
        raise InputError(lines[-1] if lines else f"no report: status {done.returncode}")


def write(job: ReportJob) -> None:
    """Write the report of a recording as it is at this moment.

    Raises:
        InputError: see `have_written`.
    """
    # What is recorded meanwhile must not come in between analysis and figures.
    with tempfile.TemporaryDirectory(prefix="gcs-sysid-") as folder:
        log = Path(folder) / job.log.name
        shutil.copyfile(job.log, log)
        reporter = Reporter(replace(job, log=log))
        with reporter as observers:
            history = ChainOptions(history_interval=HISTORY_INTERVAL)
            found = analyze_whole(
                log, job.airframe, job.vehicle, history, observers=observers, name=str(job.log)
            )
            reporter.write(found.named(str(job.log)))


def main() -> int:
    """Do the job on standard input; the exit status."""
    try:
        write(pickle.load(sys.stdin.buffer))
    except (GcsSysidError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
