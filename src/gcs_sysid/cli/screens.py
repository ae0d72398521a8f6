"""The screen of a session, on a terminal or in browsers: shown, and what can be done on it.

What only a page, a report or an export needs is loaded for that: the first frame does not wait.
"""

import argparse
import threading
from collections.abc import Mapping
from pathlib import Path

from gcs_sysid.argument_types import given_words
from gcs_sysid.cli import output
from gcs_sysid.cli.airframe_choice import given_scale
from gcs_sysid.cli.commands import EXPORT_TARGETS
from gcs_sysid.cli.headless import say_until_end
from gcs_sysid.cli.output import on_signals, say_addresses
from gcs_sysid.errors import InputError
from gcs_sysid.files import write_whole
from gcs_sysid.live.live_session import LiveSession
from gcs_sysid.live.live_view import Session
from gcs_sysid.live.replay_session import ReplaySession
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.results.result import Result
from gcs_sysid.screen import EarlierResult, Scene, app_of
from gcs_sysid.screen.call_outs import Announcer
from gcs_sysid.telemetry.tlog_writer import unused_path


def show(
    session: Session,
    truth: Mapping[str, float] | None,
    options: argparse.Namespace,
    baseline: Result | None,
    announcer: Announcer | None,
) -> None:
    """Show a session until it ends; a screen that fails costs no flight.

    A defect of the screen becomes the session's problem, where it has none of its own.

    Raises:
        InputError: there is no serving a page there.
    """
    scene = scene_of(session, truth, options, baseline, announcer)
    if options.web:
        _serve(session, scene, options.web)
    else:
        _show_on_terminal(session, scene)


def scene_of(
    session: Session,
    truth: Mapping[str, float] | None,
    options: argparse.Namespace,
    baseline: Result | None,
    announcer: Announcer | None = None,
) -> Scene:
    """The scene of a live session or a replay."""
    return Scene(
        truth or {},
        session if isinstance(session, LiveSession) else None,
        session if isinstance(session, ReplaySession) else None,
        export_result,
        EXPORT_TARGETS,
        lambda: report_session(session, truth, options),
        None if baseline is None else EarlierResult(options.baseline, baseline),
        announcer,
        options.pilot,
    )


def export_result(target: str, result: Result) -> str:
    """Write a result for a simulator, into a file of the present folder that was not there.

    Raises:
        GcsSysidError: it lacks what the format needs, or the file cannot be written.
    """
    from gcs_sysid.exports import FORMATS
    from gcs_sysid.exports.exported_vehicle import assemble

    vehicle = assemble(result)
    text = FORMATS[target].write(vehicle)
    path = unused_path(Path(f"{vehicle.name}{FORMATS[target].suffix}"))
    write_whole(path, text, replace=False)
    missing = "; see its header for what is missing" if FORMATS[target].notes(vehicle) else ""
    return f"Exported to {path}{missing}"


def report_session(
    session: Session,
    truth: Mapping[str, float] | None,
    options: argparse.Namespace,
) -> str:
    """Write a report of a session's recording so far, or of the log, beside it; says where.

    Raises:
        InputError: there is no recording, or no result from it yet.
    """
    from gcs_sysid.web.log_report import ReportJob, have_written

    recording = session.flushed_recording()
    if recording is None:
        raise InputError("no recording to report on: o starts one")
    target = unused_path(recording.with_suffix(".html"))
    snapshot = session.latest()
    received = () if snapshot is None else snapshot.link.vehicles
    vehicle = next((v.address for v in received if v.chosen), None)
    command = _command(recording, target, session.airframe, vehicle, options)
    job = ReportJob(recording, target, session.airframe, command, vehicle, truth or {})
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
        words += given_words("arm", options.arm)
    anchor, given = airframe.anchor(), given_scale(options)
    if anchor is not None:
        sigma = None if given is None else getattr(given[1], "sigma", None)
        words += given_words(*anchor, sigma=sigma)
    for name, value, std in options.prior:
        words += ["--prior", f"{name}={value:.9g}+-{std:.9g}"]
    if vehicle is not None:
        words += ["--vehicle", ":".join(str(part) for part in vehicle if part is not None)]
    return (*words, "--report", str(target))


def _show_on_terminal(session: Session, scene: Scene) -> None:
    app = app_of(session, scene)
    stopped = threading.Event()

    def stop() -> None:
        stopped.set()
        app.exit()
        if app.defect is not None:
            session.request_stop()

    with on_signals(stop):
        session.start()
        try:
            if not stopped.is_set():
                app.run()
            if app.defect is not None and not stopped.is_set() and not app.is_abandoned:
                kind = type(app.defect).__name__
                output.say(
                    f"the screen failed ({kind}: {app.defect}); the session continues without "
                    "it until Ctrl-C"
                )
                say_until_end(session, scene.announcer)
        finally:
            session.stop()
    if app.defect is not None and session.problem is None:
        session.problem = app.defect


def _serve(session: Session, scene: Scene, address: tuple[str, int]) -> None:
    """Serve a session until Ctrl-C; the terminal says what it says without a screen.

    Raises:
        InputError: there is no serving there.
    """
    from gcs_sysid.web.session_page import SessionPage
    from gcs_sysid.web.site import Site

    host, port = address
    stopped = threading.Event()

    def stop() -> None:
        stopped.set()
        session.request_stop()

    page = SessionPage(session, scene)
    site = Site(host, port, page)
    try:
        site.start()
    except InputError:
        # Nothing of the session may stay: its link, an empty recording.
        session.request_stop()
        session.start()
        session.join()
        raise
    try:
        with on_signals(stop):
            say_addresses(site, host)
            session.start()
            say_until_end(session, scene.announcer)
            if not stopped.is_set():
                output.say("ended; the page stays until Ctrl-C")
            output.wait_for(stopped)
    finally:
        session.stop()
        site.stop()
