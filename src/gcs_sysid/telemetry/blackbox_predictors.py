"""Decodes blackbox frames from differences to values, and checks their plausibility.

Between two I frames the differences add up: one sum over all frames for the predictor "as before",
two for "in a straight line". "The mean of the last two" is rounded at every step, so it is taken
step by step, but for all chains of P frames together.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.telemetry.blackbox_format import (
    AVERAGE_2,
    INCREMENT,
    MOTOR_0,
    PREVIOUS,
    STRAIGHT_LINE,
    UNCUT,
    Definition,
    Header,
)

_LONGEST_CHAIN = 4096
"""P frames after an I frame; firmware writes 1024 at most."""
WRAP = 2**32
MOST_TIME, MOST_LOOPS = 10_000_000, 5_000
"""us and loops between two frames that belong together; as the reference decoder."""


@dataclass(frozen=True)
class FrameTable:
    """Frames of one type.

    Attributes:
        names: of the columns.
        order: (n,) rising, the place of each among the frames of all types.
        values: (n, columns) integers as logged.
    """

    names: tuple[str, ...]
    order: Array
    values: Array

    def columns(self, *names: str) -> Array | None:
        """(n, names) as floats; None when one of them is not there."""
        if not set(names) <= set(self.names):
            return None
        return self.values[:, [self.names.index(name) for name in names]].astype(float)


def main_frames(
    header: Header, keys: FrameTable, deltas: FrameTable, breaks: Array, resumed: Array
) -> tuple[FrameTable, Array]:
    """The I and P frames that can be computed and believed, and (n,) us of each.

    Args:
        header: of the session.
        keys: the I frames as written.
        deltas: the P frames as written, with the same columns.
        breaks: (k,) rising places where P frames lose what they build on.
        resumed: (k, 3) order, loop and us of events that mark a pause.
    """
    order = np.concatenate([keys.order, deltas.order])
    sorting = np.argsort(order, kind="stable")
    order, is_key = order[sorting], sorting < len(keys.order)
    rows = np.arange(len(order))
    key = np.maximum.accumulate(np.where(is_key, rows, -1))
    since = np.searchsorted(breaks, order) - np.searchsorted(breaks, order[key])
    sound = is_key | ((key >= 0) & (since == 0) & (rows - key <= _LONGEST_CHAIN))
    order, is_key = order[sound], is_key[sound]
    values = np.asfortranarray(np.concatenate([keys.values, deltas.values])[sorting[sound]])
    if not len(order):
        return FrameTable(keys.names, order, values), order
    chains = _chains(is_key)
    _predict(header, keys.names, values, chains)
    loop = values[:, keys.names.index("loopIteration")] % WRAP
    clock = values[:, keys.names.index("time")] % WRAP
    jump, forward = np.diff(loop, prepend=loop[:1]), np.diff(clock, prepend=clock[:1]) % WRAP
    wrong = ~is_key & ((jump < 0) | (jump >= MOST_LOOPS) | (forward >= MOST_TIME))
    sound = chains.since(np.cumsum(wrong)) == 0
    passed = chains.since(np.cumsum(np.where(is_key, 0, forward)))
    first = chains.first
    last = first + np.bincount(chains.number, sound).astype(np.int64) - 1
    table = np.column_stack([order[first], loop[first], clock[first], loop[last], clock[last]])
    starts = _believed_starts(table, passed[last], resumed)
    sound &= starts[chains.number] >= 0
    time = starts[chains.number] + passed
    return FrameTable(keys.names, order[sound], values[sound]), time[sound]


class _Chains(NamedTuple):
    """I frames, each followed by its P frames."""

    first: Array
    """(k,) rows of the I frames."""
    lengths: Array
    """(k,) rows from each I frame to the next."""
    number: Array
    """(n,) which chain a row belongs to."""

    def held(self, values: Array) -> Array:
        """(k,) of the I frames as (n,)."""
        return np.repeat(values, self.lengths)

    def since(self, sums: Array) -> Array:
        """What (n,) sums have grown by since the I frame."""
        grown: Array = sums - self.held(sums[self.first])
        return grown


def _chains(is_key: Mask) -> _Chains:
    """Of (n,) rows, the first of which is an I frame."""
    first = np.flatnonzero(is_key)
    return _Chains(first, np.diff(first, append=len(is_key)), np.cumsum(is_key) - 1)


def _predict(header: Header, names: tuple[str, ...], values: Array, chains: _Chains) -> None:
    """Add the predictions to (n, columns) values as written, in place."""
    keys, deltas = (header.frames[letter].only(names) for letter in "IP")
    constants = header.constants()
    motor = names.index("motor[0]") if "motor[0]" in names else 0
    top = values[chains.first]
    for definition, rows in ((keys, top), (deltas, values)):
        predictors = np.array(definition.predictors)
        if definition is deltas:
            rows[chains.first] = 0
            _add_earlier(header, names, predictors, rows, top, chains, definition)
        for predictor, constant in constants.items():
            rows[:, predictors == predictor] += constant
        _wrap(rows, definition)
        if MOTOR_0 in definition.predictors:
            rows[:, predictors == MOTOR_0] += rows[:, [motor]]
            _wrap(rows, definition)
    values[chains.first] = top


def _add_earlier(
    header: Header, names: tuple[str, ...], predictors: Array, values: Array, top: Array,
    chains: _Chains, definition: Definition,
) -> None:  # fmt: skip
    """Add to P frames what is predicted from earlier ones.

    Args:
        header: of the session.
        names: of the columns.
        predictors: (columns,) of P frames.
        values: (n, columns) as written; 0 in the I frames, where any value may come to stand.
        top: (k, columns) of the I frames.
        chains: of the frames.
        definition: of the P frames' columns.
    """
    for predictor in (PREVIOUS, STRAIGHT_LINE):
        for column in np.flatnonzero(predictors == predictor).tolist():
            sums = chains.since(np.cumsum(values[:, column]))
            if predictor == STRAIGHT_LINE:
                sums = chains.since(np.cumsum(sums))
            values[:, column] = sums + chains.held(top[:, column])
    columns = np.flatnonzero(predictors == AVERAGE_2)
    if len(columns):
        written = np.ascontiguousarray(values[:, columns])
        written[chains.first] = top[:, columns]
        low = definition.lowest()[columns]
        values[:, columns] = _averages(written, chains.first, low)
    counted = np.flatnonzero(predictors == INCREMENT)
    loop = names.index("loopIteration")
    if loop in counted:
        n = np.arange(len(values)) - chains.held(chains.first)
        values[:, loop] = _logged_after(header, chains.held(top[:, loop]), n)
    steps = _logged_after(header, values[:-1, loop], np.ones(1, np.int64)) - values[:-1, loop]
    steps = chains.since(np.append([0], np.cumsum(steps)))
    for column in counted[counted != loop].tolist():
        values[:, column] = chains.held(top[:, column]) + steps


def _averages(values: Array, first: Array, low: Array) -> Array:
    """Add to differences the mean of the two values before, rounded towards zero.

    Args:
        values: (n, columns) I frames as they are and P frames as written; changed.
        first: (k,) rows of the I frames.
        low: (columns,) lowest values of columns that are cut to 32 bits.
    """
    lengths = np.diff(first, append=len(values))
    by_length = np.argsort(-lengths, kind="stable")
    starts, shorter = first[by_length], -lengths[by_length]
    for step in range(1, int(lengths.max())):
        rows = starts[: np.searchsorted(shorter, -step)] + step
        both = values[rows - 1] + values[rows - min(step, 2)]
        both += both < 0
        both >>= 1
        values[rows] = _cut(both + values[rows], low)
    return values


def _logged_after(header: Header, loop: Array, n: Array) -> Array:
    """The n-th loop that is logged after a loop; for n = 0 that loop."""
    logged, interval = header.logged, header.interval
    before = loop // interval * len(logged)
    rank = before + np.searchsorted(logged, loop % interval, side="right") + n - 1
    later = rank // len(logged) * interval + logged[rank % len(logged)]
    found: Array = np.where(n == 0, loop, later)
    return found


def _outside(values: Array, low: Array) -> Mask:
    """(columns,) whether some value needs more than 32 bits and must not."""
    if not len(values):
        return np.zeros(len(low), bool)
    outside: Mask = (values.min(axis=0) < low) | (values.max(axis=0) >= low + WRAP)
    outside &= low != UNCUT
    return outside


def _cut(values: Array, low: Array) -> Array:
    return np.where(low == UNCUT, values, (values - low) % WRAP + low)


def _wrap(values: Array, definition: Definition) -> None:
    """Cut values to 32 bits where the reference does, in place."""
    low = definition.lowest()
    outside = _outside(values, low)
    if outside.any():
        values[:, outside] = _cut(values[:, outside], low[outside])


def slow_frames(header: Header, written: FrameTable) -> FrameTable:
    """S frames, which build on no others, from those as written."""
    definition = header.frames["S"].only(written.names)
    constants = header.constants()
    values = written.values + [constants.get(p, 0) for p in definition.predictors]
    _wrap(values, definition)
    return replace(written, values=values)


def latest(order: Array, values: Array, places: Array) -> Array:
    """(k,) the last of (n,) values before each place; 0 before the first."""
    before = np.searchsorted(order, places)
    last: Array = np.append([0], values)[before]
    return last


def _believed_starts(chains: Array, passed: Array, resumed: Array) -> Array:
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
    now = paused = 0
    for i, (_, loop, clock, end_loop, end_clock) in enumerate(rows):
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
            doubted = (i, end_loop, end_clock)
            continue
        starts[i] = start
        now = start + times[i]
        last, doubted = (end_loop, end_clock), None
    return np.array(starts, np.int64)


def _follows(last: tuple[int, int], loop: int, clock: int) -> bool:
    return 0 <= loop - last[0] < MOST_LOOPS and (clock - last[1]) % WRAP < MOST_TIME
