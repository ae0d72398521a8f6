"""Data waiting to be processed, and when they are too many."""

from typing import Any

from gcs_sysid.live.reception import Source

TOO_SLOW, CAUGHT_UP = 0.5, 0.1
"""s of data that wait: from which the computer is too slow, until it has caught up. A fit of many
minutes takes up to 0.4 s, on a core that does nothing else."""


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
                f"the computer is too slow: {waiting:.1f} s of data waiting, none lost; advice and "
                "new estimates wait until it has caught up"
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
