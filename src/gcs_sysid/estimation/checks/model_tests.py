"""Is the vehicle what the model takes it for: a rigid body, with the rotors of the airframe file?

**A rigid body.** Izz and the rotors' torque share one scale, which only the gyroscopic torque w x J
w determines; products of inertia depend on it too. Where a vehicle (or its simulator) does not have
that torque, the fit bends Izz until there is none, explains nearly all of the motion, and is
confidently wrong. So the predicted torque is tested: what multiple of it is present, axis by axis,
with everything that rotors and damping could do left free? A rigid body gives 1.

**Its layout.** An autopilot allocates within the span of its own mixer M: the rotors' O = Omega^2
are t pinv(M) for signals t = [roll, pitch, thrust, yaw]. With the rotors in another order, O is
mixed with M', which gives t' = t pinv(M) M'. Under the hypothesis that M is another layout the true
signals follow from those seen, t = t' (pinv(M) M')^-1, and so do the moments of rows: no sample is
needed again.
"""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit.whitener_choice import explained_by
from gcs_sysid.estimation.noise.whitening import WhitenedMoments
from gcs_sysid.estimation.rows.actuator_dynamics import BODY, SIGNALS, ActuatorDynamics
from gcs_sysid.model import rigid_body as rb

PRODUCTS = [rb.SIGNALS.index(name) for name in ("qr", "rp", "pq", "pp", "qq", "rr")]
"""Columns of the products of rates, which the gyroscopic torque is made of."""
_OTHERS = np.setdiff1d(np.arange(rb.N_SIGNALS), PRODUCTS)
_OFF, _SURE = 0.3, 4.0
"""By how much, and how many standard deviations, a share must be off to count."""
_NONE = 1e-8
"""Share of an axis' acceleration that is negligible, of gyroscopic torque or unexplained."""
_ROUNDING = 1e-30
"""Of the largest input, what the square of one must exceed."""
LEAST_RATE = 0.1
"""rad/s rms of roll and pitch, below which the layout is not observable: a hover has noise and
vibration alone."""
_CONVINCING = 0.5
"""Share of the motion left unexplained, over the three axes' product, that another layout leaves of
it at most, while it leaves no axis its inverse: with rotors 2 and 8 of an octocopter exchanged the
right order leaves a ten thousandth, and 6 % more than that one in roll, which is noise there."""
_EQUAL = 0.01
"""By which logarithms of what is left differ where they say the same. How little is left says
nothing: with those rotors exchanged it was .2, .07 and 1.6 %."""
_WHITENERS = ("leak 0.3 s", "torque noise to 18 Hz", "moment to 4 Hz", "moment to 11 Hz")


@dataclass(frozen=True)
class RigidBodyTest:
    """Gyroscopic torque found, over that of the rigid body fitted.

    Attributes:
        share: (3,) per axis; NaN where none is predicted.
        std: (3,) standard deviations, from the scatter over the batches.
    """

    share: Array
    std: Array

    @property
    def contradicted(self) -> bool:
        """Whether it is surely not the rigid body's on some axis."""
        away = np.abs(self.share - 1.0)
        return bool(np.any((away > _OFF) & (away > _SURE * self.std)))


def judge_rigid_body(batches: Array, Q: Array) -> RigidBodyTest:
    """Compare the gyroscopic torque in the data with that of the fit.

    Args:
        batches: (k, 3, WIDTH, WIDTH) moments of rows [x, y], as each axis has them.
        Q: (3, N_SIGNALS) of the fit.
    """
    n = rb.N_SIGNALS
    share, std = np.full(3, np.nan), np.full(3, np.nan)
    for axis in range(3):
        own = batches[:, axis]
        total = own.sum(axis=0)
        predicted, residual = np.zeros(n + 3), np.zeros(n + 3)
        predicted[PRODUCTS] = Q[axis, PRODUCTS]
        residual[:n], residual[n + axis] = -Q[axis], 1.0
        power = predicted @ total @ predicted
        if not power > _NONE * total[n + axis, n + axis]:
            continue
        predicted, residual = (_apart(total, v) for v in (predicted, residual))
        power = float(predicted @ total @ predicted)
        if not power > _NONE**2 * total[n + axis, n + axis]:
            continue
        more = float(predicted @ total @ residual) / power
        # Neighboring batches share slow noise, as in the sandwich of the fit.
        scores = (own @ (residual - more * predicted)) @ predicted
        meat = float(scores @ scores + 2.0 * (scores[1:] @ scores[:-1]))
        share[axis] = 1.0 + more
        std[axis] = np.sqrt(max(meat, float(scores @ scores))) / power
    return RigidBodyTest(share, std)


def _apart(total: Array, combination: Array) -> Array:
    """A combination of columns without what all the other inputs explain of it."""
    moments = total[np.ix_(_OTHERS, _OTHERS)]
    diagonal = np.diag(moments)
    # Negligible columns are left unchanged: their share of anything is rounding.
    d = np.sqrt(np.where(diagonal > _ROUNDING * diagonal.max(initial=0.0), diagonal, 1.0))
    scaled = np.linalg.pinv(moments / np.outer(d, d), rcond=1e-10, hermitian=True)
    out: Array = combination.copy()
    out[_OTHERS] -= scaled @ (total[_OTHERS] @ combination / d) / d
    return out


def find_other_layout(
    data: WhitenedMoments, basis: ActuatorDynamics, geometry: Array
) -> str | None:
    """What is wrong with the layout, by the mistakes that are made: two rotors swapped, the frame
    turned.

    Args:
        data: moments of rows with the given layout.
        basis: of the elements.
        geometry: (3, rotors) given.
    """
    few = [i for i, w in enumerate(data.whiteners) if w.name in _WHITENERS or not data.of_steps]
    small = data.under(few).summed
    # Of the same rows: by others, gusts count for less or for more.
    own, found = _left(small, basis), []
    if (own - _least(small, basis)).sum() <= -np.log(_CONVINCING):
        return None
    for says, other in _mistakes(geometry):
        between = np.linalg.pinv(rb.mixer(other)) @ rb.mixer(geometry)
        if np.linalg.cond(between) > 1e6:
            continue
        gain = own - _left(_seen_as(small, basis, np.linalg.inv(between).T), basis)
        if gain.min() > np.log(_CONVINCING) and gain.sum() > -np.log(_CONVINCING):
            found.append((float(gain.sum()), says))
    best = max((gain for gain, _ in found), default=0.0)
    # Swapped within an allocation of full rank, two pairs of many rotors may look the same.
    return ", or ".join(says for gain, says in found if gain > best - _EQUAL) or None


def _left(data: WhitenedMoments, basis: ActuatorDynamics) -> Array:
    """(3,) logarithms of the shares of the motion that a fit leaves unexplained."""
    explained = explained_by(data, basis)
    if explained is None:
        return np.zeros(3)
    left: Array = np.log(np.clip(1.0 - explained, _NONE, 1.0))
    return left


def _least(data: WhitenedMoments, basis: ActuatorDynamics) -> Array:
    """(3,) as `_left`, of one batch, were each axis free to mix its signals: none leaves less."""
    total = data.parts[0][0][:, None]
    P = basis.maps(basis.nodes)[:, 0]
    moments = P @ total @ np.swapaxes(P, 1, 2)  # (bank, nodes, WIDTH, WIDTH)
    diagonal = np.diagonal(moments, axis1=2, axis2=3)
    d = np.sqrt(np.where(diagonal > _ROUNDING, diagonal, 1.0))
    r = moments / (d[..., None] * d[..., None, :])
    cross = r[..., :-3, -3:]
    mixed = np.linalg.pinv(r[..., :-3, :-3], rcond=_NONE, hermitian=True) @ cross
    explained = (cross * mixed).sum(axis=2).max(axis=(0, 1))
    left: Array = np.log(np.clip(1.0 - explained, _NONE, 1.0))
    return left


def _mistakes(geometry: Array) -> list[tuple[str, Array]]:
    """What may be the truth where (3, rotors) was given, and the words for it."""
    found = []
    for i, j in combinations(range(geometry.shape[1]), 2):
        order = np.arange(geometry.shape[1])
        order[[i, j]] = j, i
        found.append(
            (f"rotors {i + 1} and {j + 1} look swapped in the airframe file", geometry[:, order])
        )
    x, y, s = geometry
    turned = ((90, -y, x), (180, -x, -y), (270, y, -x))
    found += [
        (f"the airframe file looks turned by {angle} degrees", np.stack([a, b, s]))
        for angle, a, b in turned
    ]
    found.append(("the airframe file looks mirrored, left for right", np.stack([x, -y, s])))
    return found


def _seen_as(data: WhitenedMoments, basis: ActuatorDynamics, turn: Array) -> WhitenedMoments:
    """One batch with other rotor signals: (4, 4) `turn` times those of each element."""
    width = basis.width
    map_ = np.eye(width)
    for start in range(0, width - BODY, SIGNALS):
        map_[start : start + 4, start : start + 4] = turn
    seen = map_ @ data.parts[0] @ map_.T
    return replace(data, parts=(seen,), noise=map_ @ data.noise @ map_.T)
