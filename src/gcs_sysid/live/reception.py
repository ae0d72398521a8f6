"""Reading, time-stamping and recording: what a live session does before anything else.

It depends on nothing that can be slow or fail. A session drives it in its own thread, where the
sender can wait (an emulator at full speed) or the link is one of memory; else it has a process of
its own (`receiver_process`), and hands over the same items in the same order.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

from gcs_sysid.live.recording import SessionRecording
from gcs_sysid.telemetry.marks import reset_mark
from gcs_sysid.telemetry.receiver import ReceivedFrames
from gcs_sysid.telemetry.transceiver import LinkReport, Port, Requests, Transceiver
from gcs_sysid.telemetry.urls import LinkUrl


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


class Source(Port, Protocol):
    """Where a session's data come from: a reception, here or in another process."""

    @property
    def recording_report(self) -> RecordingReport:
        """As things stand."""

    @property
    def waiting(self) -> float:
        """Arrived data that were not taken yet, s."""

    @property
    def withheld(self) -> int:
        """Frames that are recorded and were not handed over, because too many waited."""

    def next_items(self, timeout: float) -> Sequence[Item]:
        """Wait up to `timeout` s; what comes next, in order."""

    def take_events(self) -> list[str]:
        """What happened to the recording since this was last asked, one line each."""

    def mark_reset(self) -> None:
        """Have a `ResetMark` recorded and handed over."""

    def start_recording(self, path: Path) -> None:
        """Record into another file from now on; `Toggled` reports it."""

    def stop_recording(self) -> None:
        """End the recording; `Toggled` reports it."""

    def cut_recording(self, path: Path) -> None:
        """Go on in another file, if it is recorded at all; hand over a `RecordingCut`."""

    def flushed_recording(self) -> Path | None:
        """The latest recording, all that was written so far in the file; None without one."""

    def finish(self) -> None:
        """End: what is left is handed over, and `Ended`."""


class Reception:
    """Receives, records and hands over, whenever it is asked to.

    Args:
        transceiver: `close` closes it.
        recording: of what is received.
    """

    withheld = 0
    waiting = 0.0
    """Taking never waits; the rest is in the system's buffer."""

    def __init__(self, transceiver: Transceiver, recording: SessionRecording) -> None:
        self._transceiver = transceiver
        self._recording = recording
        self._items: list[Item] = []
        self._finished = False

    @property
    def url(self) -> LinkUrl:
        """Of the link."""
        return self._transceiver.url

    @property
    def gate(self) -> Requests:
        """Decides what is sent."""
        return self._transceiver.gate

    @property
    def link_report(self) -> LinkReport:
        """As things stand."""
        return self._transceiver.link_report

    @property
    def recording_report(self) -> RecordingReport:
        """As things stand."""
        recording = self._recording
        return RecordingReport(
            recording.active,
            recording.path,
            recording.dropped,
            tuple(recording.lines()),
        )

    def follow(self, vehicle: tuple[int, int]) -> None:
        """Answer to this vehicle from now on."""
        self._transceiver.follow(vehicle)

    def next_items(self, timeout: float) -> list[Item]:
        """Wait up to `timeout` s; what came, recorded."""
        if not self._finished and not self._items:
            self._receive(timeout)
        items, self._items = self._items, []
        return items

    def _receive(self, timeout: float) -> None:
        for batch in self._transceiver.receive(timeout):
            self._recording.write(batch.time_us, batch.frames)
            self._items.append(batch)

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
        if self._recording.active:
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
            self._transceiver.close()
            self._recording.finish()
            self._items.append(Ended())

    def close(self) -> None:
        """End without handing over what is left."""
        self.finish()
