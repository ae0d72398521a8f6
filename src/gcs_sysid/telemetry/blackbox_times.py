"""Which chains of blackbox frames are believed, by their loops and times."""

import numpy as np

from gcs_sysid.arrays import Array, Mask

WRAP = 2**32
MOST_TIME, MOST_LOOPS = 10_000_000, 5_000
"""us and loops between two frames that belong together; as the reference decoder."""
_DOUBTS = 16
"""Chains in a row that are not believed, before many are looked at together."""


def believed_starts(chains: Array, passed: Array, resumed: Array) -> Array:
    """(k,) us at which the I frames begin, without wraps; -1 for those not believed.

    As in the reference decoder an I frame must come soon after the last main frame, or after an
    event that marks a pause. The reference decoder loses all that follows a wrong clock; here two
    chains that agree overrule one that does not.

    Args:
        chains: (k, 5) place, loop and us of the I frame, loop and us of the last frame that counts.
        passed: (k,) us between the two.
        resumed: (k, 3) place, loop and us of events.
    """
    pauses = np.searchsorted(resumed[:, 0], chains[:, 0]).tolist()  # before each
    lasting = np.append([0], np.cumsum(np.diff(resumed[:, 2]) % WRAP))  # from the first one
    starts = [-1] * len(chains)
    rows, times = chains.tolist(), passed.tolist()
    start = -1
    last: tuple[int, int] | None = None
    doubted: tuple[int, int, int] | None = None
    now = paused = i = trusted = 0
    while i < len(rows):
        _, loop, clock, end_loop, end_clock = rows[i]
        if pauses[i] > paused:
            now += (int(resumed[paused, 2]) - last[1]) % WRAP if last else int(resumed[paused, 2])
            now += int(lasting[pauses[i] - 1] - lasting[paused])
            paused = pauses[i]
            last, doubted = (int(resumed[paused - 1, 1]), int(resumed[paused - 1, 2])), None
        if last is None or _follows(last, loop, clock):
            start = now + (clock - last[1]) % WRAP if last else clock
        elif doubted is not None and _follows(doubted[1:], loop, clock):
            before = (clock - rows[doubted[0]][2]) % WRAP
            start = now + (clock - last[1] + WRAP // 2) % WRAP - WRAP // 2
            start += WRAP if start < before else 0
            starts[doubted[0]] = max(start - before, 0)
        else:
            if i - trusted > _DOUBTS:
                next_pause = resumed[paused, 0] if paused < len(resumed) else np.inf
                i = _next_believed(chains, i, last, next_pause)
            doubted = (i, *rows[i][3:])
            i += 1
            continue
        starts[i] = start
        now = start + times[i]
        last, doubted = (end_loop, end_clock), None
        trusted = i
        i += 1
    return np.array(starts, np.int64)


def _next_believed(chains: Array, doubted: int, last: tuple[int, int], pause: float) -> int:
    """The last of the chains that are doubted because one is; all between are doubted, too.

    Args:
        chains: as for `believed_starts`.
        doubted: number of the one.
        last: loop and us of the last main frame that is believed.
        pause: the place of the next event that marks a pause.
    """
    at, step = doubted + 1, _DOUBTS
    while at < len(chains):
        some = chains[at - 1 : at + step]
        place, loop, clock = some[1:, :3].T
        may_follow = _follow_each(np.array([last]), loop, clock)
        may_follow |= _follow_each(some[:-1, 3:], loop, clock)
        may_follow |= place > pause
        found = np.flatnonzero(may_follow)
        if len(found):
            return at - 1 + int(found[0])
        at += step
        step *= 2
    return len(chains) - 1


def _follows(last: tuple[int, int], loop: int, clock: int) -> bool:
    return 0 <= loop - last[0] < MOST_LOOPS and (clock - last[1]) % WRAP < MOST_TIME


def _follow_each(last: Array, loop: Array, clock: Array) -> Mask:
    last_loop, last_clock = last.T
    jump = loop - last_loop
    soon: Mask = (jump >= 0) & (jump < MOST_LOOPS) & ((clock - last_clock) % WRAP < MOST_TIME)
    return soon
