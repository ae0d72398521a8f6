"""Which maneuver to fly next."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from gcs_sysid.arrays import Array
from gcs_sysid.coach.information import Motion, information, motion_of, within_reach
from gcs_sysid.coach.interval_targets import excess, is_enough
from gcs_sysid.coach.manoeuvre_library import Manoeuvre
from gcs_sysid.coach.predicted_information import PredictedInformation
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.rows.actuator_dynamics import Coordinate

Judge = Callable[[Fit], Mapping[str, float | None]]
"""Shares of a fit, see `interval_targets.shares`."""

USUAL = 10.0
"""s that a maneuver lasts."""
_LENGTHS = (*range(5, 16), 18, 20)
_BOTH = 0.1
"""Of roll's and pitch's squared rates, what the lesser needs of the greater to start a fit."""
_CLOSE = 0.9
"""Factor by which expected intervals must be narrower than the target: they are an estimate."""


@dataclass(frozen=True)
class Choice:
    """A maneuver and what it is expected to bring.

    Attributes:
        manoeuvre: within the vehicle's reach, with its length.
        motion: of it.
        now: shares before.
        expected: shares after.
        after: the fit expected then.
        added: (N_UNKNOWNS, N_UNKNOWNS) information from one second of it.
    """

    manoeuvre: Manoeuvre
    motion: Motion
    now: Mapping[str, float | None]
    expected: Mapping[str, float | None]
    after: Fit
    added: Array

    @property
    def names(self) -> list[str]:
        """Parameters that it narrows, the widest first; what is unknown in its usual order."""
        # To gain less than 3 % is not worth a word.
        gained = [
            (-math.inf if before is None or before > 1.0 else -before, place, name)
            for place, (name, share) in enumerate(self.expected.items())
            for before in (self.now.get(name),)
            if share is not None and (before is None or share < 0.97 * before)
        ]
        return [name for _, _, name in sorted(gained)]

    def names_above(self, target: float) -> list[str]:
        """Of `names`, those not yet within the target share; all of them where every one is."""
        names = self.names
        wide = [n for n in names if (before := self.now.get(n)) is None or before > target]
        return wide or names


def choose(
    prospect: PredictedInformation,
    library: Iterable[Manoeuvre],
    judge: Judge,
    target: float,
    achieved: Callable[[Manoeuvre], Manoeuvre] | None = None,
) -> Choice | None:
    """The maneuver that brings the widest intervals nearest to the target; None: none can.

    Args:
        prospect: what is known.
        library: to choose from.
        judge: gives the shares of a fit.
        target: share to reach.
        achieved: a maneuver as the vehicle was seen to fly it: the same with smaller swings.
            Expected information is that of the achieved one.
    """
    now = judge(prospect.after())
    far = excess(now, _CLOSE * target)
    best: tuple[float, Manoeuvre, Motion, Array] | None = None
    for manoeuvre in library:
        found = within_reach(manoeuvre, prospect.craft)
        if found is None:
            continue
        reached, motion = found
        if achieved is not None and (flown := achieved(reached)) != reached:
            motion = motion_of(flown, prospect.craft)
        if prospect.fit.rotation is None and not _starts(motion):
            continue
        added = information(
            motion, prospect.craft, prospect.noise, float(prospect.coordinates[Coordinate.LAG])
        )
        reached = reached.lasting(USUAL)
        left = excess(judge(_after(prospect, added, reached)), _CLOSE * target)
        if best is None or left < best[0]:
            best = left, reached, motion, added
    if best is None or not best[0] < far:
        return None
    _, chosen, motion, added = best
    for seconds in _LENGTHS:
        tried = chosen.lasting(float(seconds))
        if is_enough(judge(_after(prospect, added, tried)), _CLOSE * target):
            chosen = tried
            break
    after = _after(prospect, added, chosen)
    return Choice(chosen, motion, now, judge(after), after, added)


def _starts(motion: Motion) -> bool:
    """Whether a fit can start from it alone: that takes motion in roll and in pitch."""
    roll, pitch, _ = (motion.rates**2).mean(axis=0)
    return bool(min(roll, pitch) > _BOTH * max(roll, pitch))


def _after(prospect: PredictedInformation, added: Array, manoeuvre: Manoeuvre) -> Fit:
    return prospect.after(added, manoeuvre.seconds, manoeuvre.effective_seconds)
