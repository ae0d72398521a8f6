"""What `live`, `demo` and `replay` share: a session, shown until it ends, then its numbers."""

import argparse
import functools
import gc
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from gcs_sysid.cli import output
from gcs_sysid.cli.headless import say_until_end
from gcs_sysid.cli.output import JsonLines, on_signals
from gcs_sysid.coach.manoeuvre_library import Limits
from gcs_sysid.errors import InputError
from gcs_sysid.live.flight_coach import CoachOptions
from gcs_sysid.live.live_view import Session
from gcs_sysid.results.result import Result
from gcs_sysid.results.result_file import read_result
from gcs_sysid.results.result_view import result_table
from gcs_sysid.telemetry.tlog_writer import NOT_RECORDING

if TYPE_CHECKING:
    from gcs_sysid.screen.call_outs import Announcer


def baseline_of(options: argparse.Namespace) -> Result | None:
    """The earlier result that the screen compares with.

    Raises:
        InputError: the file holds none.
    """
    return read_result(Path(options.baseline)) if options.baseline else None


def refit_interval(options: argparse.Namespace) -> float:
    """Vehicle time between estimates in s: as often as a screen is drawn, or a line or page."""
    return 0.5 if options.headless or options.web else 0.2


def coach_options(options: argparse.Namespace) -> CoachOptions:
    """What the coach aims at, and what the pilot allows."""
    limits = Limits(
        math.radians(options.max_tilt), math.radians(options.max_rate), options.max_height
    )
    return CoachOptions(options.target, limits)


def is_watched(options: argparse.Namespace) -> bool:
    """Whether there is a screen, on a terminal or in browsers; else lines are printed."""
    if options.headless and options.web:
        raise InputError("--headless and --web exclude each other")
    # Without a terminal there is no screen to draw on.
    terminal = not options.headless and sys.stdin.isatty() and sys.stdout.isatty()
    return terminal or options.web is not None


def load_screen(options: argparse.Namespace) -> None:
    """Load what a session is shown with, before its data come: they would wait for that."""
    if is_watched(options):
        import gcs_sysid.cli.screens  # noqa: F401 - lines need no screen


def follow(
    session: Session,
    writer: JsonLines,
    truth: Mapping[str, float] | None,
    options: argparse.Namespace,
    baseline: Result | None = None,
    late_truth: Callable[[], Mapping[str, float] | None] | None = None,
) -> int:
    """Show a session until it ends, then print its final numbers.

    Args:
        session: not yet started.
        writer: gets the final result as its last line.
        truth: shown beside the estimates.
        options: of the command line; `headless`: print instead of the screen; `web`: a page
            in browsers.
        baseline: an earlier result that the screen compares with.
        late_truth: gives the truth in force at the end, when that may have changed.

    Returns:
        Exit status: 1 when the session ended without an answer.

    Raises:
        Exception: what went wrong in the session or its screen, once all else is done.
    """
    writer.when_gone = session.request_stop
    spare_what_stays()
    watched = is_watched(options)
    with announcing(options) as announcer:
        if watched:
            from gcs_sysid.cli.screens import show  # lines need no screen

            show(session, truth, options, baseline, announcer)
        else:
            with on_signals(session.request_stop):
                session.start()
                try:
                    say_until_end(session, announcer)
                finally:
                    session.stop()
    if session.final is None:
        assert session.problem is not None
        raise session.problem
    if late_truth is not None:
        truth = late_truth() or truth
    table = result_table(session.final, truth, output.terminal_width())
    deliveries = output.Deliveries()
    if not writer.to_stdout:
        deliveries.give(lambda: output.show(table))
    writer.write(session.final)
    if not deliveries.give(writer.close) and writer.to_stdout and not deliveries.unread:
        output.say(table)  # the numbers of a flight are not lost with a disk
    for line in session.recordings():
        if vars(options).get("record") and line.startswith(NOT_RECORDING):
            deliveries.give(functools.partial(_refuse, line))
        else:
            output.say(line)
    if session.problem is not None:
        raise session.problem
    deliveries.check()
    return 1 if session.final.verdict == "refused" else 0


def _refuse(line: str) -> None:
    raise InputError(line)


@contextmanager
def announcing(options: argparse.Namespace) -> "Iterator[Announcer | None]":
    """What calls out the session, where that is wanted; silent at the end."""
    if not options.speak and not options.bell:
        yield None
        return
    from gcs_sysid.screen.call_outs import Announcer

    announcer = Announcer(mode="voice" if options.speak else "bell", ring=_ring)
    if options.speak and announcer.mode != "voice":
        output.say(announcer.describe())
    try:
        yield announcer
    finally:
        announcer.close()


def _ring() -> None:
    if sys.stderr.isatty():
        print("\a", end="", file=sys.stderr, flush=True)


def spare_what_stays() -> None:
    """Exempt all there is now from collections, and have full ones less often.

    A full collection walks all that a program holds. With a screen that took 0.1 s every ten
    seconds, in which no datagram was read and no key answered; modules and style sheets are most
    of it, and they stay. To be called by the owner of the process, once everything is loaded.
    """
    gc.collect()
    gc.freeze()
    young, middle, _ = gc.get_threshold()
    gc.set_threshold(young, middle, 100)  # middle collections to a full one; by default 10
