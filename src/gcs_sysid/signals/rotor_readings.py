"""Each rotor's measured speed against its command, the others, its age and what shakes the IMU.

Motors of one vehicle turn alike for one command, within what propellers scatter. A rotor that reads
otherwise either turns otherwise, or its ESC reports another number of poles. Yaw decides: reaction
torque balances in hover, so that the stream by which it does not is the wrong one.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from gcs_sysid.arrays import Array, complete_rows
from gcs_sysid.significance import FALSE_ALARM_RATE, student_limit

Rotors = Sequence[tuple[Array, Array]]
"""(n,) s and (n,) values of each rotor."""

APART = 0.1
"""Share by which a speed differs from what its command gives the others: motors of one make scatter
by 3 %; pole counts of 12 and 14 make 15 %."""
AGE = 0.005
"""s by which the readings of one rotor are older than the others', on the average, from which they
are not those of its rotor: 8 ms cost inertia 4 %."""
_HOLDS, _FEWEST, _HELD = 0.1, 5, 0.2
"""s and repeats for which a rotor's reading stays the same while most others change, and the share
of time in such holds from which its readings are not those of its rotor."""


@dataclass(frozen=True)
class OddReading:
    """A rotor whose speed is not that of the others at its command.

    Attributes:
        rotor: from 0.
        ratio: speed read over the speed that the others have at that command.
        by_command: whether yaw balances with its speed by its command, and not with that read.
    """

    rotor: int
    ratio: float
    by_command: bool

    @property
    def words(self) -> str:
        """Why its speeds are not used."""
        reads = f"rotor {self.rotor + 1} reads {self.ratio:.2f} times the speed that"
        if self.by_command:
            reads += " the others have at its command, and yaw would be out of balance"
        else:
            reads += " balances the others"
        return f"{reads}: check the pole count of its ESC"


class RotorLines:
    """What the IMU shows of the speeds read, by pieces from all of a flight.

    Its spectra have lines at multiples of them. And yaw, which sets the rotors of one spin against
    the others, does nothing to thrust where both lift alike for the speed that they read.

    Args:
        spin: (rotors,) 1 or -1.
    """

    _ORDERS = np.geomspace(0.3, 3.4, 243)
    _TURNS, _PIECES, _FEWEST = 64, 256, 16
    """Of the rotors in a piece, whose lines are that sharp; pieces, at most and at least."""
    _OFF, _SLOW = 0.04, 0.1
    """Share by which a line may be off a whole multiple; share of the IMU's rate below which its
    spectrum is that of flying."""

    def __init__(self, spin: Array) -> None:
        self.factor: float | None = None
        """By what rotors turn faster than read: 1 where lines are at whole multiples of what is
        read; None: there are no lines."""
        self._spin = spin
        self._dt, self._rest = 0.0, np.empty((0, 0))
        self._restart(0)

    def _restart(self, length: int) -> None:
        """Begin with pieces of so many samples; 0: not known yet."""
        self._length, self._kept, self._every, self._passed = length, list[Array](), 1, 0
        self._yawed = list[tuple[float, float]]()
        self._due, self.factor = self._FEWEST, None

    def update(self, dt: float, imu: Array, speeds: Array, *, fresh: bool = False) -> None:
        """Take samples; how they are grouped does not matter.

        Args:
            dt: s between them.
            imu: (n, 6) rates and specific force as measured; rates NaN where it does not fly.
            speeds: (n, rotors) rad/s.
            fresh: whether a gap lies before them.
        """
        rows = np.hstack([imu, speeds])
        turns = complete_rows(imu[:, :3]) & (speeds > 0.0).all(axis=1)
        if dt != self._dt or not self._length:
            if not turns.any():
                return
            rows, fresh, self._dt = rows[int(turns.argmax()) :], True, dt
            turn = 2.0 * math.pi / (float(rows[0, 6:].mean()) * dt)
            self._restart(max(round(self._TURNS * turn), 1))
        rest = rows if fresh else np.concatenate([self._rest, rows])
        while len(rest):
            piece = rest[: self._length]
            flown = np.where(complete_rows(piece[:, :3]), piece[:, 6:].mean(axis=1), 0.0)
            turned = np.cumsum(np.nan_to_num(flown)) * dt / (2.0 * math.pi)
            if turned[-1] > 2 * self._TURNS:  # they idled, or hardly turned, before
                at = int(np.searchsorted(turned, 2 * self._TURNS)) + 1
                self._restart(max(at // 2, 1))
                rest = rest[at:]
                continue
            if len(piece) < self._length:
                break
            rest = rest[self._length :]
            sound = np.isfinite(piece[:, :3]).all() and (piece[:, 6:] > 0.0).all()
            if sound and self._length >= 0.5 * self._TURNS:  # else too slow even for folded lines
                self._keep(piece)
        self._rest = rest

    def _keep(self, piece: Array) -> None:
        if self._passed % self._every == 0:
            self._kept.append(piece.astype(np.float32))
            self._yawed.append(self._yaw_of(piece))
        self._passed += 1
        if len(self._kept) > self._PIECES:
            self._kept, self._yawed = self._kept[::2], self._yawed[::2]
            self._every *= 2
        if self._passed >= self._due:  # a fifth more each time, so that it costs little
            self._due, self.factor = math.ceil(1.2 * self._passed), self._read(np.array(self._kept))

    def _yaw_of(self, piece: Array) -> tuple[float, float]:
        """Sums x^2 and x y of a piece: y is the specific force, and x what one spin's squared
        speeds have of it more than the other's, each less what goes with all of them.
        """
        squares, force = piece[:, 6:] ** 2, piece[:, 5]
        total = squares.sum(axis=1) / squares.sum()
        more = squares @ self._spin / squares.sum()
        x, y = (v - v.sum() * total for v in (force.sum() * more, force))
        return float(x @ x), float(x @ y)

    @property
    def unlike_spins(self) -> float | None:
        """Share of the mean by which rotors of spin 1 lift more, and the others less, for the speed
        read; None where they may lift alike. Propellers scatter by less.
        """
        if len(self._yawed) < self._FEWEST:
            return None
        power, product = np.array(self._yawed).T
        weights = power / power.sum() if power.any() else np.ones(1)
        freedom = 1.0 / float(weights @ weights) - 1.0
        if not freedom > 0.0:
            return None
        # By leaving each piece out: few of them may have most of the yaw.
        share = float(product.sum() / power.sum())
        left = (product - share * power) / (1.0 - weights)
        std = float(np.linalg.norm(left) / power.sum())
        sure = abs(share) - student_limit(freedom) * std > 0.5 * APART
        return share if sure else None

    def _read(self, pieces: Array) -> float | None:
        """What (p, n, 6 + rotors) pieces show."""
        size, orders = 4 * self._length, self._ORDERS
        above = np.zeros((len(pieces), size // 2 + 1))
        for shaken in np.nan_to_num(np.diff(pieces[:, :, :6], axis=1)).transpose(2, 0, 1):
            shaken = (shaken - shaken.mean(axis=1, keepdims=True)) * np.hanning(shaken.shape[1])
            power = np.abs(np.fft.rfft(shaken, size)) ** 2
            power /= np.maximum(power.mean(axis=1, keepdims=True), math.ulp(1.0))
            above += power / np.maximum(power.mean(axis=0), math.ulp(1.0))
        # (p, orders, rotors) places in the spectra, folded.
        turns = pieces[:, None, :, 6:].mean(axis=2) * self._dt / (2.0 * math.pi)
        at = orders[:, None] * turns
        at = np.abs(at - np.rint(at))
        place = np.rint(at * size).astype(int).reshape(len(at), -1)
        # What is more in a piece at all its frequencies is no line.
        above -= above.mean(axis=1, keepdims=True)
        seen = np.take_along_axis(above, place, axis=1).reshape(at.shape)
        seen[at < self._SLOW] = 0.0
        strength, each = seen.mean(axis=0), seen.mean(axis=2)
        mean, std = each.mean(axis=0), each.std(axis=0, ddof=1) / math.sqrt(len(each))
        sure = mean > student_limit(len(each) - 1, FALSE_ALARM_RATE / len(mean)) * std
        if not sure.any():
            return None
        whole = np.abs(orders / np.maximum(np.rint(orders), 1.0) - 1.0) < self._OFF
        lines = np.where(sure, mean, 0.0)
        # A line of one rotor alone is at others' multiples too, where speeds go together.
        if strength[whole].max() > 0.5 * strength[sure & ~whole].max(initial=0.0):
            own = whole[lines.argmax()] and sure[whole & (orders < 1.5)].any()
            return 1.0 if own else None
        lowest = float(orders[sure.argmax()])
        return float(orders[np.where(orders < 1.5 * lowest, lines, 0.0).argmax()])


_PARTS = 8
"""Of a stretch, in each of which a rotor's reading must differ alike."""
_FEW = 50
"""Readings, fewer than which do not show whose command they follow."""
_ROUNDED = 3.0
"""Least steps by which a reading must usually change in the time of a hold."""


def odd_reading(speeds: Array, commands: Array, spin: Array) -> OddReading | None:
    """The rotor that reads otherwise than the others, if one does.

    Args:
        speeds: (n, rotors) in any unit, all turning; NaN: no reading.
        commands: (m, rotors) likewise, of the same stretch of flight.
        spin: (rotors,) 1 or -1.
    """
    if min(len(speeds), len(commands)) < 2 * _PARTS:
        return None
    omega, u = (
        np.array([np.nanmean(part, axis=0) for part in np.array_split(values, _PARTS)])
        for values in (speeds, commands)
    )
    if not (np.isfinite(omega).all() and np.isfinite(u).all() and omega.min() > 0.0):
        return None
    # One slope for all, from how much either moves: lag shifts it, and does not scale it.
    moves = float(np.median(np.nanstd(commands, axis=0)))
    slope = float(np.median(np.nanstd(speeds, axis=0))) / moves if moves > 0.0 else 0.0
    asked = slope * (u - np.median(u, axis=1, keepdims=True))
    expected = np.median(omega - asked, axis=1, keepdims=True) + asked
    if not expected.min() > 0.0:
        return None
    # A pole count is the same all the time; what a throw or a tumble does is not.
    ratios = np.log(omega / expected)
    means, stds = ratios.mean(axis=0), ratios.std(axis=0, ddof=1) / math.sqrt(_PARTS)
    limit = student_limit(_PARTS - 1, FALSE_ALARM_RATE / len(means)) * stds
    rotor = int((np.abs(means) - limit).argmax())
    ratio = math.exp(float(means[rotor]))
    if abs(ratio - 1.0) < APART or abs(means[rotor]) < limit[rotor]:
        return None
    read = omega.mean(axis=0)
    mended = np.where(np.arange(len(spin)) == rotor, expected.mean(axis=0), read)
    by_speed, by_command = (abs(spin @ v**2) / float((v**2).sum()) for v in (read, mended))
    # One rotor of n that is off by so much in speed turns the balance by twice that over n.
    apart = 2.0 * APART / len(spin)
    return OddReading(rotor, ratio, bool(by_command < apart < by_speed - by_command))


def unlike_squares(speeds: Array, commands: Array) -> float | None:
    """Share, rms over the rotors, by which squares of speeds are not those of their commands.

    Thrust goes with a power of the command between the first and the second; lag averages out.

    Args:
        speeds: (n, rotors) in any unit; NaN: no reading.
        commands: (m, rotors) of 0 to 1, of the same stretch of flight.

    Returns:
        By the power for which it is least; None where a rotor did not turn.
    """
    squares, asked = np.nanmean(speeds, axis=0) ** 2, np.nanmean(commands, axis=0)
    if not (squares.min() > 0.0 and asked.min() > 0.0):
        return None
    y, x = (np.log(v) - np.log(v).mean() for v in (squares, asked))
    power = float(np.clip(x @ y / max(float(x @ x), 1e-300), 1.0, 2.0))
    return float(np.sqrt(np.mean((y - power * x) ** 2)))


def unbalanced_reading(speeds: Array, geometry: Array) -> OddReading | None:
    """The rotor whose speed no balance of a hover bears out, if one does; without any commands.

    Squared speeds of alike rotors are those of a CG that is off, of yaw trim, and of propellers
    that scatter, which are all normal. That one reads any other speed is another hypothesis: it
    holds where the others' speeds without it are as much likelier as such readings are rare. On
    four rotors yaw alone decides: a CG may be anywhere that they can balance.

    Args:
        speeds: (n, rotors) in any unit, all turning; NaN: no reading.
        geometry: (3, rotors) as of the airframe.
    """
    if len(speeds) < 2 or speeds.shape[1] < 4:
        return None
    # A throw or a tumble has no balance: both halves must have the same rotor.
    found = [_unbalanced(half, geometry) for half in np.array_split(speeds, 2)]
    return found[0] if found[0] and found[1] and found[0].rotor == found[1].rotor else None


def _unbalanced(speeds: Array, geometry: Array) -> OddReading | None:
    """The same of one stretch."""
    squares = np.nanmean(speeds**2, axis=0)
    if not (np.isfinite(squares).all() and squares.min() > 0.0):
        return None
    gains, over = _alone(squares / squares.mean(), geometry, 0.5 * APART)
    rotor = int(np.argmax(gains))
    sure = gains[rotor] > math.log(len(gains) / FALSE_ALARM_RATE)
    # Less than half of its thrust no propeller gives that flies.
    if not sure or abs(math.log(over[rotor])) < math.log(2.0):
        return None
    return OddReading(rotor, math.sqrt(over[rotor]), by_command=False)


def unlike_load(loads: Array, geometry: Array, scatter: float) -> tuple[tuple[int, ...], float]:
    """The rotor whose load no CG and no yaw trim explains beside those of the others.

    Of four rotors any loads are those of a CG and a yaw trim, or of several rotors.

    Args:
        loads: (rotors,) squared speeds or thrusts by commands, in any unit.
        geometry: (3, rotors) as of the airframe.
        scatter: of rotors that are alike, 1 sigma.

    Returns:
        Which it may be, none where all may be alike, and the load over what balances the others.
    """
    if len(loads) <= 4 or not loads.min() > 0.0:
        return (), 1.0
    gains, over = _alone(loads / loads.mean(), geometry, scatter)
    rotor = int(np.argmax(gains))
    if gains[rotor] < math.log(len(gains) / FALSE_ALARM_RATE):
        return (), 1.0
    rivals = gains > gains[rotor] + math.log(FALSE_ALARM_RATE)
    return tuple(int(i) for i in np.flatnonzero(rivals)), float(over[rotor])


def _alone(loads: Array, geometry: Array, scatter: float) -> tuple[Array, Array]:
    """(rotors,) nats by which the others' loads are likelier where one may carry anything, and its
    load over what balances theirs; (rotors,) loads are relative to their mean.
    """
    rotors = len(loads)
    # Evenly within half of the arm, where a rotor of four would stand still, a CG has a standard
    # deviation of a quarter of it, which shifts half of the load. Motors' tilts shift less to yaw.
    arm = float(np.hypot(*geometry[:2]).mean())
    modes = np.vstack([0.5 * geometry[:2] / arm, 0.25 * APART * geometry[2]])
    alike, own, over = -math.inf, np.full(rotors, -np.inf), np.ones(rotors)
    for pattern in _coaxial_patterns(geometry, 0.2 * arm):
        every = np.vstack([modes, 0.15 * pattern])
        covariance = every.T @ every + scatter**2 * np.eye(rotors)
        alike = max(alike, _likelihood(loads, covariance))
        for rotor in range(rotors):
            keep = np.arange(rotors) != rotor
            of_others = covariance[np.ix_(keep, keep)]
            # The load itself may be anything from a quarter to four times.
            likely = _likelihood(loads[keep], of_others) - math.log(2.0 * math.log(16.0))
            others = loads[keep] / loads[keep].mean()
            weights = np.linalg.solve(of_others, covariance[keep, rotor])
            balancing = float(loads[keep].mean()) * (1.0 + float(weights @ (others - 1.0)))
            if likely > own[rotor] and balancing > 0.0:
                own[rotor], over[rotor] = likely, loads[rotor] / balancing
    return own - alike, over


def _coaxial_patterns(geometry: Array, near: float) -> Iterator[Array]:
    """(rotors,) 1 and -1 of the two rotors of each arm, in all ways: one is in the wash of the
    other, on all arms alike. Zeros where there are no such pairs.
    """
    rotors = geometry.shape[1]
    pairs = [
        (i, j)
        for i, j in combinations(range(rotors), 2)
        if math.hypot(*(geometry[:2, i] - geometry[:2, j])) < near
    ]
    for signs in product((1.0, -1.0), repeat=max(len(pairs) - 1, 0)):
        pattern = np.zeros(rotors)
        for (i, j), sign in zip(pairs, (1.0, *signs), strict=False):
            pattern[i], pattern[j] = sign, -sign
        yield pattern


def _likelihood(values: Array, covariance: Array) -> float:
    """Logarithm of the normal density of (n,) values over their mean, whatever that is."""
    contrasts = np.linalg.svd(np.ones((1, len(values))))[2][1:]
    apart = contrasts @ values / values.mean()
    variance = 2.0 * math.pi * contrasts @ covariance @ contrasts.T
    square = 2.0 * math.pi * float(apart @ np.linalg.solve(variance, apart))
    return -0.5 * (square + float(np.linalg.slogdet(variance)[1]))


def together(rotors: Rotors) -> Array:
    """(n, rotors) readings of all rotors, number by number, from the times and values of each."""
    n = min(len(v) for _, v in rotors)
    return np.column_stack([v[:n] for _, v in rotors])


def apart(t: Array, rotors: Rotors) -> Array:
    """(n, rotors) at (n,) times, what sets each rotor apart from the mean of all."""
    values = np.column_stack([np.interp(t, *rotor) for rotor in rotors])
    return values - values.mean(axis=1, keepdims=True)


def correlation(a: Array, b: Array) -> float:
    """Of two arrays whose means are taken off; 0 where one does not vary."""
    power = math.sqrt(float((a**2).sum() * (b**2).sum()))
    return float((a * b).sum()) / power if power > 0.0 else 0.0


def moved_columns(speeds: Rotors, commands: Rotors) -> str:
    """Why speeds are not used whose columns changed places; empty where each follows its command.

    Args:
        speeds: times and values of each rotor, of the same stretch of flight as
        commands: likewise.
    """
    t = speeds[0][0]
    t = t[(t > commands[0][0][0]) & (t < commands[0][0][-1])]
    if len(t) < _FEW:
        return ""
    own, asked = (v - v.mean(axis=0) for v in (apart(t, speeds), apart(t, commands)))
    power = math.sqrt(float((own**2).sum() * (asked**2).sum()))
    if not power > 0.0:
        return ""
    alike = own.T @ asked / power

    def is_better(left: float) -> bool:
        """More alike than not, and in their own places twice as much is left."""
        return left <= 0.5 and 1.0 - float(np.trace(alike)) >= 2.0 * left

    if not is_better(1.0 - float(alike.max(axis=1).sum())):  # no order leaves less
        return ""
    from scipy.optimize import linear_sum_assignment  # takes a while to load

    rotors, follows = linear_sum_assignment(-alike)
    if not is_better(1.0 - float(alike[rotors, follows].sum())):
        return ""
    rotor = int(np.argmax(follows != rotors))
    return (
        f"has columns that changed places: rotor {rotor + 1} follows the command of rotor "
        f"{follows[rotor] + 1}"
    )


def late_reading(speeds: Rotors, commands: Rotors) -> str:
    """Why speeds are not used of which one rotor's follow its command later than the others' do.

    Args:
        speeds: times and values of each rotor, of the same stretch of flight as
        commands: likewise.
    """
    delays = AGE * np.arange(50)  # a motor's lag, and that of its reading
    t = speeds[0][0]
    t = t[(t > commands[0][0][0] + delays[-1]) & (t < commands[0][0][-1])]
    if len(t) < _FEW:
        return ""
    left = np.empty((len(speeds), len(delays)))
    for own, asked, row in zip(speeds, commands, left, strict=True):
        read = np.interp(t, *own)
        for i, delay in enumerate(delays.tolist()):
            sent = np.interp(t - delay, *asked)
            row[i] = 1.0 - correlation(read - read.mean(), sent - sent.mean())
    best = left.argmin(axis=1)
    usual = int(np.median(best))
    rotor = int(np.argmax(np.abs(best - usual)))
    apart = AGE * float(best[rotor] - usual)
    # Where the others do not follow theirs, these are not their commands.
    sure = np.median(left[:, usual]) < 0.5 and left[rotor, usual] > 2.0 * left[rotor, best[rotor]]
    if not sure or abs(apart) < 2.0 * AGE:
        return ""
    way = "later" if apart > 0.0 else "earlier"
    return (
        f"reads rotor {rotor + 1} {1e3 * abs(apart):.0f} ms {way} after its command than the "
        "others: have all ESCs read at once"
    )


def held_reading(rotors: Rotors) -> str:
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
