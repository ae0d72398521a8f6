"""What a detected change was: a rotor that lost thrust, or the body (mass, CG, inertia).

Two looks. Shortly after an alarm, competing hypotheses (`change_hypotheses`) separate a failing
rotor from a changed body, and both from a disturbance. Later, the fits before and after give what
changed, by how much, and how certainly.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from gcs_sysid.model.parameters import INERTIA, grouped
from gcs_sysid.significance import interval95

Kind = Literal["mass_change", "payload", "cg_shift", "inertia_change", "rotor_failure", "change"]
CauseKind = Literal[
    "mass_change", "payload", "cg_shift", "inertia_change", "rotor_failure", "passing", "change"
]

Disturbance = Literal["contact", "thrust", "climb", "airspeed", "force", "moment"]
"""Contact with the ground; thrust far from the usual; climb or descent; forward flight; a force or
a moment, as of a gust."""

_SURE = 3.0
"""Standard deviations of a difference that names the kind."""


@dataclass(frozen=True)
class Cause:
    """What explains the residuals after a detection best.

    Attributes:
        kind: "passing" when the vehicle is what it was.
        rotor: index of the failing rotor, else None.
        loss: share of its thrust that is gone, else 0.
        loss_std: of the loss.
        mass_ratio: mass after over mass before, were it the mass.
        cg_shift: m, forward and right, at the inertia before.
        explained: likelihood over that of any force and moment.
        disturbance: of "passing", what passed.
        mass_std: of the mass ratio.
    """

    kind: CauseKind
    rotor: int | None
    loss: float
    loss_std: float
    mass_ratio: float
    cg_shift: tuple[float, float]
    explained: float
    disturbance: Disturbance | None = None
    mass_std: float = 0.0


def describe(
    before: Mapping[str, tuple[float | None, float | None]],
    after: Mapping[str, tuple[float | None, float | None]],
) -> dict[str, Any]:
    """The event of a change, from the estimates on both sides of it.

    Args:
        before: value and standard deviation by parameter name; None where there is none.
        after: the same of the estimate that began after the change, at the scale of unchanged
            rotors (k_T given).

    Returns:
        {"kind": ..., "parameters": {name: {before, after, difference, ci95}}}, the parameters
        being those that both know.
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
            "ci95": list(interval95(difference, std)),
        }
        if abs(difference) > max(_SURE * std, 0.01 * abs(old)):
            changed.add(name)
    kind: str = kind_of(
        "mass" in changed,
        not changed.isdisjoint(grouped("center of gravity")),
        not changed.isdisjoint(INERTIA),
    )
    return {"kind": kind, "parameters": parameters}


def kind_of(mass: bool, cg: bool, inertia: bool) -> Kind:
    """Of a changed body, by what changed."""
    if mass:
        return "payload" if cg or inertia else "mass_change"
    if cg:
        return "cg_shift"
    return "inertia_change" if inertia else "change"
