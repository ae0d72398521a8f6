"""The one door to recordings of every kind.

    log = open_log(Path("flight.ulg"))
    for block in log.blocks():
        ...
    print(log.vehicle, log.as_dict())

What a file is shows in its content, not in its name.
"""

import weakref
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError
from gcs_sysid.files import BAG_SUFFIXES, check_regular, is_bag_folder, split_log, unreadable
from gcs_sysid.signals.columns import IntakeEvent, RecordBlock
from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.clock import ClockDrift
from gcs_sysid.telemetry.intake import Intake
from gcs_sysid.telemetry.log_formats import BY_NAME, format_of, unpack, usual_endings
from gcs_sysid.telemetry.monitor import Counts, SampleLoss
from gcs_sysid.telemetry.tlog import TlogReader
from gcs_sysid.telemetry.track_collector import Recording
from gcs_sysid.telemetry.vehicles import MavlinkSystem


class TlogLog(Intake):
    """What a ground station recorded."""

    kind = "tlog"

    def __init__(self, path: Path, wanted: tuple[int, int | None] | None = None) -> None:
        super().__init__(wanted)
        self._reader = TlogReader(path)
        self._size = max(path.stat().st_size, 1)

    def blocks(self) -> Iterator[RecordBlock]:
        """The records of the chosen vehicle and the events, once; blocks follow each other."""
        for frames in self._reader.blocks():
            if self.recorded is None:
                self.recorded = float(frames.time_us[0]) * 1e-6
            yield self.block(frames)

    @property
    def share_read(self) -> float:
        """How much of it was read, 0 to 1."""
        return self._reader.bytes_read / self._size

    def as_dict(self) -> dict[str, Any]:
        """The result's `telemetry`."""
        self.garbage_bytes = self._reader.counts.garbage_bytes
        torn = self._reader.counts.cut_short
        facts = {"clock_drift_ppm": self.drift.ppm} | ({"cut_short": torn} if torn else {})
        return {**super().as_dict(), **facts}


class OnboardLog:
    """What the autopilot recorded itself: all of one vehicle, read at once."""

    recorded: float | None = None

    def __init__(
        self, kind: str, recording: Recording, wanted: tuple[int, int | None] | None = None
    ) -> None:
        self.kind = kind
        self.problems = recording.problems
        self.drift = ClockDrift(by_gps=True)
        self.drift.add_moments(*recording.clock)
        self._recording = recording
        own = MavlinkSystem(
            recording.system, recording.component, recording.vehicle_type, recording.autopilot
        )
        self.systems = [own]
        fits = wanted is None or (wanted[0] == own.system and wanted[1] in (None, own.component))
        self.vehicle = own if fits else None
        self.parameters = {name: value for _, name, value in recording.parameters}
        start, _ = self._span()
        received = IntakeEvent(start, "vehicle", f"{own} found")
        self._notes = ((0, received),) if fits else ()
        self.share_read = 0.0

    def blocks(self) -> Iterator[RecordBlock]:
        """The records of the vehicle, once: one block."""
        if self.vehicle is not None:
            self.share_read = 1.0
            yield replace(self._recording.block(), events=self._notes)

    @property
    def extras(self) -> Mapping[str, tuple[Array, Array]]:
        """As of `Recording`."""
        return self._recording.extras

    def as_dict(self) -> dict[str, Any]:
        """The result's `telemetry`, with the writing's pauses as `dropouts`."""
        recording = self._recording
        start, end = self._span()
        span = end - start
        entries = sum(recording.counts.values())
        return {
            "duration": span,
            "systems": [str(system) for system in self.systems],
            "messages": {
                name: {"count": n, "rate": n / span if span > 0.0 else None}
                for name, n in sorted(recording.counts.items())
            },
            "received": entries,
            "unknown": 0,
            "bad_crc": 0,
            "garbage_bytes": recording.garbage_bytes,
            "damaged": recording.damaged,
            "lost": recording.lost,
            "lost_percent": 100.0 * recording.lost / max(entries + recording.lost, 1),
            **self._imu_loss().as_dict(),
            "dropouts": {
                "count": len(recording.dropouts),
                "seconds": sum(length for _, length in recording.dropouts),
            },
            "reboots": 0,
            "dropped": dict(recording.dropped),
        }

    def _span(self) -> tuple[float, float]:
        tracks = self._recording.tracks
        if not tracks:
            return 0.0, 0.0
        return min(float(track.t[0]) for track in tracks), max(
            float(track.t[-1]) for track in tracks
        )

    def _imu_loss(self) -> Counts:
        loss = SampleLoss()
        for track in self._recording.tracks:
            if track.stream is Stream.IMU:
                loss.add_times(track.t)
        return loss.counts


Telemetry = Intake | OnboardLog
"""What a link or a log has beside its records."""
Log = TlogLog | OnboardLog
"""A recording. Its figures are those of what was read so far."""


def open_log(path: Path, wanted: tuple[int, int | None] | None = None) -> Log:
    """Open a log of any of `log_formats.FORMATS`, packed or not, or a table of signals.

    Args:
        path: of the file; `LOG.bbl#2` for its second session, `flight.csv#map.toml` for a table
            and its mapping.
        wanted: system and perhaps component to listen to; None: the first autopilot in it.

    Raises:
        InputError: it is none of these, or cannot be read.
    """
    file_path, session, mapping = split_log(path)
    with ExitStack() as until:
        try:
            if file_path.is_dir() and not is_bag_folder(file_path):
                raise InputError(
                    f"{path} is a folder: give a {usual_endings(' or ')} file in it, or all of "
                    f"them: gcs-sysid batch {path} --airframe NAME -o DIR"
                )
            if is_bag_folder(file_path):
                form, whole = BY_NAME["rosbag"], file_path
            elif mapping is not None and file_path.suffix.lower() not in BAG_SUFFIXES:
                check_regular(file_path)
                form, whole = BY_NAME["table"], unpack(file_path, until)
            else:
                form, whole = format_of(file_path), unpack(file_path, until)
        except OSError as error:
            raise InputError(f"cannot read {path}: {unreadable(file_path, error)}") from error
        if session is not None and not form.in_sessions:
            raise InputError(f"{path}: only blackbox logs hold sessions; give {file_path.name}")
        try:
            if form.name == "tlog":
                log = TlogLog(whole, wanted)
                weakref.finalize(log, until.pop_all().close)  # read as it is asked for
                return log
            part = mapping or session
            recording = form.read(whole, *(() if part is None else (part,)))
        except InputError as error:
            raise InputError(str(error).replace(str(whole), str(file_path))) from error
        return OnboardLog(form.name, recording, wanted)
