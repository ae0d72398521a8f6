"""Rows of commands through motors, linearized about one set of motor parameters.

Thrust answers a command u through a curve and a lag of first order, x' = (v - x) / tau, which no
single time constant describes: propellers speed up faster than they slow down, and faster the
faster they turn. With e the asymmetry and p the exponent of speed

    tau(x, v) = tau exp(-e / 2 or e / 2) (x_0 / x)^p        speeding up, or slowing down

about hover x_0. What lags, x, is one of (`LagPlace`)

    speed     v = sqrt((1 - c) u + c u^2)    T / T_max = x^2
    command   v = u                          T / T_max = (1 - c) x + c x^2
    thrust    v = (1 - c) u + c u^2          T / T_max = x

All of these bend the response of thrust to command, so that without e and p their part goes into
the thrust curve, and into every moment of inertia with it: on flights with sharp sticks the curve
was 0.54 for 0.4. Here signals are made at one point (d, tau, c, e, p) as they are, to all orders,
and once more with each parameter moved a little. Rows near that point are a linear map of these,
and the five are unknowns of the fit; it starts again where it ends, until it stays.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array, complete_rows, runs
from gcs_sysid.estimation.rows.actuator_dynamics import (
    N_COORDINATES,
    ROTOR_COLUMNS,
    SIGNALS,
    WIDTH,
    ActuatorDynamics,
    Coordinate,
    LagOf,
    LagPlace,
)
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.signals.one_step import OneStep
from gcs_sysid.signals.recursions import recursion

LOW = np.array([-0.03, 0.002, -0.3, -1.5, -1.5])
HIGH = np.array([0.06, 0.2, 1.3, 1.5, 2.5])
"""Range of delay (s), lag (s), curve, asymmetry and exponent."""
_MOVED = np.array([0.0, 0.0, 0.05, 0.05, 0.1])
"""Of curve, asymmetry and exponent, over which rows are linear, nearly; of the lag a twentieth."""
_SPACING = 0.004
"""s between the delays that a parabola is laid through."""
STEP = 0.012
"""s of a row. Between commands 4 ms apart the motors' response is not observable; beyond 30 Hz they
are not of first order, and electronic speed controllers have lags of their own."""
_SETTLED = 4.0 * HIGH[Coordinate.LAG]
"""s after which a motor's past is forgotten, the same for all: rows of motors that are compared
begin alike, or the gyro's noise there, which whiteners of a long memory carry on, would decide."""
_LEAST = 1e-3
"""Of full thrust and command: roots have no slope at none."""
_SLOWEST = 0.3
"""Of hover, state below which a lag no longer grows."""
_COUPLED = tuple(rb.SIGNALS.index(name) for name in ("qH", "pH"))
OWN = SIGNALS + len(_COUPLED)
"""Columns of one set of motor parameters."""
_THRUST = rb.SIGNALS.index("thrust")
_OF_ROTORS = np.array([*ROTOR_COLUMNS, *_COUPLED])
BODY_PLACES = tuple(i for i in range(WIDTH) if i not in (*ROTOR_COLUMNS, *_COUPLED))
"""Columns of a row [x, y] that no motor has a part in."""


class LocalDynamics(ActuatorDynamics):
    """The map from linearized rows to rows [x, y], near one set of motor parameters.

    A row holds, for the point itself, for what a shorter and a longer delay and then every other
    free parameter changes of it, the SIGNALS and the products of rates with H; then the rest.

    Args:
        at: (N_COORDINATES,) the point.
        of: what lags.
        dt: s between samples.
        curve: whether the thrust curve is unknown too.
    """

    def __init__(self, at: Array, of: LagOf, dt: float, *, curve: bool = True) -> None:
        super().__init__((0.0,))
        self.at = np.clip(at, LOW, HIGH)
        self.motors = True
        self.lag_place = LagPlace(of)
        self.free = tuple(i for i in range(N_COORDINATES) if curve or i != Coordinate.CURVE)
        self.low, self.high = LOW, HIGH
        self.nodes = self.at[None]
        self.moved = _MOVED.copy()
        """(N_COORDINATES,) steps of the linearization, which the sets are in."""
        self.moved[Coordinate.LAG] = 0.05 * self.at[Coordinate.LAG]
        self.spacing = max(round(_SPACING / dt), 1)
        """Samples between delays."""
        self.moved[Coordinate.DELAY] = self.spacing * dt
        self.late_by = round(float(self.at[Coordinate.DELAY]) / dt)
        """Samples of delay in the middle."""
        self._middle = self.late_by * dt
        self.varied = tuple(i for i in self.free if i != Coordinate.DELAY)
        """Those with a set of their own."""
        self.sets = 3 + len(self.varied)
        self.late = self.sets * OWN
        self._slopes = np.zeros((1 + len(self.free), self.sets))
        """Weights, and their derivatives, that are the same everywhere."""
        self._slopes[0, 0] = 1.0
        for place, i in enumerate(self.varied, 3):
            self._slopes[1 + self.free.index(i), place] = 1.0 / self.moved[i]
        self.width = self.late + len(BODY_PLACES)
        twice = self._twice_delayed = np.zeros((WIDTH, self.width))
        """Second derivative of all maps by delay."""
        places = np.arange(OWN)[:, None] + OWN * np.arange(1, 3)  # of both delays
        twice[_OF_ROTORS[:, None], places] = self.moved[Coordinate.DELAY] ** -2.0

    def weights(self, at: Array) -> Array:
        """(K, 1 + f, sets) at (K, N_COORDINATES): of each set, and its derivatives.

        The first set is that of the point, the next two are of both delays, of which a parabola is
        laid, and the others of what varies beside.
        """
        step = self.moved[Coordinate.DELAY]
        x = (at[:, Coordinate.DELAY] - self._middle) / step
        out = np.zeros((len(at), 1 + len(self.free), self.sets))
        out[:] = self._slopes
        out[:, 0, 1], out[:, 0, 2] = 0.5 * (x * x - x), 0.5 * (x * x + x)
        varied = list(self.varied)
        out[:, 0, 3:] = (at[:, varied] - self.at[varied]) / self.moved[varied]
        by_delay = 1 + self.free.index(Coordinate.DELAY)
        out[:, by_delay, 1], out[:, by_delay, 2] = (x - 0.5) / step, (x + 0.5) / step
        return out

    def maps(self, at: Array) -> Array:
        """See `ActuatorDynamics.maps`."""
        maps = np.zeros((len(at), 1 + len(self.free), WIDTH, self.width))
        places = np.arange(OWN)[:, None] + OWN * np.arange(self.sets)
        maps[:, :, _OF_ROTORS[:, None], places] = self.weights(at)[:, :, None]
        maps[:, 0, BODY_PLACES, range(self.late, self.width)] = 1.0
        return maps

    def curvature(self, at: Array, maps: Array, weights: Array) -> Array:
        """See `ActuatorDynamics.curvature`; other coordinates than delay have none."""
        f, late = len(self.free), self.free.index(Coordinate.DELAY)
        out = np.zeros((len(at), f, f))
        out[:, late, late] = (weights * self._twice_delayed).sum(axis=(1, 2))
        return out

    def body_places(self, columns: Sequence[int]) -> list[int]:
        """See `ActuatorDynamics.body_places`."""
        return [self.late + BODY_PLACES.index(column) for column in columns]


def step_of(dt: float) -> OneStep:
    """The step of rows of commands that come every `dt` s."""
    return OneStep(dt, (0,), max(round(STEP / dt), 1), mean=False)


@dataclass(frozen=True)
class MeanThrust:
    """What the noise of commands does to the mean thrust.

    Motors that speed up faster than they slow down follow it upwards.

    Attributes:
        basis: the motors that thrust was summed with.
        sums: of thrust over samples: at these motors, what moving each of their parameters that
            varies changes, and with one time constant.
    """

    basis: LocalDynamics
    sums: Array

    def rectified(self, at: Array) -> tuple[float, Array]:
        """Mean thrust over that of motors with one time constant, less one.

        Args:
            at: (N_COORDINATES,) the motors.

        Returns:
            That share, and its (N_COORDINATES,) derivatives.
        """
        even, slope = self.sums[-1], np.zeros(N_COORDINATES)
        if even <= 0.0:
            return 0.0, slope
        for place, i in enumerate(self.basis.varied, 1):
            if i in (Coordinate.ASYMMETRY, Coordinate.EXPONENT):
                slope[i] = self.sums[place] / (even * self.basis.moved[i])
        share = (self.sums[0] - even) / even + slope @ (at - self.basis.at)
        return float(share), slope


class MotorRows:
    """Samples to linearized rows of one step, block by block.

    Args:
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
        basis: what they are linearized about.
        hover: mean command, about which a lag depends on speed.
    """

    def __init__(self, geometry: Array, dt: float, basis: LocalDynamics, hover: float) -> None:
        self._dt, self._basis, self.hover = dt, basis, hover
        self._mixer, self._spin = rb.mixer(geometry), geometry[2]
        _, self._tau, self._curve, self._e, self._p = basis.at.tolist()
        # Of the state, of what each parameter that varies does to it, and, for the mean thrust, of
        # motors with one time constant.
        self._points = 2 + len(basis.varied)
        self._thrusts = np.zeros(self._points)
        at_hover, by_curve = self._drive(np.array(hover))
        self._hover, self._hover_by_curve = max(float(at_hover), _LEAST), float(by_curve)
        self.step = step_of(dt)
        """Of rows."""
        before, after = basis.late_by - basis.spacing, basis.late_by + basis.spacing
        # Rows about any motors are of the same samples, and so of the same noise: whole steps, and
        # from the same sample on.
        self._past, self._ahead = -min(before, 0), max(after, 0)
        self._past += -self._past % self.step.step
        self._settling = int(np.ceil(_SETTLED / dt)) + before
        self._shifts = (basis.late_by, before, after)
        self.restart()

    @property
    def mean_thrust(self) -> "MeanThrust":
        """Of the samples so far; it does not change with those that come."""
        return MeanThrust(self._basis, self._thrusts)

    def restart(self) -> None:
        """What comes next does not join on to what came before."""
        self._state: Array | None = None
        self._last: Array = np.empty(0)
        self._wait = 0
        self._held: Array | None = None
        self.step.restart()

    def update(self, inputs: Array, gyro: Array, rates: Array) -> Array:
        """(m, width) rows that (n, rotors) commands, (n, 3) gyro and rates in rad/s complete."""
        signals, sets = self._signals(inputs), self._basis.sets
        whole = complete_rows(signals[:, :, _THRUST])
        # One after the other: sums are the same however samples are grouped.
        sums = np.concatenate([self._thrusts[None], signals[whole, :, _THRUST]])
        self._thrusts = np.cumsum(sums, axis=0)[-1]
        signals, points = signals[:, :-1], self._points - 1
        timeline = np.column_stack([signals.reshape(-1, points * SIGNALS), gyro, rates])
        if self._held is not None:
            timeline = np.concatenate([self._held, timeline])
        count = max(len(timeline) - self._past - self._ahead, 0)
        self._held = timeline[count:]
        now = slice(self._past, self._past + count)
        signals = timeline[:, :-6].reshape(-1, points, SIGNALS)
        late, before, after = (
            signals[self._past + s : self._past + s + count] for s in self._shifts
        )
        rotors = np.empty((count, sets, SIGNALS))
        rotors[:, 0] = late[:, 0]
        rotors[:, 1], rotors[:, 2] = before[:, 0] - late[:, 0], after[:, 0] - late[:, 0]
        rotors[:, 3:] = late[:, 1:]
        gyro, rates = timeline[now, -6:-3], timeline[now, -3:]
        products = rotors[..., -1:] * rates[:, None, 1::-1]
        flat = rotors.reshape(-1, sets * SIGNALS)
        rows = self.step.update(
            np.column_stack(
                [
                    flat,
                    products.reshape(-1, sets * len(_COUPLED)),
                    rb.rate_signals(rates),
                    gyro,
                ]
            ),
            flat.shape[1],
        )
        m = len(rows.average)
        out = np.empty((m, self._basis.width))
        of_sets = np.empty((m, sets, OWN))
        of_sets[..., :SIGNALS] = rows.average[:, : flat.shape[1]].reshape(m, sets, SIGNALS)
        of_sets[..., SIGNALS - 1] = rows.derivative[:, SIGNALS - 1 : flat.shape[1] : SIGNALS]
        body = self._basis.late
        of_sets[..., SIGNALS:] = rows.average[:, flat.shape[1] : body].reshape(
            m, sets, len(_COUPLED)
        )
        out[:, :body] = of_sets.reshape(m, body)
        out[:, body:-3] = rows.average[:, body:-3]
        out[:, -3:] = rows.derivative[:, -3:]
        return out

    def _signals(self, inputs: Array) -> Array:
        """(n, points, SIGNALS) roll, pitch, thrust, yaw and H, undelayed; NaN until settled."""
        out = np.full((len(inputs), self._points, SIGNALS), np.nan)
        for run, there in runs(complete_rows(inputs)):
            if not there:
                self._state = None
                continue
            driven = np.stack(self._drive(inputs[run]))
            if self._state is None:
                self._state = np.zeros((self._points, inputs.shape[1]))
                self._state[[0, -1]], self._last = driven[0, 0], driven[:, 0]
                if Coordinate.CURVE in self._basis.varied:
                    place = 1 + self._basis.varied.index(Coordinate.CURVE)
                    self._state[place] = driven[1, 0] * self._basis.moved[Coordinate.CURVE]
                self._wait = self._settling
            reached = self._lagged(driven)
            skip = min(self._wait, len(reached))
            self._wait -= skip
            share, speed = self._thrust(reached[skip:])
            at = slice(run.start + skip, run.stop)
            out[at, :, :-1], out[at, :, -1] = share @ self._mixer, speed @ self._spin
        return out

    def _drive(self, u: Array) -> tuple[Array, Array]:
        """What the state goes after, of commands, and its derivative by the curve."""
        of = self._basis.lag_place.of
        if of == "command":
            return u, np.zeros_like(u)
        share, by_curve = (1.0 - self._curve) * u + self._curve * u * u, u * u - u
        return (share, by_curve) if of == "thrust" else _root(share, by_curve)

    def _thrust(self, states: Array) -> tuple[Array, Array]:
        """(n, points, rotors) shares of full thrust, and roots of these, of so many states."""
        of, c = self._basis.lag_place.of, self._curve
        x, changes = states[:, [0, -1]], states[:, 1:-1]
        share, by_state, by_curve = x, np.ones_like(x), np.zeros_like(x)
        if of == "speed":
            share, by_state = x * x, 2.0 * x
        elif of == "command":
            share, by_state, by_curve = x + c * (x * x - x), 1.0 - c + 2.0 * c * x, x * x - x
        slopes = by_state[:, :1] * changes
        if Coordinate.CURVE in self._basis.varied:
            place = self._basis.varied.index(Coordinate.CURVE)
            slopes[:, place] += by_curve[:, 0] * self._basis.moved[Coordinate.CURVE]
        shares = np.concatenate([share[:, :1], slopes, share[:, 1:]], axis=1)
        if of == "speed":
            return shares, states
        roots, by_share = _root(share, np.ones_like(share))
        slopes = by_share[:, :1] * slopes
        return shares, np.concatenate([roots[:, :1], slopes, roots[:, 1:]], axis=1)

    def _lagged(self, driven: Array) -> Array:
        """(n, points, rotors) after each sample, commands halfway between two in force there.

        Args:
            driven: (2, n, rotors) as of `_drive`.
        """
        assert self._state is not None
        mean = 0.5 * (driven + np.concatenate([self._last[:, None], driven[:, :-1]], axis=1))
        self._last = driven[:, -1]
        # (rotors, n): each state's samples lie side by side.
        v, v_by_curve = np.ascontiguousarray(np.moveaxis(mean, 1, -1))
        first = self._state[..., None]
        # A state stays among what it goes after.
        low = np.minimum(v.min(axis=-1, keepdims=True), first[0])
        high = np.maximum(v.max(axis=-1, keepdims=True), first[0])
        kept = np.full(v.shape, np.exp(-self._dt / self._tau))
        states = np.empty((self._points, len(v), len(mean[0]) + 1))
        states[..., :1] = first
        states[-1, :, 1:] = recursion(kept, (1.0 - kept) * v, first[-1])
        x = states[0]
        x[:, 1:] = recursion(kept, (1.0 - kept) * v, first[0])
        # Which time constant is in force depends on the state itself. Newton's method finds all
        # states at once, in some five steps: a state is exact one step after the one before it,
        # so that it ends, and where one time constant does, its steps are quadratic.
        for _ in range(len(mean[0]) + 1):
            before = x[:, :-1]
            away = before - v
            rate, _above = self._rates(before, away)
            share = np.exp(rate)
            slope = self._slope(before, away, rate, share)
            after = recursion(slope, v + away * share - slope * before, first[0])
            np.clip(after, low, high, out=after)
            moved = float(np.abs(after - x[:, 1:]).max())
            x[:, 1:] = after
            # A smaller step, of full thrust, leaves nothing but rounding.
            if moved < 1e-9:
                break
        before = x[:, :-1]
        away = before - v
        rate, above = self._rates(before, away)
        share = np.exp(rate)
        slope = self._slope(before, away, rate, share)
        # What each parameter does to the next state by itself, and from there on.
        bent = away * share * rate
        added = np.empty((len(self._basis.varied), *v.shape))
        for own, i in zip(added, self._basis.varied, strict=True):
            if i == Coordinate.LAG:
                own[:] = -bent / self._tau
            elif i == Coordinate.ASYMMETRY:
                own[:] = np.where(away < 0.0, 0.5 * bent, -0.5 * bent)
            elif i == Coordinate.EXPONENT:
                own[:] = bent * above
            else:
                faster = np.where(before > self._slowest, self._p / self._hover, 0.0)
                own[:] = (1.0 - share) * v_by_curve - bent * faster * self._hover_by_curve
            own *= self._basis.moved[i]
        states[1:-1, :, 1:] = recursion(np.broadcast_to(slope, added.shape), added, first[1:-1])
        self._state = states[..., -1].copy()
        return np.moveaxis(states[..., 1:], -1, 0)

    @property
    def _slowest(self) -> float:
        """State below which a lag no longer grows."""
        return _SLOWEST * self._hover

    def _rates(self, x: Array, away: Array) -> tuple[Array, Array]:
        """-dt over the time constant of (rotors, n) states, and ln of these over hover's."""
        above = np.log(np.maximum(x, self._slowest) / self._hover)
        rate: Array = np.exp(self._p * above)
        rate *= (
            -self._dt
            / self._tau
            * np.where(away < 0.0, np.exp(0.5 * self._e), np.exp(-0.5 * self._e))
        )
        return rate, above

    def _slope(self, x: Array, away: Array, rate: Array, share: Array) -> Array:
        """Of the next state by (rotors, n) states, a share of how far these are away being left."""
        least = self._slowest
        faster = np.where(x > least, self._p * away * rate / np.maximum(x, least), 0.0)
        return share * (1.0 + faster)


def _root(share: Array, change: Array) -> tuple[Array, Array]:
    """The root of shares of full thrust, and its change with theirs; flat where they are least."""
    root = np.sqrt(np.maximum(share, _LEAST))
    return root, np.where(share > _LEAST, 0.5 * change / root, 0.0)
