"""`gcs-sysid live`: identify a vehicle while it flies."""

import argparse
from datetime import datetime
from pathlib import Path

from gcs_sysid.cli import airframe_choice, output
from gcs_sysid.cli.followed_session import (
    baseline_of,
    coach_options,
    follow,
    is_watched,
    load_screen,
    refit_interval,
)
from gcs_sysid.cli.output import JsonLines
from gcs_sysid.errors import GcsSysidError, InputError
from gcs_sysid.live.live_estimate import LiveOptions
from gcs_sysid.live.live_session import LiveSession
from gcs_sysid.live.receiver_process import ReceiverProcess
from gcs_sysid.telemetry.tlog_writer import unused_path
from gcs_sysid.telemetry.urls import parse_url


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    airframe = None if airframe_choice.is_auto(options) else airframe_choice.airframe_of(options)
    if airframe is None:
        airframe_choice.check_scale_given(options)
    truth = output.read_truth(options.truth) if options.truth else None
    baseline = baseline_of(options)
    if options.record and options.no_record:
        raise InputError("--record and --no-record exclude each other")
    signing_key = Path(options.signing_key) if options.signing_key else None
    record_to = recording_path(options)
    load_screen(options)
    receiver = ReceiverProcess(
        parse_url(options.url, options.baud),
        listen_only=options.listen_only,
        signing_key=signing_key,
        record_to=record_to,
    )
    try:
        if airframe is None:
            airframe = airframe_choice.of_link(receiver, options)
        session = LiveSession(
            receiver,
            airframe,
            LiveOptions(
                rate=options.rate,
                listen_only=options.listen_only,
                wanted=options.vehicle,
                duration=options.duration,
                refit_interval=refit_interval(options),
                signing_key=signing_key,
                coach=coach_options(options),
                state_folder=state_folder(),
                predict=is_watched(options) and not options.web,
            ),
            record_to=record_to,
            on_result=(writer := JsonLines(options.json, force=options.force)).write,
        )
    except (GcsSysidError, KeyboardInterrupt):
        receiver.close()
        raise
    return follow(session, writer, truth, options, baseline)


def state_folder() -> Path:
    """Where what a killed session leaves is kept for the next one."""
    try:
        import platformdirs
    except ImportError:  # no user ids where it looks for them
        return Path.home() / ".gcs-sysid"
    return platformdirs.user_state_path("gcs-sysid", appauthor=False)


def recording_path(options: argparse.Namespace) -> Path | None:
    """Where to record: as asked, else a dated file under logs/."""
    if options.no_record:
        return None
    if options.record:
        return Path(options.record)
    return unused_path(Path("logs") / f"{datetime.now():%Y-%m-%d_%H-%M-%S}.tlog")
