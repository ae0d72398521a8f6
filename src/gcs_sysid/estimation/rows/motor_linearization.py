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
"""By how much curve, asymmetry and exponent are moved for their derivatives; lag by a twentieth."""
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
        """(N_COORDINATES,) by how much each is moved for its derivative."""
        self.moved[Coordinate.LAG] = 0.05 * self.at[Coordinate.LAG]
        self.spacing = max(round(_SPACING / dt), 1)
        """Samples between delays."""
        self.moved[Coordinate.DELAY] = self.spacing * dt
        self.late_by = round(float(self.at[Coordinate.DELAY]) / dt)
        """Samples of delay in the middle."""
        self._middle = self.late_by * dt
        self.varied = tuple(i for i in self.free if i != Coordinate.DELAY)
        """Those moved."""
        self.sets = 3 + len(self.varied)
        self.late = self.sets * OWN
        self._slopes = np.zeros((1 + len(self.free), self.sets))
        """Weights, and their derivatives, that are the same everywhere."""
        self._slopes[0, 0] = 1.0
        for place, i in enumerate(self.varied, 3):
            self._slopes[1 + self.free.index(i), place] = 1.0 / self.moved[i]
        self.width = self.late + len(BODY_PLACES)

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
        sums: of thrust over samples: at these motors, with each of their parameters moved that
            varies, and with one time constant.
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
                slope[i] = (self.sums[place] - self.sums[0]) / (even * self.basis.moved[i])
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
        points = np.tile(basis.at, (1 + len(basis.varied), 1))
        for row, i in enumerate(basis.varied, 1):
            points[row, i] += basis.moved[i]
        # Last, motors with one time constant, for the mean thrust.
        points = np.concatenate([points, points[:1]])
        points[-1, [Coordinate.ASYMMETRY, Coordinate.EXPONENT]] = 0.0
        self._thrusts = np.zeros(len(points))
        _, self._tau, self._curve, e, self._p = (v[:, None] for v in points.T)
        self._up, self._down = np.exp(-0.5 * e), np.exp(0.5 * e)
        self._hover = self._drive(np.full((1, geometry.shape[1]), hover))[0]
        self._step = step_of(dt)
        before, after = basis.late_by - basis.spacing, basis.late_by + basis.spacing
        # Rows about any motors are of the same samples, and so of the same noise: whole steps, and
        # from the same sample on.
        self._past, self._ahead = -min(before, 0), max(after, 0)
        self._past += -self._past % self._step.step
        self._settling = int(np.ceil(_SETTLED / dt)) + before
        self._shifts = (basis.late_by, before, after)
        self.restart()

    @property
    def mean_thrust(self) -> "MeanThrust":
        """Of the samples so far; it does not change with those that come."""
        return MeanThrust(self._basis, self._thrusts)

    @property
    def samples_a_row(self) -> int:
        """How far rows are apart."""
        return self._step.step

    def restart(self) -> None:
        """What comes next does not join on to what came before."""
        self._state: Array | None = None
        self._last: Array = np.empty(0)
        self._wait = 0
        self._held: Array | None = None
        self._step.restart()

    def update(self, inputs: Array, gyro: Array, rates: Array) -> Array:
        """(m, width) rows that (n, rotors) commands, (n, 3) gyro and rates in rad/s complete."""
        signals, sets = self._signals(inputs), self._basis.sets
        whole = complete_rows(signals[:, :, _THRUST])
        # One after the other: sums are the same however samples are grouped.
        sums = np.concatenate([self._thrusts[None], signals[whole, :, _THRUST]])
        self._thrusts = np.cumsum(sums, axis=0)[-1]
        signals = signals[:, :-1]
        points = signals.shape[1]
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
        rotors[:, 3:] = late[:, 1:] - late[:, :1]
        gyro, rates = timeline[now, -6:-3], timeline[now, -3:]
        products = rotors[..., -1:] * rates[:, None, 1::-1]
        flat = rotors.reshape(-1, sets * SIGNALS)
        rows = self._step.update(
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
        x = np.full((len(inputs), *self._tau.shape[:1], inputs.shape[1]), np.nan)
        for run, there in runs(complete_rows(inputs)):
            if not there:
                self._state = None
                continue
            driven = self._drive(inputs[run])
            if self._state is None:
                self._state, self._last = driven[0], driven[0]
                self._wait = self._settling
            reached = self._lagged(driven)
            skip = min(self._wait, len(reached))
            self._wait -= skip
            x[run.start + skip : run.stop] = reached[skip:]
        c, of = self._curve, self._basis.lag_place.of
        share = x * x if of == "speed" else x if of == "thrust" else (1.0 - c) * x + c * x * x
        speed = x if of == "speed" else np.sqrt(np.maximum(share, _LEAST))
        return np.concatenate([share @ self._mixer, (speed @ self._spin)[..., None]], axis=-1)

    def _drive(self, u: Array) -> Array:
        """(n, points, rotors) what the state goes after, of (n, rotors) commands."""
        u, c = u[:, None], self._curve
        of = self._basis.lag_place.of
        share = (1.0 - c) * u + c * u * u
        if of == "speed":
            driven: Array = np.sqrt(np.maximum(share, _LEAST))
        else:
            driven = share if of == "thrust" else np.broadcast_to(u, share.shape)
        return driven

    def _lagged(self, driven: Array) -> Array:
        """The states after each sample, commands halfway between two samples in force there."""
        assert self._state is not None
        mean = 0.5 * (driven + np.concatenate([self._last[None], driven[:-1]]))
        self._last = driven[-1]
        # (points, rotors, n): each state's samples lie side by side.
        v = np.ascontiguousarray(np.moveaxis(mean, 0, -1))
        first = self._state[..., None]
        # A state stays among what it goes after.
        low = np.minimum(v.min(axis=-1, keepdims=True), first)
        high = np.maximum(v.max(axis=-1, keepdims=True), first)
        kept = np.broadcast_to(np.exp(-self._dt / self._tau)[..., None], v.shape)
        x = np.concatenate([first, recursion(kept, (1.0 - kept) * v, first)], axis=-1)
        # Which time constant is in force depends on the state itself. Newton's method finds all
        # states at once, in some five steps: a state is exact one step after the one before it,
        # so that it ends, and where one time constant does, its steps are quadratic.
        for _ in range(len(mean) + 1):
            before = x[..., :-1]
            away = before - v
            share, slope = self._shares(before, away)
            after = recursion(slope, v + away * share - slope * before, first)
            np.clip(after, low, high, out=after)
            moved = float(np.abs(after - x[..., 1:]).max())
            x[..., 1:] = after
            # A smaller step, of full thrust, leaves nothing but rounding.
            if moved < 1e-9:
                break
        self._state = x[..., -1].copy()
        reached: Array = np.moveaxis(x[..., 1:], -1, 0)
        return reached

    def _shares(self, x: Array, away: Array) -> tuple[Array, Array]:
        """What a sample leaves of how far states are away, and the slope of the next state.

        Args:
            x: (points, rotors, n) states.
            away: from what they go after.
        """
        least, p = _SLOWEST * self._hover[..., None], self._p[..., None]
        above = np.maximum(x, least)
        rate = np.where(
            away < 0.0,
            (-self._dt / (self._tau * self._up))[..., None],
            (-self._dt / (self._tau * self._down))[..., None],
        )
        rate *= np.exp(p * np.log(above / self._hover[..., None]))
        share = np.exp(rate)
        return share, share * (1.0 + np.where(x > least, p * away * rate / above, 0.0))
