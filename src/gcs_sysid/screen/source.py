"""What the screen needs of a session, what may be done with one, and all that it knows of it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from gcs_sysid.results.result import Result
from gcs_sysid.results.snapshot import Snapshot


class SnapshotSource(Protocol):
    """Whatever makes snapshots: a running session, the replay of a log, a still.

    Both methods are called from the screen's thread while the source runs in its own, so they
    are thread-safe.
    """

    def latest(self) -> Snapshot | None:
        """The newest snapshot, the same object again while there is nothing new.

        Returns at once. None until there is a first one.
        """
        ...

    def stop(self) -> None:
        """End the session. Called when the user quits; calling it again does nothing."""
        ...


@dataclass(frozen=True)
class Actions:
    """Actions of the screen. None: not with this source, and the screen shows `absent`.

    Each is called from the screen's thread and returns at once, but `export` and `report`, which
    are called in a thread of their own. What an action changed is the session's to report: it
    adds an `Event` to its next snapshots, so that the event log, the recording and the headless
    output agree. An action that fails raises a `GcsSysidError` or an `OSError`; the screen shows
    its one line and goes on. A text returned says what happened, in one line.

    Attributes:
        mark: write a mark into the event log at the present instant.
        reset: forget all information gathered so far and restart the estimate.
        toggle_recording: start or stop recording; such as "recording to flight.tlog".
        set_anchor: change the scale reference: "mass", "k_T" or "T_max", and its value in SI.
        choose_vehicle: restart on another vehicle: its system and component.
        export: write a result for a simulator: one of `export_targets`; never over another file.
        export_targets: names of the formats.
        report: write a report of the flight so far; never over another file.
        absent: why some are None, in words that follow "not": "in a replay".
    """

    mark: Callable[[str], None] | None = None
    reset: Callable[[], None] | None = None
    toggle_recording: Callable[[], str] | None = None
    set_anchor: Callable[[str, float], str] | None = None
    choose_vehicle: Callable[[tuple[int, int]], str] | None = None
    export: Callable[[str, Result], str] | None = None
    export_targets: tuple[str, ...] = ()
    report: Callable[[], str] | None = None
    absent: str = "here"
