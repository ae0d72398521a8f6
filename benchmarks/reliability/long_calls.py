"""Which calls of a live session keep samples waiting: how many are long, and for how long."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from gcs_sysid.estimation.changes.change_watch import ChangeWatch
from gcs_sysid.estimation.online.online import OnlineEstimator
from gcs_sysid.estimation.online.rotation_estimator import RotationEstimator
from gcs_sysid.live.flight_coach import Coach
from gcs_sysid.live.live_estimate import HoverWatch, LiveEstimate
from gcs_sysid.live.live_session import LiveSession

LONG_MS = 5.0
CALLS: dict[str, tuple[type, str]] = {
    "health of the last 90 s": (HoverWatch, "look"),
    "coach: maneuvers compared": (Coach, "think"),
    "full fit, between flights and at the end": (OnlineEstimator, "_full_fit"),
    "running fit that chooses whiteners": (OnlineEstimator, "_settle"),
    "validation of a fit": (RotationEstimator, "validate"),
    "quick fits": (OnlineEstimator, "_followed"),
    "change before there is a reference": (ChangeWatch, "early"),
    "0.1 s of frames: decoding, grid, rows": (LiveEstimate, "learn"),
    "snapshot": (LiveSession, "_publish"),
    "result passed on": (LiveSession, "_report_result"),
}
"""What is told apart. A call's time is without that of others in it."""


@dataclass
class Tally:
    """Of one kind of call: all, the long ones, s that these took, and the longest."""

    count: int = 0
    long: int = 0
    seconds: float = 0.0
    longest: float = 0.0

    def add(self, seconds: float) -> None:
        """Another call."""
        self.count += 1
        if 1e3 * seconds > LONG_MS:
            self.long += 1
            self.seconds += seconds
            self.longest = max(self.longest, seconds)


class LongCalls:
    """Times the calls of a session's thread.

    Args:
        now: s, of a clock.
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._inside: list[float] = []  # s, of calls within those that have begun
        self._tallies = {what: Tally() for what in CALLS}

    def watch(self) -> None:
        """Have these calls timed from now on."""
        for what, (owner, name) in CALLS.items():
            setattr(owner, name, self._timed(what, getattr(owner, name)))

    def _timed(self, what: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*words: Any, **settings: Any) -> Any:
            began = self._now()
            self._inside.append(0.0)
            try:
                return call(*words, **settings)
            finally:
                spent = self._now() - began
                self._tallies[what].add(spent - self._inside.pop())
                if self._inside:
                    self._inside[-1] += spent

        return timed

    def table(self) -> str:
        """Calls that are long, the kind that takes longest first."""
        found = sorted(self._tallies.items(), key=lambda item: -item[1].seconds)
        head = f"{'call':<44}{'calls':>9}{f'> {LONG_MS:.0f} ms':>9}{'s in all':>10}{'longest':>12}"
        return "\n".join(
            [head]
            + [
                f"{what:<44}{of.count:>9}{of.long:>9}{of.seconds:>10.2f}{1e3 * of.longest:>9.0f} ms"
                for what, of in found
                if of.long
            ]
        )
