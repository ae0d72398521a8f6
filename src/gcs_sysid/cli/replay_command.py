"""`gcs-sysid replay`: a recorded flight through the live screen."""

import argparse
import math
from pathlib import Path

from gcs_sysid.cli import airframe_choice, output
from gcs_sysid.cli.followed_session import baseline_of, follow, is_watched, refit_interval
from gcs_sysid.cli.output import JsonLines
from gcs_sysid.live.replay_session import ReplaySession, survey


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    airframe = airframe_choice.airframe_of(options)
    truth = output.read_truth(options.truth) if options.truth else None
    baseline = baseline_of(options)
    stay = is_watched(options)
    writer = JsonLines(options.json, force=options.force)
    bar = output.progress_bar(options.log)
    session = ReplaySession(
        survey(Path(options.log), airframe, options.vehicle, bar),
        math.inf if options.speed == "max" else float(options.speed),
        refit_interval(options),
        options.target,
        stay=stay,
        on_result=writer.write,
    )
    return follow(session, writer, truth, options, baseline)
