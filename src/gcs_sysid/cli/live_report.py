"""A report of a recording that may still be growing, made by a process of its own.

    python -m gcs_sysid.cli.live_report < JOB

JOB is a pickled `ReportJob`. In the session's process an analysis at full speed would hold up
the session; and what that process has for a terminal belongs to the screen.
"""

import argparse
import pickle
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from gcs_sysid.cli.reporting import Reporter
from gcs_sysid.errors import GcsSysidError, InputError
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.session.chain_options import ChainOptions


@dataclass(frozen=True)
class ReportJob:
    """A report to be made.

    Attributes:
        recording: that it is of; may still be growing.
        target: file to write, not there yet.
        airframe: with the anchor in force.
        vehicle: system and component; None: the first autopilot found.
        truth: of an emulated vehicle.
        command: that would make it again.
    """

    recording: Path
    target: Path
    airframe: Airframe
    vehicle: tuple[int, int] | None
    truth: Mapping[str, float] | None
    command: tuple[str, ...]


def have_written(job: ReportJob) -> None:
    """Have another process write a report, and wait for it.

    Raises:
        InputError: the recording has no result, or the file cannot be written.
    """
    done = subprocess.run(
        [sys.executable, "-P", "-m", "gcs_sysid.cli.live_report"],
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
        log = Path(folder) / job.recording.name
        shutil.copyfile(job.recording, log)
        options = argparse.Namespace(
            logs=[str(log)],
            report=str(job.target),
            json=None,
            truth=None,
            airframe=None,
            force=False,
            vehicle=job.vehicle,
            start=0.0,
            argv=job.command,
        )
        reporter = Reporter(options, job.airframe, job.truth)
        with reporter as observer:
            history = ChainOptions(history_interval=reporter.history_interval)
            found = analyze_log(log, job.airframe, job.vehicle, history, observer=observer)
            reporter.write(replace(found, source=str(job.recording)))


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
