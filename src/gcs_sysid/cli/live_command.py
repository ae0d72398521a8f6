"""`gcs-sysid live`: identify a vehicle while it flies."""

import argparse
import functools
import gc
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from gcs_sysid.cli import arguments, output, reported_airframe
from gcs_sysid.cli.option_groups import coach_options
from gcs_sysid.cli.output import JsonLines, on_signals
from gcs_sysid.cli.result_table import result_table
from gcs_sysid.errors import GcsSysidError, InputError
from gcs_sysid.live.live_options import LiveOptions
from gcs_sysid.live.live_session import LiveSession
from gcs_sysid.live.receiver_process import ReceiverProcess
from gcs_sysid.model.parameters import CORE_OF, REGISTRY
from gcs_sysid.results.result import Result
from gcs_sysid.results.result_file import read_result
from gcs_sysid.results.snapshot import Event, LinkState, Snapshot
from gcs_sysid.results.summary import before_data, contradicted
from gcs_sysid.results.words import WAITING, WRONG_AIRFRAME, shown
from gcs_sysid.telemetry.tlog_writer import NOT_RECORDING, unused_path
from gcs_sysid.telemetry.urls import parse_url

if TYPE_CHECKING:
    from gcs_sysid.screen.call_outs import Announcer

_SAY_EVERY = 1.0
"""s between lines of the headless output."""
_SELDOM = 100
"""Middle collections to a full one; Python's default is 10."""


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    airframe = None if arguments.is_auto(options) else arguments.airframe_of(options)
    if airframe is None:
        arguments.check_scale_given(options)
    truth = output.read_truth(options.truth) if options.truth else None
    baseline = baseline_of(options)
    if options.record and options.no_record:
        raise InputError("--record and --no-record exclude each other")
    signing_key = Path(options.signing_key) if options.signing_key else None
    record_to = recording_path(options)
    receiver = ReceiverProcess(
        parse_url(options.url, options.baud),
        listen_only=options.listen_only,
        signing_key=signing_key,
        record_to=record_to,
    )
    try:
        if airframe is None:
            airframe = reported_airframe.of_link(receiver, options)
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


def baseline_of(options: argparse.Namespace) -> Result | None:
    """The earlier result that the screen compares with.

    Raises:
        InputError: the file holds none.
    """
    return read_result(Path(options.baseline)) if options.baseline else None


def refit_interval(options: argparse.Namespace) -> float:
    """Vehicle time between estimates in s: as often as a screen is drawn, or a line or page."""
    return 0.5 if options.headless or options.web else 0.2


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


class Session(Protocol):
    """What is shown: a live session or a replay."""

    final: Result | None
    problem: Exception | None

    def start(self) -> None:
        """Begin."""

    def latest(self) -> Snapshot | None:
        """The newest snapshot."""

    def request_stop(self) -> None:
        """End soon; returns at once."""

    def stop(self) -> None:
        """End, and wait until it has."""

    def join(self, timeout: float | None = None) -> bool:
        """Wait for the end; whether it has come."""

    def recordings(self) -> list[str]:
        """A line for each recording made."""


def is_watched(options: argparse.Namespace) -> bool:
    """Whether there is a screen, on a terminal or in browsers; else lines are printed."""
    if options.headless and options.web:
        raise InputError("--headless and --web exclude each other")
    # Without a terminal there is no screen to draw on.
    terminal = not options.headless and sys.stdin.isatty() and sys.stdout.isatty()
    return terminal or options.web is not None


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
            _show(session, truth, options, baseline, announcer)
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


def _show(
    session: Session,
    truth: Mapping[str, float] | None,
    options: argparse.Namespace,
    baseline: Result | None,
    announcer: "Announcer | None",
) -> None:
    """Show a session on a screen until it ends; one that fails costs no flight.

    A defect of the screen becomes the session's problem, where it has none of its own.
    """
    from gcs_sysid.cli.screens import scene_of

    scene = scene_of(session, truth, options, baseline, announcer)
    if options.web:
        from gcs_sysid.cli.screens import show

        show(session, scene, options.web)
        return
    app = scene.app(session)
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
            if app.defect is not None and not stopped.is_set():
                kind = type(app.defect).__name__
                output.say(
                    f"the screen failed ({kind}: {app.defect}); the session continues without "
                    "it until Ctrl-C"
                )
                say_until_end(session, announcer)
        finally:
            session.stop()
    if app.defect is not None and session.problem is None:
        session.problem = app.defect


def say_until_end(session: Session, announcer: "Announcer | None" = None) -> None:
    """One line a second on standard error, and one for each event; call-outs where wanted."""
    said = -_SAY_EVERY
    last = ""
    printed: Event | None = None
    advised = ""
    ended = False
    while not ended:
        ended = session.join(0.1)
        now = time.monotonic()
        snapshot = session.latest()
        if snapshot is None:
            continue
        if announcer is not None:
            announcer.see(snapshot)
        for event in events_after(printed, snapshot.events):
            output.say(f"{event.t:7.1f} s  {event.text}")
            printed = event
        if ended:
            return
        if snapshot.advice is not None and snapshot.advice.text != advised:
            advised = snapshot.advice.text
            output.say(f"{snapshot.t:7.1f} s  coach: {advised}")
        if now - said < _SAY_EVERY:
            continue
        line = status_line(snapshot)
        if line != last:
            output.say(line)
        said, last = now, line


def events_after(last: Event | None, events: Sequence[Event]) -> Sequence[Event]:
    """The events after the last one printed; all, when that is long gone."""
    for i in range(len(events) - 1, -1, -1):
        if events[i] is last:
            return events[i + 1 :]
    return events


def status_line(snapshot: Snapshot) -> str:
    """The state of a session in one line."""
    link = snapshot.link
    if link.state is LinkState.WAITING:
        reasons = snapshot.result.reasons
        if link.received or len(reasons) > 1:  # something is received, but no vehicle
            return f"listening on {link.url}: {'; '.join(reasons)}"
        return f"listening on {link.url}: no vehicle yet"
    words = [f"{snapshot.t:7.1f} s", link.vehicle or link.url]
    if link.state is not LinkState.CONNECTED:
        words.append(str(link.state.value))
    words.append(_verdict_words(snapshot))
    for name in CORE_OF[snapshot.result.rotor_input]:
        estimate = snapshot.result.parameters.get(name)
        if REGISTRY[name].sign != "positive" or (estimate and estimate.status == "given"):
            continue
        words.append(f"{name} {shown(estimate, 4).text}")
    reasons = snapshot.result.reasons
    if snapshot.result.verdict == "refused" and reasons:
        words.append(f"({reasons[0]})")
    return "  ".join(words)


def _verdict_words(snapshot: Snapshot) -> str:
    """The verdict, or what stands in its place before there are data."""
    if contradicted(snapshot.result):
        return WRONG_AIRFRAME
    waiting = snapshot.result.verdict == "refused" and before_data(snapshot)
    return WAITING.meaning if waiting else snapshot.result.verdict


def spare_what_stays() -> None:
    """Exempt all there is now from collections, and have full ones less often.

    A full collection walks all that a program holds. With a screen that took 0.1 s every ten
    seconds, in which no datagram was read and no key answered; modules and style sheets are most
    of it, and they stay. To be called by the owner of the process, once everything is loaded.
    """
    gc.collect()
    gc.freeze()
    young, middle, _ = gc.get_threshold()
    gc.set_threshold(young, middle, _SELDOM)
