"""When the vehicle flies: what the autopilot says, else what rotors, IMU and height say.

Rotors at zero are not the ground: a throttle is cut and a mixer saturates in the air too, and a
hand throws a vehicle whose rotors stand. On the ground the accelerometer reads 1 g and nothing
turns; in free fall it reads next to nothing. Rotors that turn are not flight either: what idles
on its feet reads 1 g at a fraction of the thrust that carries it, and what lies on its back is
pushed the way in which its rotors never push.

Who carries the vehicle, its rotors or the ground, is a sequential test too (`GroundTest`). In the
air the specific force is thrust over mass, so that from one window to the next

    d log |f| = a d log u + v,

with u what thrust grows with (squared speeds, or commands) and a near 1: motor lag takes from it,
the thrust curve of commands adds. On the ground |f| is 1 g whatever the rotors do: a = 0. The test
adds up the log-likelihood ratio of the two (Wald 1945), with a the most likely within bounds, and v
as large as the better of the two leaves it.

Nor does what stands turn as its rotors would have it. In the air the shares s of a frame's rotors
in roll and pitch turn it by |f| s l / (r^2 sqrt(2 n)), with arm l and radius of gyration r, so that
its angular acceleration is as large as a |f| ds, with ds the change of s from window to window. In
flights a was 1 to 30 per m, with feet on the ground or a bench 0.4 and less. That is a ratio of
likelihoods likewise, and one that only counts against flight: gusts turn what stands, and hands.

It needs no report, no height and no known vehicle, and says nothing while thrust is constant. What
turns fast or reads far from 1 g stands on nothing, whatever thrust does. Rotors that are read wrong
make a change of u where they change unlike each other: only what is beyond that counts.

What is reported is one witness. What is said to fly and has risen flies; what was never said to be
in the air, or to be armed, flies when its rotors carry it, off the ground where heights are known.
"""

import math
from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.signals.recursions import lfilter
from gcs_sysid.signals.rotor_readings import APART


@dataclass(frozen=True)
class GroundRules:
    """Settings of the test.

    Attributes:
        window: s, long against most motors' lags.
        slopes: of thrust that carries.
        memory: s over which the residuals' power is averaged.
        least_noise: of log |f|: what an accelerometer leaves of a mean over a window.
        step: nats that one window may add: a shock is one like others.
        one_g: m/s^2, between which the mean force of what stands lies.
        turns: rad/s, mean rate from which nothing stands, nor lies on its back.
        answers: 1/m, of the rotors' shares: at most on the ground, at least in the air.
    """

    window: float = 0.2
    slopes: tuple[float, float] = (0.5, 1.25)
    memory: float = 3.0
    least_noise: float = 0.003
    step: float = 2.0
    one_g: tuple[float, float] = (6.5, 13.5)
    turns: float = 1.0
    answers: tuple[float, float] = (0.2, 0.6)


_GROUND = GroundRules()
_ODDS = math.log(1000.0)
"""Nats from which it stands; until half of them are lost again."""
_KEPT = math.exp(-_GROUND.window / _GROUND.memory)
_MOST = np.array([0.3, 0.2, 0.2])
"""Of the changes of log |f| and log u that count: a shock is one window like others."""


class GroundTest:
    """Takes samples block by block; how they are grouped does not matter.

    Args:
        geometry: (2 or more, rotors) x and y of each rotor, in any unit; None: not known, and
            what they turn is not looked at.

    Attributes:
        stood: s from and until which it stood, as turned out at the end of each: what stands and
            was never shown to fly has stood all the while.
    """

    def __init__(self, geometry: Array | None = None) -> None:
        self.stood: list[tuple[float, float]] = []
        self._levers = None if geometry is None else np.linalg.qr(geometry[:2].T)[0]
        self._flew = -math.inf
        self._number = -1
        self._sums = np.zeros((2, 0))
        self._before = self._shares = np.zeros(0)
        self._latest: Array | None = None
        self._rates = np.full(2, np.nan)
        self._lowest = np.nan
        # By squared speeds, by commands, and by what the rotors turn.
        self._nats = np.zeros(3)
        self._power = np.full((2, 2), 1e-4)
        self._stand = np.zeros(3, dtype=bool)
        self._carrier = 0.0

    def update(
        self,
        t: Array,
        force: Array,
        rates: Array,
        thrust: Array,
        speeds: Array,
        reported: Array | None = None,
    ) -> Array:
        """Take a block.

        Args:
            t: (n,) s.
            force: (n,) m/s^2, norm of the specific force; NaN: not measured.
            rates: (n, 3) rad/s.
            thrust: (n, 2) as of `FlightDetector.update`.
            speeds: (n, rotors) likewise.
            reported: (n, 2) whether it is said to fly, and down in m; NaN: not reported.

        Returns:
            (n,) who carries it, by the windows before each sample: -1 the ground, 1 its rotors,
            0 not known.
        """
        reported = np.full((len(t), 2), np.nan) if reported is None else reported
        norms = np.linalg.norm(rates, axis=1)
        before = speeds[[0, 0]] if self._latest is None else self._latest
        self._latest = np.vstack([before, speeds])[-2:]
        jitter = np.diff(speeds, 2, axis=0, prepend=before) ** 2 / 6.0  # variances of white noise
        parts = (reported, rates[:, :2], norms, force, thrust, speeds, jitter)
        values = np.column_stack(parts)
        numbers = np.floor(t / _GROUND.window).astype(np.int64)
        starts = np.flatnonzero(np.diff(numbers, prepend=numbers[0] - 1))
        known = np.isfinite(values)
        if self._sums.shape[1] != values.shape[1]:
            self._sums = np.zeros((2, values.shape[1]))
            self._before = self._shares = np.array([np.nan])
        sums = np.add.reduceat(np.where(known, values, 0.0), starts, axis=0)
        counts = np.add.reduceat(known, starts, axis=0)
        out = np.empty(len(t))
        for k, start in enumerate(starts):
            if numbers[start] != self._number:
                self._close()
                self._number = int(numbers[start])
            self._sums += np.stack([sums[k], counts[k]])
            out[start : starts[k + 1] if k + 1 < len(starts) else None] = self._carrier
        return out

    def _close(self) -> None:
        """Judge the window that has ended against the one before it."""
        total, count = self._sums
        mean = np.divide(total, count, out=np.full(len(total), np.nan), where=count > 0)
        self._sums = np.zeros_like(self._sums)
        said, down, *rates, turns, force = mean[:6]
        end = (self._number + 1) * _GROUND.window
        self._lowest = np.fmax(down, self._lowest)
        climbed = said > 0.5 and self._lowest - down > RULES.risen
        speeds, scatter = np.split(mean[8:], 2)
        scatter /= np.maximum(count[-len(speeds) :], 1.0)
        shown = mean[5 : 8 + len(speeds)]  # force, squared speeds, commands, each rotor
        logs = np.log(shown, out=np.full(len(shown), np.nan), where=shown > 0.0)
        changes = logs - self._before
        self._before = logs
        answered = self._answered(np.array(rates), speeds, scatter, force)
        if not math.isfinite(changes[0]):
            return
        # As far as rotors change unlike each other, some that read wrong look like thrust.
        unlike = 4.0 * APART * np.nan_to_num(changes[3:]).std()
        changes[1] -= np.clip(changes[1], -unlike, unlike)
        y, *both = np.clip(changes[:3], -_MOST, _MOST)
        known = np.isfinite(both)
        if not known.any():
            return
        gains = np.array([0.0, 0.0, answered])
        for i in np.flatnonzero(known).tolist():
            gains[i] = self._followed(i, y, both[i])
        self._nats[2] *= _KEPT
        self._nats += gains.clip(-_GROUND.step, _GROUND.step)
        if climbed or not _GROUND.one_g[0] < force < _GROUND.one_g[1] or turns > _GROUND.turns:
            self._nats = np.maximum(self._nats, 0.0)
        self._nats = self._nats.clip(-_ODDS, [_ODDS, _ODDS, 0.0])
        together = self._nats + np.array([1.0, 1.0, 0.0]) * self._nats[2]
        self._stand = together <= np.where(self._stand, -0.5, -1.0) * _ODDS
        together = together[:2][known]
        # A rotor that is read wrong hides what the force follows, but not from the commands.
        stands = self._stand[known.argmax()] and not (self._nats[:2][known] > 0.0).any()
        stands |= self._stand[2] and together.max() < 0.0
        if climbed or together.max() > 0.5 * _ODDS:
            self._flew, self._lowest = end, down
        if stands and self._carrier >= 0.0:
            self.stood.append((self._flew, end))
        flies = together.max() >= (0.5 if self._carrier > 0.0 else 1.0) * _ODDS
        self._carrier = -1.0 if stands else float(flies)

    def _followed(self, i: int, y: float, x: float) -> float:
        """Nats of a window in which log |f| changed by y, and log u of a stream by x."""
        slope = min(max(y / x, _GROUND.slopes[0]), _GROUND.slopes[1]) if x else 0.0
        squares = np.array([y * y, (y - slope * x) ** 2])
        self._power[i] = _KEPT * self._power[i] + (1.0 - _KEPT) * squares
        # Twice: differences of means that follow each other are correlated by -1/2.
        variance = 2.0 * max(float(self._power[i].min()), _GROUND.least_noise**2)
        return float(squares[0] - squares[1]) / (2.0 * variance)

    def _answered(self, rates: Array, speeds: Array, scatter: Array, force: float) -> float:
        """Nats of a window's (2,) rates, against what (rotors,) speeds turn in the air.

        Noise turns nothing: what scatter, the variances of these speeds, makes does not count.
        """
        with np.errstate(invalid="ignore", divide="ignore"):
            shares, noise = speeds / speeds.mean(), 2.0 * scatter / speeds.mean() ** 2
        turned, self._rates = (rates - self._rates) / _GROUND.window, rates
        changes, self._shares = shares - self._shares, shares
        if self._levers is None:
            return 0.0
        asked = force * changes @ self._levers
        x = float(asked @ asked - 4.0 * force**2 * (self._levers**2).sum(axis=1) @ noise)
        x, y = max(x, 0.0), float(turned @ turned)
        if not math.isfinite(x + y):
            return 0.0
        ground, air = (a * a * x + (_GROUND.least_noise * _G) ** 2 for a in _GROUND.answers)
        return math.log(ground / air) + y * (1.0 / ground - 1.0 / air)


TAKE_OFF = 1.0
"""s after leaving the ground that do not count yet: ground effect, and feet that slip."""


@dataclass(frozen=True)
class FlightRules:
    """What shows that a vehicle flies, falls, or is carried by the ground.

    Attributes:
        height: m above the ground, from which a vehicle that does not report its state counts as
            flying.
        risen: m above where it was not known to fly, from which a vehicle that reports flight
            does: on the ground heights drifted by 0.7 m in seconds, and by 1.5 m in minutes.
        rest, rest_for: m/s^2 from 1 g and rad/s within which it rests, and s of it. Idling rotors
            shake it by 0.7 m/s^2 (LOG00259 of indiflightSupport); hovering it leaves these bounds
            several times in that time.
        still: the same of means over `smooth`, within which a record may begin on the ground: in
            hover real flights read 0.07 rad/s and more, with idling rotors on the ground 0.02.
            Simulated ones may hover as quietly, so it counts as flight until thrust has grown
            several times, and the ground is known.
        fall, fall_for: m/s^2 below which it falls, and s of it.
        one_g: m/s^2 that an accelerometer must have read before it may indicate a fall.
        least_force: m/s^2 from which force over thrust is taken, and which nothing in the air has
            the wrong way round.
        forgets: s in which the least ratio grows by e: a payload, or a spike that was taken for
            thrust.
        smooth: s, of means.
        placed_for: s for which the last height reported holds.
        silent_for: s without any rotor, or a change of one, after which nothing shows flight.
        same: share of an output by which interpolation between equal ones may differ.
    """

    height: float = 0.3
    risen: float = 1.0
    rest: tuple[float, float] = (2.5, 0.35)
    rest_for: float = 0.25
    still: tuple[float, float] = (0.6, 0.05)
    fall: float = 4.0
    fall_for: float = 0.1
    one_g: tuple[float, float] = (7.0, 13.0)
    least_force: float = 5.0
    forgets: float = 60.0
    smooth: float = 0.1
    placed_for: float = 2.0
    silent_for: float = 1.0
    same: float = 1e-6


RULES = FlightRules()
_G = 9.81
_CARRIED = np.log([5.0, 2.5])
"""Logarithms of specific force over squared speeds and over commands, against their least in
flight, from which the ground carries it. Over squared speeds: 9 to 10 with idling rotors, at most
2 in flight. Over commands: 3.6 and more with idling rotors, 1.6 in flight, be thrust linear or
square in the command."""


class FlightDetector:
    """Marks flight on the grid, block by block; how samples are grouped does not matter.

    Args:
        geometry: as of `GroundTest`.

    Attributes:
        left_ground: s from which a flight counts -> s at which it left the ground.
        ground_test: who carries it.
    """

    def __init__(self, geometry: Array | None = None) -> None:
        self.left_ground: dict[float, float] = {}
        self._counted = False
        self._t = np.nan
        self._state = 0.0
        """1 in the air, -1 on the ground, 0 not known."""
        self._stood_at = self._restless_at = self._carried_at = self._rotors_at = -np.inf
        self._driven_at = -np.inf
        self._speeds: Array | None = None
        self._unfallen_at = self._fell_at = self._upright_at = -np.inf
        self._placed_at = -np.inf
        self._ground = self._down = np.nan
        self._began: float | None = None
        self._smooth = np.full(4, np.nan)
        self._log_least = np.full(2, np.inf)
        self._sensed = self._stood = self._moved = False
        self._weighed = self._weighed_upright = False
        self._said = np.zeros((1, 2), bool)
        """Whether it was ever said to be in the air; armed."""
        self._still: tuple[float, float, Array] | None = None
        self.ground_test = GroundTest(geometry)

    @property
    def first_left(self) -> float:
        """S until which it has only stood, as turned out so far."""
        until = [end for start, end in self.ground_test.stood if math.isinf(start)]
        return max(until, default=-math.inf)

    def update(
        self,
        t: Array,
        in_air: Array,
        armed: Array,
        speeds: Array,
        position: Array,
        force: Array | None = None,
        rates: Array | None = None,
        thrust: Array | None = None,
    ) -> Mask:
        """Take a block.

        Args:
            t: (n,) s, session times.
            in_air: (n,) 1 where the autopilot reports flight, 0 where not, NaN: not reported.
            armed: (n,) the same for arming.
            speeds: (n, rotors) speeds or commands, zero where a rotor stands; NaN: not reported.
            position: (n, 3) north, east, down in m; NaN: not reported.
            force: (n, 3) specific force in m/s^2; NaN: not reported.
            rates: (n, 3) body rates in rad/s; NaN: not reported.
            thrust: (n, 2) mean of squared speeds, and of commands from that of no thrust on, both
                in any unit; NaN: not reported.

        Returns:
            (n,) whether it flies.
        """
        unknown = np.full((len(t), 3), np.nan)
        along = unknown[:, 2] if force is None else force[:, 2]
        force = np.linalg.norm(unknown if force is None else force, axis=1)
        turning = unknown if rates is None else rates
        rates = np.linalg.norm(turning, axis=1)
        thrust = unknown[:, :2] if thrust is None else thrust
        zero = (speeds == 0.0).all(axis=1)
        turn = (speeds > 0.0).all(axis=1)
        sensed = np.isfinite(force) & np.isfinite(rates)
        had_imu = np.logical_or.accumulate(np.append(self._sensed, sensed))[1:]
        smooth = self._smoothed(t, np.column_stack([force, rates, thrust]))
        ratio = self._ratios(smooth)
        least = self._least(t, ratio)
        with np.errstate(invalid="ignore"):
            restless: Mask = sensed & (
                (np.abs(force - _G) > RULES.rest[0]) | (rates > RULES.rest[1])
            )
            carried = (ratio > _CARRIED + least).any(axis=1)
            carried &= ~(ratio <= _CARRIED + least).any(axis=1)
            falls = sensed & (force < RULES.fall) & (force > 0.0)
            # A racer's drag may push it so for a while, but not with 1 g and without turning.
            lies = (
                (smooth[:, 0] > RULES.one_g[0])
                & (smooth[:, 0] < RULES.one_g[1])
                & (smooth[:, 1] < _GROUND.turns)
            )
            overturned = sensed & (along > RULES.least_force) & lies
        rests = self._since(t, restless | ~zero, "_restless_at") >= RULES.rest_for
        idles = self._since(t, restless | zero | ~carried, "_carried_at") >= RULES.rest_for
        falls = self._since(t, ~falls, "_unfallen_at") >= RULES.fall_for
        falls &= self._once_weighed(force, "_weighed")
        # An IMU that is mounted or read upside down has never shown its weight the right way.
        overturned = self._since(t, ~overturned, "_upright_at") >= RULES.rest_for
        overturned &= self._once_weighed(-along, "_weighed_upright")
        # Outputs that nothing changes turn no rotors: what is disarmed then stands.
        first = speeds[:1] if self._speeds is None else self._speeds
        before, self._speeds = np.vstack([first, speeds[:-1]]), speeds[-1:].copy()
        with np.errstate(invalid="ignore"):
            changes = (np.abs(speeds - before) > RULES.same * speeds).any(axis=1)
        driven = turn & (self._since(t, changes, "_driven_at") < RULES.silent_for)
        down = self._lately(t, position[:, 2])
        said = np.column_stack([in_air, down])
        carrier = self.ground_test.update(t, force, turning, thrust, speeds, said)
        stands = (zero & (rests | ~had_imu)) | (idles & had_imu) | overturned
        stands |= ((armed < 0.5) & ~driven) | (carrier < 0.0)
        stood = np.logical_or.accumulate(np.append(self._stood, stands | zero))[1:]
        self._note_beginning(t, smooth, had_imu & ~stood, down, ratio)
        ground, stood_at = self._grounds(t, np.where(stands, position[:, 2], np.nan), least)
        # Where height or ground is not known, turning rotors must do.
        low = ground - down < RULES.height
        received: Mask = np.logical_or.reduce(np.isfinite(speeds), axis=1)
        silent = self._since(t, received, "_rotors_at") >= RULES.silent_for
        # Who never said yes is not believed against rotors that carry it.
        reports = np.column_stack([in_air, armed])
        yes = np.logical_or.accumulate(np.vstack([self._said, reports > 0.5]))[1:]
        self._said = yes[-1:]
        denied = (yes & (reports < 0.5)).any(axis=1)
        flown = (in_air > 0.5) | (driven & (carrier > 0.0) & ~low & ~denied)
        reported = np.isfinite(in_air) | (armed < 0.5)
        change = np.select(
            [stands, reported, falls, low | silent, turn],
            [-1.0, np.where(flown, 1.0, -1.0), 1.0, -1.0, 1.0],
            0.0,
        )
        state = _held(np.where(change == 0.0, np.nan, change), self._state)
        flies = self._counts(t, np.where(state < 0.0, t, stood_at), state, falls & (state > 0.0))
        self._state, self._t = float(state[-1]), float(t[-1])
        self._sensed, self._stood = bool(had_imu[-1]), bool(stood[-1])
        return flies

    def _counts(self, t: Array, stood_at: Array, state: Array, falls: Mask) -> Mask:
        """Where it flies, and has left the ground long enough ago or was seen to fall since."""
        stood_at = np.maximum.accumulate(np.append(self._stood_at, stood_at))
        fell_at = np.maximum.accumulate(np.append(self._fell_at, np.where(falls, t, -np.inf)))
        self._stood_at, self._fell_at = float(stood_at[-1]), float(fell_at[-1])
        long_ago = t - stood_at[1:] >= TAKE_OFF
        flies: Mask = (state > 0.0) & (long_ago | (fell_at > stood_at)[1:])
        for i in np.flatnonzero(flies & ~np.append(self._counted, flies[:-1])).tolist():
            left = float(stood_at[i + 1]) if long_ago[i] else -math.inf  # else it was thrown
            self.left_ground[float(t[i])] = left if math.isfinite(left) else float(t[i])
        self._counted = bool(flies[-1])
        return flies

    def _since(self, t: Array, happens: Mask, name: str) -> Array:
        """(n,) s since something happened last; the time of it is kept under a name."""
        before: float = getattr(self, name)
        if math.isinf(before):
            before = float(t[0])
        last = np.maximum.accumulate(np.append(before, np.where(happens, t, -np.inf)))
        setattr(self, name, float(last[-1]))
        return t - last[1:]

    def _once_weighed(self, force: Array, name: str) -> Mask:
        """(n,) whether the accelerometer has read about 1 g before; kept under a name."""
        with np.errstate(invalid="ignore"):
            weighs = (force > RULES.one_g[0]) & (force < RULES.one_g[1])
        weighed: Mask = np.logical_or.accumulate(np.append(getattr(self, name), weighs))[1:]
        setattr(self, name, bool(weighed[-1]))
        return weighed

    def _smoothed(self, t: Array, x: Array) -> Array:
        """(n, k) means over some time; what is missing holds the value before."""
        x = np.column_stack([_held(x[:, k], self._smooth[k]) for k in range(x.shape[1])])
        step = float(t[1] - t[0]) if len(t) > 1 else float(t[0]) - self._t
        # Before the first sample nothing is smoothed, whatever the step.
        decay = math.exp(-max(step, 0.0) / RULES.smooth) if step == step else 0.0
        out = x.copy()
        for k in range(x.shape[1]):
            first = int(np.argmax(np.isfinite(x[:, k])))
            if np.isfinite(x[first, k]):
                before = self._smooth[k] if np.isfinite(self._smooth[k]) else x[first, k]
                part, _ = lfilter(
                    [1.0 - decay], [1.0, -decay], x[first:, k], np.array([decay * before])
                )
                out[first:, k] = part
        self._smooth = out[-1].copy()
        return out

    @staticmethod
    def _ratios(smooth: Array) -> Array:
        """(n, 2) logarithm of specific force over thrust, by speeds and by commands."""
        force, thrust = smooth[:, :1], smooth[:, 2:]
        good = (force > RULES.least_force) & (thrust > 0.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(good, np.log(force / thrust), np.nan)

    def _least(self, t: Array, ratio: Array) -> Array:
        """(n, 2) the least of the ratios so far, which grows while none is less."""
        drift = t[:, None] / RULES.forgets
        found = np.where(np.isfinite(ratio), ratio, np.inf) - drift
        least = np.minimum.accumulate(np.vstack([self._log_least, found]), axis=0)[1:]
        self._log_least = least[-1].copy()
        return least + drift

    def _lately(self, t: Array, down: Array) -> Array:
        """(n,) down in m, for a while after the last report."""
        held = _held(down, self._down)
        self._down = float(held[-1])
        age = self._since(t, np.isfinite(down), "_placed_at")
        return np.where(age < RULES.placed_for, held, np.nan)

    def _note_beginning(
        self, t: Array, smooth: Array, judged: Mask, down: Array, ratio: Array
    ) -> None:
        """Keep where it was until it first moved: there it stood, or hovered."""
        gentle = (np.abs(smooth[:, 0] - _G) < RULES.still[0]) & (smooth[:, 1] < RULES.still[1])
        if self._began is None:
            self._began = float(t[0])
        gentle |= t - self._began < 2.0 * RULES.smooth
        moved = np.logical_or.accumulate(np.append(self._moved, judged & ~gentle))[1:]
        self._moved = bool(moved[-1])
        still = judged & ~moved
        if still.any():
            last = int(np.flatnonzero(still)[-1])
            # The greatest: commands lead the motion that they make.
            greatest = np.fmax.reduce(ratio[still], axis=0)
            if self._still is not None:
                greatest = np.fmax(greatest, self._still[2])
            self._still = float(t[last]), float(down[last]), greatest

    def _grounds(self, t: Array, stood: Array, least: Array) -> tuple[Array, Array]:
        """(n,) down of where it stood last, m, and when it turned out to have stood until then.

        Whether it stood where the record began is seen when it has left that place.
        """
        stood_at = np.full(len(t), -np.inf)
        if self._still is not None and self._moved:
            at, down, ratio = self._still
            with np.errstate(invalid="ignore"):
                carried = (ratio > _CARRIED + least).any(axis=1) & (t >= at)
            if carried.any():
                self._still = None
                first = int(np.argmax(carried))
                # Thrust has grown several times: it stood there, and has left the ground since.
                if np.isnan(self._ground) and np.isnan(stood[: first + 1]).all():
                    stood = stood.copy()
                    stood[first] = down
                    stood_at[first] = at
                    self.ground_test.stood.append((-math.inf, at))
        ground = _held(stood, self._ground)
        self._ground = float(ground[-1])
        return ground, stood_at


def _held(values: Array, before: float) -> Array:
    """Each value, or where it is NaN the last one before it."""
    known = np.append(before, values)
    index = np.maximum.accumulate(np.where(np.isfinite(known), np.arange(len(known)), 0))
    return known[index][1:]
