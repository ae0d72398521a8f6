"""What the screen of each kind of session shows and offers."""

import argparse
from collections.abc import Mapping

from gcs_sysid.cli.live_command import Session
from gcs_sysid.cli.screen_actions import export_result, live_actions, report_session
from gcs_sysid.exports.formats import TARGETS
from gcs_sysid.live.live_session import LiveSession
from gcs_sysid.live.replay_session import ReplaySession
from gcs_sysid.results.result import Result
from gcs_sysid.screen import Actions, Baseline
from gcs_sysid.screen.scene import Scene
from gcs_sysid.screen.widgets.transport import Transport


def scene_of(
    session: Session,
    truth: Mapping[str, float] | None,
    options: argparse.Namespace,
    baseline: Result | None,
) -> Scene:
    """The scene of a live session or a replay."""
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
