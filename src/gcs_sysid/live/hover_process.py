"""The look at the hover in a process of its own: minutes of records take up to a second to assess.

    python -m gcs_sysid.live.hover_process

is started by `HoverProcess`, which sends it records and questions as pickles and takes its answers.
It has little priority, and ends when its input closes.
"""

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import Any, NamedTuple, cast

from gcs_sysid.live.hover_watch import EVERY, HoverNews, HoverWatch, Identified
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.signals.columns import RecordBlock
from gcs_sysid.telemetry.logs import Telemetry
from gcs_sysid.telemetry.vehicles import Vehicle

_COMMAND = [sys.executable, "-P", "-m", "gcs_sysid.live.hover_process"]
_MOST_WAITING = 256 * 2**20
"""Bytes for a process that does not take them, before it is given up: a minute of them is 12 MB at
1 kHz."""
_LAST_WITHIN = 3.0
"""s that the last answer may take."""


class Question(NamedTuple):
    """What a look needs beside the records, see `HoverWatch`.

    Attributes:
        vehicle: of the link.
        systems: found on it.
        parameters: of the autopilot.
        airframe: with the scale in force.
        verdict: of the identification.
        reasons: for it.
    """

    vehicle: Vehicle | None
    systems: list[Vehicle]
    parameters: dict[str, float]
    airframe: Airframe
    verdict: str
    reasons: tuple[str, ...]


class HoverProcess:
    """A `HoverWatch` whose looks cost the session nothing; it answers a while after it was asked.

    Args:
        telemetry: as of `HoverWatch`.
        source: as of `HoverWatch`.
    """

    def __init__(self, telemetry: Telemetry, source: str) -> None:
        self._telemetry = telemetry
        self._source = source
        self._asked_at: float | None = None
        self._now = 0.0
        self._wake = threading.Condition()
        self._waiting: list[bytes] = []
        self._size = 0
        self._asked = self._answered = 0
        self._news: HoverNews | None = None
        self._over = False
        self._process: subprocess.Popen[bytes] | None = None

    def take(self, block: RecordBlock) -> None:
        """The next records."""
        self._send(block)
        for track in block.tracks:
            if len(track.t):
                self._now = max(self._now, float(track.t[-1]))
        if any(event.kind == "reboot" for _, event in block.events):
            self._now, self._asked_at = 0.0, None
        if self._asked_at is None and self._now:
            self._asked_at = self._now

    def look(
        self,
        airframe: Airframe,
        result: Callable[[], Identified],
        *,
        last: bool = False,
    ) -> HoverNews | None:
        """The answer to an earlier question, once; asks again where that is due.

        Args:
            airframe: with the scale in force.
            result: the latest of the identification; called where it is time to look.
            last: wait for the answer.

        Raises:
            RuntimeError: the process has failed.
        """
        if self._over:
            raise RuntimeError("the process that assesses the hover has ended")
        idle = self._asked == self._answered
        due = self._asked_at is not None and self._now - self._asked_at >= EVERY
        if due and idle:
            self._asked_at = self._now
            known, latest = self._telemetry, result()
            self._asked += 1
            self._send(
                Question(
                    known.vehicle,
                    known.systems,
                    dict(known.parameters),
                    airframe,
                    latest.verdict,
                    latest.reasons,
                )
            )
        with self._wake:
            if last:
                self._wake.wait_for(lambda: self._asked == self._answered, _LAST_WITHIN)
            news, self._news = self._news, None
        return news

    def close(self) -> None:
        """End the process."""
        with self._wake:
            self._over = True
            self._wake.notify_all()
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def _send(self, thing: RecordBlock | Question) -> None:
        data = pickle.dumps(thing, pickle.HIGHEST_PROTOCOL)
        with self._wake:
            self._waiting.append(data)
            self._size += len(data)
            self._wake.notify_all()
            self._over |= self._size > _MOST_WAITING
        if self._process is None and isinstance(thing, Question):
            self._start()

    def _start(self) -> None:
        # Not to be reached by the terminal's signals.
        apart: dict[str, Any] = {"start_new_session": True}
        if os.name == "nt":
            apart = {"creationflags": getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)}
        pipe = subprocess.PIPE
        self._process = process = subprocess.Popen(
            [*_COMMAND, self._source], stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, **apart
        )
        for work in (self._write, self._read):
            threading.Thread(target=work, args=(process,), daemon=True).start()

    def _write(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdin is not None
        with contextlib.suppress(OSError, ValueError), process.stdin as pipe:
            while True:
                with self._wake:
                    self._wake.wait_for(lambda: self._waiting or self._over)
                    if self._over:
                        return
                    waiting, self._waiting, self._size = self._waiting, [], 0
                for data in waiting:
                    pipe.write(data)
                pipe.flush()

    def _read(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout is not None
        with contextlib.suppress(EOFError, OSError, pickle.UnpicklingError, ValueError):
            while True:
                news = pickle.load(process.stdout)
                with self._wake:
                    self._news, self._answered = news, self._answered + 1
                    self._wake.notify_all()
        with self._wake:
            self._over, self._answered = True, self._asked
            self._wake.notify_all()


class _Known:
    """What the link knows beside the records, by the latest question."""

    vehicle: Vehicle | None = None

    def __init__(self) -> None:
        self.systems: list[Vehicle] = []
        self.parameters: dict[str, float] = {}

    def see(self, question: Question) -> None:
        """Take what it is now."""
        self.vehicle, self.systems = question.vehicle, question.systems
        self.parameters = question.parameters


def _answer(watch: HoverWatch, question: Question) -> HoverNews | None:
    return watch.look(question.airframe, lambda: question)


def main() -> None:
    """Answer until the input closes."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    if hasattr(os, "nice"):
        os.nice(10)
    known = _Known()
    watch = HoverWatch(cast(Telemetry, known), sys.argv[1])
    with contextlib.suppress(EOFError):
        while True:
            thing = pickle.load(sys.stdin.buffer)
            if isinstance(thing, RecordBlock):
                watch.take(thing)
                continue
            known.see(thing)
            news = _answer(watch, thing)
            pickle.dump(news, sys.stdout.buffer)
            sys.stdout.buffer.flush()


if __name__ == "__main__":
    main()
