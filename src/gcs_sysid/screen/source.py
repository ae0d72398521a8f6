"""What the screen needs from a session, and all that it knows of one."""

from typing import Protocol

from gcs_sysid.session.snapshot import Snapshot


class SnapshotSource(Protocol):
    """A running session, seen from the screen.

    Every method is called from the screen's thread while the session runs in its own, so each
    one is thread-safe and returns at once. What an action changed is the session's to report:
    it adds an `Event` to its next snapshots, so that the event log, the recording and the
    headless output tell the same story. An action that fails raises a `GcsSysidError` or an
    `OSError`; the screen shows its one line and goes on.
    """

    def latest(self) -> Snapshot | None:
        """The newest snapshot, the same object again while there is nothing new.

        None until the link is open.
        """
        ...

    def mark(self, text: str) -> None:
        """Write a mark into the event log (and the recording) at the present instant."""
        ...

    def reset(self) -> None:
        """Forget all information gathered so far and start the estimate anew."""
        ...

    def toggle_recording(self) -> str:
        """Start or stop recording; returns what happened, such as "recording to flight.tlog"."""
        ...

    def stop(self) -> None:
        """End the session. Called when the user quits; calling it again does nothing."""
        ...
