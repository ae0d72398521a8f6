"""Which calls of a live session keep samples waiting: how many are long, and for how long."""

from collections import defaultdict
from collections.abc import Callable
from typing import Any

from gcs_sysid.estimation.change_watch import ChangeWatch
from gcs_sysid.estimation.online import OnlineEstimator
from gcs_sysid.live.flight_coach import Coach
from gcs_sysid.live.hover_watch import HoverWatch
from gcs_sysid.live.live_session import LiveSession
from gcs_sysid.session.pipeline import Pipeline

LONG_MS = 5.0
CALLS: dict[str, tuple[type, str]] = {
    "health of the last 90 s": (HoverWatch, "look"),
    "coach: maneuvers compared": (Coach, "think"),
    "full fit, between flights and at the end": (OnlineEstimator, "_full_fit"),
    "running fit that chooses whiteners": (OnlineEstimator, "_settle"),
    "validation of a fit": (OnlineEstimator, "_validate"),
    "quick fits": (OnlineEstimator, "_followed"),
    "change before there is a reference": (ChangeWatch, "early"),
    "0.1 s of frames: decoding, grid, rows": (Pipeline, "_read"),
    "snapshot": (LiveSession, "_publish"),
    "result passed on": (LiveSession, "_report_result"),
}
"""What is told apart. A call's time is without that of others in it."""


class LongCalls:
    """Times the calls of a session's thread.

    Args:
        now: s, of a clock.
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._inside: list[float] = []  # s, of calls within those that have begun
        self._times: dict[str, list[float]] = defaultdict(list)

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
                self._times[what].append(spent - self._inside.pop())
                if self._inside:
                    self._inside[-1] += spent

        return timed

    def table(self) -> str:
        """Calls that are long, the kind that takes longest first."""
        rows = []
        for what, times in self._times.items():
            long = [t for t in times if 1e3 * t > LONG_MS]
            if long:
                rows.append((sum(long), what, len(times), len(long), max(long)))
        head = f"{'call':<44}{'calls':>9}{f'> {LONG_MS:.0f} ms':>9}{'s in all':>10}{'longest':>12}"
        return "\n".join(
            [head]
            + [
                f"{what:<44}{count:>9}{number:>9}{total:>10.2f}{1e3 * most:>9.0f} ms"
                for total, what, count, number, most in sorted(rows, reverse=True)
            ]
        )
