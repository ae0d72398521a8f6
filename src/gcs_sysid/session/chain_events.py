"""What happened to a chain's link, rotors, IMU and estimate, for the event log and for results."""

from collections import deque
from typing import Any

from gcs_sysid.results.snapshot import Event
from gcs_sysid.sanitize import one_line
from gcs_sysid.signals.columns import IntakeEvent
from gcs_sysid.signals.time_base import TimeBase

_MOST_NOTES = 300
_MOST_OF_ORIGIN = 1000


class ChainEvents:
    """Keeps the latest events; times are s, session time.

    Attributes:
        of_rotors: rotor streams that died, came again or were replaced, as in a result.
        of_origin: what link or log said between records, as in a result.
    """

    def __init__(self) -> None:
        self.of_rotors: deque[dict[str, Any]] = deque(maxlen=_MOST_NOTES)
        self.of_origin: deque[dict[str, Any]] = deque(maxlen=_MOST_OF_ORIGIN)
        self._notes: deque[Event] = deque(maxlen=_MOST_NOTES)
        self._usable = True
        self._spiked = self._stood_still = False

    @property
    def notes(self) -> tuple[Event, ...]:
        """The event log, the latest last."""
        return tuple(self._notes)

    def note(self, t: float, text: str) -> None:
        """Add a line to the event log."""
        self._notes.append(Event(t, one_line(text)))

    def note_rotors(self, t: float, text: str) -> None:
        """Add what happened to the rotors' input."""
        self.note(t, text)
        self.of_rotors.append({"t": t, "kind": "rotor_input", "text": text})

    def note_origin(self, t: float, event: IntakeEvent) -> None:
        """Add what link or log said, which has its line already."""
        self.of_origin.append({"t": t, "kind": event.kind, "text": event.text})

    def note_imu(self, t: float, base: TimeBase) -> None:
        """Add when the IMU becomes too slow for the grid, and when it no longer is; when the first
        gyro spike was replaced, and when rotor speeds first stood still.

        How many there were is in the result.
        """
        if base.is_usable != self._usable:
            self._usable = base.is_usable
            consequence = "the estimate continues" if self._usable else "too slow for the estimate"
            rate = f"at {1.0 / base.imu_interval:.0f} Hz" if base.imu_interval else "again"
            self.note(t, f"IMU data {rate}: {consequence}")
        if base.faults.spikes and not self._spiked:
            self._spiked = True
            self.note(t, "gyro spikes: replaced by interpolation")
        if base.still_speeds and not self._stood_still:
            self._stood_still = True
            self.note(t, "rotor speeds frozen under new timestamps: not used")
