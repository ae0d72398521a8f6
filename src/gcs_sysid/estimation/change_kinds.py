"""What a detected change was: a rotor that lost thrust, or the body (mass, CG, inertia).

Two looks. Shortly after the detection, the residuals of the old reference tell a failing rotor
from a changed body: one number, the lost share of one rotor's thrust and torque, then explains
all four residuals at once. Later, the fits before and after say what changed, by how much, and
how certainly.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.parameters import INERTIA, grouped

Kind = Literal["mass_change", "payload", "cg_shift", "inertia_change", "rotor_failure", "change"]
CauseKind = Literal[
    "mass_change", "payload", "cg_shift", "inertia_change", "rotor_failure", "passing", "change"
]

_Z95 = 1.959964
_SURE = 3.0
"""Standard deviations of a difference that names the kind."""
_INDEPENDENT = 0.25
"""Share of the residuals that counts as independent: they are coloured."""
_MIN_CG = 0.002
"""m, smallest shift that is called one from a fraction of a second."""


@dataclass(frozen=True)
class Cause:
    """What explains the residuals after a detection best.

    Attributes:
        kind: "passing" when there is nothing left of the jump.
        rotor: index of the failing rotor, else None.
        loss: share of its thrust that is gone, else 0.
        loss_std: of the loss.
        mass_ratio: mass after over mass before, were it the mass.
        cg_shift: m, forward and right.
        explained: share of the residuals' weighted square that the cause explains.
    """

    kind: CauseKind
    rotor: int | None
    loss: float
    loss_std: float
    mass_ratio: float
    cg_shift: tuple[float, float]
    explained: float


class Evidence:
    """Residuals after a detection, with what the hypotheses need.

    Args:
        geometry: (3, rotors).
        Q: (3, N_SIGNALS) of the reference; NaN rows where an axis is not watched.
        kappa: k_T / m of the reference; NaN when thrust is not watched.
        std: (4,) noise levels of the thrust and the three angular residuals; inf: unknown.
    """

    def __init__(self, geometry: Array, Q: Array, kappa: float, std: Array) -> None:
        self.geometry, self.Q, self.kappa, self.std = geometry, Q, kappa, std
        self._e: list[Array] = []
        self._x: list[Array] = []
        self._squares: list[Array] = []

    def __len__(self) -> int:
        return sum(map(len, self._e))

    def add(self, e: Array, x: Array, squares: Array) -> None:
        """Take (n, 4) residuals, (n, N_SIGNALS) inputs, (n, rotors) squared speeds."""
        self._e.append(e)
        self._x.append(x)
        self._squares.append(squares)

    def arrays(self) -> tuple[Array, Array, Array]:
        """All taken so far."""
        return np.concatenate(self._e), np.concatenate(self._x), np.concatenate(self._squares)


def find_cause(evidence: Evidence) -> Cause | None:
    """The hypothesis that explains the residuals best (Bayes' information criterion).

    Returns:
        None when there is not enough left to tell.
    """
    e, x, squares = evidence.arrays()
    Q, kappa = np.nan_to_num(evidence.Q), np.nan_to_num(evidence.kappa)
    watched = np.append(np.isfinite(evidence.kappa), np.isfinite(evidence.Q).all(axis=1))
    watched &= np.isfinite(evidence.std)
    rows = np.isfinite(e[:, watched]).all(axis=1)
    if rows.sum() < 4 or not watched.any():
        return None
    e, x, squares = e[rows], x[rows], squares[rows]
    scale = watched / np.where(watched, evidence.std, 1.0)
    target = (np.nan_to_num(e) * scale).ravel()
    weight = _INDEPENDENT

    def fit(columns: Array) -> tuple[Array, Array, float]:
        """Estimates, standard deviations and remaining weighted square of (n, 4, p) columns."""
        A = (columns * scale[:, None]).reshape(len(target), -1)
        normal = weight * A.T @ A
        d = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        inverse = np.linalg.inv(normal / np.outer(d, d) + 1e-9 * np.eye(len(d)))
        value = inverse @ (weight * A.T @ target / d) / d
        left = target - A @ value
        return value, np.sqrt(np.diag(inverse)) / d, weight * float(left @ left)

    whole = weight * float(target @ target)
    penalty = float(np.log(max(weight * len(e), 2.0)))
    values, std, left = fit(_body_columns(Q, x))
    relative = values[0] / max(kappa, 1e-300)  # (kappa - kappa') / kappa = 1 - m / m'
    mass_ratio = 1.0 / max(1.0 - relative, 0.1)
    # With inertia g times as large, J'^-1 = J^-1 / g: the inertia's column has 1/g - 1.
    shrunk = max(1.0 + values[3], 0.1)
    shift = (float(values[1] / shrunk), float(values[2] / shrunk))
    body = left + 4.0 * penalty
    losses = [
        fit(_rotor_columns(evidence.geometry[:, i], Q, kappa, squares[:, i]))
        for i in range(squares.shape[1])
    ]
    i = int(np.argmin([part[2] for part in losses]))
    loss, loss_std, rotor_left = float(losses[i][0][0]), float(losses[i][1][0]), losses[i][2]
    second = e[len(e) // 2 :]
    gone = np.abs(np.nan_to_num(np.median(second, axis=0)) * scale).max() < 1.0
    if gone and whole < 3.0 * weight * len(target):
        return Cause("passing", None, 0.0, 0.0, 1.0, (0.0, 0.0), 0.0)
    if rotor_left + penalty < body and loss > 0.01 and watched.sum() > 1:
        return Cause("rotor_failure", i, loss, loss_std, 1.0, (0.0, 0.0), 1.0 - rotor_left / whole)
    mass = abs(values[0]) > _SURE * std[0] and abs(relative) > 0.01
    moved = any(
        abs(v) > max(_SURE * s, _MIN_CG) for v, s in zip(values[1:3], std[1:3], strict=True)
    )
    inertia = abs(values[3]) > max(_SURE * std[3], 0.03)
    # Thrust alone cannot tell a heavier vehicle from a weaker rotor.
    kind = _kind_of(mass, moved, inertia) if watched[1:3].all() else "change"
    return Cause(kind, None, 0.0, 0.0, float(mass_ratio), shift, 1.0 - left / whole)


def describe(
    before: Mapping[str, tuple[float | None, float | None]],
    after: Mapping[str, tuple[float | None, float | None]],
    cause: Cause | None = None,
) -> dict[str, Any]:
    """The event of a change, from the estimates on both sides of it.

    Args:
        before: value and standard deviation by parameter name; None where there is none.
        after: the same of the estimate that began after the change, at the scale of unchanged
            rotors (k_T given).
        cause: what the detector said of it; a failing rotor is taken from there.

    Returns:
        {"kind": ..., "parameters": {name: {before, after, difference, ci95}}}, the parameters
        being those that both know, and for a failing rotor {"rotor": index, "loss": ...} too.
    """
    parameters: dict[str, dict[str, Any]] = {}
    changed = set()
    for name, (old, old_std) in before.items():
        new, new_std = after.get(name, (None, None))
        if old is None or new is None or old_std is None or new_std is None:
            continue
        difference, std = new - old, float(np.hypot(old_std, new_std))
        if not np.isfinite(std):
            continue
        parameters[name] = {
            "before": old,
            "after": new,
            "difference": difference,
            "ci95": [difference - _Z95 * std, difference + _Z95 * std],
        }
        if abs(difference) > max(_SURE * std, 0.01 * abs(old)):
            changed.add(name)
    kind: str = _kind_of(
        "mass" in changed,
        not changed.isdisjoint(grouped("center of gravity")),
        not changed.isdisjoint(INERTIA),
    )
    event: dict[str, Any] = {"kind": kind, "parameters": parameters}
    if cause is not None and cause.kind == "rotor_failure":
        half = _Z95 * cause.loss_std
        event["kind"] = "rotor_failure"
        event["rotor"] = cause.rotor
        event["loss"] = {"value": cause.loss, "ci95": [cause.loss - half, cause.loss + half]}
    return event


def _kind_of(mass: bool, cg: bool, inertia: bool) -> Kind:
    if mass:
        return "payload" if cg or inertia else "mass_change"
    if cg:
        return "cg_shift"
    return "inertia_change" if inertia else "change"


def _body_columns(Q: Array, x: Array) -> Array:
    """(n, 4, 4) what a change of 1/m, of the CG (forward, right) and of all inertia leaves."""
    total = x[:, _THRUST]
    columns = np.zeros((len(x), 4, 4))
    columns[:, 0, 0] = total
    # J w' = ... + cg_y T about x, - cg_x T about y; Q's first two columns are those of J^-1.
    columns[:, 1:, 1] = -total[:, None] * Q[:, 1]
    columns[:, 1:, 2] = total[:, None] * Q[:, 0]
    columns[:, 1:, 3] = x @ Q.T
    return columns


def _rotor_columns(place: Array, Q: Array, kappa: float, square: Array) -> Array:
    """(n, 4, 1) what the loss of all thrust of one rotor leaves."""
    x, y, spin = place
    columns = np.zeros((len(square), 4, 1))
    columns[:, 0, 0] = kappa * square
    columns[:, 1:, 0] = -square[:, None] * (Q[:, :4] @ np.array([-y, x, 1.0, spin]))
    return columns


_THRUST = rb.SIGNALS.index("thrust")
