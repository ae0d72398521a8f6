"""Deviations from the model: damping per axis, unequal rotors, a turned IMU.

    J w' + w x (J w + h) + h' = M + sum_k phi_k B_k x

with B_k one deviation's torque by axis and signal:

    damping     -d_a w_a on each axis a beside the damping that all share
    thrust      k_T of rotor i is (1 + e_i) of the mean: torque e_i (-y_i, x_i) O_i
    torque      k_M of rotor i is off the mean by c_i: yaw torque c_i s_i O_i

e and c sum to zero, as their means are k_T and k_M themselves. An allocation of full rank drives
the rotors' O = Omega^2 within the span of roll, pitch, thrust and yaw, so that O_i is a
combination of these four signals: the pseudo-inverse of the mixer (exact for four rotors).

Deviations are nuisance parameters: of each kind the size is unknown, phi ~ N(0, sigma^2). With g
and H the score and information of phi at phi = 0, the other unknowns marginalized, the evidence
for sigma is

    ln p(data | sigma) - ln p(data | 0) = (g' (H + sigma^-2)^-1 g - ln det(1 + sigma H sigma)) / 2

(empirical Bayes). A kind without evidence stays out: undisturbed flights of equal rotors lose
nothing by it. On commands, yaw carries little information on its damping, and on k_M only at low
frequency, where damping matters: there damping by axis is always an unknown, with a size typical of
multirotors, since without it moment_ratio was up to 9 % too large with no evidence of it.

An IMU turned by a degree looks much like rotors of unequal torque: roll and pitch motion then shows
in yaw. It is no deviation of the vehicle (`given_errors` looks for it), but it competes:
its evidence comes first.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.rows.actuator_dynamics import WIDTH
from gcs_sysid.model import rigid_body as rb

SIZES: Mapping[str, tuple[float, ...]] = {
    "damping": (0.003, 0.01, 0.03, 0.1, 0.3, 1.0),
    "thrust": (0.001, 0.003, 0.01, 0.03, 0.1),
    "torque": (0.003, 0.01, 0.03, 0.1, 0.3, 1.0),
}
"""Standard deviations that are tried: of damping in moments of inertia per second, of thrust and
torque relative to the mean over the rotors."""
AXIS_DAMPING = 0.3
"""1/s, of an axis' damping about the mean, in moments of inertia: inflow and flapping damp roll and
pitch of multirotors by 0.1 to 0.5, and hardly yaw."""
SURE = 3.0
"""Nats of evidence from which a kind of deviation is included."""
TURN = math.radians(1.0)
"""rad, standard deviation of the IMU's rotation, whatever is given."""
N_X, _AXES = rb.N_SIGNALS, 3
_COLUMN = {name: i for i, name in enumerate(rb.SIGNALS)}
_RATES = [_COLUMN[name] for name in "pqr"]
_MOMENTUM = [_COLUMN["pH"], _COLUMN["qH"]]
_PAIRS = [(1, 2), (2, 0), (0, 1), (0, 0), (1, 1), (2, 2)]
_PRODUCT = {frozenset(pair): _COLUMN["qr"] + i for i, pair in enumerate(_PAIRS)}
"""Column of the product of two rates."""
_CROSS = np.array(
    [[[0, 0, 0], [0, 0, 1], [0, -1, 0]], [[0, 0, -1], [0, 0, 0], [1, 0, 0]],
     [[0, 1, 0], [-1, 0, 0], [0, 0, 0]]], float
)  # fmt: skip
"""Body rates as read by an IMU rotated about each axis, to first order: w - turn x w."""


@dataclass(frozen=True, eq=False)
class Deviations:
    """Nuisance parameters of a fit.

    Attributes:
        torques: (m, 3, N_SIGNALS) B_k.
        std: (m,) of their prior; infinite: only the data limit them.
        thrusts: (m, rotors) change of each rotor's thrust coefficient, relative.
        ratios: (m, rotors) change of each rotor's torque over the mean thrust coefficient, m.
        dampings: (m, 3) change of the damping of each axis.
        shown: kinds (of `SIZES`) that the flight shows; others are only allowed for.
    """

    torques: Array
    std: Array
    thrusts: Array
    ratios: Array
    dampings: Array
    shown: frozenset[str] = frozenset(SIZES)

    @cached_property
    def information(self) -> Array:
        """(m,) of the prior."""
        return self.std**-2.0

    def torque(self, phi: Array) -> Array:
        """(..., 3, N_SIGNALS) that (..., m) deviations add to B of J w' = B x."""
        return np.tensordot(phi, self.torques, 1)

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
    shown=frozenset(),
)


class DeviationChoice:
    """Which kinds of deviations a flight shows, and of what size.

    Args:
        geometry: (3, rotors) of the airframe.
        commands: whether commands are the input, and damping by axis always allowed for.
    """

    def __init__(self, geometry: Array, *, commands: bool = False) -> None:
        self._geometry = geometry
        self._least = (AXIS_DAMPING if commands else 0.0, 0.0, 0.0)
        rotors = geometry.shape[1]
        self._signal = np.linalg.pinv(rb.mixer(geometry))
        """(4, rotors) of O in the four signals."""
        # Orthonormal contrasts, so that their standard deviation is that of a rotor.
        self._contrasts = np.linalg.svd(np.ones((1, rotors)))[2][1:]
        self._kind = np.repeat(np.arange(3), [3, rotors - 1, rotors - 1])

    @cached_property
    def older(self) -> Array:
        """(rotors - 1, 4, 4) what rotors read later than the others do to the four signals, of
        these differentiated by a delay of all.
        """
        own = self._signal.T[:, None, :] * rb.mixer(self._geometry)[:, :, None]
        return np.tensordot(self._contrasts, own, 1)

    def every(self, unknowns: Array) -> Deviations:
        """All of them, limited by the data alone; thrust acts about the CG of (N_UNKNOWNS,)."""
        x, y, s = self._geometry
        rotors = len(s)
        torques = np.zeros((3 + 2 * rotors, 3, rb.N_SIGNALS))
        for axis, rate in enumerate("pqr"):
            torques[axis, axis, rb.SIGNALS.index(rate)] = -1.0
        torques[3 : 3 + rotors, 0, :4] = ((unknowns[rb.CG_Y] - y) * self._signal).T
        torques[3 : 3 + rotors, 1, :4] = ((x - unknowns[rb.CG_X]) * self._signal).T
        torques[3 + rotors :, 2, :4] = (s * self._signal).T
        thrusts, ratios = np.zeros((2, len(self._kind), rotors))
        thrusts[self._kind == _THRUST] = self._contrasts
        ratios[self._kind == _TORQUE] = self._contrasts
        per_rotor = (torques[3 : 3 + rotors], torques[3 + rotors :])
        return Deviations(
            np.concatenate(
                [torques[:3], *(np.tensordot(self._contrasts, t, 1) for t in per_rotor)]
            ),
            np.full(len(self._kind), np.inf),
            thrusts,
            ratios,
            np.eye(len(self._kind), 3),
        )

    def with_turns(self, every: Deviations, unknowns: Array) -> Deviations:
        """The same and, last, what an IMU turned about roll, pitch and yaw looks like, by rad."""
        theta = unknowns[: rb.N_THETA]
        turns = rb.inertia_matrix(theta) @ missed_by(PER_TURN, rb.forward_matrix(theta))
        none = np.zeros((len(turns), every.thrusts.shape[1]))
        return Deviations(
            np.concatenate([every.torques, turns]),
            np.concatenate([every.std, np.full(len(turns), np.inf)]),
            np.concatenate([every.thrusts, none]),
            np.concatenate([every.ratios, none]),
            np.concatenate([every.dampings, np.zeros((len(turns), 3))]),
        )

    def shares(self, unknowns: Array) -> Array:
        """(rotors,) of thrust at hover, where it acts at the CG of a (N_UNKNOWNS,) fit."""
        trim = np.array([-unknowns[rb.CG_Y], unknowns[rb.CG_X], 1.0, 0.0])
        return trim @ self._signal

    def choose(
        self, every: Deviations, unknowns: Array, score: Array, information: Array
    ) -> Deviations:
        """Those with evidence.

        Args:
            every: of them.
            unknowns: (N_UNKNOWNS,) of a fit without them, or with some.
            score: (m + k,) gradient of the log likelihood by `every` at phi = 0, the others
                marginalized; the last k are turns of the IMU that compete.
            information: (m + k, m + k) of the same.
        """
        kinds, turns = self._kind, len(score) - len(self._kind)
        units = np.concatenate(
            [
                np.abs(unknowns[rb.MOMENTS]),
                np.ones((kinds == _THRUST).sum()),
                np.full((kinds == _TORQUE).sum(), max(abs(float(unknowns[rb.MOMENT_RATIO])), 1e-6)),
                np.full(turns, TURN),
            ]
        )
        g, H = score * units, information * np.outer(units, units)
        found, last = list(self._least), np.ones(turns)
        best = evidence_for(g, H, np.concatenate([np.array(found)[kinds], last]))
        for _ in range(3):
            before = list(found)
            for kind, tried in enumerate(SIZES.values()):
                least = self._least[kind]
                for size in (least, *(size for size in tried if size > least)):
                    sizes = [*found[:kind], size, *found[kind + 1 :]]
                    evidence = evidence_for(g, H, np.concatenate([np.array(sizes)[kinds], last]))
                    evidence -= SURE * np.count_nonzero(np.greater(sizes, self._least))
                    if evidence > best:
                        best, found = evidence, sizes
            if found == before:
                break
        std = np.array(found)[kinds] * units[: len(kinds)]
        use = std > 0.0
        if not use.any():
            return NO_DEVIATIONS
        return Deviations(
            every.torques[use],
            std[use],
            every.thrusts[use],
            every.ratios[use],
            every.dampings[use],
            frozenset(
                name
                for name, size, least in zip(SIZES, found, self._least, strict=True)
                if size > least
            ),
        )


_THRUST, _TORQUE = 1, 2


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


def turned(R: Array) -> Array:
    """(WIDTH, WIDTH) what becomes of a row where rates are R times what they were, (3, 3)."""
    out = np.eye(WIDTH)
    out[np.ix_(_RATES, _RATES)] = out[N_X:, N_X:] = R
    for i, j in _PAIRS:
        own = out[_PRODUCT[frozenset((i, j))]]
        own[:] = 0.0
        for k in range(_AXES):
            for m in range(_AXES):
                own[_PRODUCT[frozenset((k, m))]] += R[i, k] * R[j, m]
    # r H is not among the signals; rotors' angular momentum is small.
    out[np.ix_(_MOMENTUM, _MOMENTUM)] = R[:2, :2]
    return out


def rotation_of(turns: Array) -> Array:
    """(3, 3) of (3,) rad about roll, pitch and yaw, by Cayley's transform."""
    K = np.tensordot(turns, _CROSS, 1)
    return np.linalg.solve(np.eye(_AXES) + 0.5 * K, np.eye(_AXES) - 0.5 * K)


# The map is of second order in R, so that this difference is its derivative.
PER_TURN = np.stack([0.5 * (turned(np.eye(_AXES) + E) - turned(np.eye(_AXES) - E)) for E in _CROSS])
"""(3, WIDTH, WIDTH) what a rad about each axis does to a row, to first order."""


def missed_by(L: Array, Q: Array) -> Array:
    """(..., 3, N_X) D of residual = D x, where rows are off by (..., WIDTH, WIDTH) L.

    x = (1 + L) x_true, w' = (1 + E) w'_true, E the part of L for w':  D = E Q - Q L
    """
    return L[..., N_X:, N_X:] @ Q - Q @ L[..., :N_X, :N_X]
