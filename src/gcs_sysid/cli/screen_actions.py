"""What the live screen can do, put together of session, exports and report."""

import argparse
from collections.abc import Mapping
from pathlib import Path

from gcs_sysid.cli.live_report import ReportJob, have_written
from gcs_sysid.cli.output import save
from gcs_sysid.errors import InputError
from gcs_sysid.exports.exported_vehicle import assemble
from gcs_sysid.exports.formats import TARGETS
from gcs_sysid.live.live_session import LiveSession
from gcs_sysid.live.replay_session import ReplaySession
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.results.result import Result
from gcs_sysid.screen import Actions
from gcs_sysid.telemetry.tlog_writer import unused_path

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
    path = unused_path(Path(f"{vehicle.name}{TARGETS[target].form.suffix}"))
    save(path, text, force=False)
    missing = "; what it lacks is said in the file" if TARGETS[target].notes(vehicle) else ""
    return f"Exported to {path}{missing}"


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
    command = _command(recording, target, session.airframe, vehicle, options)
    job = ReportJob(recording, target, session.airframe, vehicle, truth, command)
    have_written(job)
    return f"Report written to {target}"


def _command(
    recording: Path,
    target: Path,
    airframe: Airframe,
    vehicle: tuple[int, int | None] | None,
    options: argparse.Namespace,
) -> tuple[str, ...]:
    """The command line that makes the same report of the finished recording."""
    words = ["gcs-sysid", "analyze", str(recording), "--airframe", str(options.airframe)]
    if options.arm is not None:
        words += ["--arm", f"{options.arm:.9g}"]
    anchor = airframe.anchor()
    if anchor is not None:
        words += [_SCALE_OPTIONS[anchor[0]], f"{anchor[1]:.9g}"]
    for name, value, std in options.prior:
        words += ["--prior", f"{name}={value:.9g}+-{std:.9g}"]
    if vehicle is not None:
        words += ["--vehicle", ":".join(str(part) for part in vehicle if part is not None)]
    return (*words, "--report", str(target))


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
