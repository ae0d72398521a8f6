"""Reading, time-stamping and recording: what a live session does before anything else.

It depends on nothing that can be slow or fail. A session drives it in its own thread, where the
sender can wait (an emulator at full speed) or the link is one of memory; else it has a process of
its own (`receiver_process`), and hands over the same items in the same order.
"""

import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from gcs_sysid.telemetry.frames import Frame
from gcs_sysid.telemetry.link import Link
from gcs_sysid.telemetry.tlog_writer import TlogWriter, reset_mark
from gcs_sysid.telemetry.transceiver import ReceivedFrames, Transceiver

POLL = 0.05
"""s; the longest that an order waits."""


@dataclass(frozen=True)
class RecordingReport:
    """State of the recording.

    Attributes:
        active: whether frames are to be recorded, be the disk willing or not.
        path: of the file that they reach; empty when they reach none.
        dropped: frames that were to be recorded and are in no file.
        lines: one for each recording that has ended.
    """

    active: bool = False
    path: str = ""
    dropped: int = 0
    lines: tuple[str, ...] = ()


class SessionRecording:
    """Starts and stops recordings; nothing here waits for the disk, but for `finish`.

    Args:
        path: of the first; None: nothing is recorded until it is started.

    Raises:
        InputError: that file exists.
    """

    def __init__(self, path: Path | None) -> None:
        self._writer = TlogWriter(path) if path else None
        self._ending: list[TlogWriter] = []
        # The latest are listed at the end.
        self._lines: deque[str] = deque(maxlen=100)
        self._recorded: Path | None = None
        self._dropped = 0
        self._ended_with = ""

    @property
    def report(self) -> RecordingReport:
        """As things stand."""
        writer, path = self._writer, self._ended_with
        if writer is not None:
            path = "" if writer.problem else str(writer.path)
        dropped = sum(w.dropped for w in (writer, *self._ending) if w)
        return RecordingReport(
            writer is not None, path, self._dropped + dropped, tuple(self._lines)
        )

    def write(self, time_us: int, frames: Sequence[Frame]) -> None:
        """Record frames that arrived at `time_us`, us since 1970."""
        if self._writer is not None:
            self._writer.write(time_us, frames)

    def start(self, path: Path) -> str:
        """Record into another file from now on; what is to be said of it."""
        if self._writer is not None:
            return ""  # asked for twice before the first was done
        self._writer = TlogWriter(path, beside=True)
        return f"recording to {path}"

    def stop(self) -> str:
        """End the recording; what is to be said of it."""
        writer, self._writer = self._writer, None
        if writer is None:
            return ""
        writer.finish()
        self._ending.append(writer)
        return f"recording {writer.path} stopped"

    def take_events(self) -> list[str]:
        """What happened since this was last asked, one line each."""
        events = []
        for writer in (*self._ending, self._writer):
            if writer is not None:
                events += writer.take_events()
        while self._ending and self._ending[0].ended:
            self._settle(self._ending.pop(0))
        return events

    def flushed(self) -> Path | None:
        """The latest recording, all that was written so far in the file; None without one."""
        writer = self._writer
        if writer is None:
            return self._ending[-1].path if self._ending else self._recorded
        writer.flush()
        return None if writer.problem else writer.path

    def finish(self) -> None:
        """End everything; waits for a disk that answers, and a little for one that does not."""
        whole = self._writer is not None
        self.stop()
        deadline = time.monotonic() + TlogWriter.PATIENCE
        for writer in self._ending:
            writer.close(max(0.0, deadline - time.monotonic()))
            self._settle(writer)
        if whole and not self._ending[-1].problem and self._recorded is not None:
            self._ended_with = str(self._recorded)
        self._ending.clear()

    def _settle(self, writer: TlogWriter) -> None:
        self._recorded = writer.recorded[-1] if writer.recorded else None
        self._dropped += writer.dropped
        self._lines.append(writer.summary())


class ResetMark(NamedTuple):
    """The user reset the estimate here; the recording is marked too."""

    time_us: int


class RecordingCut(NamedTuple):
    """Another recording begins here, and with it another estimate."""


class Toggled(NamedTuple):
    """Here the user started or stopped the recording."""

    text: str


class Failure(NamedTuple):
    """Something in here was defective; it goes on as far as it can."""

    text: str


class Ended(NamedTuple):
    """All was handed over, and the recording is closed."""


Item = ReceivedFrames | ResetMark | RecordingCut | Toggled | Failure | Ended


class Reception(Transceiver):
    """Receives, records and hands over, whenever it is asked to.

    Args:
        link: as are the next two, of the transceiver.
        record_to: the first recording; None: nothing is recorded until it is started.
        listen_only: see above.
        signing_key: see above.

    Raises:
        InputError: the recording exists, or there is no key.
    """

    withheld = 0
    waiting = 0.0
    """Taking never waits; the rest is in the system's buffer."""

    def __init__(
        self,
        link: Link,
        record_to: Path | None,
        *,
        listen_only: bool = False,
        signing_key: Path | None = None,
    ) -> None:
        super().__init__(link, listen_only=listen_only, signing_key=signing_key)
        self._recording = SessionRecording(record_to)
        self._items: list[Item] = []
        self._finished = False

    @property
    def recording_report(self) -> RecordingReport:
        """As things stand."""
        return self._recording.report

    def next_items(self, timeout: float) -> list[Item]:
        """Wait up to `timeout` s; what came, recorded."""
        for batch in self.receive(timeout) if not self._finished and not self._items else ():
            self._recording.write(batch.time_us, batch.frames)
            self._items.append(batch)
        items, self._items = self._items, []
        return items

    def take_events(self) -> list[str]:
        """What happened to the recording since this was last asked, one line each."""
        return self._recording.take_events()

    def mark_reset(self) -> None:
        """Record that the user reset the estimate."""
        now = time.time_ns() // 1000
        self._recording.write(now, [reset_mark()])
        self._items.append(ResetMark(now))

    def start_recording(self, path: Path) -> None:
        """Record into another file from now on."""
        self._items.append(Toggled(self._recording.start(path)))

    def stop_recording(self) -> None:
        """End the recording."""
        self._items.append(Toggled(self._recording.stop()))

    def cut_recording(self, path: Path) -> None:
        """Go on in another file, if it is recorded at all."""
        if self._recording.report.active:
            self._recording.stop()
            self._recording.start(path)
        self._items.append(RecordingCut())

    def flushed_recording(self) -> Path | None:
        """The latest recording, all that was written so far in the file; None without one."""
        return self._recording.flushed()

    def finish(self) -> None:
        """Close link and recording; nothing more comes."""
        if not self._finished:
            self._finished = True
            super().close()
            self._recording.finish()
            self._items.append(Ended())

    close = finish  # what is left is not handed over
