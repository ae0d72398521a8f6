"""How wide an interval is, against what.

A share of the value is what one asks for; but a product of inertia or an offset of the CG may be
zero. These are measured against themselves or, where they are smaller, against what they matter
to: a twentieth of the moments that a product couples, a twentieth of the arm.
"""

import math
from collections.abc import Mapping

from gcs_sysid.intervals import Z95
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import ARM, CORE_OF, REGISTRY
from gcs_sysid.model.rotor_input import RotorInput

_SMALL = 0.05


def shares(
    values: Mapping[str, Estimate], arm: float, rotor_input: RotorInput
) -> dict[str, float | None]:
    """Half of each 95 % interval over its reference value; None where nothing is known.

    Parameters that are given do not count, nor do those that only a vehicle with something beside
    a rigid body and rotors has (damping, rotor inertia, drag).
    """
    sizes = {name: entry.value or 0.0 for name, entry in values.items()} | {ARM: arm}
    out: dict[str, float | None] = {}
    for name in CORE_OF[rotor_input]:
        found = values[name]
        if found.std == 0.0:  # given
            continue
        if found.value is None or found.std is None:
            out[name] = None
            continue
        reference = max(abs(found.value), _SMALL * REGISTRY[name].reference.counterpart(sizes))
        out[name] = Z95 * found.std / reference if reference > 0.0 else None
    return out


def is_enough(found: Mapping[str, float | None], target: float) -> bool:
    """Whether every interval meets the target."""
    return bool(found) and all(share is not None and share <= target for share in found.values())


def excess(found: Mapping[str, float | None], target: float) -> float:
    """How far intervals are from the target: the sum of ln(share / target) of those beyond."""
    return sum(
        math.log(max(_FAR if share is None else min(share, _FAR), target) / target)
        for share in found.values()
    )


_FAR = 3.0
"""A share beyond which nothing is known in any case."""
