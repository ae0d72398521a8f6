"""`gcs-sysid live`: identify a vehicle while it flies."""

import argparse
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Protocol, TextIO

from gcs_sysid.cli import arguments, output
from gcs_sysid.cli.coaching import coach_options
from gcs_sysid.cli.signals import on_signals
from gcs_sysid.cli.table import result_table
from gcs_sysid.errors import GcsSysidError, InputError
from gcs_sysid.session.live import LiveSession
from gcs_sysid.session.live_options import LiveOptions
from gcs_sysid.session.result import Result
from gcs_sysid.session.result_file import read_result
from gcs_sysid.session.snapshot import Event, LinkState, Snapshot
from gcs_sysid.telemetry.link import open_link
from gcs_sysid.telemetry.reconnect import PersistentLink
from gcs_sysid.telemetry.tlog_writer import unused_path
from gcs_sysid.telemetry.urls import parse_url

_SAY_EVERY = 1.0
"""s between lines of the headless output."""


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    airframe = arguments.airframe_of(options)
    truth = output.read_truth(options.truth) if options.truth else None
    baseline = baseline_of(options)
    if options.record and options.no_record:
        raise InputError("--record and --no-record exclude each other")
    link = PersistentLink(open_link(parse_url(options.url, options.baud)))
    try:
        session = LiveSession(
            link,
            airframe,
            LiveOptions(
                rate=options.rate,
                listen_only=options.listen_only,
                wanted=options.vehicle,
                duration=options.duration,
                refit_interval=refit_interval(options),
                signing_key=Path(options.signing_key) if options.signing_key else None,
                coach=coach_options(options),
            ),
            record_to=recording_path(options),
            on_result=(writer := JsonLines(options.json)).write,
        )
    except GcsSysidError:
        link.close()
        raise
    return follow(session, writer, truth, options, baseline)


def baseline_of(options: argparse.Namespace) -> Result | None:
    """The earlier result that the screen compares with.

    Raises:
        InputError: the file holds none.
    """
    return read_result(Path(options.baseline)) if options.baseline else None


def refit_interval(options: argparse.Namespace) -> float:
    """Vehicle time between estimates in s: as often as somebody looks."""
    return 0.5 if options.headless else 0.2


def recording_path(options: argparse.Namespace) -> Path | None:
    """Where to record: as asked, else a dated file under logs/."""
    if options.no_record:
        return None
    if options.record:
        return Path(options.record)
    return unused_path(Path("logs") / f"{datetime.now():%Y-%m-%d_%H-%M-%S}.tlog")


class JsonLines:
    """Writes results as JSON, one a line; nothing without a path.

    Args:
        path: file, `-` for standard output, or None.
    """

    def __init__(self, path: str | None) -> None:
        self.to_stdout = path == "-"
        self._file: TextIO | None = output.open_output(path) if path else None

    def write(self, result: Result) -> None:
        """Write one line."""
        if self._file:
            print(result.dumps(indent=None), file=self._file, flush=True)

    def close(self) -> None:
        """Close the file (not standard output)."""
        if self._file and not self.to_stdout:
            self._file.close()


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
        options: of the command line; `headless`: print instead of the screen; `web`: the screen
            in browsers.
        baseline: an earlier result that the screen compares with.
        late_truth: gives the truth in force at the end, when that may have changed.

    Returns:
        Exit status: 1 when the session ended without an answer.
    """
    if is_watched(options):
        from gcs_sysid.cli.scenes import scene_of

        scene = scene_of(session, truth, options, baseline)
        if options.web:
            from gcs_sysid.cli.browser import show

            show(session, scene, options.web)
        else:
            app = scene.app(session)
            with on_signals(app.exit):
                session.start()
                try:
                    app.run()
                finally:
                    session.stop()
    else:
        with on_signals(session.request_stop):
            session.start()
            say_until_end(session)
    if session.problem is not None:
        raise session.problem
    assert session.final is not None
    if late_truth is not None:
        truth = late_truth() or truth
    writer.write(session.final)
    writer.close()
    if not writer.to_stdout:
        print(result_table(session.final, truth, output.terminal_width()))
    for line in session.recordings():
        print(line, file=sys.stderr)
    return 1 if session.final.verdict == "refused" else 0


def say_until_end(session: Session) -> None:
    """One line a second on standard error, and one for each event."""
    said = -_SAY_EVERY
    last = ""
    told: Event | None = None
    advised = ""
    ended = False
    while not ended:
        ended = session.join(0.1)
        now = time.monotonic()
        snapshot = session.latest()
        if snapshot is None:
            continue
        for event in events_after(told, snapshot.events):
            print(f"{event.t:7.1f} s  {event.text}", file=sys.stderr, flush=True)
            told = event
        if ended:
            return
        if snapshot.advice is not None and snapshot.advice.text != advised:
            advised = snapshot.advice.text
            print(f"{snapshot.t:7.1f} s  coach: {advised}", file=sys.stderr, flush=True)
        if now - said < _SAY_EVERY:
            continue
        line = status_line(snapshot)
        if line != last:
            print(line, file=sys.stderr, flush=True)
        said, last = now, line


def events_after(last: Event | None, events: Sequence[Event]) -> Sequence[Event]:
    """The events that came after the last one told; all, when that is long gone."""
    for i in range(len(events) - 1, -1, -1):
        if events[i] is last:
            return events[i + 1 :]
    return events


def status_line(snapshot: Snapshot) -> str:
    """The state of a session in one line."""
    link = snapshot.link
    if link.state is LinkState.WAITING:
        reasons = snapshot.result.reasons
        if link.received or len(reasons) > 1:  # somebody speaks, but nobody to listen to
            return f"listening on {link.url}: {'; '.join(reasons)}"
        return f"listening on {link.url}: no vehicle has spoken yet"
    words = [f"{snapshot.t:7.1f} s", link.vehicle or link.url]
    if link.state is not LinkState.CONNECTED:
        words.append(str(link.state.value))
    words.append(snapshot.result.verdict)
    speeds = snapshot.result.rotor_input == "speed"
    for name in ("Ixx", "Iyy", "Izz", *(("k_T", "k_M") if speeds else ("T_max", "moment_ratio"))):
        estimate = snapshot.result.parameters.get(name)
        if estimate is None or estimate.value is None or estimate.std is None:
            words.append(f"{name} -")
        else:
            share = 196.0 * estimate.std / abs(estimate.value) if estimate.value else 999.0
            words.append(f"{name} {estimate.value:.4g} ±{min(share, 999.0):.1f}%")
    return "  ".join(words)
