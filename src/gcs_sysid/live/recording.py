"""What a live session records: one file after the other, never over another."""

import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path

from gcs_sysid.telemetry.frames import Frame
from gcs_sysid.telemetry.tlog_writer import TlogWriter


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
    def active(self) -> bool:
        """Whether there is a recording that has not been stopped, be the disk willing or not."""
        return self._writer is not None

    @property
    def path(self) -> str:
        """Of the file that frames reach, or reached to the end; empty when they reach none."""
        writer = self._writer
        if writer is None:
            return self._ended_with
        return "" if writer.problem else str(writer.path)

    @property
    def dropped(self) -> int:
        """Frames that were to be recorded and are in no file."""
        return self._dropped + sum(w.dropped for w in (self._writer, *self._ending) if w)

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

    def lines(self) -> list[str]:
        """A line for each recording that has ended: where it is, or why it is not."""
        return list(self._lines)

    def _settle(self, writer: TlogWriter) -> None:
        self._recorded = writer.recorded[-1] if writer.recorded else None
        self._dropped += writer.dropped
        self._lines.append(writer.summary())
