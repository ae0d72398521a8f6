"""Each rotor's measured speed against its command, the other rotors and its own age.

Motors of one vehicle turn alike for one command, within what propellers scatter. A rotor that reads
otherwise either turns otherwise, or its ESC reports another number of poles. Yaw decides: reaction
torque balances in hover, so that the stream by which it does not is the wrong one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array

_APART = 0.1
"""Share by which a speed differs from what its command gives the others: motors of one make scatter
by 3 %; pole counts of 12 and 14 make 15 %."""
_OUT_OF_BALANCE = 0.05
"""Share of the load by which yaw is out of balance beyond that by the other stream: one rotor of
four that is 10 % off."""
_HOLDS, _FEWEST, _HELD = 0.15, 5, 0.2
"""s and repeats for which a rotor's reading stays the same while most others change, and the share
of time in such holds from which its readings are not those of its rotor."""


@dataclass(frozen=True)
class OddReading:
    """A rotor whose speed is not that of the others at its command.

    Attributes:
        rotor: from 0.
        ratio: speed read over the speed that the others have at that command.
        by_command: whether yaw balances by commands and not by speeds.
    """

    rotor: int
    ratio: float
    by_command: bool

    @property
    def words(self) -> str:
        """Why its speeds are not used."""
        return (
            f"rotor {self.rotor + 1} reads {self.ratio:.2f} times the speed that the others have "
            "at its command, and yaw would be out of balance: check the pole count of its ESC"
        )


_ROUNDED = 3.0
"""Least steps by which a reading must usually change in the time of a hold."""


def odd_reading(speeds: Array, commands: Array, spin: Array) -> OddReading | None:
    """The rotor that reads otherwise than the others, if one does.

    Args:
        speeds: (n, rotors) in any unit, all turning; NaN: no reading.
        commands: (m, rotors) likewise, of the same stretch of flight.
        spin: (rotors,) 1 or -1.
    """
    if len(speeds) < 2 or len(commands) < 2:
        return None
    omega, u = np.nanmean(speeds, axis=0), np.nanmean(commands, axis=0)
    if not (np.isfinite(omega).all() and np.isfinite(u).all() and omega.min() > 0.0):
        return None
    # One slope for all, from how much either moves: lag shifts it, and does not scale it.
    moves = float(np.median(np.nanstd(commands, axis=0)))
    slope = float(np.median(np.nanstd(speeds, axis=0))) / moves if moves > 0.0 else 0.0
    expected = np.median(omega - slope * (u - np.median(u))) + slope * (u - np.median(u))
    ratio = omega / expected
    rotor = int(np.abs(np.log(np.maximum(ratio, 1e-9))).argmax())
    if not expected.min() > 0.0 or abs(ratio[rotor] - 1.0) < _APART:
        return None
    by_speed, by_command = (abs(spin @ w**2) / float((w**2).sum()) for w in (omega, expected))
    return OddReading(rotor, float(ratio[rotor]), by_speed > by_command + _OUT_OF_BALANCE)


def together(rotors: Sequence[tuple[Array, Array]]) -> Array:
    """(n, rotors) readings of all rotors, number by number, from the times and values of each."""
    n = min(len(v) for _, v in rotors)
    out: Array = np.column_stack([v[:n] for _, v in rotors])
    return out


def held_reading(rotors: Sequence[tuple[Array, Array]]) -> str:
    """Why speeds are not used of which one rotor's are old; empty where none are.

    Args:
        rotors: times and values of each. Those that came one by one are not compared.
    """
    times = rotors[0][0]
    if any(len(t) != len(times) for t, _ in rotors[1:]):
        return ""
    held = held_rotor(times, together(rotors))
    if held is None:
        return ""
    return (
        f"holds old readings of rotor {held[0] + 1} for {100.0 * held[1]:.0f} % of the time while "
        "the others change"
    )


def held_rotor(t: Array, speeds: Array) -> tuple[int, float] | None:
    """The rotor whose readings are held while those of the others move on, and for what share.

    One that never changes is another matter: it may stand, or be at its limit.

    Args:
        t: (n,) s, rising.
        speeds: (n, rotors).
    """
    if len(t) < 2 or speeds.shape[1] < 2:
        return None
    same = np.diff(speeds, axis=0) == 0.0
    others = (same.shape[1] - 1) / 2.0
    apart = max(_FEWEST, round(_HOLDS / max(float(np.median(np.diff(t))), 1e-9)))
    worst = (0, 0.0)
    for rotor in range(same.shape[1]):
        # Where it hardly changes in that time, rounding alone may hold it.
        if not _changes(speeds[:, rotor], apart) > _ROUNDED:
            continue
        moved = (~np.delete(same, rotor, axis=1)).sum(axis=1) >= others
        held = np.concatenate([[False], same[:, rotor], [False]])
        begins, ends = (np.flatnonzero(held[:-1] < held[1:]), np.flatnonzero(held[:-1] > held[1:]))
        counts = np.concatenate([[0], np.cumsum(moved)])
        long = (t[ends] - t[begins] >= _HOLDS) & (ends - begins >= _FEWEST)
        alone = counts[ends] - counts[begins] > 0.5 * (ends - begins)
        share = float((t[ends] - t[begins])[long & alone].sum()) / max(float(t[-1] - t[0]), 1e-9)
        worst = max(worst, (rotor, share), key=lambda one: one[1])
    return worst if worst[1] > _HELD else None


def _changes(values: Array, apart: int) -> float:
    """Least steps by which (n,) readings usually change over so many messages."""
    steps = np.diff(np.unique(values))
    if not len(steps) or len(values) <= apart:
        return 0.0
    return float(np.median(np.abs(values[apart:] - values[:-apart])) / steps.min())
