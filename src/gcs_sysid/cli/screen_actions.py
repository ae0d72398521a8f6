"""What the live screen can do, put together of session, exports and report."""

import argparse
import contextlib
import io
import multiprocessing
import shutil
import tempfile
from collections.abc import Mapping
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

from gcs_sysid.cli.export import save
from gcs_sysid.cli.live import Session
from gcs_sysid.cli.reporting import Reporter
from gcs_sysid.errors import InputError
from gcs_sysid.exports.targets import TARGETS
from gcs_sysid.exports.vehicle import assemble
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.screen import Actions, Baseline
from gcs_sysid.screen.scene import Scene
from gcs_sysid.screen.widgets.transport import Transport
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.session.chain import ChainOptions
from gcs_sysid.session.live import LiveSession
from gcs_sysid.session.replay import ReplaySession
from gcs_sysid.session.result import Result
from gcs_sysid.telemetry.tlog import unused_path

SUFFIXES = {
    "px4-sih": ".params",
    "gazebo-sdf": ".sdf",
    "urdf": ".urdf",
    "mjcf": ".xml",
    "rotorpy": ".py",
}
_SCALE_OPTIONS = {"mass": "--mass", "k_T": "--k-t", "T_max": "--t-max"}


def export_result(target: str, result: Result) -> str:
    """Write a result for a simulator, into a file of the present folder that was not there.

    Args:
        target: one of `TARGETS`.
        result: as it is at this moment.

    Raises:
        GcsSysidError: it does not tell what the format needs, or the file cannot be written.
    """
    vehicle = assemble(result)
    text = TARGETS[target].write(vehicle)
    path = unused_path(Path(f"{vehicle.name}{SUFFIXES[target]}"))
    save(path, text, force=False)
    missing = "; what it lacks is said in the file" if TARGETS[target].notes(vehicle) else ""
    return f"Exported to {path}{missing}"


@dataclass(frozen=True)
class ReportJob:
    """A report to be made by another process.

    Attributes:
        recording: that it is of; may still be growing.
        target: file to write, not there yet.
        airframe: with the anchor in force.
        vehicle: system and component; None: the first autopilot heard.
        truth: of an emulated vehicle.
        command: that would make it again.
    """

    recording: Path
    target: Path
    airframe: Airframe
    vehicle: tuple[int, int] | None
    truth: Mapping[str, float] | None
    command: tuple[str, ...]


def write_report(job: ReportJob) -> None:
    """Write the report of a recording as it is at this moment.

    Raises:
        InputError: the recording tells nothing, or the file cannot be written.
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
            argv=job.command,
        )
        reporter = Reporter(options, job.airframe, job.truth)
        # The screen has the terminal: no progress is told there.
        with contextlib.redirect_stderr(io.StringIO()), reporter as observer:
            course = ChainOptions(course_interval=reporter.course_interval)
            found = analyze_log(log, job.airframe, job.vehicle, course, observer=observer)
            reporter.write(replace(found, source=str(job.recording)))


def report_session(
    session: LiveSession | ReplaySession,
    truth: Mapping[str, float] | None,
    options: argparse.Namespace,
) -> str:
    """Write a report of a session's recording so far, or of the log, beside it; says where.

    Raises:
        InputError: there is no recording, or it tells nothing yet.
    """
    recording = session.flushed_recording()
    if recording is None:
        raise InputError("a report is made of the recording, and there is none: R starts one")
    target = unused_path(recording.with_suffix(".html"))
    snapshot = session.latest()
    heard = () if snapshot is None else snapshot.link.vehicles
    vehicle = next((v.address for v in heard if v.chosen), None)
    command = _command(recording, target, session.airframe, options)
    job = ReportJob(recording, target, session.airframe, vehicle, truth, command)
    # In a process of its own: an analysis at full speed would hold up the session's thread.
    context = multiprocessing.get_context("spawn")
    try:
        with ProcessPoolExecutor(1, context) as pool:
            pool.submit(write_report, job).result()
    except BrokenExecutor as error:
        raise InputError(f"the process that made the report ended: {error}") from error
    return f"Report written to {target}"


def _command(
    recording: Path, target: Path, airframe: Airframe, options: argparse.Namespace
) -> tuple[str, ...]:
    """The command line that makes the same report of the finished recording."""
    words = ["gcs-sysid", "analyze", str(recording), "--airframe", str(options.airframe)]
    if options.arm is not None:
        words += ["--arm", f"{options.arm:g}"]
    anchor = airframe.anchor()
    if anchor is not None:
        words += [_SCALE_OPTIONS[anchor[0]], f"{anchor[1]:.9g}"]
    for name, value, std in options.prior:
        words += ["--prior", f"{name}={value:g}+-{std:g}"]
    return (*words, "--report", str(target))


def scene_of(
    session: Session,
    truth: Mapping[str, float] | None,
    options: argparse.Namespace,
    baseline: Result | None,
) -> Scene:
    """What the screen of a session shows and offers."""
    known = None if baseline is None else Baseline(options.baseline, baseline)
    if isinstance(session, ReplaySession):
        actions, transport = replay_actions(session, truth, options), transport_of(session)
        return Scene(truth or {}, actions, transport, known)
    assert isinstance(session, LiveSession)
    return Scene(truth or {}, live_actions(session, truth, options), None, known)


def transport_of(session: ReplaySession) -> Transport:
    """What moves a replay."""
    return Transport(session.toggle_pause, session.change_speed, session.seek, session.skip)


def replay_actions(
    session: ReplaySession, truth: Mapping[str, float] | None, options: argparse.Namespace
) -> Actions:
    """What can be done with a recorded flight: nothing that would change its numbers."""
    return Actions(
        export=export_result,
        export_targets=tuple(TARGETS),
        report=lambda: report_session(session, truth, options),
        absent="in a replay",
    )


def live_actions(
    session: LiveSession, truth: Mapping[str, float] | None, options: argparse.Namespace
) -> Actions:
    """All that can be done with a live session."""
    return Actions(
        mark=session.mark,
        reset=session.reset,
        toggle_recording=session.toggle_recording,
        set_anchor=session.set_anchor,
        choose_vehicle=session.choose_vehicle,
        export=export_result,
        export_targets=tuple(TARGETS),
        report=lambda: report_session(session, truth, options),
    )
