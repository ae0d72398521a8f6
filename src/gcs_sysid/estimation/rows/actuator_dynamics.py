"""The unknown actuator dynamics between the rotor stream and the thrust.

Three parameters relate the telemetered rotor signal to the thrust that acts when the IMU samples:

    rotor delay d   s, of the rotors' stamps behind the IMU's
    motor lag tau   s, of first order, where commands are the input; measured speeds have none
    thrust curve c  T / T_max = (1 - c) w + c w^2 of the lagged command w; speeds have none

What lags the command matters to second order. A motor turns a propeller, so speed does: sqrt(T)
follows the root of the share of full thrust that is commanded; a simulator may let thrust lag, or
the command itself. Around hover all three are

    T / T_max = (1 - c) w + c w^2 + k (L[u^2] - w^2),    w = L[u]

with L the lag of command u. k is 0 where the command lags, c where thrust does, and below zero
where speed does (`LagPlace`). The last term is largest where two axes turn together: what lags
matters for Izz and k_M, which separate there.

The rotors' signals are filtered with a few pairs of lag and delay, the elements of a basis. The
response of any other pair, exp(i omega d) / (1 + i omega tau), is a sum of the elements with
weights found by least squares over the frequencies that pass the window, to 2e-4 of the signal;
sums with weights add up to one, so that constants pass unchanged. The curve mixes the signals of w
and of w^2. So a row at any delay, lag and curve is a linear map of the row that holds all elements,
its moments are that map of their moments, derivatives included, and the three are unknowns of the
fit like any other. Moments made so are those of real rows: residual power is never negative,
however small.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from itertools import product
from typing import Literal, get_args

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.signals.redundant_commands import SLOW_COMMANDS
from gcs_sysid.signals.smoothers import cosine_window

COORDINATE_NAMES = ("rotor_delay", "motor_lag", "thrust_curve", "lag_asymmetry", "lag_exponent")
"""Of the coordinates d, tau, c as in `model.parameters`, and of e and p, which only
`motor_linearization` has; they are nuisances."""
N_COORDINATES = len(COORDINATE_NAMES)


class Coordinate(IntEnum):
    """Indices of the coordinates; among all unknowns they are those of `fit.priors.Unknown`."""

    DELAY = 0
    LAG = 1
    CURVE = 2
    ASYMMETRY = 3
    EXPONENT = 4


WIDTH = rb.N_SIGNALS + 3
"""Of a row [x, y]."""
ROTOR_COLUMNS = (0, 1, 2, 3, rb.SIGNALS.index("dH"))
"""Columns of x that come from the rotors: roll, pitch, thrust, yaw torque, and H'."""
_BODY_COLUMNS = tuple(i for i in range(WIDTH) if i not in ROTOR_COLUMNS)
SIGNALS, BODY = len(ROTOR_COLUMNS), len(_BODY_COLUMNS)
N_BENT = 4
"""Of these columns, those of torques and thrust: what lags matters there."""

_COUPLED = tuple(rb.SIGNALS.index(name) for name in ("qH", "pH"))
"""Columns of x that are products of the rates with H."""
_PAST = 0.02
"""s between the past values of H that products are formed with, where speeds are the input: about
the time in which torque changes by an eighth of a radian at 1 Hz."""


def motor_filter(dt: float, lag: float) -> tuple[float, float, float]:
    """(a, b0, b1) of w_k = a w_{k-1} + b0 u_k + b1 u_{k-1} for a motor of first order.

    Exact for commands interpolated linearly between stamps, which adds no phase; the zero-order
    hold of the commands is then part of the delay.
    """
    if lag == 0.0:
        return 0.0, 1.0, 0.0
    a = float(np.exp(-dt / lag))
    share = lag / dt * (1.0 - a)
    return a, 1.0 - share, share - a


def response(omega: Array, delay: Array, lag: Array) -> Array:
    """(..., n) of motors with these lags (...), stamps late by (...) put right, at (n,) rad/s."""
    passed: Array = np.exp(1j * omega * delay[..., None]) / (1.0 + 1j * omega * lag[..., None])
    return passed


_MOTION, _FASTEST = 6.0, 40.0
"""Hz. Torque falls off with frequency above the one, and is next to nothing above the other."""


def _passed(half_width: float | None, dt: float) -> tuple[Array, Array]:
    """(n,) rad/s, and how much of the rotors' signals at these frequencies reaches a row."""
    if half_width is None:
        fastest = min(_FASTEST, 0.45 / dt) if dt else _FASTEST
        omega = 2.0 * np.pi * np.linspace(0.0, fastest, 120)
        return omega, 1.0 / np.sqrt(1.0 + (omega / (2.0 * np.pi * _MOTION)) ** 2)
    omega = np.linspace(0.0, 10.0 / half_width, 80)
    window = cosine_window(100, half_width / 100.0).average
    places = np.linspace(-half_width, half_width, len(window))
    # What the window lets pass. The motion lies in its lower half: weights that grow with
    # frequency leave four times the error there.
    return omega, np.abs(np.cos(np.outer(omega, places)) @ window)


_PAIRED = 2.0 * np.pi * np.array([0.4, 1.0, 2.0, 3.5])
"""rad/s, of motion whose products count."""
_SHARE = 0.01
"""Weight of these products beside the signals themselves: brings them from 0.4 to 0.005, and costs
the signals next to nothing 1e-5."""


def _differentiated(passed: Array, omega: Array, lag: Array, by: int | None) -> Array:
    """(K, n) responses at (K,) lags, differentiated by delay or lag or not."""
    if by == Coordinate.DELAY:
        passed = passed * (1j * omega)
    elif by == Coordinate.LAG:
        passed = passed * (-1j * omega / (1.0 + 1j * omega * lag[:, None]))
    return passed


_PAIRS = np.triu_indices(len(_PAIRED))
"""Of `_PAIRED`, each with itself and those after it."""


def _second_order(passed: Array, change: Array | None = None) -> Array:
    """(..., m) products of (..., n) responses at `_PAIRED`, real and imaginary parts.

    Args:
        passed: the responses.
        change: their derivative; the products' derivative then. None: the products themselves.
    """
    i, j = _PAIRS
    other = np.conj(passed)
    if change is None:
        products = passed[..., i] * passed[..., j], passed[..., i] * other[..., j]
    else:
        turned = np.conj(change)
        products = (
            change[..., i] * passed[..., j] + passed[..., i] * change[..., j],
            change[..., i] * other[..., j] + passed[..., i] * turned[..., j],
        )
    both = np.concatenate(products, axis=-1)
    return _SHARE * np.concatenate([both.real, both.imag], axis=-1)


class _Targets:
    """What filters are to approximate, for all spans of a basis: made once, where it is asked for.

    Args:
        omega: (n,) rad/s.
        passed: (n,) how much reaches a row.
        delay: (K,) s.
        lag: (K,) s.
    """

    def __init__(self, omega: Array, passed: Array, delay: Array, lag: Array) -> None:
        self._omega, self._passed, self._at = omega, passed, (delay, lag)
        self._responses: dict[str, Array] = {}
        self._made: dict[tuple[int | None, bool], Array] = {}

    def by(self, place: int | None, *, squared: bool) -> Array:
        """(K, m) responses, with their products or not, differentiated by delay, lag or nothing."""
        if (place, squared) not in self._made:
            if squared:
                paired = self._response("paired", _PAIRED)
                change = None if place is None else self._differentiated(paired, _PAIRED, place)
                parts = self.by(place, squared=False), _second_order(paired, change)
                made = np.concatenate(parts, axis=-1)
            else:
                passed = self._response("all", self._omega)
                made = _stacked(self._differentiated(passed, self._omega, place), self._passed)
            self._made[place, squared] = made
        return self._made[place, squared]

    def _response(self, name: str, omega: Array) -> Array:
        if name not in self._responses:
            self._responses[name] = response(omega, *self._at)
        return self._responses[name]

    def _differentiated(self, passed: Array, omega: Array, by: int | None) -> Array:
        return _differentiated(passed, omega, self._at[1], by)


def _stacked(passed: Array, share: Array) -> Array:
    """(..., 2 n) real and imaginary parts of (..., n) responses, of which a share reaches a row."""
    weighed = passed * share
    return np.concatenate([weighed.real, weighed.imag], axis=-1)


class _Span:
    """Weights with which some filters approximate another one.

    Args:
        half_width: s, of the window that all pass afterwards; None: rows are of one step.
        delays: (k,) s.
        lags: (k,) s.
        dt: s between samples; 0: next to nothing.
        squared: whether the same weights shall make the other one's square of their squares. To
            first order they do. What is of second order, on which the thrust curve rests, is that
            of the response at two frequencies at once, H(w1) H(w2) and H(w1) H(-w2).
    """

    def __init__(
        self,
        half_width: float | None,
        delays: Array,
        lags: Array,
        dt: float,
        *,
        squared: bool = False,
    ) -> None:
        self.omega, self._passed = _passed(half_width, dt)
        self._squared = squared
        A = _stacked(self._made(self.omega, delays, lags, dt), self._passed).T
        if squared:
            A = np.concatenate([A, _second_order(self._made(_PAIRED, delays, lags, dt)).T])
        # Weighted least squares with the weights' sum given, for all right-hand sides. Filters
        # resemble each other in a long window: the sum is put right by itself, as rounding in a
        # bordered system would leave it off by 3e-4, and with it every moment of inertia.
        system = A.T @ A + 1e-12 * np.eye(len(delays))
        free, even = np.linalg.solve(system, A.T), np.linalg.solve(system, np.ones(len(delays)))
        self._of_sum = even / even.sum()
        self._of_target = free - np.outer(self._of_sum, free.sum(axis=0))

    def targets(self, delay: Array, lag: Array) -> _Targets:
        """What spans of the same window and samples approximate at (K,) delays and lags."""
        return _Targets(self.omega, self._passed, delay, lag)

    def weights_by(self, targets: _Targets, by: Sequence[int | None]) -> list[Array]:
        """(K, k) differentiated by each of some coordinates or none.

        No other than delay and lag changes them: by it they are not differentiated.
        """
        made: dict[int | None, Array] = {}
        for place in by:
            own = place if place in (Coordinate.DELAY, Coordinate.LAG) else None
            if own not in made:
                made[own] = targets.by(own, squared=self._squared) @ self._of_target.T
                if own is None:
                    made[own] += self._of_sum
        return [
            made[place if place in (Coordinate.DELAY, Coordinate.LAG) else None] for place in by
        ]

    def weights(self, delay: Array, lag: Array) -> Array:
        """(K, k) for (K,) delays and lags."""
        return self.weights_by(self.targets(delay, lag), (None,))[0]

    @staticmethod
    def _made(omega: Array, delays: Array, lags: Array, dt: float) -> Array:
        """(k, n) what the filters really pass: those of motors lose some between slow samples."""
        if not dt:
            return response(omega, delays, lags)
        late = np.exp(-1j * omega * dt)
        coefficients = np.array([motor_filter(dt, lag) for lag in lags])
        a, b0, b1 = coefficients.T[:, :, None]
        moved = np.exp(1j * omega * delays[:, None])
        made: Array = moved * (b0 + b1 * late) / (1.0 - a * late)
        return made


LagOf = Literal["speed", "command", "thrust"]
LAGS_OF: tuple[LagOf, ...] = get_args(LagOf)


_NODES = np.array([-(3.0**0.5), 0.0, 3.0**0.5])
_WEIGHTS = np.array([1.0, 4.0, 1.0]) / 6.0
"""Means over a normal distribution (Gauss-Hermite)."""
_LEAST_SHARE = 0.01
"""Of full thrust: the root has no slope at none."""


@dataclass(frozen=True)
class LagPlace:
    """What lags behind the command.

    Attributes:
        of: the rotor's speed, the command itself before the thrust curve, or thrust.
        hover: mean command.
        spread: standard deviation of commands.
    """

    of: LagOf = "speed"
    hover: float = 0.5
    spread: float = 0.02

    def bend(self, curve: Array) -> tuple[Array, Array]:
        """(K,) k at (K,) thrust curves, see the module, and its derivative by the curve.

        Where speed lags, k is such that a lag without end leaves the square of the mean speed.
        """
        inside = (curve > 0.0) & (curve < 1.0)
        c = np.clip(curve, 0.0, 1.0)[:, None]
        if self.of == "command":
            return np.zeros(len(c)), np.zeros(len(c))
        if self.of == "thrust":
            return c[:, 0], 1.0 * inside
        spread = max(self.spread, 1e-3)
        u = self.hover + spread * _NODES
        share = np.maximum((1.0 - c) * u + c * u * u, _LEAST_SHARE)
        by = np.where(share > _LEAST_SHARE, u * u - u, 0.0)
        root = np.sqrt(share)
        mean, change = root @ _WEIGHTS, (0.5 * by / root) @ _WEIGHTS
        k: Array = (mean * mean - share[:, 1]) / spread**2
        slope: Array = (2.0 * mean * change - by[:, 1]) / spread**2 * inside
        return k, slope


@dataclass(frozen=True)
class Element:
    """A pair of filters, by index into a basis' lags and delays."""

    lag: int
    delay: int


class ActuatorDynamics:
    """Elements, and the maps from rows that hold them all to rows [x, y].

    A row of elements is laid out element by element, each with its `sets` (of w and of w^2 where
    commands are the input) of SIGNALS, then the further products, then the bends, then the BODY
    columns. Bends are L[u^2] - w^2 at a few lags, of commands; their delay is made by mixing.

    Products q H and p H are no filtered signals: H must have its lag and delay before it is
    multiplied. Rotors that speed up turn the body against them, J_r H is most of what Izz r is, and
    q J_r H as large as the gyroscopic torque that determines Izz. So the products are formed with H
    at several lags (commands), or with present and past H (speeds), and mixed as H would be. Those
    with the first form of H are among the BODY columns, the others are the further products.

    Args:
        delays: s, rising.
        lags: s, rising; several where commands are the input.
        curves: least and greatest thrust curve; one value where it is given. Not for speeds.
        motors: whether lag and thrust curve lie between the input and thrust, as of commands.
        half_width: s, of the window that rows pass; None: they are of one step.
        dt: s between samples; 0: so little that motors are filtered as they are.
        coupled: whether there are further products of rates and H; else H has neither lag nor
            delay in them.
    """

    def __init__(
        self,
        delays: Sequence[float] | Array,
        lags: Sequence[float] = (0.0,),
        curves: Sequence[float] = (1.0,),
        *,
        motors: bool = False,
        half_width: float | None = 0.1,
        dt: float = 0.0,
        coupled: bool = False,
    ) -> None:
        self.delays, self.lags = np.asarray(delays, float), np.asarray(lags, float)
        curve = np.asarray(curves, float)
        self.motors = motors
        self.curve_doubt = 0.0
        """One standard deviation of the thrust curve that no scatter shows; may change."""
        self.sets = 2 if motors else 1
        axes = (self.delays, self.lags, curve, np.zeros(1), np.zeros(1))
        self.low = np.array([axis[0] for axis in axes])
        self.high = np.array([axis[-1] for axis in axes])
        self.free = tuple(i for i, axis in enumerate(axes) if len(axis) > 1)
        """The coordinates that are unknown; the others are given."""
        self.elements = self._chosen()
        self.late = len(self.elements) * self.sets * SIGNALS
        """Columns of the elements."""
        self.coupled_lags: tuple[int, ...] = ()
        """Indices of the lags of H in the products, with commands."""
        self.coupled_shifts: tuple[int, ...] = ()
        """By how many samples H is past in the products, with speeds."""
        if coupled and motors:
            self.coupled_lags = tuple(range(len(self.lags)))
        elif coupled and len(self.delays) > 1:
            step = max(round(_PAST / dt), 1)
            self.coupled_shifts = (0, step, 2 * step)
        forms = len(self.coupled_lags) * self.sets + len(self.coupled_shifts)
        self.products = max(forms - 1, 0) * len(_COUPLED)
        """Columns of the further products."""
        self.lag_place = LagPlace("command")
        """What lags; may change."""
        self.bent_lags: tuple[int, ...] = ()
        """Indices of the lags of the bends."""
        # Of slow commands the squares' mean between samples is not known.
        bendable = coupled and motors and dt < SLOW_COMMANDS
        if bendable and len(self.lags) > 1 and self.lags[0] == 0.0:
            self.bent_lags = tuple(range(len(self.lags) - 1, 0, -2))[::-1]
        self.bends = len(self.bent_lags) * N_BENT
        """Columns of the bends."""
        self.width = self.late + self.products + self.bends + BODY
        """Of a row of elements."""
        self._span = _Span(
            half_width,
            np.array([self.delays[e.delay] for e in self.elements]),
            np.array([self.lags[e.lag] for e in self.elements]),
            dt,
            squared=motors,
        )
        self._coupled_span: _Span | None = None
        if forms:
            past = -dt * np.array(self.coupled_shifts or (0,))
            lags_of_H = self.lags[list(self.coupled_lags)] if motors else np.zeros(len(past))
            past = np.broadcast_to(past, lags_of_H.shape)
            self._coupled_span = _Span(half_width, past, lags_of_H, dt)
        self._lag_span = _Span(half_width, np.zeros_like(self.lags), self.lags, dt, squared=motors)
        # Without a lag there is no bend: its weight, which makes up the sum, goes nowhere.
        bent = self.lags[[0, *self.bent_lags]]
        self._bent_span = (
            _Span(half_width, np.zeros_like(bent), bent, dt, squared=True) if self.bends else None
        )
        scan = [_thinned(axis, most) for axis, most in zip(axes, _SCANNED, strict=True)]
        self.nodes = np.array(list(product(*scan)))
        """(n, N_COORDINATES) coordinates from which a search may start."""

    def _chosen(self) -> tuple[Element, ...]:
        if len(self.lags) == 1:
            return tuple(Element(0, j) for j in range(len(self.delays)))
        middle = len(self.delays) // 2
        lagged = [Element(i, middle) for i in range(len(self.lags))]
        # At a usual lag: then their squares are nearly those of any lag that is as late.
        usual = len(self.lags) // 2
        moved = [Element(usual, j) for j in range(len(self.delays)) if j != middle]
        return (*lagged, *moved)

    @cached_property
    def middle(self) -> int:
        """The node nearest to no delay, and to the middle of lags and curves."""
        center = 0.5 * (self.low + self.high)
        center[Coordinate.DELAY] = 0.0
        span = np.where(self.high > self.low, self.high - self.low, 1.0)
        return int(np.argmin((((self.nodes - center) / span) ** 2).sum(axis=1)))

    def maps(self, at: Array) -> Array:
        """(K, 1 + f, WIDTH, width) maps at (K, 3) coordinates.

        The first makes rows [x, y] of rows of elements, the others are its derivatives by the f
        free coordinates.
        """
        K, by = len(at), (None, *self.free)
        targets = self._span.targets(at[:, Coordinate.DELAY], at[:, Coordinate.LAG])
        filters = np.stack(self._span.weights_by(targets, by), axis=1)
        mixtures = np.stack([self._mixture(at[:, Coordinate.CURVE], i) for i in by], axis=1)
        rotors = (filters[..., None] * mixtures[:, :, None]).reshape(K, len(by), -1)
        maps = np.zeros((K, len(by), WIDTH, self.width))
        for place, column in enumerate(ROTOR_COLUMNS):
            maps[:, :, column, place : self.late : SIGNALS] = rotors
        maps[:, 0, _BODY_COLUMNS, range(self.width - BODY, self.width)] = 1.0
        if self._coupled_span is not None:
            filters = np.stack(self._coupled_span.weights_by(targets, by), axis=1)
            forms = (filters[..., None] * mixtures[:, :, None]).reshape(K, len(by), -1)
            for place, column in enumerate(_COUPLED):
                first = self.width - BODY + _BODY_COLUMNS.index(column)
                further = range(self.late + place, self.late + self.products, len(_COUPLED))
                maps[:, :, column, [first, *further]] = forms
        if self.bends:
            bent = np.stack(self._bent(at, by, targets), axis=1)
            start = self.late + self.products
            for place, column in enumerate(ROTOR_COLUMNS[:N_BENT]):
                maps[:, :, column, start + place : start + self.bends : N_BENT] = bent
        return maps

    def curvature(self, at: Array, maps: Array, weights: Array) -> Array:
        """Second derivatives of sums over the maps, by differences of the first.

        Args:
            at: (K, N_COORDINATES).
            maps: (K, 1 + f, WIDTH, width) there.
            weights: (K, WIDTH, width) that a map's elements are summed with.

        Returns:
            (K, f, f) by the free coordinates.
        """
        free, K, f = list(self.free), len(at), len(self.free)
        steps = _DIFFERENCE * (self.high - self.low)[free]
        beside = at[:, None] + np.eye(at.shape[1])[free] * steps[:, None]
        moved = self.maps(beside.reshape(K * f, -1))[:, 1:].reshape(K, f, *maps[0, 1:].shape)
        sums = (moved - maps[:, None, 1:]).reshape(K, f * f, -1) @ weights.reshape(K, -1, 1)
        out: Array = sums.reshape(K, f, f) / steps[:, None]
        return 0.5 * (out + np.swapaxes(out, 1, 2))

    def _bent(self, at: Array, by: Sequence[int | None], targets: _Targets) -> list[Array]:
        """(K, bent lags) weights of the bends at (K, 3) coordinates, or their derivatives."""
        if self._bent_span is None:
            return [np.empty((len(at), 0)) for _ in by]
        k, change = self.lag_place.bend(at[:, Coordinate.CURVE])
        every = self._bent_span.weights_by(targets, by)
        return [
            (change if i == Coordinate.CURVE else k)[:, None] * weights[:, 1:]
            for i, weights in zip(by, every, strict=True)
        ]

    def map_at(self, at: Array) -> Array:
        """(WIDTH, width) that makes rows [x, y] at (3,) coordinates of rows of elements."""
        P: Array = self.maps(at[None])[0, 0]
        return P

    def moments_at(self, moments: Array, at: Array) -> Array:
        """(..., WIDTH, WIDTH) of rows at (3,) coordinates, from (..., width, width)."""
        P = self.map_at(at)
        out: Array = P @ moments @ P.T
        return out

    def body_places(self, columns: Sequence[int]) -> list[int]:
        """Where columns of x that do not come from the rotors lie in a row of elements."""
        return [self.width - BODY + _BODY_COLUMNS.index(column) for column in columns]

    def thrust_weights(self, at: Array) -> Array:
        """(thrusts,) what makes thrust, undelayed, of that of the lags at (3,) coordinates."""
        if not self.motors:
            return np.ones(1)
        targets = self._lag_span.targets(np.zeros(1), at[Coordinate.LAG : Coordinate.LAG + 1])
        weights = self._lag_span.weights_by(targets, (None,))[0]
        mixture = self._mixture(at[Coordinate.CURVE : Coordinate.CURVE + 1], None)
        bent = self._bent(at[None], (None,), targets)[0][0]
        return np.concatenate([np.outer(weights, mixture).ravel(), bent])

    @property
    def thrusts(self) -> int:
        """How many thrusts `thrust_weights` mixes."""
        return len(self.lags) * self.sets + len(self.bent_lags)

    def _mixture(self, curve: Array, by: int | None) -> Array:
        """(K, sets) of w and w^2 at (K,) curves, differentiated by a coordinate or none."""
        one = np.ones_like(curve)
        if not self.motors:
            return one[:, None]
        if by == Coordinate.CURVE:
            return np.stack([-one, one], axis=1)
        return np.stack([1.0 - curve, curve], axis=1)


_DIFFERENCE = 1e-3
"""Share of a coordinate's range, over which derivatives are differences."""
_SCANNED = (8, 6, 5, 1, 1)
"""Most values of each coordinate from which a search starts."""


def _thinned(axis: Array, most: int) -> Array:
    if len(axis) == 1:
        return axis
    count = min(max(len(axis), 5), most)
    return np.linspace(axis[0], axis[-1], count)


class _Plain(ActuatorDynamics):
    """Rows [x, y] as they are: nothing is unknown but theta."""

    def __init__(self) -> None:
        super().__init__((0.0,))
        self.width = WIDTH

    def maps(self, at: Array) -> Array:
        maps: Array = np.broadcast_to(np.eye(WIDTH), (len(at), 1, WIDTH, WIDTH))
        return maps


PLAIN = _Plain()
"""For rows [x, y] as they are."""
