"""Deviations from the model: damping per axis, unequal rotors, rotors and IMU not as given.

    J w' + w x (J w + h) + h' = M + sum_k phi_k B_k x

with B_k one deviation's torque by axis and signal:

    damping     -d_a w_a on each axis a beside the damping that all share
    thrust      k_T of rotor i is (1 + e_i) of the mean: torque e_i (-y_i, x_i) O_i
    torque      k_M of rotor i is off the mean by c_i: yaw torque c_i s_i O_i
    places      rotor i is off by (x_i, y_i): torque (-y_i, x_i) O_i
    turn        the IMU is rotated by R: it reads w' = R Q U^-1 x, where signals are U times those
                of the body (`turned`)

e and c sum to zero, as their means are k_T and k_M themselves. An allocation of full rank drives
the rotors' O = Omega^2 within the span of roll, pitch, thrust and yaw, so that O_i is a
combination of these four signals: the pseudo-inverse of the mixer (exact for four rotors).

Deviations are nuisance parameters, phi ~ N(0, sigma^2). How well places and the IMU's rotation are
known is given with the airframe, and they are always unknowns: a degree makes Izz, Ixz and Iyz
wrong by several percent, and a minute of doublets shows it to a few hundredths. What is common to
all places (a shift, a scale) looks like theta and is no deviation: see `given_errors`.

Of the other kinds the size is unknown. With g
and H the score and information of phi at phi = 0, the other unknowns marginalized, the evidence
for sigma is

    ln p(data | sigma) - ln p(data | 0) = (g' (H + sigma^-2)^-1 g - ln det(1 + sigma H sigma)) / 2

(empirical Bayes). A kind without evidence stays out: undisturbed flights of equal rotors lose
nothing by it. Only thrust comes in with torque: a rotor that leans differs in torque alone, another
propeller or a speed that is read wrong in both. Roll and pitch of four rotors show all but a
percent of it; six and more hide what they differ by, and the CG is not known better than that.

Damping by axis is always an unknown, with a size typical of multirotors. Yaw shares no cause of it
with roll and pitch, and were it the same, it would give the scale that Izz and k_M have in common:
on sixteen vehicles of an outside simulator, whose yaw was damped 3 % more than roll, both were 3 %
too small, at two standard deviations, with no evidence of it.

An IMU turned by a degree looks much like rotors of unequal torque: roll and pitch motion then shows
in yaw. As an unknown of its own it competes with them for the evidence.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation.rows.actuator_dynamics import WIDTH
from gcs_sysid.model import rigid_body as rb

SIZES: Mapping[str, tuple[float, ...]] = {
    "damping": (0.003, 0.01, 0.03, 0.1, 0.3, 1.0),
    "thrust": (0.001, 0.003, 0.01, 0.03, 0.1),
    "torque": (0.003, 0.01, 0.03, 0.1, 0.3, 1.0),
}
"""Standard deviations that are tried: of damping in moments of inertia per second, of thrust and
torque relative to the mean over the rotors."""
_HIDDEN = 0.01
"""Of thrust, of four rotors."""
AXIS_DAMPING = 0.3
"""1/s, of an axis' damping about the mean, in moments of inertia: inflow and flapping damp roll and
pitch of multirotors by 0.1 to 0.5, and hardly yaw."""
OF_AXES = np.zeros((3, 3, rb.N_SIGNALS))
"""What the damping of each axis adds to B of J w' = B x."""
for _axis, _rate in enumerate("pqr"):
    OF_AXES[_axis, _axis, rb.SIGNALS.index(_rate)] = -1.0
SURE = 3.0
"""Nats of evidence from which a kind of deviation is included."""
N_X, _AXES = rb.N_SIGNALS, 3
_COLUMN = {name: i for i, name in enumerate(rb.SIGNALS)}
_RATES = np.array([[_COLUMN[name]] for name in "pqr"])
_MOMENTUM = np.array([[_COLUMN["pH"]], [_COLUMN["qH"]]])
_FIRST, _SECOND = np.array([(1, 2), (2, 0), (0, 1), (0, 0), (1, 1), (2, 2)]).T
_PRODUCTS = _COLUMN["qr"] + np.arange(len(_FIRST))[:, None]
"""Columns of the products of these two rates."""
_BOTH = _FIRST != _SECOND
_CROSS = np.array(
    [[[0, 0, 0], [0, 0, 1], [0, -1, 0]], [[0, 0, -1], [0, 0, 0], [1, 0, 0]],
     [[0, 1, 0], [-1, 0, 0], [0, 0, 0]]], float
)  # fmt: skip
"""Body rates as read by an IMU rotated about each axis, to first order: w - turn x w."""


@dataclass(frozen=True, eq=False)
class Deviations:
    """Nuisance parameters of a fit.

    Attributes:
        torques: (m, 3, N_SIGNALS) B_k; zeros of a turn.
        std: (m,) of their prior; infinite: only the data limit them.
        thrusts: (m, rotors) change of each rotor's thrust coefficient, relative.
        ratios: (m, rotors) change of each rotor's torque over the mean thrust coefficient, m.
        dampings: (m, 3) change of the damping of each axis.
        turns: (m, 3) rotation vector of the IMU about roll, pitch and yaw, rad.
        places: (m, 2, rotors) by which rotors are off, m.
        sized: (m,) whether std is given or, with speeds, that of most evidence; with commands the
            others' is no more than usual.
        shown: kinds (of `SIZES`) that the flight shows; others are only allowed for.
    """

    torques: Array
    std: Array
    thrusts: Array
    ratios: Array
    dampings: Array
    turns: Array
    places: Array
    sized: Mask
    shown: frozenset[str] = frozenset(SIZES)

    @cached_property
    def information(self) -> Array:
        """(m,) of the prior."""
        return self.std**-2.0

    @property
    def effects(self) -> Array:
        """(m, 3 N_SIGNALS + 3) torque and turn of each."""
        return np.column_stack([self.torques.reshape(len(self.std), 3 * N_X), self.turns])

    @cached_property
    def _turning(self) -> bool:
        return bool(self.turns.any())

    @cached_property
    def _flat(self) -> Array:
        return self.torques.reshape(len(self.std), 3 * N_X)

    def doing(self, phi: Array, others: "Deviations") -> Array:
        """(m,) of these that do what (k,) of others do, as nearly as they can."""
        return np.linalg.lstsq(self.effects.T, phi @ others.effects, rcond=None)[0]

    def torque(self, phi: Array) -> Array:
        """(..., 3, N_SIGNALS) that (..., m) deviations add to B of J w' = B x."""
        return (phi @ self._flat).reshape(*phi.shape[:-1], 3, N_X)

    def forward(self, theta: Array, phi: Array) -> Array:
        """(..., 3, N_SIGNALS) Q of w' = Q x, both as the IMU reads them.

        Args:
            theta: (..., N_THETA or more).
            phi: (..., m).
        """
        Q = rb.forward_matrix(theta[..., : rb.N_THETA], self.torque(phi))
        if not self._turning:
            return Q
        R = rotation_by(phi @ self.turns)[0]
        return R @ Q @ _back(R)

    def jacobian(self, theta: Array, phi: Array) -> tuple[Array, Array]:
        """That Q and its derivatives by theta and phi, (..., N_THETA + m, 3, N_SIGNALS)."""
        Q, G = rb.forward_jacobian(theta[..., : rb.N_THETA], self.torque(phi), self.torques)
        if not self._turning:
            return Q, G
        R, after = rotation_by(phi @ self.turns)
        back = _back(R)
        Q, G = R @ Q @ back, R[..., None, :, :] @ G @ back[..., None, :, :]
        by_turn = missed_by(PER_TURN, Q[..., None, :, :])
        along = self.turns @ np.swapaxes(after, -1, -2)
        by_phi = along @ by_turn.reshape(*by_turn.shape[:-2], -1)
        G[..., rb.N_THETA :, :, :] += by_phi.reshape(*by_phi.shape[:-1], 3, N_X)
        return Q, G

    def like(self, other: "Deviations") -> bool:
        """Whether they are the same, of the same size, and torques differ by next to nothing."""
        return np.array_equal(self.std, other.std) and np.allclose(
            self.torques, other.torques, atol=_SAME * np.abs(self.torques).max(initial=0.0)
        )


_SAME = 1e-3
NO_DEVIATIONS = Deviations(
    np.zeros((0, 3, rb.N_SIGNALS)),
    np.zeros(0),
    np.zeros((0, 0)),
    np.zeros((0, 0)),
    np.zeros((0, 3)),
    np.zeros((0, 3)),
    np.zeros((0, 2, 0)),
    np.zeros(0, dtype=bool),
    shown=frozenset(),
)


class DeviationChoice:
    """Which kinds of deviations a flight shows, and of what size.

    Args:
        geometry: (3, rotors) of the airframe.
        commands: whether commands are the input: yaw then carries little information on its
            damping, and evidence counts beyond what is usual.
        place: m, standard deviation of each rotor's x and y by itself.
        turn: rad, standard deviation of the IMU's rotation about each axis.
    """

    def __init__(
        self, geometry: Array, *, commands: bool = False, place: float = 0.0, turn: float = 0.0
    ) -> None:
        self._geometry = geometry
        self._least = (AXIS_DAMPING if commands else 0.0, 0.0, 0.0)
        self._commands = np.bool_(commands)
        rotors = geometry.shape[1]
        self._signal = np.linalg.pinv(rb.mixer(geometry))
        """(4, rotors) of O in the four signals."""
        # Orthonormal contrasts, so that their standard deviation is that of a rotor.
        self._contrasts = np.linalg.svd(np.ones((1, rotors)))[2][1:]
        self._kind = np.repeat(np.arange(3), [3, rotors - 1, rotors - 1])
        ways = _misplaced(geometry, self._signal)
        self._misplaced, self._places = (place * way if place else way[:0] for way in ways)
        self._turn = turn
        more = rotors > len(self._signal)
        self._hidden = max(SIZES["thrust"]) if more else _HIDDEN
        """Size of thrust that comes in with torque, at most."""

    @cached_property
    def older(self) -> Array:
        """(rotors - 1, 4, 4) what rotors read later than the others do to the four signals, of
        these differentiated by a delay of all.
        """
        own = self._signal.T[:, None, :] * rb.mixer(self._geometry)[:, :, None]
        return np.tensordot(self._contrasts, own, 1)

    def of_rotors(self, contrasts: Array) -> Array:
        """(rotors,) whose mean is zero, of (rotors - 1,) as those of `older`."""
        apart: Array = contrasts @ self._contrasts
        return apart

    @property
    def has_given(self) -> bool:
        """Whether rotors or IMU may not be where they are given."""
        return bool(self._turn) or len(self._places) > 0

    @cached_property
    def given(self) -> Deviations:
        """Of what is given, in its standard deviations."""
        axes = np.eye(3) if self._turn else np.zeros((0, 3))
        torques = np.concatenate([self._misplaced, np.zeros((len(axes), 3, N_X))])
        n, places = len(torques), len(self._places)
        none = np.zeros((n, self._geometry.shape[1]))
        about = np.concatenate([np.zeros((places, 3)), self._turn * axes])
        off = np.concatenate([self._places, np.zeros((len(axes), 2, none.shape[1]))])
        every = np.ones(n, dtype=bool)
        return Deviations(
            torques, np.ones(n), none, none, np.zeros((n, 3)), about, off, every, frozenset()
        )

    def every(self, unknowns: Array) -> Deviations:
        """All of them, those not given limited by the data alone.

        Thrust acts about the CG of (N_UNKNOWNS,) unknowns.
        """
        x, y, s = self._geometry
        rotors = len(s)
        torques = np.zeros((3 + 2 * rotors, 3, rb.N_SIGNALS))
        torques[:3] = OF_AXES
        torques[3 : 3 + rotors, 0, :4] = ((unknowns[rb.CG_Y] - y) * self._signal).T
        torques[3 : 3 + rotors, 1, :4] = ((x - unknowns[rb.CG_X]) * self._signal).T
        torques[3 + rotors :, 2, :4] = (s * self._signal).T
        thrusts, ratios = np.zeros((2, len(self._kind), rotors))
        thrusts[self._kind == _THRUST] = self._contrasts
        ratios[self._kind == _TORQUE] = self._contrasts
        per_rotor = (torques[3 : 3 + rotors], torques[3 + rotors :])
        given, kinds = self.given, len(self._kind)
        return Deviations(
            np.concatenate(
                [
                    torques[:3],
                    *(np.tensordot(self._contrasts, t, 1) for t in per_rotor),
                    given.torques,
                ]
            ),
            np.concatenate([np.full(kinds, np.inf), given.std]),
            np.concatenate([thrusts, given.thrusts]),
            np.concatenate([ratios, given.ratios]),
            np.concatenate([np.eye(kinds, 3), given.dampings]),
            np.concatenate([np.zeros((kinds, 3)), given.turns]),
            np.concatenate([np.zeros((kinds, 2, rotors)), given.places]),
            np.concatenate([np.zeros(kinds, dtype=bool), given.sized]),
        )

    def shares(self, unknowns: Array) -> Array:
        """(rotors,) of thrust at hover, where it acts at the CG of a (N_UNKNOWNS,) fit."""
        trim = np.array([-unknowns[rb.CG_Y], unknowns[rb.CG_X], 1.0, 0.0])
        return trim @ self._signal

    def _units(self, unknowns: Array) -> Array:
        """(m,) of what sizes are shares of, then standard deviations of what is given."""
        kinds = self._kind
        return np.concatenate(
            [
                np.abs(unknowns[rb.MOMENTS]),
                np.ones((kinds == _THRUST).sum()),
                np.full((kinds == _TORQUE).sum(), max(abs(float(unknowns[rb.MOMENT_RATIO])), 1e-6)),
                self.given.std,
            ]
        )

    def largest(self, unknowns: Array) -> Array:
        """(m,) the largest standard deviations that are tried, or given."""
        largest = np.array([max(sizes) for sizes in SIZES.values()])[self._kind]
        return self._units(unknowns) * np.append(largest, np.ones(len(self.given.std)))

    def choose(
        self, every: Deviations, unknowns: Array, score: Array, information: Array
    ) -> Deviations:
        """Those with evidence, and those given.

        Args:
            every: of them.
            unknowns: (N_UNKNOWNS,) of a fit without them, or with some.
            score: (m,) gradient of the log likelihood by `every` at phi = 0, the others
                marginalized.
            information: (m, m) of the same.
        """
        kinds = self._kind
        units = self._units(unknowns)
        given = units[len(kinds) :]
        g, H = score * units, information * np.outer(units, units)
        found, last = list(self._least), np.ones(len(given))

        def stds(sizes: list[float]) -> Array:
            damping, thrust, torque = sizes
            allowed = max(thrust, min(torque, self._hidden))
            return np.concatenate([np.array([damping, allowed, torque])[kinds], last])

        best = evidence_for(g, H, stds(found))
        for _ in range(3):
            before = list(found)
            for kind, tried in enumerate(SIZES.values()):
                least = self._least[kind]
                for size in (least, *(size for size in tried if size > least)):
                    sizes = [*found[:kind], size, *found[kind + 1 :]]
                    evidence = evidence_for(g, H, stds(sizes))
                    evidence -= SURE * np.count_nonzero(np.greater(sizes, self._least))
                    if evidence > best:
                        best, found = evidence, sizes
            if found == before:
                break
        std = stds([max(found[0], AXIS_DAMPING), *found[1:]]) * units
        use = std > 0.0
        return Deviations(
            every.torques[use],
            std[use],
            every.thrusts[use],
            every.ratios[use],
            every.dampings[use],
            every.turns[use],
            every.places[use],
            (every.sized | ~self._commands)[use],
            frozenset(
                name
                for name, size, least in zip(SIZES, found, self._least, strict=True)
                if size > least
            ),
        )


_THRUST, _TORQUE = 1, 2


def _misplaced(geometry: Array, signal: Array) -> tuple[Array, Array]:
    """Of rotors that are off by a meter, in all ways that count.

    A common shift and a common scale do not. Of the others the four signals show at most five
    apart.

    Args:
        geometry: (3, rotors).
        signal: (4, rotors) of each rotor's O in the four signals.

    Returns:
        (m, 3, N_SIGNALS) torques, and (m, 2, rotors) by how much in x and y.
    """
    places, rotors = geometry[:2], geometry.shape[1]
    centered = places - places.mean(axis=1, keepdims=True)
    common = np.stack([np.repeat([1.0, 0.0], rotors), np.repeat([0.0, 1.0], rotors),
                       centered.ravel()])  # fmt: skip
    ways = np.linalg.svd(common)[2][len(common) :].reshape(-1, 2, rotors)  # the null space
    x, y = np.swapaxes(ways @ signal.T, 0, 1)  # (ways, 4) each
    mix, sizes, apart = np.linalg.svd(np.concatenate([-y, x], axis=1), full_matrices=False)
    seen = sizes > 1e-9 * sizes[0]
    torques = np.zeros((int(seen.sum()), 3, rb.N_SIGNALS))
    torques[:, :2, :4] = (sizes[seen, None] * apart[seen]).reshape(-1, 2, 4)
    return torques, np.tensordot(mix.T[seen], ways, 1)


def evidence_for(g: Array, H: Array, std: Array) -> float:
    """Nats for deviations of (m,) sizes over none, given score and information."""
    use = std > 0.0
    if not use.any():
        return 0.0
    S = std[use]
    values, vectors = np.linalg.eigh(S[:, None] * H[np.ix_(use, use)] * S)
    values = np.maximum(values, 0.0)
    along = vectors.T @ (S * g[use])
    return 0.5 * float(np.sum(along**2 / (1.0 + values) - np.log1p(values)))


def rotation_by(turn: Array) -> tuple[Array, Array]:
    """Of an IMU that is turned by (..., 3) rad.

    Returns:
        (..., 3, 3) R of rates R w that it reads of w, and A, the left Jacobian of rotations: where
        d is added to the turn, the small turn A d follows it. A to fourth order in the turn.
    """
    first = (turn @ _CROSS.reshape(3, 9)).reshape(*turn.shape[:-1], 3, 3)
    second = first @ first
    square = (turn * turn).sum(axis=-1)[..., None, None]
    size = np.sqrt(square) + 1e-9
    rise, bend = np.sin(size) / size, 2.0 * (np.sin(0.5 * size) / size) ** 2
    R = np.eye(_AXES) + rise * first + bend * second
    return R, np.eye(_AXES) + bend * first + (1.0 / 6.0 - square / 120.0) * second


def _back(R: Array) -> Array:
    """(..., N_SIGNALS, N_SIGNALS) what makes the body's signals of those read."""
    return turned(np.swapaxes(R, -1, -2))[..., :N_X, :N_X]


def turned(R: Array) -> Array:
    """(..., WIDTH, WIDTH) what becomes of a row where rates are R times what they were."""
    out = np.zeros((*R.shape[:-2], WIDTH, WIDTH))
    out[...] = np.eye(WIDTH)
    out[..., _RATES, _RATES.T] = out[..., N_X:, N_X:] = R
    out[..., _PRODUCTS, _PRODUCTS.T] = (
        R[..., _FIRST[:, None], _FIRST] * R[..., _SECOND[:, None], _SECOND]
        + _BOTH * R[..., _FIRST[:, None], _SECOND] * R[..., _SECOND[:, None], _FIRST]
    )
    # r H is not among the signals; rotors' angular momentum is small.
    out[..., _MOMENTUM, _MOMENTUM.T] = R[..., :2, :2]
    return out


# The map is of second order in R, so that this difference is its derivative.
PER_TURN = np.stack([0.5 * (turned(np.eye(_AXES) + E) - turned(np.eye(_AXES) - E)) for E in _CROSS])
"""(3, WIDTH, WIDTH) what a rad about each axis does to a row, to first order."""


def missed_by(L: Array, Q: Array) -> Array:
    """(..., 3, N_X) D of residual = D x, where rows are off by (..., WIDTH, WIDTH) L.

    x = (1 + L) x_true, w' = (1 + E) w'_true, E the part of L for w':  D = E Q - Q L
    """
    return L[..., N_X:, N_X:] @ Q - Q @ L[..., :N_X, :N_X]
