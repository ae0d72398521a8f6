"""When the vehicle flew, as a log or link tells it."""

from gcs_sysid.signals.records import Record, Stream

SHORTEST_FLIGHT = 1.0
"""s; less is a jump of the autopilot's judgement."""
MOST_FLIGHTS = 1000


class FlightWatch:
    """When the vehicle flies: what the autopilot says, else armed with its rotors turning."""

    def __init__(self) -> None:
        self.spans: list[tuple[float, float]] = []
        self._in_air: bool | None = None
        self._armed: bool | None = None
        self._turning: dict[tuple[str, int], bool] = {}
        self._since: float | None = None

    @property
    def told_by(self) -> str:
        """As `Inspection.flight_told_by` says."""
        if self._in_air is not None:
            return "autopilot"
        if self._turning:
            return "rotors"
        return "arming" if self._armed is not None else ""

    @property
    def flying(self) -> bool:
        """Whether it flies, by the records so far."""
        return self._since is not None

    def take(self, record: Record) -> bool:
        """Note a record; whether it flies now."""
        if record.stream is Stream.IN_AIR:
            self._in_air = record.values[0] > 0.5
        elif record.stream is Stream.ARMED:
            self._armed = record.values[0] > 0.5
        elif record.stream is Stream.ROTOR_SPEED and self._in_air is None:
            # One dead ESC does not mean that all stand still.
            turning = sum(1 for speed in record.values if speed > 0.0)
            self._turning[record.source, record.offset] = 2 * turning >= len(record.values)
        if self._in_air is not None:
            return self._in_air
        if self._turning:
            return self._armed is not False and any(self._turning.values())
        return bool(self._armed)

    def turn(self, t: float, *, flying: bool) -> None:
        """Take-off or landing at a time."""
        if flying:
            self._since = t
        elif self._since is not None:
            if t - self._since >= SHORTEST_FLIGHT and len(self.spans) < MOST_FLIGHTS:
                self.spans.append((self._since, t))
            self._since = None

    def reboot(self, t: float) -> None:
        """The autopilot began anew, not knowing of any flight; session time of the moment."""
        self.turn(t, flying=False)
        self._in_air = self._armed = None
        self._turning.clear()
