"""What sessions show: the thread that publishes it, the pictures, the link, the backlog of data."""

import threading
from abc import ABC, abstractmethod
from dataclasses import replace
from pathlib import Path
from typing import Any

from gcs_sysid.judgement.judge import object_to
from gcs_sysid.live.receiver_process import Source
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.estimate import Objection
from gcs_sysid.results.history import Acceleration
from gcs_sysid.results.result import Result
from gcs_sysid.results.snapshot import Advice, FoundVehicle, LinkState, LinkStatus, Snapshot
from gcs_sysid.session.chain import Chain
from gcs_sysid.telemetry.ground_station import GroundStation
from gcs_sysid.telemetry.intake import Intake

RESULT_EVERY = 1.0
"""s of the vehicle's clock between results that are passed on."""


class Session(ABC):
    """Publishes snapshots from a thread of its own: a live session or a replay."""

    def __init__(self, name: str) -> None:
        self.final: Result | None = None
        """The last result, once the session has ended."""
        self.problem: Exception | None = None
        """The first defect, or what ended the session against its will."""
        self._latest: Snapshot | None = None
        self._stop, self._wake = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    @property
    @abstractmethod
    def airframe(self) -> Airframe:
        """With the anchor in force."""

    @abstractmethod
    def recordings(self) -> list[str]:
        """A line for each recording of an ended session: where it is, or why it is not."""

    @abstractmethod
    def flushed_recording(self) -> Path | None:
        """The latest recording, all that was written so far in the file; None without one."""

    @abstractmethod
    def start(self) -> None:
        """Publish a first snapshot, and begin."""

    @abstractmethod
    def _run(self) -> None:
        """The work, in the session's thread."""

    def latest(self) -> Snapshot | None:
        """The newest snapshot."""
        return self._latest

    def request_stop(self) -> None:
        """End the session soon; returns at once."""
        self._stop.set()
        self._wake.set()

    def stop(self) -> None:
        """End the session and wait until everything is written."""
        self.request_stop()
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join()

    def join(self, timeout: float | None = None) -> bool:
        """Wait for the end; whether it has come."""
        self._thread.join(timeout)
        return not self._thread.is_alive()


TOO_SLOW, CAUGHT_UP = 0.5, 0.1
"""s of data that wait: from which the computer is too slow, until it has caught up. A fit of many
minutes takes up to 0.4 s, on a core that does nothing else."""
SELDOM = 5.0
"""s of the vehicle's clock between estimates meanwhile. With none until it has caught up, one that
was behind for a flight showed that flight's first second for all of it."""


class Backlog:
    """Watches how far a session is behind its data.

    Attributes:
        too_slow: whether the computer does not keep up.
        longest: s of data that waited at most.
    """

    def __init__(self, source: Source) -> None:
        self.too_slow = False
        self.longest = 0.0
        self._source = source
        self._seconds = 0.0  # of all times that it was too slow
        self._since = 0.0
        self._longest_now = 0.0
        self._withheld = False

    @property
    def is_idle(self) -> bool:
        """Whether nothing that matters waits."""
        # With more data waiting, in s, there is no time to think about advice.
        return not self.too_slow and self._source.waiting < 0.05

    def look(self, now: float) -> list[str]:
        """Check the backlog; messages about it, one line each.

        Args:
            now: any steady clock, s.
        """
        notes, waiting = [], self._source.waiting
        self.longest = max(self.longest, waiting)
        self._longest_now = max(self._longest_now, waiting)
        if not self.too_slow and waiting > TOO_SLOW:
            self.too_slow, self._since = True, now
            notes.append(
                f"the computer is too slow: {waiting:.1f} s of data waiting, none lost; until it "
                f"has caught up, estimates come every {SELDOM:.0f} s, and no advice"
            )
        elif self.too_slow and waiting < CAUGHT_UP:
            self.too_slow = False
            self._seconds += now - self._since
            notes.append(
                f"caught up after {now - self._since:.1f} s, {self._longest_now:.1f} s behind "
                "at most"
            )
        if not self.too_slow:
            self._longest_now = 0.0
        if self._source.withheld and not self._withheld:
            self._withheld = True
            notes.append("the backlog is too large: some data are not used for the estimate")
        return notes

    def last_words(self) -> list[str]:
        """Messages at the end of the data."""
        waiting = self._source.waiting
        if waiting < TOO_SLOW:
            return []
        return [f"no more comes; {waiting:.0f} s of data still to process"]

    def as_dict(self, now: float) -> dict[str, Any]:
        """For the result's `telemetry`."""
        slow = self._seconds + (now - self._since if self.too_slow else 0.0)
        return {
            "kernel_drops": self._source.link_report.dropped,
            "longest_wait": self.longest,
            "too_slow_seconds": slow,
            "not_learnt": self._source.withheld,
        }

    @property
    def reasons(self) -> tuple[str, ...]:
        """What a result misses for want of speed, one line each."""
        lines = []
        if self._source.withheld:
            lines.append(
                f"{self._source.withheld} messages were not used, because the computer was "
                f"too slow: "
                "analyze the recording"
            )
        dropped = self._source.link_report.dropped
        if dropped:
            lines.append(
                f"the system dropped {dropped} datagrams, because this computer did not read them "
                "in time"
            )
        return tuple(lines)


def link_status(
    state: LinkState, source: Source, station: GroundStation, intake: Intake, *, too_slow: bool
) -> LinkStatus:
    """Figures of the moment.

    `too_slow`: the session cannot keep up.
    """
    chosen = None if intake.vehicle is None else intake.vehicle.address
    return LinkStatus(
        state=state,
        url=str(source.url),
        vehicle=str(intake.vehicle or ""),
        asked=dict(station.asked),
        clock_ppm=intake.drift.ppm,
        vehicles=tuple(
            FoundVehicle(v.address, str(v), v.address == chosen) for v in intake.selector.autopilots
        ),
        recording=source.recording_report.path,
        waiting=source.waiting,
        too_slow=too_slow,
        dropped=source.link_report.dropped,
        **intake.health(),
    )


def with_link(
    result: Result, source: Source, station: GroundStation, backlog: Backlog, now: float
) -> Result:
    """A result with what only the link knows; the numbers stay those of the frames alone."""
    telemetry = {**result.telemetry, **station.as_dict(), "receiver": backlog.as_dict(now)}
    dropped = source.recording_report.dropped
    if dropped:
        telemetry["recording"] = {"missing": dropped}
    said = (
        *(Objection(problem, by="link") for problem in station.problems),
        *(Objection(reason, verdict="identified", by="receiver") for reason in backlog.reasons),
    )
    return replace(object_to(result, said), telemetry=telemetry)


def picture(
    chain: Chain,
    result: Result,
    link: LinkStatus,
    acceleration: Acceleration | None,
    target: float,
    advice: Advice | None,
) -> Snapshot:
    """State of a chain, with the link's and the recorder's."""
    sampler = chain.sampler
    return Snapshot(
        t=chain.t,
        used_seconds=chain.fit.seconds,
        flying=sampler.flying,
        result=result,
        history=chain.history,
        link=link,
        attitude=sampler.attitude,
        rates=sampler.rates,
        rotor_speeds=sampler.rotor_speeds,
        acceleration=acceleration,
        target=target,
        events=chain.events,
        advice=advice,
    )
